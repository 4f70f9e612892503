"""From a message definition to a small program that takes serialised messages apart.

The program is a table of instructions (one row each: operation, element size, count, target) that
`decode_kernels.decode` runs over all messages. Serialised form: CDR as ROS 2 uses it (XCDR1,
little endian), each primitive aligned to its size, counted from behind the 4-byte header.

Fields of nested messages get dotted names (`header.stamp`). Times and durations become one int64
in nanoseconds. A sequence, and every field of a sequence of messages, becomes a ragged column.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.message_definitions import Field

TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
MAX_LOOPS = 8

_DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8"}


class Op(IntEnum):
    """Operations. `target` is a fixed or ragged column, or -1 to skip the bytes; with LOOP and END
    the distance to the other one."""

    COPY = 0            # `count` elements of `size` bytes
    TIME = 1            # `count` times
    STRING = 2          # `count` strings, stored as codes into a dictionary
    RAGGED = 3          # like COPY, to a ragged column
    RAGGED_TIME = 4
    RAGGED_STRING = 5
    SEQUENCE = 6        # a length, then that many elements of `size` bytes
    LOOP = 7            # repeat up to END: `count` times, or as often as the length says (0)
    END = 8
    REST = 9            # leave the rest of the message alone


@dataclass(frozen=True)
class Column:
    """Where a field goes: `dtype` "" means text; `count` > 1 makes rows of that many elements."""

    name: str
    dtype: str
    count: int = 1

    @property
    def stored_dtype(self) -> np.dtype[np.generic]:
        """The type in memory while decoding (codes for text)."""
        return np.dtype(self.dtype or "i4")


@dataclass
class Plan:
    """The program for one message type, and the columns it fills.

    `left_out` names the fields that do not go into arrays, each with the reason.
    """

    fixed: list[Column] = field(default_factory=list)
    ragged: list[Column] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    instructions: list[tuple[int, int, int, int]] = field(default_factory=list)

    @property
    def program(self) -> NDArray[np.int64]:
        """The instructions, shape (n, 4)."""
        return np.array(self.instructions, dtype=np.int64).reshape(-1, 4)


class _StopError(Exception):
    """The rest of the message cannot be located."""


def compile_plan(definitions: Mapping[str, Sequence[Field]], type_name: str) -> Plan:
    """Return the plan for `type_name`; whatever cannot be put into arrays is named in it."""
    plan = Plan()
    try:
        _message(plan, definitions, type_name, "", depth=0, path=())
    except _StopError as reason:
        plan.left_out.append(str(reason))
        plan.instructions.append((Op.REST, 0, 0, -1))
    if any(op == Op.SEQUENCE or (op == Op.LOOP and count == 0)
           for op, _, count, _ in plan.instructions):
        plan.instructions.append((Op.REST, 0, 0, -1))   # Fast CDR leaves spare bytes behind these
    return plan


def _message(plan: Plan, definitions: Mapping[str, Sequence[Field]], type_name: str, prefix: str,
             depth: int, path: tuple[str, ...]) -> None:
    if type_name not in definitions:
        raise _StopError(f"{prefix or type_name} and what follows: {type_name} is not defined")
    if type_name in path:
        raise _StopError(f"{prefix} and what follows: {type_name} contains itself")
    if not definitions[type_name]:
        plan.instructions.append((Op.COPY, 1, 1, -1))   # a message without fields has one byte
    for item in definitions[type_name]:
        name = prefix + item.name
        if item.base in TIME_TYPES or item.base == "string" or item.base in _DTYPES:
            _leaf(plan, item, name, depth)
        elif item.base == "wstring":
            raise _StopError(f"{name} and what follows: wide strings are not supported")
        elif item.count is None:
            _message(plan, definitions, item.base, name + ".", depth, (*path, type_name))
        else:
            if depth + 1 > MAX_LOOPS:
                raise _StopError(f"{name} and what follows: nested too deep")
            start, columns = len(plan.instructions), len(plan.ragged)
            plan.instructions.append((Op.LOOP, 0, item.count, -1))
            try:
                _message(plan, definitions, item.base, name + ".", depth + 1, (*path, type_name))
            except _StopError as reason:
                del plan.instructions[start:], plan.ragged[columns:]
                raise _StopError(f"{name} and what follows, because of {reason}") from None
            turns = len(plan.instructions) - start
            plan.instructions.append((Op.END, 0, 0, -turns))
            plan.instructions[start] = (Op.LOOP, 0, item.count, turns)


def _leaf(plan: Plan, item: Field, name: str, depth: int) -> None:
    """Add one field of primitives, times or text."""
    time = item.base in TIME_TYPES
    text = item.base == "string"
    dtype = "i8" if time else "" if text else _DTYPES[item.base]
    size = 4 if time or text else np.dtype(dtype).itemsize
    count = 1 if item.count is None else item.count
    looped = depth > 0
    if count == 0 and (time or text):
        target = _ragged(plan, name, dtype, depth + 1)
        op = Op.RAGGED_TIME if time else Op.RAGGED_STRING
        plan.instructions += [(Op.LOOP, 0, 0, 2), (op, size, 1, target), (Op.END, 0, 0, -2)]
    elif count == 0:
        plan.instructions.append((Op.SEQUENCE, size, 0, _ragged(plan, name, dtype, depth + 1)))
    elif looped:
        op = Op.RAGGED_TIME if time else Op.RAGGED_STRING if text else Op.RAGGED
        plan.instructions.append((op, size, count, _ragged(plan, name, dtype, depth, count)))
    else:
        op = Op.TIME if time else Op.STRING if text else Op.COPY
        plan.instructions.append((op, size, count, len(plan.fixed)))
        plan.fixed.append(Column(name, dtype, count))


def _ragged(plan: Plan, name: str, dtype: str, depth: int, count: int = 1) -> int:
    if depth > 1:
        plan.left_out.append(f"{name}: a sequence inside a sequence")
        return -1
    plan.ragged.append(Column(name, dtype, count))
    return len(plan.ragged) - 1
