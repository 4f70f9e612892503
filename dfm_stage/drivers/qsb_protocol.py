"""What a US Digital QSB quadrature counter says and understands: bytes to meaning and back.

Commands are `R`, `W` or `S` (read, write, stream), a register as two hexadecimal digits and up to
eight digits of data, ended by CR. Replies repeat letter and register in the form that register 15
sets: with or without spaces, time stamp, CR and LF. Sources: the maker's QSB Commands List and
fielded drivers; what neither settles is marked [?].
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from dfm_stage.drivers.errors import ProtocolError

BAUD = 230400
TICKS_PER_SECOND = 512
BANNER = b"QSB-D  0E!\r\n"
RELEASED_INTERVAL = 0xFFFF


class Register(IntEnum):
    """Registers that the driver uses."""

    MODE = 0x00
    QUADRATURE = 0x03
    DIRECTION = 0x04
    STATUS = 0x06
    PRESET = 0x08
    COUNTER_COMMAND = 0x09
    LOAD_PRESET = 0x0A
    THRESHOLD = 0x0B
    INTERVAL = 0x0C
    TIMESTAMP = 0x0D
    COUNT = 0x0E
    IDENTITY = 0x14
    FORMAT = 0x15
    STOP_STREAMS = 0x16


class Format(IntFlag):
    """Bits of register 15."""

    LF = 1
    CR = 2
    TIMESTAMP = 4
    SPACES = 8


FACTORY_FORMAT = Format.SPACES | Format.CR | Format.LF


class Status(IntFlag):
    """Bits of register 06 (bits 5 to 7 tell of the comparator and of over- and underflow)."""

    SIGN = 1
    UP = 2
    POWER_LOSS = 4
    COUNT_ENABLED = 8
    INDEX = 16


STOP_STREAMS = b"W161\r"
SET_FORMAT = b"W15F\r"
READ_IDENTITY = b"R14\r"
QUADRATURE_MODE = b"W000\r"
FREE_RUNNING = b"W0303\r"
RESET_ON_INDEX = b"W0363\r"
COUNT_UP = b"W040\r"
NO_THRESHOLD = b"W0B0\r"
RESET_TIMESTAMP = b"W0D1\r"
STREAM_COUNT = b"S0E\r"
READ_STATUS = b"R06\r"


def set_interval(ticks: int) -> bytes:
    """Return the command for a stream interval of `ticks` / 512 s."""
    if not 1 <= ticks <= RELEASED_INTERVAL:
        raise ProtocolError(f"stream interval of {ticks} ticks: 1 to {RELEASED_INTERVAL}")
    return b"W0C%X\r" % ticks


@dataclass(frozen=True)
class Reply:
    """One reply. `kind` is r, w, s, e (bad value, nothing written) or x (not supported)."""

    kind: str
    register: int
    data: int
    timestamp: int | None = None

    @property
    def refused(self) -> bool:
        """Whether the device refused the command."""
        return self.kind in "ex"


_REPLY = re.compile(rb"([rwsex])( ?)([0-9A-F]{2})\2([0-9A-F]{8})(?:\2([0-9A-F]{8}))?\2!")
_BANNER = re.compile(rb"QSB-[A-Z]\s+[0-9A-F]{2}!")


def parse_reply(line: bytes) -> Reply:
    """Return the meaning of one line, its end already removed.

    Raises
    ------
    ProtocolError
        If it is not a complete, well-formed reply. There is no checksum: this is all there is.
    """
    found = _REPLY.fullmatch(line)
    if found is None:
        raise ProtocolError(f"not a QSB reply: {line[:40]!r}")
    kind, _, register, data, stamp = found.groups()
    return Reply(kind.decode(), int(register, 16), int(data, 16),
                 None if stamp is None else int(stamp, 16))


def is_banner(line: bytes) -> bool:
    """Return whether a line is what the device says after a reset."""
    return _BANNER.fullmatch(line) is not None


@dataclass(frozen=True)
class Identity:
    """Register 14: five digits of serial number, one of type, two of firmware."""

    serial: int
    type: str
    firmware: int

    @classmethod
    def of(cls, data: int) -> Identity:
        """Return the identity in the value of register 14."""
        kind = data >> 8 & 0xF
        return cls(data >> 12, "DMS"[kind] if kind < 3 else f"?{kind:X}", data & 0xFF)

    @property
    def data(self) -> int:
        """The value of register 14."""
        return self.serial << 12 | "DMS".index(self.type) << 8 | self.firmware

    def __str__(self) -> str:
        return f"QSB-{self.type} serial {self.serial:05X} firmware {self.firmware:02X}"


def render_reply(reply: Reply, form: Format) -> bytes:
    """Return the bytes of a reply in the given form, as the device sends them."""
    space = b" " if form & Format.SPACES else b""
    stamp = [b"%08X" % (reply.timestamp or 0)] if form & Format.TIMESTAMP else []
    end = (b"\r" if form & Format.CR else b"") + (b"\n" if form & Format.LF else b"")
    return space.join([reply.kind.encode(), b"%02X" % reply.register, b"%08X" % reply.data,
                       *stamp, b"!"]) + end
