"""Compiled steps over single elements, and loops for sequences, whose size only messages know."""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.decode_plan import MAX_LOOPS, Op
from dfm_stage.recording.numba_tools import (
    Bytes,
    Ints,
    compiled,
    inlined,
    put_u32,
    put_u64,
    u32,
    u64,
)

_COPY, _TIME, _STRING = int(Op.COPY), int(Op.TIME), int(Op.STRING)
_SEQUENCE, _LOOP, _END = int(Op.SEQUENCE), int(Op.LOOP), int(Op.END)


@inlined
def intern(data: Bytes, at: int, size: int, code: int, entries: Ints, n_entries: int) -> int:
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


@inlined
def copy_8(data: Bytes, place: int, _size: int, arena: Bytes, to: int) -> None:
    """Copy 8 bytes."""
    put_u64(arena, to, u64(data, place))


@inlined
def copy_4(data: Bytes, place: int, _size: int, arena: Bytes, to: int) -> None:
    """Copy 4 bytes."""
    put_u32(arena, to, u32(data, place))


@inlined
def copy_time(data: Bytes, place: int, _size: int, arena: Bytes, to: int) -> None:
    """Copy a time of seconds and nanoseconds as one number of nanoseconds."""
    seconds = np.int64(np.int32(u32(data, place)))
    put_u64(arena, to, np.uint64(seconds * 1000000000 + np.int64(u32(data, place + 4))))


@inlined
def copy_bytes(data: Bytes, place: int, size: int, arena: Bytes, to: int) -> None:
    """Copy `size` bytes."""
    words = size & ~7
    for k in range(0, words, 8):
        put_u64(arena, to + k, u64(data, place + k))
    for k in range(words, size):
        arena[to + k] = data[place + k]


@inlined
def store(data: Bytes, place: int, op: int, size: int, arena: Bytes, to: int) -> None:
    """Copy a time, or `size` bytes, from `place` to byte `to` of `arena`."""
    if op == _TIME:
        copy_time(data, place, size, arena, to)
    elif size == 8:
        copy_8(data, place, size, arena, to)
    elif size == 4:
        copy_4(data, place, size, arena, to)
    else:
        copy_bytes(data, place, size, arena, to)


@inlined
def step(at: int, start: int, end: int, alignment: int, size: int) -> tuple[int, int]:
    """Step over `size` bytes of a message that begins at `start`, from `at`, and is good so far.

    Returns (where they stand, the place behind them), both -1 if the message does not hold them.
    """
    place = at + ((start - at) & (alignment - 1))
    return (place, place + size) if at >= 0 and size <= end - place else (-1, -1)


@inlined
def text(data: Bytes, at: int, start: int, end: int) -> tuple[int, int]:
    """`step` over a text and its length, which stands before it."""
    place = step(at, start, end, 4, 4)[0]
    if place < 0:
        return -1, -1
    return step(place, start, end, 1, 4 + np.int64(u32(data, place)))


@compiled
def sequence(data: Bytes, start: Ints, end: Ints, at: Ints, size: int, values: Bytes,
             wanted: bool, ends: Ints) -> None:
    """Append the sequence of primitives of every message to `values`; note how far it reaches."""
    used = 0
    for m in range(len(at)):
        length = _length(data, start, end, at, m) * size
        place, at[m] = step(at[m], start[m], end[m], size if length else 1, length)
        if wanted:
            if place >= 0:
                for k in range(length):
                    values[used + k] = data[place + k]
                used += length
            ends[m] = used


@inlined
def _length(data: Bytes, start: Ints, end: Ints, at: Ints, m: int) -> int:
    """Read the length of a sequence; 0 and the message marked as bad if it is impossible."""
    place, at[m] = step(at[m], start[m], end[m], 4, 4)
    length = np.int64(u32(data, place)) if place >= 0 else 0
    if length > end[m] - at[m]:
        at[m] = -1
        return 0
    return int(length)


@inlined
def _element(data: Bytes, start: Ints, end: Ints, at: Ints, m: int, op: int, size: int, count: int,
             target: int, ragged: Bytes, used: Ints, last: Ints, entries: Ints,
             n_entries: int) -> int:
    """Append `count` primitives, or one time or text, of one message to a ragged column; return
    the size of the dictionary."""
    length = 8 if op == _TIME else size * count
    if op == _STRING:
        place, at[m] = text(data, at[m], start[m], end[m])
    else:
        place, at[m] = step(at[m], start[m], end[m], size, length)
    if place < 0 or target < 0:
        return n_entries
    if op == _STRING:
        code = intern(data, place + 4, max(at[m] - place - 5, 0), last[target], entries, n_entries)
        last[target] = code
        n_entries = max(n_entries, code + 1)
        length = 4
        put_u32(ragged[target], used[target], np.uint32(code))
    else:
        store(data, place, op, length, ragged[target], used[target])
    used[target] += length
    return n_entries


@inlined
def _turn(data: Bytes, start: Ints, end: Ints, at: Ints, m: int, program: Ints, turns: Ints,
          ragged: Bytes, used: Ints, last: Ints, entries: Ints, n_entries: int) -> int:
    """Run a part of a program from a LOOP to its END over one message; return the size of the
    dictionary."""
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
                op = _COPY
            for _ in range(min(count, 1) if op == _COPY else count):
                n_entries = _element(data, start, end, at, m, op, size, count, target, ragged,
                                     used, last, entries, n_entries)
    return n_entries


@compiled
def loop(data: Bytes, start: Ints, end: Ints, at: Ints, program: Ints, ragged: Bytes,
         used: Ints, last: Ints, ends: Ints, entries: Ints, n_entries: int) -> int:
    """Run the part of a program from a LOOP to its END over every message, one after the other;
    return the size of the dictionary."""
    turns = np.zeros(MAX_LOOPS + 2, np.int64)
    for m in range(len(at)):
        n_entries = _turn(data, start, end, at, m, program, turns, ragged, used, last, entries,
                          n_entries)
        for pc in range(program.shape[0]):
            if program[pc, 0] not in (_LOOP, _END) and program[pc, 3] >= 0:
                ends[program[pc, 3], m] = used[program[pc, 3]]
    return n_entries
