"""When an input acts, read off the equation of motion: one regression behind one filter.

The input u(t - tau) is regressed on filtered acceleration, velocity, position and usual nonlinear
functions of them; the tau that leaves least is looked for.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.decisions import TIMING_BLOCKS
from dfm_stage.transforms import shorter_length

HELD_LATE = 0.5
"""Samples by which a held input acts late on average."""
LAGS = np.arange(-1.5, 3.01, 0.25)
"""Values of tau (samples) at which the regression is made; it is smooth in between."""
GRID = np.arange(LAGS[0], LAGS[-1] + 0.005, 0.01)
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
    inner = slice(cut, u.size - cut)
    if u.size < FEWEST * cut:
        return None
    columns = motion.features(width)[:, inner]
    columns = columns / np.maximum(np.sqrt(np.mean(columns**2, axis=1)), 1e-300)[:, None]
    delayed = _delayed(u, width, sincs)[:, inner]
    delayed -= delayed.mean(axis=1, keepdims=True)
    edges = np.linspace(0, columns.shape[1], TIMING_BLOCKS + 1).astype(int)
    parts = [slice(a, b) for a, b in itertools.pairwise(edges)]
    gram = np.array([columns[:, p] @ columns[:, p].T for p in parts])
    finer = _finer()
    cross = finer @ np.array([delayed[:, p] @ columns[:, p].T for p in parts])
    power = np.array([finer @ np.sum(delayed[:, p] ** 2, axis=1) for p in parts])
    whole = gram.sum(axis=0), cross.sum(axis=0), power.sum(axis=0)
    left = _left(*whole)
    if left is None:
        return None
    without = [_left(whole[0] - g, whole[1] - c, whole[2] - p)
               for g, c, p in zip(gram, cross, power, strict=True)]
    taus = np.array([_least(each) for each in without if each is not None])
    spread = math.sqrt((taus.size - 1) * float(np.var(taus)))
    late = float(np.min(left[HELD_LATE <= GRID]))
    at = _least(left)
    inside = GRID[0] < at < GRID[-1]
    return Timing(at, spread if inside else math.inf, math.sqrt(float(left.min())),
                  math.sqrt(late))


def _left(gram: Array, cross: Array, power: Array) -> Array | None:
    """Share of the input's power (G,) that a regression leaves at each tau of the grid."""
    values, vectors = np.linalg.eigh(gram)
    kept = values > RANK * values[-1]
    if values[-1] <= 0.0 or np.any(power <= 0.0):
        return None
    taken = np.sum((cross @ vectors[:, kept]) ** 2 / values[kept], axis=1)
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


@cache
def _finer() -> Array:
    """What takes values at LAGS to those at GRID, (G, L): the cubic spline through them whose
    third derivative is the same on both sides of the second and of the last but one."""
    count = LAGS.size
    inner = np.arange(1, count - 1)
    bends, seconds = np.zeros((2, count, count))    # of `bends` @ f'' = `seconds` @ f
    for at, weight, difference in ((-1, 1.0, 6.0), (0, 4.0, -12.0), (1, 1.0, 6.0)):
        bends[inner, inner + at], seconds[inner, inner + at] = weight, difference
    bends[0, :3] = bends[-1, -3:] = 1.0, -2.0, 1.0
    curvature, values = np.linalg.solve(bends, seconds), np.eye(count)
    place = (GRID - LAGS[0]) / (LAGS[1] - LAGS[0])
    left = np.clip(place.astype(int), 0, count - 2)
    after = (place - left)[:, None]
    before = 1.0 - after
    return np.asarray(before * values[left] + after * values[left + 1]
                      + (before**3 - before) / 6.0 * curvature[left]
                      + (after**3 - after) / 6.0 * curvature[left + 1])


def _delayed(u: Waves, width: float, sincs: int) -> Array:
    """The filtered input at every lag, (L, N)."""
    spectrum = u.spectrum * np.exp(-0.5 * (u.omega * width) ** 2)
    if sincs:
        spectrum *= np.sinc(u.omega / (2.0 * np.pi)) ** sincs
    whole = np.floor(LAGS)
    most = int(np.abs(whole).max())
    moved = {part: _periodic(u.signal_of(spectrum * turns), most, u.size)
             for part, turns in u.parts_late.items()}
    line = u.line[0] + u.line[1] * np.arange(u.size)
    return np.array([moved[lag - samples][most - int(samples):][:u.size]
                     + (line - u.line[1] * lag) for lag, samples in zip(LAGS, whole, strict=True)])


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
    def parts_late(self) -> dict[float, Complex]:
        """What delays a spectrum by each part of a sample that LAGS have."""
        return {part: np.exp(-1j * self.omega * part) for part in set(
            (LAGS - np.floor(LAGS)).tolist())}

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

    def __init__(self, y: Array, derivative: int) -> None:
        self.waves, self.derivative = Waves.of(y), derivative
        self.drift = np.linspace(-1.0, 1.0, y.size) ** np.arange(derivative + 1)[:, None]
        raw = self.moved(0, 1.0)
        raw -= np.linalg.lstsq(self.drift.T, raw, rcond=None)[0] @ self.drift
        self.powers = [Waves.of(raw**3), Waves.of(raw**2)]

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

    def features(self, width: float) -> Array:
        """Filtered motion and usual nonlinear functions of it, (F, N)."""
        filter_ = np.exp(-0.5 * (self.waves.omega * width) ** 2)
        x, v, a = (self.moved(order, filter_) for order in range(3))
        directed = (Waves.of(np.sign(v)), *self.powers, Waves.of(np.abs(v) * v))
        return np.array([a, v, x, *self.drift, *(each.filtered(filter_) for each in directed)])


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
