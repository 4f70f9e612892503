"""Loop messages as CDR bytes, packed and unpacked by `struct` with a layout taken from the type.

At 1 kHz and above the time of a Python node goes into building and taking apart message objects:
deserialising a Measurement costs rclpy 9 us, unpacking the same bytes here 0.3 us. What packs is
written as Python source for each type, as `namedtuple` does it: with the fields of the type as
arguments it takes less than half the time of a function for any fields. The bytes are those of the
generated message (a test compares them with rclpy's own serialisation), publishers and
subscriptions stay typed, so other nodes, recorders and tools see ordinary messages.

Only flat messages qualify: a std_msgs/Header first, then primitive fields and builtin_interfaces
times. Layout: OMG CDR (XCDR1), little endian, alignment counted from the end of the 4-byte
encapsulation header.
"""

from __future__ import annotations

import struct
from collections import namedtuple
from collections.abc import Callable
from functools import cache
from typing import Any

from dfm_stage.errors import DfmError

ENCAPSULATION = b"\x00\x01\x00\x00"
_FORMATS = {
    "boolean": ("?", 1), "octet": ("B", 1), "uint8": ("B", 1), "int8": ("b", 1),
    "uint16": ("H", 2), "int16": ("h", 2), "uint32": ("I", 4), "int32": ("i", 4),
    "uint64": ("Q", 8), "int64": ("q", 8), "float": ("f", 4), "double": ("d", 8),
}
NS = 1_000_000_000


class WireError(DfmError):
    """Bytes that are not the message they are said to be."""


_new_tuple = tuple.__new__
"""As `namedtuple` makes one, without its check of the arguments."""
_STAMP = struct.Struct("<iI")
_HEADER = struct.Struct("<iII")


def encode_clock(stamp_ns: int) -> bytes:
    """Return a serialised rosgraph_msgs/Clock."""
    return ENCAPSULATION + _STAMP.pack(*divmod(stamp_ns, NS))


_JOINT = struct.Struct("<iIIx3xII")


def encode_joint_state(stamp_ns: int, name: bytes, position: float) -> bytes:
    """Return a serialised sensor_msgs/JointState of one joint: no frame, velocity or effort."""
    begin = _JOINT.pack(*divmod(stamp_ns, NS), 1, 1, len(name) + 1) + name
    begin += bytes(1 + -(len(begin) + 1) % 4) + _ONE
    return ENCAPSULATION + begin + bytes(-len(begin) % 8) + _LAST_OF_JOINT.pack(position, 0, 0)


_ONE = struct.pack("<I", 1)
_LAST_OF_JOINT = struct.Struct("<dII")


class Codec:
    """Packs and unpacks one message type.

    `encode(stamp_ns, *fields)` gives the serialised message; a field of the wrong type raises
    struct.error. `decode(data)` gives a named tuple `(stamp_ns, *fields)`, and
    `pair(stamp_ns, *fields)` both: the message and what decoding it would give. A
    builtin_interfaces/Time field `measurement_stamp` travels as nanoseconds under the name
    `measurement_stamp_ns`.
    """

    def __init__(self, message_type: Any, frame_id: str = "") -> None:
        fields = message_type.get_fields_and_field_types()
        if next(iter(fields.values()), None) != "std_msgs/Header":
            raise WireError(f"{message_type.__name__}: the first field must be std_msgs/Header")
        self._kinds: list[tuple[str, str]] = []
        names = ["stamp_ns"]
        self._times: list[int] = []
        for name, kind in list(fields.items())[1:]:
            if kind == "builtin_interfaces/Time":
                self._times.append(len(names))
                names.append(f"{name}_ns")
                self._kinds += [(name, "int32"), (name, "uint32")]
            elif kind in _FORMATS:
                names.append(name)
                self._kinds.append((name, kind))
            else:
                raise WireError(f"{message_type.__name__}.{name}: {kind} is not a flat field")
        self.type = message_type
        self._tuple: Any = namedtuple(  # type: ignore[misc]  # noqa: PYI024
            f"{message_type.__name__}Fields", names)
        frame = frame_id.encode() + b"\x00"
        body, padding = self._layout(len(frame))
        self.encode, self.pair = self._written(struct.Struct(
            f"<4siI{len(frame) + 4}s{body.format[1:]}{padding}x"), names,
            struct.pack("<I", len(frame)) + frame)
        self._body_by_frame: dict[int, struct.Struct] = {len(frame): body}

    def _layout(self, frame_length: int) -> tuple[struct.Struct, int]:
        offset = _HEADER.size + frame_length
        parts = []
        for _, kind in self._kinds:
            code, size = _FORMATS[kind]
            padding = -offset % size
            parts.append(f"{padding}x{code}" if padding else code)
            offset += padding + size
        # DDS pads what goes between processes to a multiple of 4; so that composed nodes give
        # the same bytes, it is done here. Not needed to decode: it may be missing.
        return struct.Struct("<" + "".join(parts)), -offset % 4

    def _written(self, layout: struct.Struct, names: list[str],
                 frame: bytes) -> tuple[Callable[..., bytes], Callable[..., tuple[bytes, Any]]]:
        """Return `encode` and `pair`, made from their source."""
        values = [f"{name} // {NS}, {name} % {NS}" if index in (0, *self._times) else name
                  for index, name in enumerate(names)]
        packed = f"_pack({ENCAPSULATION!r}, {values[0]}, {frame!r}, {', '.join(values[1:])})"
        arguments = ", ".join(names)
        encode, pair = eval(  # noqa: S307 of names that message types may have
            f"lambda {arguments}: {packed}, "
            f"lambda {arguments}: ({packed}, _new(_kind, ({arguments},)))",
            {"_pack": layout.pack, "_new": _new_tuple, "_kind": self._tuple})
        return encode, pair

    def decode(self, data: bytes) -> Any:
        """Return the fields of a serialised message.

        Raises
        ------
        WireError
            If the bytes are too short for the type or not little-endian CDR.
        """
        try:
            sec, nanosec, length = _HEADER.unpack_from(data, 4)
            body = self._body_by_frame.get(length)
            if body is None:
                if data[1] != 1 or length > len(data):
                    raise WireError(f"{self.type.__name__}: not little-endian CDR")
                body = self._body_by_frame[length] = self._layout(length)[0]
            values = body.unpack_from(data, 16 + length)
        except (struct.error, IndexError) as error:
            raise WireError(f"{self.type.__name__}: {len(data)} bytes, {error}") from error
        if self._times:
            values = self._join_times(values)
        return _new_tuple(self._tuple, (sec * NS + nanosec, *values))

    def _join_times(self, values: tuple[Any, ...]) -> tuple[Any, ...]:
        out = list(values)
        for index in self._times:
            out[index - 1:index + 1] = [values[index - 1] * NS + values[index]]
        return tuple(out)


@cache
def codec(message_type: Any, frame_id: str = "") -> Codec:
    """Return the (shared) codec of a message type."""
    return Codec(message_type, frame_id)
