"""Messages numbered by when they came through a transport that is late by different amounts."""

from __future__ import annotations

import numpy as np

from dfm_stage.recording.record import FloatArray, Ints

_WINDOW = 100
"""Messages among which some came without delay; a longer stall reads as a loss."""
_LOST_SHARE = 0.75
"""Of a period: where the earliest arrivals are later by more from one message on, one is lost."""

_ROUNDS = 5


def counted(time: FloatArray) -> Ints:
    """Return the number of the sample of each message, (n,), from 0, where some may be missing.

    A message that comes late is followed by others on time; after one that is missing all come
    later, the earliest of them, too.

    Parameters
    ----------
    time : (n,) ascending, s
    """
    index = np.arange(len(time), dtype=np.int64)
    window = min(_WINDOW, len(time) // 4)
    if window < 2:
        return index
    for _ in range(_ROUNDS):
        # losses that are not known yet make this too long, and hide behind it
        period = float(np.median((time[window:] - time[:-window])
                                 / (index[window:] - index[:-window])))
        lost = _lost(time / period - index, window) if period > 0 else np.zeros(1)
        if not lost.any():
            break
        index += np.cumsum(lost)
    return index


def _lost(late: FloatArray, window: int) -> Ints:
    """Return how many messages are missing before each, (n,), by how late all of them are."""
    n = len(late)
    # the earliest of `window` messages up to each, and of as many from each on
    padded = np.concatenate((np.full(window - 1, np.inf), late, np.full(window - 1, np.inf)))
    least = np.lib.stride_tricks.sliding_window_view(padded, window).min(axis=1)
    before, after = least[:n - window], least[window:n]
    lost, known, shift, done = np.zeros(n, np.int64), late.copy(), 0, 0
    for k in np.flatnonzero(after - before > _LOST_SHARE).tolist():
        known[done:k + 1] = late[done:k + 1] - shift
        done = k + 1
        jump = float(after[k] - shift - known[max(k + 1 - window, 0):k + 1].min())
        if jump > _LOST_SHARE:
            lost[k + 1] = max(round(jump), 1)
            shift += int(lost[k + 1])
    return lost
