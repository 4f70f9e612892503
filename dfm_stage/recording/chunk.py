"""Messages as a chunk of an MCAP file holds them, laid out many at once by compiled loops.

Laid out one by one in Python, a message cost more than all that its nodes did with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from dfm_stage.recording.chunk_kernels import AS_IT_CAME, lay_out
from dfm_stage.recording.numba_tools import MESSAGE_HEAD, Bytes, Ints

__all__ = ["Arrival", "Chunk", "Layout", "Messages", "memory", "unnumbered"]

Arrival: TypeAlias = tuple[int, bytes, int]
"""Channel, serialised message, and the system time at which it came (ns)."""

_UNSIGNED = 2**64 - 1
_COLUMNS_BYTES = 40
"""What channel, length and times of a message take."""


class Messages:
    """Serialised messages one after the other, with channel, length and times of each.

    They are added a few at a time to arrays that are there already. Thousands of small arrays held
    the interpreter lock while somebody joined them.

    Parameters
    ----------
    room : int
        Bytes of messages, with their columns, that it has room for.

    Attributes
    ----------
    room : as given
    count, size : how many they are, and the bytes of what they say
    """

    def __init__(self, room: int) -> None:
        most = room // _COLUMNS_BYTES
        self._data = np.empty(room, np.uint8)
        self._channels, self._lengths = np.empty(most, np.int64), np.empty(most, np.int64)
        self._times = np.empty((most, 3), np.int64)
        self.room = room
        self.count = self.size = 0

    @property
    def memory(self) -> int:
        """Bytes that they take."""
        return memory(self.count, self.size)

    @property
    def columns(self) -> tuple[Bytes, Ints, Ints, Ints]:
        """Data, channels, lengths (n,), and log time, publish time (ns) and number, (n, 3), as the
        bits of what MCAP holds unsigned. Where the number is `AS_IT_CAME`, both times are that of
        arrival."""
        n = self.count
        return self._data[:self.size], self._channels[:n], self._lengths[:n], self._times[:n]

    def fits(self, more: int) -> bool:
        """Return whether there is room for so many bytes of `memory` more."""
        return self.memory + more <= self.room

    def clear(self) -> None:
        """Begin anew, with the same room."""
        self.count = self.size = 0

    def add(self, channels: Sequence[int], data: Sequence[bytes],
            times: Sequence[tuple[int, int, int]] | Ints) -> None:
        """Add messages that fit."""
        content = np.frombuffer(b"".join(data), np.uint8)
        first, begin = self.count, self.size
        self.count, self.size = first + len(data), begin + len(content)
        self._data[begin:self.size] = content
        self._channels[first:self.count] = channels
        self._lengths[first:self.count] = [len(each) for each in data]
        self._times[first:self.count] = times


def memory(count: int, size: int) -> int:
    """Return the bytes that `count` messages of `size` bytes together take."""
    return size + count * _COLUMNS_BYTES


def unnumbered(came_ns: Sequence[int]) -> Ints:
    """Return the times of messages of which only their arrival is known."""
    times = np.empty((len(came_ns), 3), np.int64)
    times[:, :2] = np.array(came_ns, np.int64)[:, None]
    times[:, 2] = AS_IT_CAME
    return times


class Chunk(NamedTuple):
    """Messages as whole MCAP records, with what the index of an MCAP file says of them."""

    records: Bytes
    indexes: dict[int, Ints]
    """For each channel that occurs, log time (ns) and offset in `records` of its messages, (n, 2),
    as the MCAP message index wants them."""
    start_ns: int
    end_ns: int


class Layout:
    """Makes chunks of messages, and numbers those that came without a number.

    A chunk lies in the memory of the one before.
    """

    def __init__(self, log_stamps: bool) -> None:
        self._log_stamps = log_stamps
        self._arrived = np.zeros(0, np.int64)
        self._records: Bytes = np.empty(0, np.uint8)

    def chunk(self, messages: Messages, stamped: Sequence[bool]) -> Chunk:
        """Lay out at least one message; `stamped` tells for each channel, from 0 to the last,
        whether its messages begin with a header."""
        size = messages.size + messages.count * MESSAGE_HEAD
        if size > len(self._records):
            self._records = np.empty(size + size // 2, np.uint8)
        self._arrived.resize(len(stamped), refcheck=False)
        entries, ends = np.empty((messages.count, 2), np.int64), np.empty(len(stamped), np.int64)
        earliest, latest = lay_out(
            *messages.columns, np.array(stamped, np.int64), self._log_stamps, self._arrived,
            self._records, entries, ends)
        bounds = [0, *ends.tolist()]
        return Chunk(self._records[:size],
                     {channel: entries[begin:end] for channel, (begin, end)
                      in enumerate(pairwise(bounds)) if end > begin},
                     earliest & _UNSIGNED, latest & _UNSIGNED)
