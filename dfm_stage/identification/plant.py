"""The linear stage as the sampled record sees it: modes behind lag, delay and zero-order hold.

Continuous: G(s) = e^(-s D) / (tau s + 1) * sum_i b_i / (s^2 + c_i s + k_i). Sample k is taken
before the input of sample k acts, and that input is held for one period, so the exact discrete
response differs from G(j w) by the hold, which alone delays by half a sample. State space, hold
and fractional delay are those of `dfm_stage.model.linear`.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.model.linear import LinearPart


@dataclass(frozen=True)
class Mode:
    """b / (s^2 + c s + k): `numerator` b, `damping` c (1/s), `stiffness` k (1/s^2).

    A free body has k = 0.
    """

    numerator: float
    damping: float
    stiffness: float

    @property
    def poles(self) -> tuple[complex, complex]:
        """The two roots of s^2 + c s + k (1/s)."""
        root = cmath.sqrt(0.25 * self.damping**2 - self.stiffness)
        return -0.5 * self.damping + root, -0.5 * self.damping - root

    @property
    def natural_frequency_hz(self) -> float:
        """Undamped natural frequency, zero for a free body."""
        return math.sqrt(max(self.stiffness, 0.0)) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """Damping ratio; infinite for a free body with damping."""
        if self.stiffness <= 0.0:
            return math.inf
        return self.damping / (2.0 * math.sqrt(self.stiffness))


@dataclass(frozen=True)
class LinearPlant:
    """Modes in parallel behind a first-order lag (s) and a delay (s).

    `part` is the linear part that it is a view of, where it comes from a model: that may hold
    more than modes and a lag. Without it the modes are all there is.
    """

    modes: tuple[Mode, ...]
    lag: float = 0.0
    delay: float = 0.0
    part: LinearPart | None = field(default=None, compare=False, repr=False)

    @property
    def static_gain(self) -> float:
        """Output per unit of constant input; infinite for a free body."""
        if self.part is not None:
            return self.part.static_gain
        if any(m.stiffness <= 0.0 for m in self.modes):
            return math.inf
        return sum(m.numerator / m.stiffness for m in self.modes)

    def continuous_response(self, omega: Array) -> NDArray[np.complex128]:
        """Return G(j omega) (F,), omega in rad/s, without hold and sampling."""
        return self._linear().response(omega)

    def sampled_response(self, omega: Array, sample_period: float) -> NDArray[np.complex128]:
        """Return the exact response (F,) from held input samples to output samples."""
        frequency = np.asarray(omega, dtype=float) / (2.0 * math.pi)
        return self._linear().sampled(sample_period).response(frequency)

    def _linear(self) -> LinearPart:
        if self.part is not None:
            return self.part
        motion = 2 * len(self.modes)
        size = motion + (self.lag > 0.0)
        a, b, c, g = np.zeros((size, size)), np.zeros(size), np.zeros(size), np.zeros(size)
        for q, mode in zip(range(0, motion, 2), self.modes, strict=True):
            a[q, q + 1] = c[q] = 1.0
            a[q + 1, q], a[q + 1, q + 1] = -mode.stiffness, -mode.damping
            b[q + 1] = mode.numerator
        if self.lag > 0.0:
            a[:motion, -1], a[-1, -1] = b[:motion], -1.0 / self.lag
            b = np.append(np.zeros(motion), 1.0 / self.lag)
        return LinearPart(a, b, g, c, self.delay)
