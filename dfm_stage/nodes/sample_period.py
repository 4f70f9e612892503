"""One sampling period for the whole loop, held against the stamps of the measurements."""

from __future__ import annotations

from collections import deque
from statistics import median

from dfm_stage.errors import DfmError
from dfm_stage.nodes.parameters import Setting

SAMPLE_PERIOD = Setting("sample_period_s", 0.001, "sampling period, one value for all nodes of "
                        "the loop: that of the measurements", "s", 1e-5, 1.0)
TOLERANCE = 0.1
"""Share by which the measured period may differ. The clocks of a counter and of the host differ by
1e-4 at most, stamps taken on a crowded machine by some 1e-2 after the median; what gets mixed up
(1 kHz and the counter's 512 Hz) differs by a factor."""
COMPARED_S = 0.25
"""Length of an interval that is compared: samples that a late plant makes up for come in bursts of
up to 0.1 s, whose single intervals are zero. Twice this long the comparison takes."""
FEWEST, MOST = 8, 512
"""Bounds of the number of samples in that interval, for very slow and very fast loops."""
_MASK, _HALF = 0xFFFFFFFF, 0x80000000


class SamplePeriodError(DfmError):
    """The measurements do not come at the sampling period that a node was given."""


class PeriodCheck:
    """The period of the measurements, once enough of them have come.

    Parameters
    ----------
    period_s : float
        What the node was given.
    exact : bool
        The stamps are those of a simulated clock: two of them are enough.

    Attributes
    ----------
    agrees : whether the measured period is the given one, within TOLERANCE
    """

    def __init__(self, period_s: float, exact: bool = False) -> None:
        self.period_s = period_s
        self.measured_s: float | None = None
        self.agrees = False
        self._lag = 1 if exact else min(max(round(COMPARED_S / period_s), FEWEST), MOST)
        self._sure_after = self._doubts = 1 if exact else 2
        self._samples: deque[tuple[int, int]] = deque(maxlen=2 * self._lag)
        self._last: int | None = None

    def heard(self, seq: int, stamp_ns: int) -> bool:
        """Take a measurement; return whether something new is known.

        What agrees is not looked at again until the measurements are numbered anew. What does not
        is compared again with the next ones, and believed the second time: the host may have stood
        still.
        """
        last, self._last = self._last, seq
        if last is not None and not 0 < (seq - last) & _MASK < _HALF:
            self._samples.clear()
            self.measured_s, self.agrees = None, False
            return True
        if self.agrees:
            return False
        self._samples.append((seq, stamp_ns))
        if len(self._samples) < 2 * self._lag:
            return False
        samples = list(self._samples)
        self._samples.clear()
        measured_s = median(
            1e-9 * (late - early) / ((number - first) & _MASK) for (first, early), (number, late)
            in zip(samples, samples[self._lag:], strict=False))
        self._doubts = self._sure_after if self._near(measured_s) else self._doubts - 1
        if not self._near(measured_s) and self._doubts > 0:
            return False
        self.measured_s, self.agrees = measured_s, self._near(measured_s)
        return True

    def _near(self, measured_s: float) -> bool:
        return abs(measured_s - self.period_s) <= TOLERANCE * self.period_s

    @property
    def complaint(self) -> str:
        """What is wrong, in one line; empty before enough was heard, and where nothing is."""
        if self.measured_s is None or self.agrees:
            return ""
        return (f"{SAMPLE_PERIOD.name} is {self.period_s:.6g} s, but the measurements come every "
                f"{self.measured_s:.3g} s: give all nodes of the loop the period of the "
                "measurements")
