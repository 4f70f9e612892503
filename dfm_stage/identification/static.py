"""Force over deflection from a staircase: stiffness, linearity, hysteresis loop.

Levels are the stretches of constant input. The position of a level is where its later part comes
to rest, the motion still dying away taken out. The stage must be led to its levels far slower than
its natural frequency (a third of it at most).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.fitting import fit_line
from dfm_stage.identification.free_motion import Window, ringing_poles
from dfm_stage.identification.quantity import Quantity, interval, t95

USED_SHARE = 0.6
"""How much of a level, from its end, is looked at."""
FEWEST_LEVELS = 3
"""Different forces: two leave nothing over of a line to tell its linearity by."""
FORCE_DIGITS = 9
"""Decimals (N) to which forces are equal that are one level of the staircase."""
OUTSIDE_N = 1e-3
"""How far beyond the outermost level (N) a deflection may be asked for: rounding of a load."""
FEWEST_SAMPLES = 20
"""In a level: its rest and the free motion in it have five coefficients."""


@dataclass(frozen=True)
class Level:
    """A held input: samples `start` to `stop`, `position_m` with standard error `error_m`.

    `rising` says whether the level before was lower; None for the first.
    """

    input: float
    position_m: float
    error_m: float
    start: int
    stop: int
    rising: bool | None


@dataclass(frozen=True)
class StaticTest:
    """What a static test shows.

    Attributes
    ----------
    levels : in order of time
    force_n, position_m : (L,) of the levels
    stiffness : N/m, the slope of the line through all levels
    offset_m : deflection of that line without force
    nonlinearity_m : (L,) distance of every level from the line
    linearity : largest of them over the travel, %
    hysteresis : largest deflection coming down less coming up at one force, m;
        `hysteresis_percent` over the travel, %
    """

    levels: tuple[Level, ...]
    force_n: Array
    position_m: Array
    stiffness: Quantity
    offset_m: Quantity
    nonlinearity_m: Array
    linearity: Quantity
    hysteresis: Quantity
    hysteresis_percent: Quantity

    @property
    def travel_m(self) -> float:
        """Distance between the outermost levels."""
        return float(np.ptp(self.position_m))

    def deflection_at(self, force_n: float) -> Quantity:
        """Return the deflection at a load: that of its levels, or between the two next to it."""
        forces, at = np.unique(np.round(self.force_n, FORCE_DIGITS), return_inverse=True)
        means = np.array([self.position_m[at == i].mean() for i in range(forces.size)])
        errors = np.array([math.sqrt(sum(self.levels[j].error_m**2 for j in np.flatnonzero(
            at == i))) / np.count_nonzero(at == i) for i in range(forces.size)])
        if not forces[0] - OUTSIDE_N <= force_n <= forces[-1] + OUTSIDE_N:
            raise IdentificationError(f"a load of {force_n:g} N lies outside the test, "
                                      f"{forces[0]:.3g} to {forces[-1]:.3g} N: apply more")
        value = float(np.interp(force_n, forces, means))
        return Quantity(value, "m", interval(value, float(np.interp(force_n, forces, errors))))

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"stiffness": self.stiffness.to_dict(), "offset": self.offset_m.to_dict(),
                "linearity": self.linearity.to_dict(), "hysteresis": self.hysteresis.to_dict(),
                "hysteresis_percent": self.hysteresis_percent.to_dict(),
                "travel_m": self.travel_m,
                "levels": [{"force_n": float(f), "position_m": float(level.position_m),
                            "error_m": level.error_m, "rising": level.rising}
                           for f, level in zip(self.force_n, self.levels, strict=True)]}


def static_test(input_: Array, position: Array, sample_period: float, force_constant: float, *,
                hold_s: float = 0.3) -> StaticTest:
    """Analyse a staircase of `input_` with `position` (both (N,)); `force_constant` in N per unit.

    A stretch of constant input counts as a level when it lasts `hold_s`.

    Raises
    ------
    IdentificationError
        If there are fewer than three levels at different inputs.
    """
    levels = find_levels(np.asarray(input_, dtype=float), np.asarray(position, dtype=float),
                         sample_period, max(round(hold_s / sample_period), FEWEST_SAMPLES))
    force = force_constant * np.array([level.input for level in levels])
    x = np.array([level.position_m for level in levels])
    if np.unique(np.round(force, FORCE_DIGITS)).size < FEWEST_LEVELS:
        raise IdentificationError(f"{len(levels)} levels of held input are too few for a static "
                                  f"test: hold three or more for {hold_s:g} s each")
    (slope, offset), rest, inverse = fit_line(force, x)
    dof = x.size - 2
    noise = float(np.mean([level.error_m**2 for level in levels]))
    variance = max(float(rest @ rest) / max(dof, 1), noise)
    covariance = variance * inverse
    stiffness = 1.0 / float(slope)
    width = stiffness**2 * math.sqrt(covariance[0, 0])
    travel = float(np.ptp(x))
    worst = float(np.max(np.abs(rest)))
    error = math.sqrt(noise) * _largest_of(x.size)
    widest, spread = _loop(levels, force)
    return StaticTest(
        tuple(levels), force, x,
        Quantity(stiffness, "N/m", interval(stiffness, width, dof)),
        Quantity(float(offset), "m", interval(float(offset), math.sqrt(covariance[1, 1]), dof)),
        rest, _percent(worst, error, travel),
        Quantity(widest, "m", interval(widest, spread)), _percent(widest, spread, travel))


def find_levels(input_: Array, position: Array, sample_period: float,
                minimum: int) -> list[Level]:
    """Return the stretches of at least `minimum` samples of constant input."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(input_)) + 1, [input_.size])).tolist()
    held = [(start, stop) for start, stop in pairwise(edges) if stop - start >= minimum]
    windows = []
    for start, stop in held:
        used = position[stop - max(round(USED_SHARE * (stop - start)), minimum // 2):stop]
        windows.append(Window(np.asarray(np.arange(used.size) * sample_period), used,
                              np.ones((used.size, 1))))
    if not windows:
        return []
    shortest = min(w.time.size for w in windows) * sample_period
    poles = ringing_poles(windows, math.pi / shortest, 0.5 * math.pi / sample_period, 1)
    solved = [window.solve(poles) for window in windows]
    values = [float(input_[start]) for start, _ in held]
    return [Level(value, float(level.amplitude[0]), math.sqrt(float(level.covariance[0, 0])),
                  start, stop, None if value == before else value > before)
            for (start, stop), level, value, before in zip(
                held, solved, values, [values[0], *values[:-1]], strict=True)]


def _loop(levels: Iterable[Level], force: Array) -> tuple[float, float]:
    """Return the largest width at a level that was met from both sides, and its standard error.

    NaN where there is none.
    """
    up: dict[float, list[Level]] = {}
    down: dict[float, list[Level]] = {}
    for level, f in zip(levels, force, strict=True):
        if level.rising is not None:
            side = up if level.rising else down
            side.setdefault(round(float(f), FORCE_DIGITS), []).append(level)
    loops = []
    for f in sorted(up.keys() & down.keys()):
        above, below = (np.mean([level.position_m for level in side[f]]) for side in (down, up))
        loops.append((float(above - below), math.hypot(*(
            math.sqrt(sum(level.error_m**2 for level in side[f])) / len(side[f])
            for side in (up, down)))))
    width, error = max(loops, key=lambda loop: abs(loop[0]), default=(math.nan, math.nan))
    return width, error * _largest_of(max(len(loops), 1))


def _percent(value: float, error: float, travel: float) -> Quantity:
    half = t95(math.inf) * error
    return Quantity(100.0 * value / travel, "%", (100.0 * (value - half) / travel,
                                                  100.0 * (value + half) / travel))


def _largest_of(count: int) -> float:
    """How much wider 95 % are for the largest of `count` figures than for one (Bonferroni)."""
    return NormalDist().inv_cdf(1.0 - 0.025 / count) / t95(math.inf)
