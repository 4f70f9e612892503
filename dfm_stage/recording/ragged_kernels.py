"""Compiled loops for texts and sequences, whose size only the messages know."""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.decode_plan import MAX_LOOPS, Op
from dfm_stage.recording.numba_tools import Bytes, Ints, compiled, u32

_RAGGED, _RAGGED_TIME, _RAGGED_STRING = int(Op.RAGGED), int(Op.RAGGED_TIME), int(Op.RAGGED_STRING)
_SEQUENCE, _LOOP, _END = int(Op.SEQUENCE), int(Op.LOOP), int(Op.END)


@compiled
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


@compiled
def texts(data: Bytes, start: Ints, end: Ints, at: Ints, count: int, arena: Bytes, to: int,
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
            length = np.int64(u32(data, place))
            place += 4
            if length > end[m] - place:
                at[m] = -1
                break
            at[m] = place + length
            if to >= 0:
                code = intern(data, place, max(length - 1, 0), code, entries, n_entries)
                n_entries = max(n_entries, code + 1)
                codes[to // 4 + m * count + k] = code
    return n_entries


@compiled
def sequence(data: Bytes, start: Ints, end: Ints, at: Ints, size: int, values: Bytes,
              wanted: bool, ends: Ints) -> None:
    """Append the sequence of primitives of every message to `values`; note how far it reaches."""
    used = 0
    for m in range(len(at)):
        place = at[m]
        length = -1
        if place >= 0:
            place += (start[m] - place) & 3
            if place + 4 <= end[m]:
                length = np.int64(u32(data, place)) * size
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


@compiled
def _length(data: Bytes, start: Ints, end: Ints, at: Ints, m: int) -> int:
    """Read the length of a sequence; 0 and the message marked as bad if it is impossible."""
    place = at[m] + ((start[m] - at[m]) & 3)
    if place + 4 <= end[m]:
        length = np.int64(u32(data, place))
        if length <= end[m] - place - 4:
            at[m] = place + 4
            return int(length)
    at[m] = -1
    return 0


@compiled
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
            length += np.int64(u32(data, place))
    if length > end[m] - place:
        at[m] = -1
        return n_entries
    at[m] = place + length
    if target < 0:
        return n_entries
    to = used[target]
    values = ragged[target]
    if op == _RAGGED_STRING:
        code = intern(data, place + 4, max(length - 5, 0), last[target], entries, n_entries)
        last[target] = code
        n_entries = max(n_entries, code + 1)
        values.view(np.int32)[to // 4] = code
        length = 4
    elif op == _RAGGED_TIME:
        seconds = np.int64(np.int32(u32(data, place)))
        values.view(np.int64)[to // 8] = seconds * 1000000000 + np.int64(u32(data, place + 4))
    else:
        for k in range(length):
            values[to + k] = data[place + k]
    used[target] = to + length
    return n_entries


@compiled
def loop(data: Bytes, start: Ints, end: Ints, at: Ints, program: Ints, ragged: Bytes,
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
