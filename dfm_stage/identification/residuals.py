"""Tests of what a model leaves over: is it white, does it still know the input, at which line?

Ljung, System Identification, 2nd ed., sec. 16.6; Ljung and Box, Biometrika 65, 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats
from scipy.linalg import toeplitz

from dfm_stage.arrays import Array, Lines

LEVEL = 0.01
"""A test is failed when its p value falls below this."""


@dataclass(frozen=True)
class ResidualTest:
    """One test: `statistic` against chi-square with `dof`; curves for a plot.

    `lags` (L,) and `correlation` (L,) are the normalised correlations, `band` (L,) the limits
    within which 99 % of them lie if the residual holds nothing but noise.
    """

    name: str
    statistic: float
    dof: int
    p_value: float
    lags: Lines
    correlation: Array
    band: Array
    text: str

    @property
    def passed(self) -> bool:
        """Whether the test finds nothing."""
        return self.p_value >= LEVEL

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.name, "statistic": float(self.statistic), "dof": int(self.dof),
                "p_value": float(self.p_value), "passed": bool(self.passed), "text": self.text}


def whiteness(innovations: Array, *, lags: int = 30, fitted: int = 0) -> ResidualTest:
    """Test (Ljung and Box) that `innovations` (N,) are white; `fitted` noise coefficients."""
    e = innovations - innovations.mean()
    samples = e.size
    lags = max(min(lags + fitted, samples // 4), fitted + 1)
    power = float(e @ e)
    index = np.arange(1, lags + 1)
    correlation = np.array([float(e[k:] @ e[:-k]) for k in index]) / max(power, 1e-300)
    statistic = samples * (samples + 2) * float(np.sum(correlation**2 / (samples - index)))
    dof = lags - fitted
    p = float(stats.chi2.sf(statistic, dof))
    band = np.full(lags, stats.norm.ppf(0.995) / math.sqrt(samples))
    text = ("white" if p >= LEVEL else
            f"not white: correlation {_largest(correlation):.3f} at its largest")
    return ResidualTest("whiteness", statistic, dof, p, index, correlation, band, text)


def input_correlation(innovations: Array, input_: Array, *, lags: int = 30) -> ResidualTest:
    """Test that white `innovations` (N,) do not depend on the `input_` (N,) before them.

    Under the null the correlations at lags 1 to `lags` are jointly normal with the
    autocorrelation of the input as covariance; what they add up to is chi-square with as many
    degrees of freedom as the input has strength.
    """
    e, u = innovations - innovations.mean(), input_ - input_.mean()
    samples = e.size
    lags = max(min(lags, samples // 4), 1)
    index = np.arange(1, lags + 1)
    deviation = math.sqrt(max(float(e @ e) * float(u @ u), 1e-300))
    cross = np.array([float(e[k:] @ u[:-k]) for k in index]) / deviation
    auto = np.array([float(u[k:] @ u[: samples - k]) for k in range(lags)])
    auto /= max(float(u @ u), 1e-300)
    strength, directions = np.linalg.eigh(toeplitz(auto))
    kept = strength > 1e-6 * strength[-1]
    seen = directions[:, kept].T @ cross
    statistic = samples * float(np.sum(seen**2 / strength[kept]))
    dof = int(np.count_nonzero(kept))
    p = float(stats.chi2.sf(statistic, dof))
    band = np.full(lags, stats.norm.ppf(0.995) / math.sqrt(samples))
    text = ("independent of the input" if p >= LEVEL else
            f"depends on the input: correlation {_largest(cross):.3f} at its largest")
    return ResidualTest("input_correlation", statistic, dof, p, index, cross, band, text)


@dataclass(frozen=True)
class LineResidual:
    """Residual power at the excited lines over noise power there.

    `frequency_hz`, `ratio` (F,); `band` is the 99.9 % limit of a ratio where only noise is left,
    over all lines together.
    """

    frequency_hz: Array
    ratio: Array
    band: float

    @property
    def worst_hz(self) -> float:
        """The frequency at which most is left over."""
        return float(self.frequency_hz[int(np.argmax(self.ratio))])

    @property
    def passed(self) -> bool:
        """Whether no line stands out."""
        return bool(np.max(self.ratio) <= self.band)


def line_residuals(residual: Array, period: int, lines: Lines,
                   sample_period: float) -> LineResidual | None:
    """Compare the residual (N,) that repeats with `period` with what does not repeat.

    None where fewer than three periods fit.
    """
    count = residual.size // period
    if count < 3:
        return None
    rows = residual[residual.size - count * period:].reshape(count, period)
    spectra = np.fft.rfft(rows, axis=1)[:, lines] / period
    mean = spectra.mean(axis=0)
    noise = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (count - 1) / count
    ratio = np.abs(mean) ** 2 / np.maximum(noise, 1e-300)
    level = 1.0 - 1e-3 / max(lines.size, 1)
    band = float(stats.f.ppf(level, 2, 2 * (count - 1)))
    return LineResidual(np.asarray(lines / (period * sample_period)), np.asarray(ratio), band)


def noise_floor_from_periods(output: Array, period: int) -> float | None:
    """Return the RMS of what does not repeat in `output` (N,), None below two periods.

    Slow drift of the mean counts as noise.
    """
    count = output.size // period
    if count < 2:
        return None
    rows = output[output.size - count * period:].reshape(count, period)
    return float(np.sqrt(np.sum((rows - rows.mean(axis=0)) ** 2) / (period * (count - 1))))


def _largest(values: Array) -> float:
    return float(values[int(np.argmax(np.abs(values)))])
