"""Compiled loops that take serialised messages apart, by the program of a plan.

Each instruction runs over all messages before the next one does. No loop trusts its data: a
message that does not fit its definition is reported instead of decoded.

As long as a field stands at the same place in every message, which only a text or a sequence of
changing length ends, that place is kept once (`common`) instead of for each message (`at`).
"""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.decode_plan import Op
from dfm_stage.recording.numba_tools import (
    CDR_HEAD,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Bytes,
    Ints,
    compiled,
    entry,
    u32,
    u64,
)
from dfm_stage.recording.ragged_kernels import intern, loop, sequence, texts

TRAILING = 8            # more bytes than this behind the last field: not this definition

_COPY, _TIME, _STRING = int(Op.COPY), int(Op.TIME), int(Op.STRING)
_SEQUENCE, _LOOP, _REST = int(Op.SEQUENCE), int(Op.LOOP), int(Op.REST)


@compiled
def _start(data: Bytes, offsets: Ints, row: int, arena: Bytes, bases: Ints, start: Ints, end: Ints,
           at: Ints) -> None:
    """Store what the records say of their messages; find where the messages begin and end."""
    arena4 = arena.view(np.uint32)
    arena8 = arena.view(np.uint64)
    log_base, publish_base = bases[0] // 8 + row, bases[1] // 8 + row
    sequence_base = bases[2] // 4 + row
    for m in range(len(offsets)):
        record = offsets[m]
        sequence = u32(data, record + 11)
        arena8[log_base + m] = u64(data, record + 15)
        arena8[publish_base + m] = u64(data, record + 23)
        arena4[sequence_base + m] = sequence
        head = record + MESSAGE_HEAD
        start[m] = head + CDR_HEAD
        end[m] = record + RECORD_HEAD + np.int64(u64(data, record + 1))
        little_endian = (end[m] >= start[m] and data[head] == 0 and data[head + 1] == 1)
        at[m] = start[m] if little_endian else -1


@compiled
def _shortest(start: Ints, end: Ints, at: Ints) -> int:
    """Return the size of the shortest message, -1 if one of them is bad."""
    shortest = end[0] - start[0] if len(at) else -1
    for m in range(len(at)):
        shortest = min(shortest, end[m] - start[m] if at[m] >= 0 else -1)
    return int(shortest)


@compiled
def _spread(start: Ints, common: int, at: Ints) -> None:
    for m in range(len(at)):
        at[m] = start[m] + common


@compiled
def _copy_common(data: Bytes, start: Ints, common: int, size: int, count: int, arena: Bytes,
                 to: int) -> None:
    """`_copy` where the elements stand `common` behind the start of every message."""
    arena4 = arena.view(np.uint32)
    arena8 = arena.view(np.uint64)
    for k in range(count):
        place, first = common + k * size, to // size + k
        if size == 8:
            for m in range(len(start)):
                arena8[first + m * count] = u64(data, start[m] + place)
        elif size == 4:
            for m in range(len(start)):
                arena4[first + m * count] = u32(data, start[m] + place)
        else:
            for m in range(len(start)):
                for b in range(size):
                    arena[size * (first + m * count) + b] = data[start[m] + place + b]


@compiled
def _times_common(data: Bytes, start: Ints, common: int, count: int, arena: Bytes,
                  to: int) -> None:
    """`_times` where they stand `common` behind the start of every message."""
    arena8 = arena.view(np.int64)
    for k in range(count):
        place, first = common + 8 * k, to // 8 + k
        for m in range(len(start)):
            seconds = np.int64(np.int32(u32(data, start[m] + place)))
            arena8[first + m * count] = (seconds * 1000000000
                                         + np.int64(u32(data, start[m] + place + 4)))


