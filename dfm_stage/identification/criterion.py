"""The weighted, whitened residual of a problem, and its derivative."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.identification.least_squares import STUCK, Jacobian, Solution, dense, minimise
from dfm_stage.identification.noise import whiten
from dfm_stage.identification.problem import Problem, Signals
from dfm_stage.identification.weights import Weights

ROUGH, ACCURATE = 1e-2, 1e-4
"""A search ends when the next step would lower chi-square by less than this."""


class Criterion:
    """Residuals over the unknowns x (n,) of a problem, white and in standard deviations.

    `weights` are those of each run and signal. With `joint` the coefficients of each run's noise
    are unknowns as well, behind the others: z = (x, a of run 0, a of run 1, ...), each run's
    signal by signal. `slopes(run, x, exact)` gives the derivatives of a run's signals.
    """

    def __init__(self, problem: Problem, weights: Weights, joint: bool = False,
                 slopes: Callable[[int, Array, bool], Signals] | None = None) -> None:
        self.problem, self.weights, self.joint = problem, weights, joint
        self.slopes = slopes or problem.sensitivities
        ends = iter(pairwise(np.cumsum([problem.start.size, *(
            w.polynomial.size - 1 if joint else 0 for ws in weights for w in ws)])))
        self.noise = [[slice(*map(int, next(ends))) for _ in ws] for ws in weights]

    def start(self, x: Array) -> Array:
        """All unknowns: `x` (n,) and, where they are free, the weights' own coefficients."""
        coefficients = [w.polynomial[1:] for ws in self.weights for w in ws] \
            if self.joint else []
        return np.concatenate([x[:self.problem.start.size], *coefficients])

    def polynomial(self, run: int, signal: int, z: Array) -> Array:
        """The whitening polynomial of a signal: part of `z`, or that of its weight."""
        if self.joint:
            return np.concatenate(([1.0], z[self.noise[run][signal]]))
        return self.weights[run][signal].polynomial

    def parts(self, z: Array, residuals: list[Signals] | None = None) -> list[Array]:
        """The weighted residual of each run and signal; of given `residuals`, where they are
        known."""
        gaps = residuals or self.problem.residuals(z[:self.problem.start.size])
        return [whiten(gap, self.polynomial(i, s, z)) / self.weights[i][s].sigma
                for i, signals in enumerate(gaps) for s, gap in enumerate(signals)]

    def residual(self, z: Array) -> Array:
        """The weighted residual (N,) of all runs in a row."""
        return np.concatenate(self.parts(z))

    def jacobian(self, z: Array, *_: Array, exact: bool = False) -> Array:
        """The derivative (N, len(z)) of the residual; `exact` by central differences."""
        if self._in_windows:
            return dense(self.derivative(z, exact=exact))
        count = self.problem.start.size
        gaps = self.problem.residuals(z[:count]) if self.joint else None
        blocks = []
        for i, weights in enumerate(self.weights):
            active = self.problem.active(i)
            for s, columns in enumerate(self.slopes(i, z[:count], exact)):
                columns[~np.isfinite(columns).all(axis=1)] = 0.0
                polynomial = self.polynomial(i, s, z)
                block = np.zeros((z.size, columns.shape[1] - polynomial.size + 1))
                block[active] = -whiten(columns[active], polynomial)
                if gaps is not None and polynomial.size > 1:
                    order = polynomial.size - 1
                    lagged = np.lib.stride_tricks.sliding_window_view(gaps[i][s][:-1], order)
                    block[self.noise[i][s]] = lagged[:, ::-1].T
                blocks.append(block.T / weights[s].sigma)
        return np.vstack(blocks)

    @property
    def _in_windows(self) -> bool:
        return any(u.part is not None for u in self.problem.unknowns)

    def derivative(self, z: Array, *_: Array, exact: bool = False) -> Jacobian:
        """The same, by its entries alone where unknowns act on parts of a run."""
        problem = self.problem
        if not self._in_windows:
            return self.jacobian(z, exact=exact)
        entries: list[list[Array]] = [[] for _ in problem.unknowns]
        places: list[list[Lines]] = [[] for _ in problem.unknowns]
        before = 0
        for i, weights in enumerate(self.weights):
            for s, (columns, weight) in enumerate(zip(self.slopes(i, z, exact), weights,
                                                      strict=True)):
                polynomial = self.polynomial(i, s, z)
                order = polynomial.size - 1
                for k in problem.active(i):
                    first, last = problem.shown(k, i).indices(columns.shape[1])[:2]
                    lead = min(order, first)
                    column = np.concatenate((
                        np.zeros(lead), columns[problem.rows[k], first:last],
                        np.zeros(min(order, columns.shape[1] - last))))
                    if last > first and np.isfinite(column).all():
                        entries[k].append(-whiten(column, polynomial) / weight.sigma)
                        places[k].append(before + first - lead
                                         + np.arange(entries[k][-1].size, dtype=np.int64))
                before += columns.shape[1] - order
        ends = np.cumsum([0, *(sum(e.size for e in found) for found in entries)])
        from scipy.sparse import csc_array

        return csc_array((np.concatenate([e for found in entries for e in found]),
                          np.concatenate([p for parts in places for p in parts]), ends),
                         shape=(before, z.size))

    def minimise(self, x: Array, max_iterations: int, tolerance: float) -> Solution:
        """Search from `x`; by central differences where one-sided ones lead no further."""
        problem, start = self.problem, self.start(x)
        extra = start.size - problem.start.size
        search = partial(minimise, self.residual,
                         scale=np.concatenate((problem.scale, np.ones(extra))),
                         low=np.concatenate((problem.low, np.full(extra, -np.inf))),
                         high=np.concatenate((problem.high, np.full(extra, np.inf))),
                         max_iterations=max_iterations, tolerance=tolerance)
        found = search(self.jacobian, start)
        if found.reason != STUCK:
            return found
        return search(partial(self.jacobian, exact=True), found.x)
