"""Keeping a reference or an output from waking a resonance: input shapers and a notch."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array
from dfm_stage.control.errors import ControlError


def shaper(frequency_hz: float, damping_ratio: float, sample_period_s: float,
           impulses: int = 2) -> Array:
    """Return the weights (M,), sum one, that a reference is convolved with to leave no vibration.

    Two impulses half a damped period apart cancel what the mode would do afterwards (ZV); three
    (ZVD) do so with zero slope in frequency, for a mode that is known less well (Singer and
    Seering, ASME J. Dyn. Syst. Meas. Control 112, 1990). Impulses between samples are shared by
    their neighbours.

    Raises
    ------
    ControlError
        If the frequency is not between zero and half the rate, the damping ratio not in [0, 1),
        or impulses not 2, 3 or 4.
    """
    _in_band(frequency_hz, sample_period_s, "shaper")
    if not 0.0 <= damping_ratio < 1.0 or impulses not in (2, 3, 4):
        raise ControlError("shaper: damping_ratio must lie in [0, 1) and impulses be 2, 3 or 4, "
                           f"not {damping_ratio!r} and {impulses!r}")
    root = math.sqrt(1.0 - damping_ratio**2)
    k = math.exp(-damping_ratio * math.pi / root)
    half = 0.5 / (frequency_hz * root) / sample_period_s
    order = impulses - 1
    weights = np.zeros(math.floor(order * half + 1e-9) + 2)
    for i in range(impulses):
        share = math.comb(order, i) * k**i / (1.0 + k)**order
        whole = math.floor(i * half + 1e-9)
        late = max(0.0, i * half - whole)
        weights[whole] += share * (1.0 - late)
        weights[whole + 1] += share * late
    return np.trim_zeros(weights, "b")


def shape(reference: ArrayLike, weights: ArrayLike) -> Array:
    """Return the shaped reference (N,), before it at rest on its first value."""
    r, w = np.asarray(reference, dtype=np.float64), np.asarray(weights, dtype=np.float64)
    return np.asarray(np.convolve(np.pad(r, (w.size - 1, 0), "edge"), w)[w.size - 1:][:r.size])


Point = tuple[float, float, float]


class ReferenceShaper:
    """A shaper one sample at a time, on position, velocity and acceleration together.

    Before the first sample the reference has been at rest on its first position. Only impulses
    cost time, not the samples between them.
    """

    __slots__ = ("_past", "_taps")

    def __init__(self, weights: ArrayLike) -> None:
        w = np.asarray(weights, dtype=np.float64)
        # The newest sample stands at the right end.
        self._taps = [(-1 - int(i), float(w[i])) for i in np.flatnonzero(w)]
        self._past: deque[Point] = deque(maxlen=max(1, w.size))

    def step(self, position_m: float, velocity_m_s: float, acceleration_m_s2: float) -> Point:
        """Return the shaped reference of this sample."""
        past = self._past
        if not past:
            past.extend([(position_m, 0.0, 0.0)] * (past.maxlen or 1))
        past.append((position_m, velocity_m_s, acceleration_m_s2))
        r = v = a = 0.0
        for index, weight in self._taps:
            each = past[index]
            r += weight * each[0]
            v += weight * each[1]
            a += weight * each[2]
        return r, v, a


class Notch:
    """A filter that takes one frequency out of a signal, one sample per call.

    (s^2 + 2 z_0 w s + w^2) / (s^2 + 2 z_1 w s + w^2) by Tustin's rule with w kept in place: gain
    one at rest and at high frequencies, z_0 / z_1 at w.

    Raises
    ------
    ControlError
        If the frequency is not between zero and half the rate, or a damping ratio is negative.
    """

    __slots__ = ("_a_1", "_a_2", "_b_0", "_b_1", "_b_2", "_s_1", "_s_2")

    def __init__(self, frequency_hz: float, sample_period_s: float, depth_damping: float = 0.01,
                 width_damping: float = 0.3) -> None:
        _in_band(frequency_hz, sample_period_s, "notch")
        if not (depth_damping >= 0.0 and width_damping > 0.0):
            raise ControlError("notch: damping ratios must not be negative, width_damping above "
                               f"zero, not {depth_damping!r} and {width_damping!r}")
        t = math.tan(math.pi * frequency_hz * sample_period_s)
        norm = 1.0 + 2.0 * width_damping * t + t * t
        self._b_0 = (1.0 + 2.0 * depth_damping * t + t * t) / norm
        self._b_1 = self._a_1 = 2.0 * (t * t - 1.0) / norm
        self._b_2 = (1.0 - 2.0 * depth_damping * t + t * t) / norm
        self._a_2 = (1.0 - 2.0 * width_damping * t + t * t) / norm
        self._s_1 = self._s_2 = 0.0

    @property
    def coefficients(self) -> tuple[float, float, float, float, float]:
        """b_0, b_1, b_2, a_1, a_2 of (b_0 z^2 + b_1 z + b_2) / (z^2 + a_1 z + a_2)."""
        return self._b_0, self._b_1, self._b_2, self._a_1, self._a_2

    def step(self, value: float) -> float:
        """Return the filtered value of this sample."""
        out = self._b_0 * value + self._s_1
        self._s_1 = self._b_1 * value - self._a_1 * out + self._s_2
        self._s_2 = self._b_2 * value - self._a_2 * out
        return out

    def reset(self, value: float = 0.0) -> None:
        """Start as if the signal had always been `value`."""
        self._s_2 = (self._b_2 - self._a_2) * value
        self._s_1 = (self._b_1 - self._a_1) * value + self._s_2


def _in_band(frequency_hz: float, sample_period_s: float, where: str) -> None:
    if not 0.0 < frequency_hz * sample_period_s < 0.5:
        raise ControlError(f"{where}: the frequency must lie between 0 and "
                           f"{0.5 / sample_period_s:g} Hz, not {frequency_hz!r}")
