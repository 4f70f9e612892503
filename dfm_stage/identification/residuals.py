"""Tests of what a model leaves over: is it white, does it still know the input, at which line?

Ljung, System Identification, 2nd ed., sec. 16.6; Ljung and Box, Biometrika 65, 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, takewhile
from typing import Any

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.identification.periods import FEWEST_PERIODS, settled_from

LEVEL = 0.01
"""A test is failed when its p value falls below this."""
BAND, LINE_LEVEL = 0.99, 1e-3
"""Share of noise inside the band of a correlation, and outside the limit of all lines together."""
LONGEST_LAG = 4
"""Longest lags that fit into a record: at longer ones too few products are averaged."""
STRENGTH = 1e-6
"""Over the largest: directions of the input that carry less do not count as excited."""
FEWEST_TO_SPLIT = 3
"""Periods, to tell what repeats from what does not, line by line."""
QUARTERS, DIES_OUT = 4, 10.0
"""Parts of a period, and the power of one over that of the next from which a transient dies out in
it: noise does not fall so from part to part, and a slower transient is in the last part, too."""


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
    lags = max(min(lags + fitted, samples // LONGEST_LAG), fitted + 1)
    power = float(e @ e)
    index = np.arange(1, lags + 1)
    correlation = np.array([float(e[k:] @ e[:-k]) for k in index]) / max(power, 1e-300)
    statistic = samples * (samples + 2) * float(np.sum(correlation**2 / (samples - index)))
    return _test("whiteness", statistic, lags - fitted, index, correlation, samples,
                 ("white", "not white"))


def input_correlation(innovations: Array, input_: Array, *, lags: int = 30) -> ResidualTest:
    """Test that white `innovations` (N,) do not depend on the `input_` (N,) before them.

    Under the null the correlations at lags 1 to `lags` are jointly normal with the
    autocorrelation of the input as covariance; what they add up to is chi-square with as many
    degrees of freedom as the input has strength.
    """
    e, u = innovations - innovations.mean(), input_ - input_.mean()
    samples = e.size
    lags = max(min(lags, samples // LONGEST_LAG), 1)
    index = np.arange(1, lags + 1)
    deviation = math.sqrt(max(float(e @ e) * float(u @ u), 1e-300))
    cross = np.array([float(e[k:] @ u[:-k]) for k in index]) / deviation
    auto = np.array([float(u[k:] @ u[: samples - k]) for k in range(lags)])
    auto /= max(float(u @ u), 1e-300)
    apart = np.abs(np.subtract.outer(np.arange(lags), np.arange(lags)))
    strength, directions = np.linalg.eigh(auto[apart])
    kept = strength > STRENGTH * strength[-1]
    seen = directions[:, kept].T @ cross
    statistic = samples * float(np.sum(seen**2 / strength[kept]))
    return _test("input_correlation", statistic, int(np.count_nonzero(kept)), index, cross,
                 samples, ("independent of the input", "depends on the input"))


def _test(name: str, statistic: float, dof: int, lags: Lines, correlation: Array, samples: int,
          verdicts: tuple[str, str]) -> ResidualTest:
    from scipy.special import chdtrc, ndtri

    p = float(chdtrc(dof, statistic)) if dof else 1.0  # nothing to be correlated with
    band = np.full(lags.size, ndtri(0.5 * (1.0 + BAND)) / math.sqrt(samples))
    largest = float(correlation[int(np.argmax(np.abs(correlation)))])
    clean, failed = verdicts
    text = clean if p >= LEVEL else f"{failed}: correlation {largest:.3f} at its largest"
    return ResidualTest(name, statistic, dof, p, lags, correlation, band, text)


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
    def passed(self) -> bool:
        """Whether no line stands out."""
        return bool(np.max(self.ratio) <= self.band)


def line_residuals(residual: Array, period: int, lines: Lines,
                   sample_period: float) -> LineResidual | None:
    """Compare the residual (N,) that repeats with `period` with what does not repeat.

    None where fewer than three periods fit.
    """
    count = residual.size // period
    if count < FEWEST_TO_SPLIT:
        return None
    rows = residual[residual.size - count * period:].reshape(count, period)
    spectra = np.fft.rfft(rows, axis=1)[:, lines] / period
    mean = spectra.mean(axis=0)
    noise = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (count - 1) / count
    ratio = np.abs(mean) ** 2 / np.maximum(noise, 1e-300)
    from scipy.special import fdtri

    level = 1.0 - LINE_LEVEL / max(lines.size, 1)
    band = float(fdtri(2, 2 * (count - 1), level))
    return LineResidual(np.asarray(lines / (period * sample_period)), np.asarray(ratio), band)


def noise_floor_from_periods(output: Array, period: int) -> float | None:
    """Return the RMS of what does not repeat in `output` (N,), None below two periods.

    Leading periods that still hold a transient are left out, of two periods the quarters of both
    over which it dies out. Slow drift of the mean counts as noise.
    """
    count = output.size // period
    if count < FEWEST_PERIODS:
        return None
    rows = output[output.size - count * period:].reshape(count, period)
    moving = np.fft.rfft(rows, axis=1)[:, 1:]
    rows = rows[min(settled_from(moving), count - FEWEST_PERIODS):]
    apart = np.sum((rows - rows.mean(axis=0)) ** 2, axis=0) / (len(rows) - 1)
    if len(rows) == FEWEST_PERIODS:
        quarters = np.array_split(apart, QUARTERS)
        dying = (before.mean() > DIES_OUT * after.mean() > 0.0
                 for before, after in pairwise(quarters))
        apart = np.concatenate(quarters[sum(takewhile(bool, dying)):])
    return float(np.sqrt(np.mean(apart)))
