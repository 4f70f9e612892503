"""Compiled loops that take serialised messages apart, by the program of a plan.

Each instruction runs over all messages before the next one does. No loop trusts its data: a
message that does not fit its definition is reported instead of decoded.

As long as a field stands at the same place in every message, which only a text or a sequence of
changing length ends, that place is kept once (`common`) instead of for each message (`at`).
"""

from __future__ import annotations

from collections.abc import Callable

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
    put_u32,
    put_u64,
    u32,
    u64,
)
from dfm_stage.recording.ragged_kernels import (
    copy_4,
    copy_8,
    copy_bytes,
    copy_time,
    intern,
    loop,
    sequence,
    step,
    text,
)

TRAILING = 8            # more bytes than this behind the last field: not this definition

_TIME, _STRING = int(Op.TIME), int(Op.STRING)
_SEQUENCE, _LOOP = int(Op.SEQUENCE), int(Op.LOOP)


@compiled
def _start(data: Bytes, offsets: Ints, row: int, arena: Bytes, bases: Ints, start: Ints, end: Ints,
           at: Ints) -> None:
    """Store what the records say of their messages; find where the messages begin and end."""
    for m in range(len(offsets)):
        record = offsets[m]
        put_u64(arena, bases[0] + 8 * (row + m), u64(data, record + 15))
        put_u64(arena, bases[1] + 8 * (row + m), u64(data, record + 23))
        put_u32(arena, bases[2] + 4 * (row + m), u32(data, record + 11))
        head = record + MESSAGE_HEAD
        start[m] = head + CDR_HEAD
        end[m] = record + RECORD_HEAD + np.int64(u64(data, record + 1))
        little_endian = (end[m] >= start[m] and data[head] == 0 and data[head + 1] == 1)
        at[m] = start[m] if little_endian else -1


def _over_messages(copy: Callable[..., None]) -> Callable[..., None]:
    """Return a compiled loop that does `copy` for every message: one loop for each kind of
    element is twice as fast as one loop that asks for the kind each time."""
    @compiled
    def run(data: Bytes, start: Ints, end: Ints, at: Ints, common: int, alignment: int, size: int,
            arena: Bytes, to: int, stride: int) -> None:
        if common >= 0:
            for m in range(len(start)):
                copy(data, start[m] + common, size, arena, to + m * stride)
            return
        for m in range(len(start)):
            place, at[m] = step(at[m], start[m], end[m], alignment, size)
            if place >= 0 and to >= 0:
                copy(data, place, size, arena, to + m * stride)

    return run


_all_times, _all_8 = _over_messages(copy_time), _over_messages(copy_8)
_all_4, _all_bytes = _over_messages(copy_4), _over_messages(copy_bytes)


@compiled
def _store(data: Bytes, start: Ints, end: Ints, at: Ints, common: int, op: int, size: int,
           count: int, arena: Bytes, to: int) -> None:
    """Store `count` elements or times of every message from byte `to` on.

    They stand `common` behind its start; with `common` < 0 next in the message (skipped if
    `to` < 0).
    """
    width, stride = size * count, size * count  # elements are one block, times come one by one
    if op == _TIME:
        width, stride = 8, 8 * count
    for k in range(0, stride, width):
        place = common + k if common >= 0 else -1
        first = to + k if to >= 0 else -1
        if op == _TIME:
            _all_times(data, start, end, at, place, size, width, arena, first, stride)
        elif width == 8:
            _all_8(data, start, end, at, place, size, width, arena, first, stride)
        elif width == 4:
            _all_4(data, start, end, at, place, size, width, arena, first, stride)
        else:
            _all_bytes(data, start, end, at, place, size, width, arena, first, stride)


