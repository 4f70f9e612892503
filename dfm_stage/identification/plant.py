"""The linear stage as the sampled record sees it: modes behind lag, delay and zero-order hold.

Continuous: G(s) = e^(-s D) / (tau s + 1) * sum_i b_i / (s^2 + c_i s + k_i). Sample k is taken
before the input of sample k acts, and that input is held for one period, so the exact discrete
response differs from G(j w) by the hold, which alone delays by half a sample. The fractional delay
splits each period in two pieces of constant input (Franklin, Powell and Workman, Digital Control
of Dynamic Systems, 3rd ed., sec. 4.3.4).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


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
    """Modes in parallel behind a first-order lag (s) and a delay (s)."""

    modes: tuple[Mode, ...]
    lag: float = 0.0
    delay: float = 0.0

    @property
    def static_gain(self) -> float:
        """Output per unit of constant input; infinite for a free body."""
        if any(m.stiffness <= 0.0 for m in self.modes):
            return math.inf
        return sum(m.numerator / m.stiffness for m in self.modes)

    def continuous_response(self, omega: Array) -> NDArray[np.complex128]:
        """Return G(j omega) (F,), omega in rad/s, without hold and sampling."""
        s = 1j * np.asarray(omega, dtype=float)
        total = sum((m.numerator / (s * s + m.damping * s + m.stiffness) for m in self.modes),
                    start=np.zeros_like(s))
        return np.asarray(total * np.exp(-s * self.delay) / (1.0 + self.lag * s))

    def sampled_response(self, omega: Array, sample_period: float) -> NDArray[np.complex128]:
        """Return the exact response (F,) from held input samples to output samples."""
        step, now, before, output, whole = self.discretised(sample_period)
        z = np.exp(1j * np.asarray(omega, dtype=float) * sample_period)
        size = step.shape[0]
        left = z[:, None, None] * np.eye(size) - step
        right = now[None, :] + before[None, :] / z[:, None]
        state = np.linalg.solve(left, right[:, :, None])[:, :, 0]
        return np.asarray((state @ output) * z ** (-whole))

    def discretised(self, sample_period: float) -> tuple[Array, Array, Array, Array, int]:
        """Return (A, B0, B1, C, n): x+ = A x + B0 u[k-n] + B1 u[k-n-1], y = C x."""
        matrix, drive, output = self._continuous()
        whole = math.floor(self.delay / sample_period)
        late = self.delay - whole * sample_period
        step, later = _held(matrix, drive, sample_period - late)
        first, earlier = _held(matrix, drive, late)
        return step @ first, later, step @ earlier, output, whole

    def _continuous(self) -> tuple[Array, Array, Array]:
        lagged = 1 if self.lag > 0.0 else 0
        size = lagged + 2 * len(self.modes)
        matrix, drive, output = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        if lagged:
            matrix[0, 0], drive[0] = -1.0 / self.lag, 1.0 / self.lag
        for i, mode in enumerate(self.modes):
            q = lagged + 2 * i
            matrix[q, q + 1] = 1.0
            matrix[q + 1, q], matrix[q + 1, q + 1] = -mode.stiffness, -mode.damping
            if lagged:
                matrix[q + 1, 0] = mode.numerator
            else:
                drive[q + 1] = mode.numerator
            output[q] = 1.0
        return matrix, drive, output


def _held(matrix: Array, drive: Array, duration: float) -> tuple[Array, Array]:
    """Return the exact transition and input vector over `duration` of constant input."""
    size = matrix.shape[0]
    block = np.zeros((size + 1, size + 1))
    block[:size, :size] = matrix * duration
    block[:size, size] = drive * duration
    full = expm(block)
    return full[:size, :size], full[:size, size]
