"""An estimation problem: unknowns, runs, and the simulation that ties them together."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

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
    that is fixed: of an offset or a drift. `part` are the samples of the run that it acts on; None
    for all.
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
    part: slice | None = None


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
        """Derivatives of one run's signals by all unknowns, each (r, N - skip) in the order of
        `rows`; with `exact` by central differences, which inference wants."""
        out = self.no_slopes(index)
        self.differences(index, x, self.fixed(index, out), exact, out)
        return out

    def no_slopes(self, index: int) -> Signals:
        """Room for the derivatives of one run's signals, zero everywhere."""
        return [np.zeros((max(self.rows, default=-1) + 1, m.size))
                for m in self.runs[index].measured]

    def fixed(self, index: int, out: Signals) -> list[int]:
        """Fill in what is fixed, and return the unknowns of a run that are left."""
        left = []
        for k in self.active(index):
            column = self.unknowns[k].column
            if column is None:
                left.append(k)
            else:
                out[0][self.rows[k]] = column[self.runs[index].skip:]
        return left

    @cached_property
    def told(self) -> NDArray[np.int64]:
        """The places of the unknowns that an estimate tells: all but those of windows."""
        return np.array([k for k, u in enumerate(self.unknowns) if u.part is None], np.int64)

    @cached_property
    def rows(self) -> list[int]:
        """The row in which the derivatives by each unknown stand: unknowns that act on different
        parts of a run share one."""
        found, ends = [], list[tuple[int | None, int]]()
        for u in self.unknowns:
            end = sys.maxsize if u.part is None else u.part.stop
            row = len(ends) if u.part is None else next((
                i for i, (run, e) in enumerate(ends) if run == u.run and e <= u.part.start),
                len(ends))
            ends[row:row + 1] = [(u.run, end)]
            found.append(row)
        return found

    def slope(self, slopes: Array, k: int, index: int) -> Array:
        """The derivative (N - skip,) by one unknown among `slopes` (r, N - skip) of a run."""
        found, part = np.zeros(slopes.shape[1]), self.shown(k, index)
        found[part] = slopes[self.rows[k], part]
        return found

    def shown(self, k: int, index: int) -> slice:
        """The samples compared that an unknown acts on."""
        part, skip = self.unknowns[k].part, self.runs[index].skip
        return slice(0, None) if part is None else slice(max(part.start - skip, 0),
                                                         max(part.stop - skip, 0))

    def differences(self, index: int, x: Array, chosen: Sequence[int], central: bool,
                    out: Signals, simulate: Simulate | None = None) -> None:
        """Fill the derivatives by the unknowns `chosen` at `x` (n,) into `out`, all simulated in
        one batch; where a side cannot be simulated, from the other one. Unknowns that act on
        different parts of the run are moved together."""
        if not chosen:
            return
        together: dict[int, list[int]] = {}
        for k in chosen:
            together.setdefault(self.rows[k], []).append(k)
        groups = list(together.values())
        rows: list[Array] = [] if central else [x]
        widths = {}
        for members in groups:
            up, down = x.copy(), x.copy()
            for k in members:
                unknown = self.unknowns[k]
                step = unknown.step * max(unknown.scale, TINY)
                up[k], down[k] = min(x[k] + step, unknown.high), max(x[k] - step, unknown.low)
                if not central:
                    down[k], up[k] = (x[k], up[k]) if up[k] > x[k] else (down[k], down[k])
                widths[k] = (max(up[k] - x[k], 0.0), x[k] - down[k])
            rows += [up, down] if central else [up]
        found = self.signals(index, np.array(rows), simulate)
        parts = {k: self.shown(k, index) for members in groups for k in members}
        if not central:
            found = self._from_below(index, x, groups, widths, parts, found, simulate)
        # between two finite sides the centre is not looked at, and need not be simulated
        centre = [f[0] for f in found] if not central or all(
            np.isfinite(f[:, part][:, -1:]).all() for f in found for part in
            {p.stop: p for p in parts.values()}.values()) else [
            f[0] for f in self.signals(index, x[None, :], simulate)]
        for slopes, outputs, here in zip(out, found, centre, strict=True):
            for j, members in enumerate(groups):
                for k in members:
                    sides = (outputs[2 * j], outputs[2 * j + 1]) if central else \
                        (outputs[j + 1], here) if widths[k][0] else (here, outputs[j + 1])
                    up, down = (side[parts[k]] for side in sides)
                    slopes[self.rows[k], parts[k]] = _slope(up, down, here[parts[k]], widths[k])


    def _from_below(self, index: int, x: Array, groups: Sequence[Sequence[int]],
                    widths: dict[int, tuple[float, float]], parts: Mapping[int, slice],
                    found: Signals, simulate: Simulate | None) -> Signals:
        """The signals of one-sided differences, with those that could not be simulated, as where
        a parameter would leave its limits, made on the other side; `widths` are changed there."""
        lost = [j for j, members in enumerate(groups) if not all(
            np.isfinite(f[j + 1, parts[k]][-1:]).all() for f in found for k in members)
            and all(widths[k][0] and x[k] - widths[k][0] >= self.unknowns[k].low
                    for k in members)]
        if not lost:
            return found
        rows = np.tile(x, (len(lost), 1))
        for row, j in zip(rows, lost, strict=True):
            for k in groups[j]:
                row[k] -= widths[k][0]
                widths[k] = 0.0, widths[k][0]
        found = [f.copy() for f in found]
        for f, other in zip(found, self.signals(index, rows, simulate), strict=True):
            f[[j + 1 for j in lost]] = other
        return found


TINY = 1e-300
"""A size that is not zero."""


def _slope(up: Array, down: Array, centre: Array, width: tuple[float, float]) -> Array:
    """The derivative (N,) from the two sides of `centre`, or from the one that is finite."""
    whole = width[0] + width[1]
    if not np.isfinite(down[-1:]).all():
        down, whole = centre, width[0]
    elif not np.isfinite(up[-1:]).all():
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
