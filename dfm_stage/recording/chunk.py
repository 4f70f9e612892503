"""Messages as a chunk of an MCAP file holds them, laid out many at once by compiled loops.

Laid out one by one in Python, a message cost more than all that its nodes did with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from dfm_stage.recording.chunk_kernels import AS_IT_CAME, lay_out
from dfm_stage.recording.numba_tools import MESSAGE_HEAD, Bytes, Ints

__all__ = ["Arrival", "Chunk", "Messages"]

Arrival: TypeAlias = tuple[int, bytes, int]
"""Channel, serialised message, and the system time at which it came (ns)."""

_ARRAYS_BYTES = 700
"""What four arrays take beside what they hold."""


class Messages(NamedTuple):
    """Serialised messages one after the other, with channel, length and times of each."""

    data: Bytes
    channels: Ints
    lengths: Ints
    times: Ints
    """Log time, publish time (ns) and number, (n, 3), as the bits of what MCAP holds unsigned.
    Where the number is `AS_IT_CAME`, both times are that of arrival."""

    @property
    def message_count(self) -> int:
        """How many they are."""
        return len(self.lengths)

    @property
    def content(self) -> int:
        """Bytes of what they say."""
        return len(self.data)

    @property
    def memory(self) -> int:
        """Bytes that they take, about."""
        return self.content + self.message_count * MESSAGE_HEAD + _ARRAYS_BYTES

    @classmethod
    def of(cls, channels: Sequence[int], data: Sequence[bytes], times: Ints) -> Messages:
        """Make them of columns."""
        return cls(np.frombuffer(b"".join(data), np.uint8), np.array(channels, np.int64),
                   np.fromiter(map(len, data), np.int64, len(data)), times)

    @classmethod
    def arrived(cls, arrivals: Sequence[Arrival]) -> Messages:
        """Make them of some that came, to be numbered."""
        channels, data, came_ns = zip(*arrivals, strict=True)
        times = np.full((len(data), 3), AS_IT_CAME)
        times[:, :2] = np.array(came_ns, np.int64)[:, None]
        return cls.of(channels, data, times)

    @classmethod
    def joined(cls, parts: Sequence[Messages]) -> Messages:
        """Return several as one."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


class Chunk:
    """Messages waiting to be written.

    `records` holds whole MCAP message records; `indexes[channel_id]` holds for each of its
    messages the log time (ns) and the offset in `records`, two little-endian uint64 each, as the
    MCAP message index wants them.
    """

    def __init__(self) -> None:
        self.records: Bytes = np.empty(0, np.uint8)
        self.indexes: dict[int, bytearray] = {}
        self.message_count = 0

    def add(self, messages: Messages) -> None:
        """Add messages that have their numbers."""
        count, size = len(messages.lengths), len(messages.data)
        of_channel = np.bincount(messages.channels)
        ends = np.cumsum(of_channel) - of_channel
        records = np.empty(size + count * MESSAGE_HEAD, np.uint8)
        entries = np.empty((count, 2), np.int64)
        lay_out(*messages, len(self.records), ends, records, entries)
        self.records = np.concatenate((self.records, records)) if len(self.records) else records
        for channel in np.flatnonzero(of_channel).tolist():
            index = self.indexes.setdefault(channel, bytearray())
            index += entries[ends[channel] - of_channel[channel]:ends[channel]].data
        self.message_count += count
