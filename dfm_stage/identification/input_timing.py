"""When an input acts, read off the equation of motion: one regression behind one filter.

The input u(t - tau) is regressed on filtered acceleration, velocity, position and usual nonlinear
functions of them; the tau that leaves least is looked for.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from numpy.polynomial import chebyshev
from numpy.polynomial.polyutils import mapdomain

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.decisions import TIMING_BLOCKS
from dfm_stage.transforms import shorter_length

HELD_LATE = 0.5
"""Samples by which a held input acts late on average."""
FIRST_LAG, LAST_LAG = -1.5, 3.0
"""The tau (samples) between which the least is looked for."""
LAG_STEP = 0.25
"""Spacing of the tau (samples) at which the regression is made; it is smooth in between."""
WIDE_LAGS = 10
"""Number of these tau behind filters so wide that samples are left out."""
GRID = np.arange(FIRST_LAG, LAST_LAG + 0.005, 0.01)
UNIT = -1.0, 1.0
"""Domain of the Chebyshev polynomials."""
NARROWEST = 2.0
"""Least width of a filter in samples that are kept: above half their rate it passes 3e-9."""
TAIL = 6.0
"""Widths of a filter after which its response is over."""
FEWEST = 20
"""Least samples of a record over those that a filter takes at each end."""
LONGEST = 2**15
"""Samples that are looked at, from the part that moves most: more make timing no surer."""
STARTS = 8
"""Starts of that part that are compared, within its length."""


@dataclass(frozen=True)
class Timing:
    """What one filter says: the tau (samples) that leaves least and its block-jackknife standard
    error, RMS left over that of the input, and the same if tau may not be below half a sample."""

    tau: float
    sigma: float
    left: float
    left_late: float


def timing(u: Waves, motion: Motion, width: float, sincs: int = 0) -> Timing | None:
    """Regress the input on the motion through one Gaussian filter of `width` samples.

    `sincs` is the power of sinc with which the input is weakened between its samples. None where
    the record is too short for the filter.
    """
    cut = int(TAIL * width) + 8
    if u.size < FEWEST * cut:
        return None
    every = _spacing(width, u.size)
    inner = slice(-(-cut // every), -(-(u.size - cut) // every))
    lags = lags_of(every)
    columns = motion.features(width, every)[:, inner]
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=1)), 1e-300)[:, None]
    delayed = delayed_by(lags / every, u.every(every), width / every, sincs, every)[:, inner]
    delayed -= delayed.mean(axis=1, keepdims=True)
    edges = np.linspace(0, columns.shape[1], TIMING_BLOCKS + 1).astype(int)
    parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
    gram = np.array([columns[:, p] @ columns[:, p].T for p in parts])
    finer = finer_from(every)
    cross = finer @ np.array([delayed[:, p] @ columns[:, p].T for p in parts])
    power = np.array([finer @ np.sum(delayed[:, p] ** 2, axis=1) for p in parts])
    left = _left(*(np.concatenate(([each.sum(axis=0)], each.sum(axis=0) - each))
                   for each in (gram, cross, power)))
    if not np.isfinite(left[0, 0]):
        return None
    at, *taus = (_least(each) for each in left if np.isfinite(each[0]))
    spread = math.sqrt((len(taus) - 1) * float(np.var(taus)))
    late = float(np.min(left[0, HELD_LATE <= GRID]))
    inside = GRID[0] < at < GRID[-1]
    return Timing(at, spread if inside else math.inf, math.sqrt(float(left[0].min())),
                  math.sqrt(late))


def _left(gram: Array, cross: Array, power: Array) -> Array:
    """Share of the input's power that regressions with products (K, F, F) and (K, G, F) leave at
    each tau of the grid, (K, G); NaN of one that has no power."""
    values, vectors = np.linalg.eigh(gram)
    kept = values > RANK * values[:, -1:]
    weights = np.where(kept, 1.0 / np.where(kept, values, 1.0), 0.0)
    taken = ((cross @ vectors) ** 2 @ weights[:, :, None])[:, :, 0]
    possible = (values[:, -1] > 0.0) & np.all(power > 0.0, axis=1)
    power = np.where(possible[:, None], power, math.nan)
    return np.asarray(np.maximum(1.0 - taken / power, 0.0))


RANK = 1e-12
"""Eigenvalue over the largest below which columns are the same."""


def _least(left: Array) -> float:
    """Where on the grid the least lies, by a parabola through its neighbours."""
    at = int(np.argmin(left))
    if not 0 < at < left.size - 1:
        return float(GRID[at])
    before, here, after = left[at - 1:at + 2]
    bend = before - 2.0 * here + after
    return float(GRID[at] + (0.5 * (before - after) / bend if bend > 0.0 else 0.0)
                 * (GRID[1] - GRID[0]))


def _spacing(width: float, size: int) -> int:
    """Samples from one that is kept to the next behind a filter, so that first and last are."""
    most = max(int(width / NARROWEST), 1)
    return next(every for every in range(most, 0, -1) if (size - 1) % every == 0)


def lags_of(every: int) -> Array:
    """Values of tau (L,), in samples, at which the regression is made."""
    if every == 1:
        return np.arange(FIRST_LAG, LAST_LAG + 0.5 * LAG_STEP, LAG_STEP)
    return np.asarray(mapdomain(chebyshev.chebpts1(WIDE_LAGS), UNIT, (FIRST_LAG, LAST_LAG)))


@cache
def finer_from(every: int) -> Array:
    """What takes values at those tau to those at GRID, (G, L): a polynomial through all of them,
    or the cubic spline whose third derivative is the same on both sides of the second and of the
    last but one."""
    lags = lags_of(every)
    count = lags.size
    if every > 1:
        few, fine = (chebyshev.chebvander(mapdomain(each, (FIRST_LAG, LAST_LAG), UNIT), count - 1)
                     for each in (lags, GRID))
        return np.asarray(fine @ np.linalg.inv(few))
    inner = np.arange(1, count - 1)
    bends, seconds = np.zeros((2, count, count))    # of `bends` @ f'' = `seconds` @ f
    for at, weight, difference in ((-1, 1.0, 6.0), (0, 4.0, -12.0), (1, 1.0, 6.0)):
        bends[inner, inner + at], seconds[inner, inner + at] = weight, difference
    bends[0, :3] = bends[-1, -3:] = 1.0, -2.0, 1.0
    curvature, values = np.linalg.solve(bends, seconds), np.eye(count)
    place = (GRID - lags[0]) / (lags[1] - lags[0])
    left = np.clip(place.astype(int), 0, count - 2)
    after = (place - left)[:, None]
    before = 1.0 - after
    return np.asarray(before * values[left] + after * values[left + 1]
                      + (before**3 - before) / 6.0 * curvature[left]
                      + (after**3 - after) / 6.0 * curvature[left + 1])


def delayed_by(lags: Array, u: Waves, width: float, sincs: int = 0, every: int = 1) -> Array:
    """The filtered input at every lag, (L, N); its samples are `every` sample periods apart."""
    spectrum = u.spectrum * np.exp(-0.5 * (u.omega * width) ** 2)
    if sincs:
        spectrum *= np.sinc(u.omega / (2.0 * np.pi * every)) ** sincs
    whole = np.floor(lags)
    most = int(np.abs(whole).max())
    moved = {part: _periodic(u.signal_of(spectrum * u.turns(part)), most, u.size)
             for part in set((lags - whole).tolist())}
    line = u.line[0] + u.line[1] * np.arange(u.size)
    return np.array([moved[lag - samples][most - int(samples):][:u.size]
                     + (line - u.line[1] * lag) for lag, samples in zip(lags, whole, strict=True)])


def _periodic(wave: Array, margin: int, size: int) -> Array:
    """The first `size` samples of a periodic signal, with some before and behind."""
    return np.concatenate((wave[-margin:], wave[:size + margin]))


@dataclass(frozen=True)
class Waves:
    """A signal (N,) as the `line` through its ends, value and slope, and the `spectrum` of what
    is left with its reflection, at `omega` radians a sample."""

    size: int
    line: Array
    omega: Array
    spectrum: Complex

    @classmethod
    def of(cls, values: Array) -> Waves:
        line, wave = reflected(values)
        omega: Array = 2.0 * np.pi * np.fft.rfftfreq(wave.size).astype(np.float64)
        return cls(values.size, line, omega, np.fft.rfft(wave))

    @cached_property
    def _turns(self) -> dict[float, Complex]:
        return {}

    def turns(self, part: float) -> Complex:
        """What delays a spectrum by a part of a sample."""
        if part not in self._turns:
            self._turns[part] = np.exp(-1j * self.omega * part)
        return self._turns[part]

    def every(self, count: int) -> Waves:
        """Every so many samples of the signal, whose spectrum must have sunk at their rate."""
        size = (self.size - 1) // count + 1
        return self if count == 1 else Waves(
            size, self.line * (1, count), self.omega[:size] * count, self.spectrum[:size] / count)

    def signal_of(self, spectrum: Complex) -> Array:
        """The periodic signal (2 N - 2,) of a spectrum."""
        return np.asarray(np.fft.irfft(spectrum, 2 * self.size - 2))

    def filtered(self, weights: Array) -> Array:
        """The signal (N,) through a filter that leaves straight lines alone."""
        return np.asarray(self.signal_of(self.spectrum * weights)[:self.size]
                          + self.line[0] + self.line[1] * np.arange(self.size))


class Motion:
    """An output (N,) that is the position's derivative of some order, and what of it is the same
    behind every filter."""

    def __init__(self, waves: Waves, derivative: int, powers: Sequence[Waves]) -> None:
        self.waves, self.derivative, self.powers = waves, derivative, powers
        self.drift = np.linspace(-1.0, 1.0, waves.size) ** np.arange(derivative + 1)[:, None]

    @classmethod
    def of(cls, y: Array, derivative: int) -> Motion:
        """The motion of an output, with square and cube of the position."""
        plain = cls(Waves.of(y), derivative, ())
        raw, drift = plain.moved(0, 1.0), plain.drift
        raw -= np.linalg.solve(drift @ drift.T, drift @ raw) @ drift
        return cls(plain.waves, derivative, [Waves.of(raw**3), Waves.of(raw**2)])

    def every(self, count: int) -> Motion:
        """The same at every so many samples."""
        return self if count == 1 else Motion(self.waves.every(count), self.derivative,
                                              [each.every(count) for each in self.powers])

    def moved(self, order: int, weights: Array | float) -> Array:
        """The position's derivative of some order, integrals up to their initial values."""
        spectrum, straight = self._derived[order]
        return self.waves.signal_of(spectrum * weights)[:self.waves.size] + straight

    @cached_property
    def _derived(self) -> list[tuple[Complex, Array]]:
        """The spectrum of the position and of its derivatives up to the second, and what straight
        lines (N,) of the output are of them."""
        waves, found = self.waves, list[tuple[Complex, Array]]()
        for order in range(3):
            power, time = self.derivative - order, np.arange(waves.size)
            turns = np.where(waves.omega > 0.0, 1j * waves.omega, 1.0) ** -power
            turns[0] = float(power == 0)
            straight = np.zeros(waves.size) if power < 0 else \
                waves.line[0] * time**power / math.gamma(power + 1)
            if power >= -1:
                straight = straight + waves.line[1] * time**(power + 1) / math.gamma(power + 2)
            found.append((waves.spectrum * turns, straight))
        return found

    def features(self, width: float, every: int = 1) -> Array:
        """Filtered motion and usual nonlinear functions of it, (F, N / every), at every so many
        samples. The direction and the square of the speed, which no filter has passed yet, are
        taken of all samples."""
        few = self.every(every)
        narrow, wide = (np.exp(-0.5 * (omega * width) ** 2)
                        for omega in (self.waves.omega, few.waves.omega / every))
        v = self.moved(1, narrow)
        directed = (Waves.of(np.sign(v)).every(every), *few.powers,
                    Waves.of(np.abs(v) * v).every(every))
        return np.array([few.moved(2, wide), v[::every] * every, few.moved(0, wide), *few.drift,
                         *(each.filtered(wide) for each in directed)])


def livest(u: Array, y: Array) -> tuple[Array, Array]:
    """At most LONGEST samples, those in which the output changes most."""
    u, y = np.asarray(u, dtype=float), np.asarray(y, dtype=float)
    count = shorter_length(min(u.size, LONGEST) - 1) + 1
    change = np.concatenate(([0.0], np.cumsum(np.diff(y) ** 2)))
    starts = np.arange(0, u.size - count + 1, max(count // STARTS, 1))
    first = int(starts[int(np.argmax(change[starts + count - 1] - change[starts]))])
    return u[first:first + count], y[first:first + count]


def reflected(values: Array) -> tuple[Array, Array]:
    """The line through first and last value, as value and slope, and what is left with its
    reflection in the end points, (2 N - 2,): periodic, without a jump."""
    slope = float(values[-1] - values[0]) / (values.size - 1)
    left = values - values[0] - slope * np.arange(values.size)
    return np.array([values[0], slope]), np.concatenate((left, -left[-2:0:-1]))
