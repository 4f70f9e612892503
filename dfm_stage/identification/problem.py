"""An estimation problem: unknowns, runs, and the simulation that ties them together."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.run import Run

Signals = list[Array]
"""One array for each signal that a run compares."""

STEP = 1e-4
"""Step of a difference over the size of an unknown: its error is 1e-8 of the third derivative."""


@dataclass(frozen=True)
class Unknown:
    """One number to estimate: where it starts, how large it typically is, where it may go.

    An unknown that belongs to one run only (an initial state) names its index in `run`. `step` is
    that of a difference, over its size. `column` (N,) is the response of the output to it where
    that is fixed: of an offset or a drift.
    """

    name: str
    start: float
    scale: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    run: int | None = None
    step: float = STEP
    column: Array | None = None


Simulate = Callable[[int, Array], "Array | Signals"]
"""Takes a run's index and rows (P, n) of all unknowns; gives its output (P, N), or one array for
each signal compared, NaN in a row that cannot be simulated."""


class Problem:
    """Unknowns (n), runs, and the simulation of these by rows of those."""

    def __init__(self, unknowns: Sequence[Unknown], runs: Sequence[Run],
                 simulate: Simulate, unit: str = "m") -> None:
        self.unknowns, self.runs = tuple(unknowns), tuple(runs)
        self.simulate, self.unit = simulate, unit
        self.start = np.array([u.start for u in self.unknowns], dtype=float)
        self.scale = np.array([u.scale for u in self.unknowns], dtype=float)
        self.low = np.array([u.low for u in self.unknowns], dtype=float)
        self.high = np.array([u.high for u in self.unknowns], dtype=float)

    def signals(self, index: int, rows: Array, simulate: Simulate | None = None) -> Signals:
        """What the model gives for the signals compared of one run, each (P, N - skip)."""
        run = self.runs[index]
        found = (simulate or self.simulate)(index, rows)
        parts = [np.asarray(s, dtype=float)[:, run.skip:]
                 for s in (found if isinstance(found, list) else [found])]
        for k, unknown in enumerate(self.unknowns):
            if unknown.column is not None and unknown.run == index:
                parts[0] = parts[0] + rows[:, k, None] * unknown.column[run.skip:]
        return parts

    def residuals(self, x: Array) -> list[Signals]:
        """Measured minus simulated, per run and signal, (N - skip,)."""
        return [[m - s[0] for m, s in zip(run.measured, self.signals(i, x[None, :]), strict=True)]
                for i, run in enumerate(self.runs)]

    def active(self, index: int) -> list[int]:
        """The unknowns that a run depends on."""
        own = {u.name for u in self.unknowns if u.run == index}
        return [k for k, u in enumerate(self.unknowns)
                if u.run == index or (u.run is None and u.name not in own)]

    def sensitivities(self, index: int, x: Array, exact: bool = True) -> Signals:
        """Derivatives of one run's signals, each (n, N - skip), by all unknowns; with `exact` by
        central differences, which inference wants."""
        out = self.no_slopes(index)
        self.differences(index, x, self.fixed(index, out), exact, out)
        return out

    def no_slopes(self, index: int) -> Signals:
        """Room for the derivatives of one run's signals, zero everywhere."""
        return [np.zeros((len(self.unknowns), m.size)) for m in self.runs[index].measured]

    def fixed(self, index: int, out: Signals) -> list[int]:
        """Fill in what is fixed, and return the unknowns of a run that are left."""
        left = []
        for k in self.active(index):
            column = self.unknowns[k].column
            if column is None:
                left.append(k)
            else:
                out[0][k] = column[self.runs[index].skip:]
        return left

    def differences(self, index: int, x: Array, chosen: Sequence[int], central: bool,
                    out: Signals, simulate: Simulate | None = None) -> None:
        """Fill the derivatives by the unknowns `chosen` at `x` (n,) into `out`, all simulated in
        one batch; where a side cannot be simulated, from the other one."""
        if not chosen:
            return
        rows: list[Array] = [] if central else [x]
        widths = []
        for k in chosen:
            unknown, up, down = self.unknowns[k], x.copy(), x.copy()
            step = unknown.step * max(unknown.scale, TINY)
            up[k], down[k] = min(x[k] + step, unknown.high), max(x[k] - step, unknown.low)
            if not central and up[k] > x[k]:
                down[k] = x[k]
            rows += [up, down] if central else [up if up[k] > x[k] else down]
            widths.append((up[k] - x[k], x[k] - down[k]))
        found = self.signals(index, np.array(rows), simulate)
        # between two finite sides the centre is not looked at, and need not be simulated
        centre = [f[0] for f in found] if not central or all(
            np.isfinite(f[:, -1]).all() for f in found) else [
            f[0] for f in self.signals(index, x[None, :], simulate)]
        for slopes, outputs, here in zip(out, found, centre, strict=True):
            for j, (k, width) in enumerate(zip(chosen, widths, strict=True)):
                up, down = (outputs[2 * j], outputs[2 * j + 1]) if central else \
                    (outputs[j + 1], here) if width[0] else (here, outputs[j + 1])
                slopes[k] = _slope(up, down, here, width)


TINY = 1e-300
"""A size that is not zero."""


def _slope(up: Array, down: Array, centre: Array, width: tuple[float, float]) -> Array:
    """The derivative (N,) from the two sides of `centre`, or from the one that is finite."""
    whole = width[0] + width[1]
    if not np.isfinite(down[-1]):
        down, whole = centre, width[0]
    elif not np.isfinite(up[-1]):
        up, whole = centre, width[1]
    return np.asarray((up - down) / whole) if whole else np.zeros(up.size)


def trend(run: Run, index: int, usual: int, unit: str) -> list[Unknown]:
    """Offset and drift of one run, as far as its trend (or the `usual` one) goes."""
    degree = usual if run.trend is None else run.trend
    return [Unknown(("offset", "drift")[k] if k < len(("offset", "drift")) else f"trend{k}", 0.0,
                    run.spread or TINY, unit=unit, run=index, column=_power(run.output.size, k))
            for k in range(degree + 1)]


@lru_cache(maxsize=8)
def _power(size: int, degree: int) -> Array:
    """t**degree (N,) over a run, t from -1 to 1: kept, as a screen builds hundreds of systems."""
    power = np.asarray(np.linspace(-1.0, 1.0, size) ** degree)
    power.flags.writeable = False
    return power
