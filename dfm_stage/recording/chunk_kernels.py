"""Compiled loops that lay messages out as records of a chunk; they leave the interpreter lock
alone."""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.numba_tools import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Bytes,
    Ints,
    entry,
    inlined,
    put_u32,
    put_u64,
    u32,
)
from dfm_stage.recording.record_kernels import MESSAGE

NS = 1_000_000_000
AS_IT_CAME = -1
_NEGATIVE = 2**31       # bits of seconds before 1970, which no clock of a message shows
_STAMP_END = 12         # of a message that begins with a std_msgs/Header: seconds, nanoseconds


@entry
def lay_out(data: Bytes, channels: Ints, lengths: Ints, times: Ints, stamped: Ints,
            log_stamps: bool, arrived: Ints, records: Bytes, entries: Ints,
            ends: Ints) -> tuple[int, int]:
    """Write the records of messages, and for each channel its entries of the message index.

    One call does all: between two of them a thread has to wait for the interpreter lock again.

    Parameters
    ----------
    data, channels, lengths : (bytes,) uint8, (n,) int64, (n,) int64
        The messages one after the other.
    times : (n, 3) int64
        Log time, publish time, number, the bits of what MCAP holds unsigned; changed where the
        number is `AS_IT_CAME`.
    stamped, arrived : (channels + 1,) int64
        Whether a channel's messages begin with a header, and how many came so far; increased.
    log_stamps : bool
        Whether a message with a stamp was logged at that, not when it came.
    records : (at least bytes + n * MESSAGE_HEAD,) uint8
        Filled.
    entries : (n, 2) int64
        Filled with log time and offset of each message, channel by channel.
    ends : (channels + 1,) int64
        Filled with where the entries of each channel end.

    Returns
    -------
    The earliest and the latest log time, as int64 that stand for uint64.
    """
    _number(data, channels, lengths, times, stamped, log_stamps, arrived)
    ends[:] = 0
    for k in range(len(channels)):
        ends[channels[k]] += 1
    total = 0
    for channel in range(len(ends)):   # first where they begin
        total += ends[channel]
        ends[channel] = total - ends[channel]
    begin = at = 0
    earliest = latest = np.uint64(times[0, 0])
    for k in range(len(lengths)):
        length, channel = lengths[k], channels[k]
        records[at] = MESSAGE
        put_u64(records, at + 1, MESSAGE_HEAD - RECORD_HEAD + length)
        put_u32(records, at + 9, channel)      # two bytes; the number follows
        put_u32(records, at + 11, times[k, 2])
        put_u64(records, at + 15, times[k, 0])
        put_u64(records, at + 23, times[k, 1])
        for index in range(length):
            records[at + MESSAGE_HEAD + index] = data[begin + index]
        entries[ends[channel], 0], entries[ends[channel], 1] = times[k, 0], at
        ends[channel] += 1
        earliest = min(earliest, np.uint64(times[k, 0]))
        latest = max(latest, np.uint64(times[k, 0]))
        begin += length
        at += MESSAGE_HEAD + length
    return np.int64(earliest), np.int64(latest)


@inlined
def _number(data: Bytes, channels: Ints, lengths: Ints, times: Ints, stamped: Ints,
            log_stamps: bool, arrived: Ints) -> None:
    """Number the messages of which only the time of their arrival is known, and date them."""
    begin = 0
    for k in range(len(lengths)):
        channel = channels[k]
        if times[k, 2] == AS_IT_CAME:
            if (stamped[channel] and lengths[k] >= _STAMP_END
                    and u32(data, begin + 4) < _NEGATIVE):
                stamp = NS * int(u32(data, begin + 4)) + int(u32(data, begin + 8))
                if log_stamps:
                    times[k, 0] = stamp
                if stamp:
                    times[k, 1] = stamp
            arrived[channel] += 1
            times[k, 2] = arrived[channel]
        begin += lengths[k]
