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
from typing import Any

import numpy as np
from scipy.stats import norm

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.free_motion import Window, ringing_poles
from dfm_stage.identification.quantity import Quantity, interval, t95

USED_SHARE = 0.6
"""How much of a level, from its end, is looked at."""


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
    loop_force_n, loop_width_m : (P,) deflection coming down less coming up, per force
    hysteresis : largest loop width, m; `hysteresis_percent` over the travel, %
    """

    levels: tuple[Level, ...]
    force_n: Array
    position_m: Array
    stiffness: Quantity
    offset_m: Quantity
    nonlinearity_m: Array
    linearity: Quantity
    loop_force_n: Array
    loop_width_m: Array
    hysteresis: Quantity
    hysteresis_percent: Quantity

    @property
    def travel_m(self) -> float:
        """Distance between the outermost levels."""
        return float(np.ptp(self.position_m))

    def deflection_at(self, force_n: float) -> Quantity:
        """Return the deflection at a load: that of its levels, or between the two next to it."""
        forces, at = np.unique(np.round(self.force_n, 9), return_inverse=True)
        means = np.array([self.position_m[at == i].mean() for i in range(forces.size)])
        errors = np.array([math.sqrt(sum(self.levels[j].error_m**2 for j in np.flatnonzero(
            at == i))) / np.count_nonzero(at == i) for i in range(forces.size)])
        if not forces[0] - 1e-3 <= force_n <= forces[-1] + 1e-3:
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
                         sample_period, max(round(hold_s / sample_period), 20))
    force = force_constant * np.array([level.input for level in levels])
    x = np.array([level.position_m for level in levels])
    if np.unique(np.round(force, 9)).size < 3:
        raise IdentificationError(f"{len(levels)} levels of held input are too few for a static "
                                  f"test: hold three or more for {hold_s:g} s each")
    design = np.column_stack((force, np.ones_like(force)))
    (slope, offset), *_ = np.linalg.lstsq(design, x, rcond=None)
    rest = x - design @ np.array([slope, offset])
    dof = x.size - 2
    noise = float(np.mean([level.error_m**2 for level in levels]))
    variance = max(float(rest @ rest) / max(dof, 1), noise)
    covariance = variance * np.linalg.inv(design.T @ design)
    stiffness = 1.0 / float(slope)
    width = stiffness**2 * math.sqrt(covariance[0, 0])
    travel = float(np.ptp(x))
    worst = float(np.max(np.abs(rest)))
    error = math.sqrt(noise) * _largest_of(x.size)
    loop_force, loop_width, loop_error = _loop(levels, force)
    at = int(np.argmax(np.abs(loop_width))) if loop_width.size else -1
    widest = float(loop_width[at]) if at >= 0 else math.nan
    spread = float(loop_error[at]) * _largest_of(loop_width.size) if at >= 0 else math.nan
    return StaticTest(
        tuple(levels), force, x,
        Quantity(stiffness, "N/m", interval(stiffness, width, dof)),
        Quantity(float(offset), "m", interval(float(offset), math.sqrt(covariance[1, 1]), dof)),
        rest, _percent(worst, error, travel), loop_force, loop_width,
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
    levels: list[Level] = []
    for (start, stop), window in zip(held, windows, strict=True):
        solved = window.solve(poles)
        value = float(input_[start])
        rising = None if not levels or value == levels[-1].input else value > levels[-1].input
        levels.append(Level(value, float(solved.amplitude[0]),
                            math.sqrt(float(solved.covariance[0, 0])), start, stop, rising))
    return levels


def _loop(levels: Iterable[Level], force: Array) -> tuple[Array, Array, Array]:
    """Return force, width and its standard error where a level was met from both sides."""
    up: dict[float, list[Level]] = {}
    down: dict[float, list[Level]] = {}
    for level, f in zip(levels, force, strict=True):
        if level.rising is not None:
            (up if level.rising else down).setdefault(round(float(f), 9), []).append(level)
    both = sorted(up.keys() & down.keys())
    width, error = [], []
    for f in both:
        above = [level.position_m for level in down[f]]
        below = [level.position_m for level in up[f]]
        width.append(float(np.mean(above) - np.mean(below)))
        error.append(math.hypot(*(math.sqrt(sum(level.error_m**2 for level in side)) / len(side)
                                  for side in (up[f], down[f]))))
    return np.array(both), np.array(width), np.array(error)


def _percent(value: float, error: float, travel: float) -> Quantity:
    half = t95(math.inf) * error
    return Quantity(100.0 * value / travel, "%", (100.0 * (value - half) / travel,
                                                  100.0 * (value + half) / travel))


def _largest_of(count: int) -> float:
    """How much wider 95 % are for the largest of `count` figures than for one (Bonferroni)."""
    return float(norm.ppf(1.0 - 0.025 / count)) / t95(math.inf)
