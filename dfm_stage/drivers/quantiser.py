"""The last count of an amplifier, shaped: what a step leaves over is paid with the next ones."""

from __future__ import annotations


class SigmaDelta:
    """First-order noise shaping of a value that can only be sent in whole counts.

    The mean of what is sent is the value asked for; the error of one step is pushed to
    frequencies near the rate of sending, where a stage with mass does not follow. Without
    `shaped` it is plain rounding.
    """

    def __init__(self, count: float, shaped: bool = True) -> None:
        self._count = count
        self._shaped = shaped
        self._owed = 0.0

    def __call__(self, value: float) -> int:
        """Return the counts to send for `value`."""
        wanted = value / self._count + self._owed
        counts = round(wanted)
        if self._shaped:
            self._owed = wanted - counts
        return counts

    def reset(self) -> None:
        """Owe nothing."""
        self._owed = 0.0
