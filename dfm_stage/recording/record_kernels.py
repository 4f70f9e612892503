"""Compiled loops over the records of a chunk; every read is inside the bounds of the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.numba_tools import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Bytes,
    Ints,
    compiled,
    entry,
    u16,
    u64,
)

MESSAGE = 5
SCHEMA = 3
CHANNEL = 4


@compiled
def _head(data: Bytes, at: int) -> tuple[int, int]:
    """Return (opcode, length) of the record at `at`; length -1 if no whole, possible one is
    there."""
    left = len(data) - at - RECORD_HEAD
    if left < 0:
        return 0, -1
    opcode, length = np.int64(data[at]), np.int64(u64(data, at + 1))
    if length > left or opcode == 0 or (
            opcode == MESSAGE and length < MESSAGE_HEAD - RECORD_HEAD):
        return opcode, -1
    return opcode, length


@entry
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
    opcode, length = _head(data, at)
    while length >= 0:
        if opcode == MESSAGE:
            counts[np.int64(u16(data, at + RECORD_HEAD))] += 1
        elif opcode in (SCHEMA, CHANNEL):
            if found < len(definitions):
                definitions[found] = at
            found += 1
        at += RECORD_HEAD + length
        opcode, length = _head(data, at)
    return at, found


@entry
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
    opcode, length = _head(data, at)
    while length >= 0:
        slot = slots[np.int64(u16(data, at + RECORD_HEAD))] if opcode == MESSAGE else -1
        if slot >= 0:
            cursor = cursors[slot]
            if cursor < ends[slot]:
                offsets[cursor] = at
                cursors[slot] = cursor + 1
            else:
                surplus += 1
        at += RECORD_HEAD + length
        opcode, length = _head(data, at)
    return at, surplus
