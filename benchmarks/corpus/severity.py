"""How much an effect adds beyond a linear refit, and the search for a given severity."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.linear import sensitivities

FREE = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay", "back_emf",
        "coil_inductance")
TOLERANCE = 0.03


@dataclass(frozen=True)
class Refit:
    """The linear refit of one or several runs: what is left of a gap after it."""

    centre: list[Any]
    basis: Any
    solve: Any

    @classmethod
    def of(cls, base: dict[str, float], period: float, commands: Sequence[Any],
           offsets: bool) -> Refit:
        """Free are the base parameters that are there, and each run's first states and offset."""
        free = [name for name in FREE if base.get(name, 0.0) > 0.0]
        found = [sensitivities(base, free, period, command) for command in commands]
        own = 3 if offsets else 2
        rows = sum(len(command) for command in commands)
        matrix = np.zeros((rows, len(free) + own * len(found)))
        at = 0
        for i, (_, columns) in enumerate(found):
            part = slice(at, at + len(columns))
            first = len(free) + own * i
            matrix[part, :len(free)] = columns[:, :len(free)]
            matrix[part, first:first + own] = columns[:, len(free):len(free) + own]
            at += len(columns)
        sizes = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
        matrix /= sizes
        values, vectors = np.linalg.eigh(matrix.T @ matrix)
        known = values > 1e-14 * values[-1]
        basis = matrix @ (vectors[:, known] / np.sqrt(values[known]))
        units = np.ones(sizes.size)
        units[:len(free)] = [base[name] for name in free]
        solve = (vectors[:, known] / np.sqrt(values[known])) / (sizes * units)[:, None]
        return cls([centre for centre, _ in found], basis, solve)

    def left(self, outputs: Sequence[Any]) -> Any:
        """The gap (m) between outputs and model that no refit removes, all runs in a row."""
        gap = self.before(outputs)
        return gap - self.basis @ (self.basis.T @ gap)

    def before(self, outputs: Sequence[Any]) -> Any:
        """The gap (m) without a refit, all runs in a row."""
        return np.concatenate([y - c for y, c in zip(outputs, self.centre, strict=True)])


def left_by_refit(base: dict[str, float], period: float, commands: Sequence[Any],
                  outputs: Sequence[Any], offsets: bool) -> Any:
    """The gap (m) that the best linear stage leaves: Gauss-Newton steps until they change nothing.

    One step will not do where an effect shifts the resonance by more than a little.
    """
    free = [name for name in FREE if base.get(name, 0.0) > 0.0]
    at, best, kept = dict(base), math.inf, np.zeros(0)
    for _ in range(6):
        refit = Refit.of(at, period, commands, offsets)
        gap = refit.before(outputs)
        along = refit.basis.T @ gap
        left = gap - refit.basis @ along
        size = rms(left)
        if size > 0.97 * best:
            return left if size < best else kept
        best, kept = size, left
        step = np.clip(refit.solve @ along, -0.5, 0.5)[:len(free)]
        for name, change in zip(free, step, strict=True):
            at[name] *= 1.0 + float(change)
    return kept


def rms(values: Any) -> float:
    """Root of the mean square."""
    return math.sqrt(float(np.mean(np.square(values))))


def scale_for(severity: Callable[[float], float], target: float) -> tuple[float, float]:
    """The scale whose severity is `target` within 3 %, and the severity there.

    Secant steps in logarithms. Raises ValueError where none is found.
    """
    tried: list[tuple[float, float]] = []
    scale = target / 10.0
    for _ in range(14):
        value = severity(scale)
        if not math.isfinite(value):
            scale *= 0.2
            continue
        if abs(value / target - 1.0) < TOLERANCE:
            return scale, value
        tried.append((math.log(scale), math.log(max(value, 1e-12) / target)))
        scale = math.exp(_next(tried))
    raise ValueError(f"no scale gives a severity of {target:g}")


def _next(tried: list[tuple[float, float]]) -> float:
    at, value = tried[-1]
    slope = 1.0
    if len(tried) > 1 and tried[-2][0] != at:
        slope = (value - tried[-2][1]) / (at - tried[-2][0])
        slope = min(max(slope, 0.3), 4.0) if math.isfinite(slope) else 1.0
    below = [x for x, y in tried if y < 0.0]
    above = [x for x, y in tried if y > 0.0]
    step = at - min(max(value, -7.0), 7.0) / slope
    if below and above and max(below) < min(above) and not max(below) < step < min(above):
        return 0.5 * (max(below) + min(above))
    return step