@compiled
def _text_common(data: Bytes, start: Ints, common: int, length: int, arena: Bytes, to: int,
                 entries: Ints, n_entries: int) -> int:
    """Store the codes of a text of `length` bytes that stands `common` behind every start.

    Returns the size of the dictionary, or -1 at the first text of another length.
    """
    codes = arena.view(np.int32)
    code = -1
    for m in range(len(start)):
        place = start[m] + common
        if np.int64(u32(data, place)) != length:
            return -1
        code = intern(data, place + 4, max(length - 1, 0), code, entries, n_entries)
        n_entries = max(n_entries, code + 1)
        codes[to // 4 + m] = code
    return n_entries


@compiled
def _common(data: Bytes, start: Ints, shortest: int, common: int, instruction: Ints, arena: Bytes,
            to: int, entries: Ints, n_entries: int) -> tuple[int, int]:
    """Run an instruction whose operands stand at the same place in every message.

    Returns (the place behind them, size of the dictionary); the place is -1 if they do not, and
    the instruction is to be run again message by message.
    """
    op, size, count = instruction[0], instruction[1], instruction[2]
    if op > _STRING or (op == _STRING and (count > 1 or to < 0)):
        return -1, n_entries
    place = common + (-common & (size - 1))
    behind = place + (8 if op == _TIME else size) * count
    if behind > shortest:
        return -1, n_entries
    if op == _COPY:
        if to >= 0:
            _copy_common(data, start, place, size, count, arena, to)
    elif op == _TIME:
        _times_common(data, start, place, count, arena, to)
    else:
        length = np.int64(u32(data, start[0] + place))
        behind += length
        if behind > shortest:
            return -1, n_entries
        found = _text_common(data, start, place, length, arena, to, entries, n_entries)
        if found < 0:
            return -1, n_entries
        n_entries = found
    return behind, n_entries


@compiled
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
                    arena8[first // 8 + k] = u64(data, place + 8 * k)
            elif size == 4:
                for k in range(count):
                    arena4[first // 4 + k] = u32(data, place + 4 * k)
            else:
                for k in range(size * count):
                    arena[first + k] = data[place + k]


@compiled
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
            seconds = np.int64(np.int32(u32(data, place + 8 * k)))
            arena8[to // 8 + m * count + k] = (seconds * 1000000000
                                               + np.int64(u32(data, place + 8 * k + 4)))


@compiled
def _each(data: Bytes, start: Ints, end: Ints, at: Ints, program: Ints, arena: Bytes, to: int,
          ragged: Bytes, used: Ints, last: Ints, ragged_ends: Ints, entries: Ints,
          n_entries: int) -> int:
    """Run the first instruction of `program` message by message; return the dictionary's size."""
    op, size, count, target = program[0, 0], program[0, 1], program[0, 2], program[0, 3]
    if op == _COPY:
        _copy(data, start, end, at, size, count, arena, to)
    elif op == _TIME:
        _times(data, start, end, at, count, arena, to)
    elif op == _STRING:
        n_entries = texts(data, start, end, at, count, arena, to, entries, n_entries)
    elif op == _SEQUENCE:
        sequence(data, start, end, at, size, ragged[target], target >= 0, ragged_ends[target])
    elif op == _LOOP:
        n_entries = loop(data, start, end, at, program[:1 + target], ragged, used, last,
                         ragged_ends, entries, n_entries)
    elif op == _REST:
        for m in range(len(at)):
            if at[m] >= 0:
                at[m] = end[m]
    return n_entries


@entry
def decode(data: Bytes, offsets: Ints, row: int, program: Ints, arena: Bytes, bases: Ints,
           ragged: Bytes, ragged_ends: Ints, entries: Ints, bad: Ints) -> tuple[int, int]:
    """Decode the messages at `offsets` into the columns in `arena`, from row `row` on.

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
    start = np.empty(len(offsets), np.int64)
    end = np.empty(len(offsets), np.int64)
    at = np.empty(len(offsets), np.int64)
    _start(data, offsets, row, arena, bases, start, end, at)
    used = np.zeros(ragged.shape[0], np.int64)
    last = np.full(ragged.shape[0], -1, np.int64)
    shortest = _shortest(start, end, at)
    common = 0 if shortest >= 0 else -1
    n_entries = 0
    pc = 0
    while pc < program.shape[0]:
        op, size, count, target = (program[pc, 0], program[pc, 1], program[pc, 2], program[pc, 3])
        to = -1
        if op <= _STRING and target >= 0:
            to = bases[3 + target] + row * count * (8 if op == _TIME else size)
        if common >= 0:
            behind, n_entries = _common(data, start, shortest, common, program[pc], arena, to,
                                        entries, n_entries)
            if behind < 0:
                _spread(start, common, at)
            common = behind
        if common < 0:
            n_entries = _each(data, start, end, at, program[pc:], arena, to, ragged, used, last,
                              ragged_ends, entries, n_entries)
        pc += 1 + (target if op == _LOOP else 0)
    if common >= 0:
        _spread(start, common, at)
    n_bad = 0
    for m in range(len(at)):
        if at[m] < 0 or end[m] - at[m] > TRAILING:
            bad[n_bad] = m
            n_bad += 1
    return n_bad, n_entries
