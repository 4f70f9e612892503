"""Compiled loops over MCAP records and serialised messages; importing this imports numba.

No loop trusts its data: every read is inside the bounds it was given, and a message that does not
fit its definition is reported instead of decoded.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from dfm_stage.recording.decode_plan import MAX_LOOPS, Op

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

MESSAGE = 5
SCHEMA = 3
CHANNEL = 4
RECORD_HEAD = 9
MESSAGE_HEAD = 31       # record head, channel, sequence, log time, publish time
CDR_HEAD = 4
TRAILING = 8            # more bytes than this behind the last field: not this definition

_COPY, _TIME, _STRING = int(Op.COPY), int(Op.TIME), int(Op.STRING)
_RAGGED, _RAGGED_TIME, _RAGGED_STRING = int(Op.RAGGED), int(Op.RAGGED_TIME), int(Op.RAGGED_STRING)
_SEQUENCE, _LOOP, _END, _REST = int(Op.SEQUENCE), int(Op.LOOP), int(Op.END), int(Op.REST)

Function = TypeVar("Function", bound=Callable[..., Any])


def _compiled(function: Function) -> Function:
    return cast("Function", numba.njit(cache=True, nogil=True)(function))


def _loader(bits: int) -> Any:
    """Return a compiled `load(data, at)`: the little-endian integer of `bits` at byte `at`."""
    word = ir.IntType(bits)
    result = getattr(types, f"uint{bits}")

    def load(_typing: Any, data: Any, _at: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            array = context.make_array(signature.args[0])(context, builder, arguments[0])
            place = builder.gep(array.data, [arguments[1]])
            value = builder.load(builder.bitcast(place, word.as_pointer()))
            value.align = 1
            return value

        return result(data, types.int64), generate

    return intrinsic(load)


_u16 = _loader(16)
_u32 = _loader(32)
_u64 = _loader(64)


@_compiled
def survey(data: Bytes, counts: Ints, definitions: Ints) -> tuple[int, int]:
    """Count the messages of each channel and list where schemas and channels stand.

    Parameters
    ----------
    counts : (65536,) int64
        Increased, by channel id.
    definitions : (n,) int64
        Filled with the offsets of schema and channel records; more than n are not listed.

    Returns
    -------
    (where the last whole record ends, how many definitions were found)
    """
    at = 0
    found = 0
    size = len(data)
    while size - at >= RECORD_HEAD:
        opcode = data[at]
        length = np.int64(_u64(data, at + 1))
        if length < 0 or length > size - at - RECORD_HEAD:
            break
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD - RECORD_HEAD:
                break
            counts[np.int64(_u16(data, at + RECORD_HEAD))] += 1
        elif opcode in (SCHEMA, CHANNEL):
            if found < len(definitions):
                definitions[found] = at
            found += 1
        elif opcode == 0:
            break
        at += RECORD_HEAD + length
    return at, found


@_compiled
def locate(data: Bytes, slots: NDArray[np.int32], cursors: Ints, ends: Ints,
           offsets: Ints) -> tuple[int, int]:
    """Write the offset of every message of a wanted channel into its slot's part of `offsets`.

    Parameters
    ----------
    slots : (65536,) int32
        Slot of each channel id, -1 if not wanted.
    cursors, ends : (n_slots,) int64
        Where the next offset of a slot goes (advanced), and where its part ends.

    Returns
    -------
    (where the last whole record ends, messages that found no room)
    """
    at = 0
    surplus = 0
    size = len(data)
    while size - at >= RECORD_HEAD:
        length = np.int64(_u64(data, at + 1))
        if length < 0 or length > size - at - RECORD_HEAD:
            break
        opcode = data[at]
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD - RECORD_HEAD:
                break
            slot = slots[np.int64(_u16(data, at + RECORD_HEAD))]
            if slot >= 0:
                cursor = cursors[slot]
                if cursor < ends[slot]:
                    offsets[cursor] = at
                    cursors[slot] = cursor + 1
                else:
                    surplus += 1
        elif opcode == 0:
            break
        at += RECORD_HEAD + length
    return at, surplus


@_compiled
def _intern(data: Bytes, at: int, size: int, code: int, entries: Ints, n_entries: int) -> int:
    """Return the code of the text at `at`: `code` if it is that text, or a new one."""
    if code >= 0 and entries[code, 1] == size:
        start = entries[code, 0]
        k = 0
        while k < size and data[start + k] == data[at + k]:
            k += 1
        if k == size:
            return code
    entries[n_entries, 0] = at
    entries[n_entries, 1] = size
    return n_entries


@_compiled
def _start(data: Bytes, offsets: Ints, row: int, arena: Bytes, bases: Ints, start: Ints, end: Ints,
           at: Ints) -> None:
    """Store what the records say of their messages; find where the messages begin and end."""
    arena4 = arena.view(np.uint32)
    arena8 = arena.view(np.uint64)
    log_base, publish_base = bases[0] // 8 + row, bases[1] // 8 + row
    sequence_base = bases[2] // 4 + row
    for m in range(len(offsets)):
        record = offsets[m]
        sequence = _u32(data, record + 11)
        arena8[log_base + m] = _u64(data, record + 15)
        arena8[publish_base + m] = _u64(data, record + 23)
        arena4[sequence_base + m] = sequence
        head = record + MESSAGE_HEAD
        start[m] = head + CDR_HEAD
        end[m] = record + RECORD_HEAD + np.int64(_u64(data, record + 1))
        little_endian = (end[m] >= start[m] and data[head] == 0 and data[head + 1] == 1)
        at[m] = start[m] if little_endian else -1


@_compiled
def _copy(data: Bytes, start: Ints, end: Ints, at: Ints, size: int, count: int, arena: Bytes,
          to: int) -> None:
    """Copy `count` elements of `size` bytes of every message to byte `to` on; skip if `to` < 0."""
    arena4 = arena.view(np.uint32)
    arena8 = arena.view(np.uint64)
    for m in range(len(at)):
        place = at[m]
        if place < 0:
            continue
        place += (start[m] - place) & (size - 1)
        at[m] = place + size * count
        if at[m] > end[m]:
            at[m] = -1
        elif to >= 0:
            first = to + m * size * count
            if size == 8:
                for k in range(count):
                    arena8[first // 8 + k] = _u64(data, place + 8 * k)
            elif size == 4:
                for k in range(count):
                    arena4[first // 4 + k] = _u32(data, place + 4 * k)
            else:
                for k in range(size * count):
                    arena[first + k] = data[place + k]


@_compiled
def _times(data: Bytes, start: Ints, end: Ints, at: Ints, count: int, arena: Bytes,
           to: int) -> None:
    """Store `count` times of every message, in ns, from byte `to` on."""
    arena8 = arena.view(np.int64)
    for m in range(len(at)):
        place = at[m]
        if place < 0:
            continue
        place += (start[m] - place) & 3
        at[m] = place + 8 * count
        if at[m] > end[m]:
            at[m] = -1
            continue
        for k in range(count):
            seconds = np.int64(np.int32(_u32(data, place + 8 * k)))
            arena8[to // 8 + m * count + k] = (seconds * 1000000000
                                               + np.int64(_u32(data, place + 8 * k + 4)))


@_compiled
def _texts(data: Bytes, start: Ints, end: Ints, at: Ints, count: int, arena: Bytes, to: int,
           entries: Ints, n_entries: int) -> int:
    """Store the codes of `count` texts of every message from byte `to` on (skip if `to` < 0);
    return the size of the dictionary."""
    codes = arena.view(np.int32)
    code = -1
    for m in range(len(at)):
        for k in range(count):
            place = at[m]
            if place < 0:
                break
            place += (start[m] - place) & 3
            if place + 4 > end[m]:
                at[m] = -1
                break
            length = np.int64(_u32(data, place))
            place += 4
            if length > end[m] - place:
                at[m] = -1
                break
            at[m] = place + length
            if to >= 0:
                code = _intern(data, place, max(length - 1, 0), code, entries, n_entries)
                n_entries = max(n_entries, code + 1)
                codes[to // 4 + m * count + k] = code
    return n_entries


@_compiled
def _sequence(data: Bytes, start: Ints, end: Ints, at: Ints, size: int, values: Bytes,
              wanted: bool, ends: Ints) -> None:
    """Append the sequence of primitives of every message to `values`; note how far it reaches."""
    used = 0
    for m in range(len(at)):
        place = at[m]
        length = -1
        if place >= 0:
            place += (start[m] - place) & 3
            if place + 4 <= end[m]:
                length = np.int64(_u32(data, place)) * size
                place += 4
                if length:
                    place += (start[m] - place) & (size - 1)
        if length < 0 or length > end[m] - place:
            at[m] = -1
            length = 0
        else:
            at[m] = place + length
        if wanted:
            for k in range(length):
                values[used + k] = data[place + k]
            used += length
            ends[m] = used


@_compiled
def _loop(data: Bytes, start: Ints, end: Ints, at: Ints, program: Ints, ragged: Bytes,
          used: Ints, last: Ints, ends: Ints, entries: Ints, n_entries: int) -> int:
    """Run the part of a program from a LOOP to its END over every message, one after the other;
    return the size of the dictionary."""
    turns = np.zeros(MAX_LOOPS + 2, np.int64)
    for m in range(len(at)):
        depth = pc = 0
        while at[m] >= 0 and pc < program.shape[0]:
            op, size, count, target = (program[pc, 0], program[pc, 1], program[pc, 2],
                                       program[pc, 3])
            pc += 1
            if op == _LOOP:
                turns[depth] = count or _length(data, start, end, at, m)
                if turns[depth] > 0:
                    depth += 1
                else:
                    pc += target
            elif op == _END:
                turns[depth - 1] -= 1
                if turns[depth - 1] > 0:
                    pc += target
                else:
                    depth -= 1
            else:
                if op == _SEQUENCE:
                    count = _length(data, start, end, at, m)
                    op = _RAGGED if count else _END
                for _ in range(count if op != _RAGGED else 1):
                    n_entries = _element(data, start, end, at, m, op, size, count, target, ragged,
                                         used, last, entries, n_entries)
        for pc in range(program.shape[0]):
            if program[pc, 0] not in (_LOOP, _END) and program[pc, 3] >= 0:
                ends[program[pc, 3], m] = used[program[pc, 3]]
    return n_entries


@_compiled
def _length(data: Bytes, start: Ints, end: Ints, at: Ints, m: int) -> int:
    """Read the length of a sequence; 0 and the message marked as bad if it is impossible."""
    place = at[m] + ((start[m] - at[m]) & 3)
    if place + 4 <= end[m]:
        length = np.int64(_u32(data, place))
        if length <= end[m] - place - 4:
            at[m] = place + 4
            return int(length)
    at[m] = -1
    return 0


@_compiled
def _element(data: Bytes, start: Ints, end: Ints, at: Ints, m: int, op: int, size: int, count: int,
             target: int, ragged: Bytes, used: Ints, last: Ints, entries: Ints,
             n_entries: int) -> int:
    """Append `count` primitives, or one time or text, of one message to a ragged column."""
    place = at[m]
    if place < 0:
        return n_entries
    place += (start[m] - place) & (size - 1)
    length = size * count
    if op == _RAGGED_TIME:
        length = 8
    elif op == _RAGGED_STRING:
        length = 4
        if place + 4 <= end[m]:
            length += np.int64(_u32(data, place))
    if length > end[m] - place:
        at[m] = -1
        return n_entries
    at[m] = place + length
    if target < 0:
        return n_entries
    to = used[target]
    values = ragged[target]
    if op == _RAGGED_STRING:
        code = _intern(data, place + 4, max(length - 5, 0), last[target], entries, n_entries)
        last[target] = code
        n_entries = max(n_entries, code + 1)
        values.view(np.int32)[to // 4] = code
        length = 4
    elif op == _RAGGED_TIME:
        seconds = np.int64(np.int32(_u32(data, place)))
        values.view(np.int64)[to // 8] = seconds * 1000000000 + np.int64(_u32(data, place + 4))
    else:
        for k in range(length):
            values[to + k] = data[place + k]
    used[target] = to + length
    return n_entries


@_compiled
def decode(data: Bytes, offsets: Ints, row: int, program: Ints, arena: Bytes, bases: Ints,
           ragged: Bytes, ragged_ends: Ints, entries: Ints, bad: Ints) -> tuple[int, int]:
    """Decode the messages at `offsets` into the columns in `arena`, from row `row` on.

    Each instruction runs over all messages before the next one does.

    Parameters
    ----------
    bases : (3 + n_fixed,) int64
        Byte offset in `arena` of log time, publish time, sequence and the fixed columns.
    ragged : (n_ragged, n) uint8
        Receives the elements of the ragged columns, tightly packed; n is a multiple of 8 and at
        least the size of `data`.
    ragged_ends : (n_ragged, n_messages) int64
        Filled: bytes of the column used after each message.
    entries : (n, 2) int64
        Filled: offset and length in `data` of each distinct text; n at least a quarter of `data`.
    bad : (n_messages,) int64
        Filled: which messages do not fit the definition (index into `offsets`).

    Returns
    -------
    (number of bad messages, number of texts)
    """
    count_all = len(offsets)
    start = np.empty(count_all, np.int64)
    end = np.empty(count_all, np.int64)
    at = np.empty(count_all, np.int64)
    _start(data, offsets, row, arena, bases, start, end, at)
    used = np.zeros(ragged.shape[0], np.int64)
    last = np.full(ragged.shape[0], -1, np.int64)
    n_entries = 0
    pc = 0
    while pc < program.shape[0]:
        op, size, count, target = (program[pc, 0], program[pc, 1], program[pc, 2], program[pc, 3])
        to = -1
        if op <= _STRING and target >= 0:
            to = bases[3 + target] + row * count * (8 if op == _TIME else size)
        pc += 1
        if op == _COPY:
            _copy(data, start, end, at, size, count, arena, to)
        elif op == _TIME:
            _times(data, start, end, at, count, arena, to)
        elif op == _STRING:
            n_entries = _texts(data, start, end, at, count, arena, to, entries, n_entries)
        elif op == _SEQUENCE:
            _sequence(data, start, end, at, size, ragged[target], target >= 0,
                      ragged_ends[target])
        elif op == _LOOP:
            n_entries = _loop(data, start, end, at, program[pc - 1:pc + target], ragged, used,
                              last, ragged_ends, entries, n_entries)
            pc += target
        elif op == _REST:
            for m in range(count_all):
                if at[m] >= 0:
                    at[m] = end[m]
    n_bad = 0
    for m in range(count_all):
        if at[m] < 0 or end[m] - at[m] > TRAILING:
            bad[n_bad] = m
            n_bad += 1
    return n_bad, n_entries
