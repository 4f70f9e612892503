"""Device clocks: when, on the host's clock, a device took a sample that it dated itself."""

from __future__ import annotations

import itertools
from collections import deque

from dfm_stage.drivers.errors import ProtocolError


class Unwrap:
    """A counter of `modulus` values into a number without end, by the shortest way round."""

    def __init__(self, modulus: int = 1 << 32) -> None:
        self._modulus, self._total = modulus, 0

    def __call__(self, raw: int) -> int:
        """Return the number for a raw reading; the first is taken as a signed one."""
        half, before = self._modulus // 2, self._total or 0
        self._total = before + (raw - before + half) % self._modulus - half
        return self._total

    def restart(self) -> None:
        """Forget the past: the device was reset."""
        self._total = 0


class ClockMap:
    """Ticks of a device's clock to nanoseconds of the host's.

    A sample can only be late, never early: of all arrivals the least late ones carry the map. The
    lower envelope of arrival minus device time is kept over a sliding window in `slots` pieces,
    and a straight line through it follows the drift of the two clocks. Until the first half
    window has passed the offset alone is used.

    Parameters
    ----------
    tick_s : float
        Nominal length of one tick, s.
    fixed_delay_s : float
        What every sample takes at least (its time on the wire), s; taken off.
    window_s : float
        How long an arrival counts.
    """

    def __init__(self, tick_s: float, fixed_delay_s: float = 0.0, window_s: float = 10.0,
                 slots: int = 10) -> None:
        self._tick_ns = tick_s * 1e9
        self._delay_ns = fixed_delay_s * 1e9
        self._slot_ns = window_s * 1e9 / slots
        self._slots = slots
        self.restart()

    def restart(self) -> None:
        """Forget everything: the device's clock started anew."""
        self._first: int | None = None
        self._last_tick = self._base_ns = 0
        self._mins: deque[tuple[float, float]] = deque(maxlen=self._slots)
        self._slot = -1
        self._offset = self._slope = 0.0

    def __call__(self, tick: int, arrival_ns: int) -> int:
        """Return the host's time of `tick`, of which the host learned at `arrival_ns`.

        `tick` is not wrapped (see Unwrap). The result is never later than the arrival.

        Raises
        ------
        ProtocolError
            If ticks go backward: the device restarted.
        """
        if self._first is None:
            self._first, self._base_ns, self._last_tick = tick, arrival_ns, tick
        elif tick < self._last_tick:
            raise ProtocolError(f"the device's clock went back from {self._last_tick} to {tick} "
                                "ticks: it has restarted")
        self._last_tick = tick
        device_ns = (tick - self._first) * self._tick_ns
        late = arrival_ns - self._base_ns - device_ns - self._delay_ns
        slot = int(device_ns // self._slot_ns)
        if slot != self._slot:
            self._slot = slot
            self._mins.append((device_ns, late))
            self._fit()
        elif late < self._mins[-1][1]:
            self._mins[-1] = (device_ns, late)
            self._fit()
        return min(self._base_ns + int(device_ns + self._offset + self._slope * device_ns),
                   arrival_ns)

    def at(self, host_ns: int) -> float:
        """Return the device's ticks, with a fraction, at a time of the host."""
        if self._first is None:
            return 0.0
        return self._first + (host_ns - self._base_ns - self._offset) / (
            1.0 + self._slope) / self._tick_ns

    def _fit(self) -> None:
        """A line under the minima that touches two of them (or the lowest, at first)."""
        points = list(self._mins)
        if len(points) < max(3, self._slots // 2):
            self._slope = 0.0
            self._offset = min(late for _, late in points)
            return
        hull: list[tuple[float, float]] = []
        for point in points:
            while len(hull) > 1 and _turns_right(hull[-2], hull[-1], point):
                hull.pop()
            hull.append(point)
        middle = (points[0][0] + points[-1][0]) / 2
        for (x0, y0), (x1, y1) in itertools.pairwise(hull):
            if x1 >= middle:
                self._slope = (y1 - y0) / (x1 - x0)
                self._offset = y0 - self._slope * x0
                return


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) <= (b[1] - a[1]) * (c[0] - a[0])
