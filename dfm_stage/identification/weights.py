"""What the noise of each run looks like, and residuals weighted by it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import HIGH_BAND, LEAK, NOISE_ORDER, NOISE_SAMPLES
from dfm_stage.identification.noise import fit_noise, whiten


@dataclass(frozen=True)
class Weight:
    """Whitening polynomial [1, a1, ...] and standard deviation of what it leaves."""

    polynomial: Array
    sigma: float
    source: str

    @property
    def order(self) -> int:
        """The number of coefficients of the polynomial."""
        return self.polynomial.size - 1

    def apply(self, signals: Array) -> Array:
        """Return `signals` (..., N) white and in standard deviations; the first n are dropped."""
        return whiten(signals, self.polynomial) / self.sigma

    def colourless(self) -> Weight:
        """White noise of the same RMS."""
        return self if not self.order else Weight(np.ones(1), self.rms, self.source)

    def of_change(self) -> Weight:
        """The same of the change from sample to sample."""
        return Weight(np.array([1.0, -LEAK]), math.hypot(1.0, LEAK) * self.sigma, self.source)

    @property
    def rms(self) -> float:
        """RMS of the noise itself: the gain of 1/A times sigma."""
        if self.polynomial.size == 1:
            return self.sigma
        response = np.fft.rfft(self.polynomial, 8192)
        power = 1.0 / np.abs(response) ** 2
        return float(self.sigma * np.sqrt(np.mean(np.concatenate((power, power[1:-1])))))


Weights = tuple[tuple[Weight, ...], ...]
"""Per run, per signal compared."""


def white_weights(residuals: Sequence[Sequence[Array]]) -> Weights:
    """Weights while residuals may hold more than noise: white, as strong as high frequencies are.

    `residuals[run][channel]` are (N - skip,).
    """
    return tuple(tuple(Weight(np.ones(1), high_band_rms(r), "high frequencies") for r in parts)
                 for parts in residuals)


def weights_of(residuals: Sequence[Sequence[Array]]) -> Weights:
    """Weights from residuals that hold nothing but noise."""
    return tuple(tuple(_autoregression(r, "residuals") for r in parts) for parts in residuals)


def high_band_rms(residual: Array) -> float:
    """RMS of white noise as strong as `residual` (N,) is at high frequencies."""
    spectrum = np.abs(np.fft.rfft(np.diff(residual) * np.hanning(residual.size - 1)))
    omega = np.linspace(0.0, np.pi, spectrum.size)
    high = omega > HIGH_BAND * np.pi
    level = spectrum[high] / (2.0 * np.sin(0.5 * omega[high]))
    window = np.sqrt(np.sum(np.hanning(residual.size - 1) ** 2))
    found = math.sqrt(float(np.median(level**2)) / math.log(2.0)) / float(window)
    return max(found, 1e-6 * float(np.std(residual)), 1e-300)


def _autoregression(residual: Array, source: str) -> Weight:
    spread = float(np.std(residual))
    if spread == 0.0:
        return Weight(np.ones(1), 1e-300, source)
    model = fit_noise(residual, min(NOISE_ORDER, residual.size // NOISE_SAMPLES))
    return Weight(model.polynomial, max(model.sigma, 1e-9 * spread), source)