@compiled
def _text_common(data: Bytes, start: Ints, common: int, length: int, arena: Bytes, to: int,
                 entries: Ints, n_entries: int) -> int:
    """Store the codes of a text of `length` bytes that stands `common` behind every start.

    Returns the size of the dictionary, or -1 at the first text of another length.
    """
    code = -1
    for m in range(len(start)):
        place = start[m] + common
        if np.int64(u32(data, place)) != length:
            return -1
        code = intern(data, place + 4, max(length - 1, 0), code, entries, n_entries)
        n_entries = max(n_entries, code + 1)
        put_u32(arena, to + 4 * m, np.uint32(code))
    return n_entries


@compiled
def _common(data: Bytes, start: Ints, end: Ints, at: Ints, shortest: int, common: int,
            instruction: Ints, arena: Bytes, to: int, entries: Ints,
            n_entries: int) -> tuple[int, int]:
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
    if op != _STRING:
        if to >= 0:
            _store(data, start, end, at, place, op, size, count, arena, to)
        return behind, n_entries
    length = np.int64(u32(data, start[0] + place))
    behind += length
    if behind > shortest:
        return -1, n_entries
    found = _text_common(data, start, place, length, arena, to, entries, n_entries)
    return (behind, found) if found >= 0 else (-1, n_entries)


@compiled
def _texts(data: Bytes, start: Ints, end: Ints, at: Ints, count: int, arena: Bytes, to: int,
           entries: Ints, n_entries: int) -> int:
    """Store the codes of `count` texts of every message from byte `to` on (skip if `to` < 0);
    return the size of the dictionary."""
    code = -1
    for m in range(len(at)):
        for k in range(count):
            place, at[m] = text(data, at[m], start[m], end[m])
            if place >= 0 and to >= 0:
                code = intern(data, place + 4, max(at[m] - place - 5, 0), code, entries, n_entries)
                n_entries = max(n_entries, code + 1)
                put_u32(arena, to + 4 * (m * count + k), np.uint32(code))
    return n_entries


@compiled
def _each(data: Bytes, start: Ints, end: Ints, at: Ints, program: Ints, arena: Bytes, to: int,
          ragged: Bytes, used: Ints, last: Ints, ragged_ends: Ints, entries: Ints,
          n_entries: int) -> int:
    """Run the first instruction of `program` message by message; return the dictionary's size."""
    op, size, count, target = program[0, 0], program[0, 1], program[0, 2], program[0, 3]
    if op <= _TIME:
        _store(data, start, end, at, -1, op, size, count, arena, to)
    elif op == _STRING:
        n_entries = _texts(data, start, end, at, count, arena, to, entries, n_entries)
    elif op == _SEQUENCE:
        sequence(data, start, end, at, size, ragged[target], target >= 0, ragged_ends[target])
    elif op == _LOOP:
        n_entries = loop(data, start, end, at, program[:1 + target], ragged, used, last,
                         ragged_ends, entries, n_entries)
    else:
        at[:] = np.where(at >= 0, end, at)
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
    # the size of the shortest message, -1 if one of them is bad
    shortest = int(np.min(end - start)) if len(at) and np.min(at) >= 0 else -1
    common = 0 if shortest >= 0 else -1
    n_entries = 0
    pc = 0
    while pc < program.shape[0]:
        op, size, count, target = (program[pc, 0], program[pc, 1], program[pc, 2], program[pc, 3])
        to = -1
        if op <= _STRING and target >= 0:
            to = bases[3 + target] + row * count * (8 if op == _TIME else size)
        if common >= 0:
            behind, n_entries = _common(data, start, end, at, shortest, common, program[pc],
                                        arena, to, entries, n_entries)
            if behind < 0:
                at[:] = start + common
            common = behind
        if common < 0:
            n_entries = _each(data, start, end, at, program[pc:], arena, to, ragged, used, last,
                              ragged_ends, entries, n_entries)
        pc += 1 + (target if op == _LOOP else 0)
    if common >= 0:
        at[:] = start + common
    n_bad = 0
    for m in range(len(at)):
        if at[m] < 0 or end[m] - at[m] > TRAILING:
            bad[n_bad] = m
            n_bad += 1
    return n_bad, n_entries
