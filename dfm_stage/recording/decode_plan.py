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

MAX_LOOPS = 8
MOST_INSTRUCTIONS = 2000
"""Messages in messages multiply; the largest of ROS have a tenth of this."""

_TIME_TYPES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_DTYPES = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8"}


class Op(IntEnum):
    """Operations. `target` is a column, or -1 to skip the bytes: a fixed column outside of loops,
    a ragged one inside, and with SEQUENCE; with LOOP and END it is the distance to the other."""

    COPY = 0            # `count` elements of `size` bytes
    TIME = 1            # `count` times
    STRING = 2          # `count` strings, stored as codes into a dictionary
    SEQUENCE = 3        # a length, then that many elements of `size` bytes
    LOOP = 4            # repeat up to END: `count` times, or as often as the length says (0)
    END = 5
    REST = 6            # leave the rest of the message alone


_LEAVES: dict[str, tuple[Op, str, int]] = {
    **{base: (Op.COPY, dtype, np.dtype(dtype).itemsize) for base, dtype in _DTYPES.items()},
    **dict.fromkeys(_TIME_TYPES, (Op.TIME, "i8", 4)), "string": (Op.STRING, "", 4)}


@dataclass(frozen=True)
class Column:
    """Where a field goes: `dtype` "" means text; `count` > 1 makes rows of that many elements.

    `time` says that the numbers are times or durations in ns."""

    name: str
    dtype: str
    count: int = 1
    time: bool = field(default=False, compare=False)

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
    """Add the fields of a message inside `depth` loops; `path` names the messages around it."""
    if type_name not in definitions:
        raise _StopError(f"{prefix or type_name} and what follows: {type_name} is not defined")
    if type_name in path:
        raise _StopError(f"{prefix} and what follows: {type_name} contains itself")
    if not definitions[type_name]:
        plan.instructions.append((Op.COPY, 1, 1, -1))   # a message without fields has one byte
    path = (*path, type_name)
    for item in definitions[type_name]:
        name = prefix + item.name
        if len(plan.instructions) >= MOST_INSTRUCTIONS:
            raise _StopError(f"{name} and what follows: more than {MOST_INSTRUCTIONS} fields")
        if item.base in _LEAVES:
            _leaf(plan, item, name, depth)
        elif item.base == "wstring":
            raise _StopError(f"{name} and what follows: wide strings are not supported")
        elif item.count is None:
            _message(plan, definitions, item.base, name + ".", depth, path)
        else:
            _messages(plan, definitions, item, name, depth + 1, path)


def _messages(plan: Plan, definitions: Mapping[str, Sequence[Field]], item: Field, name: str,
              depth: int, path: tuple[str, ...]) -> None:
    """Add an array or sequence of messages: a loop, or nothing of it if a part cannot be read."""
    if depth > MAX_LOOPS:
        raise _StopError(f"{name} and what follows: nested too deep")
    start, columns = len(plan.instructions), len(plan.ragged)
    plan.instructions.append((Op.LOOP, 0, item.count or 0, -1))
    try:
        _message(plan, definitions, item.base, name + ".", depth, path)
    except _StopError as reason:
        del plan.instructions[start:], plan.ragged[columns:]
        raise _StopError(f"{name} and what follows, because of {reason}") from None
    turns = len(plan.instructions) - start
    plan.instructions.append((Op.END, 0, 0, -turns))
    plan.instructions[start] = (Op.LOOP, 0, item.count or 0, turns)


def _leaf(plan: Plan, item: Field, name: str, depth: int) -> None:
    """Add one field of primitives, times or text."""
    op, dtype, size = _LEAVES[item.base]
    if item.count != 0:
        column = Column(name, dtype, item.count or 1, op == Op.TIME)
        plan.instructions.append((op, size, column.count, _target(plan, column, depth)))
        return
    target = _target(plan, Column(name, dtype, time=op == Op.TIME), depth + 1)
    if op == Op.COPY:
        plan.instructions.append((Op.SEQUENCE, size, 0, target))
    else:
        plan.instructions += [(Op.LOOP, 0, 0, 2), (op, size, 1, target), (Op.END, 0, 0, -2)]


def _target(plan: Plan, column: Column, depth: int) -> int:
    """Add a column for a field inside `depth` loops; return its number, -1 if it is left out."""
    if depth > 1:
        plan.left_out.append(f"{column.name}: a sequence inside a sequence")
        return -1
    columns = plan.ragged if depth else plan.fixed
    columns.append(column)
    return len(columns) - 1
