"""Levenberg-Marquardt with bounds and truncated directions.

Levenberg 1944, Marquardt 1963 with column scaling and gain-ratio control (Nielsen 1999); steps are
taken in the space of the singular vectors of the scaled Jacobian, and directions whose singular
value is lost in rounding take no step at all, so that parameters which the data cannot tell apart
stay where they started instead of drifting.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import (
    ACCEPTED,
    CREEP,
    CREPT,
    NEARLY,
    RANK_TOLERANCE,
    SEEN,
)

if TYPE_CHECKING:
    from scipy.sparse import csc_array  # slow to import, and only windows need it

STUCK = "no step lowers the cost"

Jacobian: TypeAlias = "Array | csc_array"
"""The derivative (N, n) of a residual; sparse where windows have states of their own."""



@dataclass(frozen=True)
class Solution:
    """Where the search ended: `x` (n,), weighted `residual` (N,), `jacobian` (N, n)."""

    x: Array
    residual: Array
    jacobian: Jacobian
    cost: float
    iterations: int
    converged: bool
    at_bound: NDArray[np.bool_]
    reason: str


def minimise(residual: Callable[[Array], Array], jacobian: Callable[[Array, Array], Jacobian],
             start: Array, scale: Array, low: Array, high: Array, *,
             max_iterations: int = 60, tolerance: float = 1e-5,
             least_share: float = 0.0) -> Solution:
    """Minimise sum(residual(x)^2) for low <= x <= high.

    `residual(x)` gives (N,), not finite where x cannot be simulated; `jacobian(x, r)` gives
    (N, n). `scale` (n,) is the typical size of each x. The search ends when a step is expected to
    lower the cost by less than `tolerance` times its variance (cost over N - n), or when CREEP
    steps together lowered it by less than CREPT times that, or by less than `least_share` of what
    it has above N - n, the cost of noise.
    """
    x = np.clip(np.asarray(start, dtype=float), low, high)
    r = residual(x)
    cost = _cost(r)
    if not math.isfinite(cost):
        empty = np.zeros((r.size, x.size))
        return Solution(x, r, empty, math.inf, 0, False, np.zeros(x.size, bool),
                        "the start cannot be simulated")
    j = jacobian(x, r)
    damping, growth = 1e-3, 2.0
    held = np.zeros(x.size, bool)
    history = [cost]

    def ended(iterations: int, converged: bool, reason: str) -> Solution:
        return Solution(x, r, j, cost, iterations, converged, held, reason)

    for iteration in range(1, max_iterations + 1):
        if not np.all(np.isfinite(j if isinstance(j, np.ndarray) else j.data)):
            return ended(iteration, False, "the sensitivities overflow")
        held = _pushed_out(x, j.T @ r, low, high, scale)
        variance = cost / max(r.size - x.size, 1)
        if variance == 0.0:
            return ended(iteration, True, "exact")
        quadratic = _Quadratic(j, r, scale, low - x, high - x)
        for _ in range(12):
            step, expected = quadratic.step(damping, held)
            trial = np.clip(x + step, low, high)
            if expected <= tolerance * variance:
                return ended(iteration, True, "converged")
            new = residual(trial)
            new_cost = _cost(new)
            ratio = (cost - new_cost) / expected
            if ratio > ACCEPTED:
                break
            damping *= growth
            growth *= 2.0
        else:
            small = expected <= NEARLY * variance
            return ended(iteration, small, "converged" if small else STUCK)
        damping *= max(1.0 / 9.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        growth = 2.0
        x, r, cost = trial, new, new_cost
        j = jacobian(x, r)
        history.append(cost)
        least = max(CREPT * tolerance * variance, least_share * (cost - max(r.size - x.size, 1)))
        if len(history) > CREEP and history[-1 - CREEP] - cost < least:
            return ended(iteration, True, "converged slowly")
    held = _pushed_out(x, j.T @ r, low, high, scale)
    return ended(max_iterations, False, "iterations used up")


def _cost(residual: Array) -> float:
    total = float(residual @ residual)
    return total if math.isfinite(total) else math.inf


def _pushed_out(x: Array, gradient: Array, low: Array, high: Array,
                scale: Array) -> NDArray[np.bool_]:
    """Mark the entries that sit on a bound with the cost falling towards the outside."""
    tiny = 1e-12 * scale
    return ((x <= low + tiny) & (gradient > 0.0)) | ((x >= high - tiny) & (gradient < 0.0))


def dense(jacobian: Any) -> Array:
    """The jacobian (N, n) with all that is zero."""
    return jacobian if isinstance(jacobian, np.ndarray) else np.asarray(jacobian.toarray())


def column_norms(jacobian: Jacobian, scale: Array) -> Array:
    """Return the norms by which columns are divided; a column of nothing gets infinity."""
    entries: Any = jacobian
    squares = np.einsum("ij,ij->j", entries, entries) if isinstance(jacobian, np.ndarray) \
        else entries.power(2).sum(axis=0)
    norms = np.sqrt(squares)
    strongest = float(np.max(norms * scale, initial=0.0))
    return np.where(norms * scale > SEEN * strongest, norms, math.inf)


def spectral(gram: Array) -> tuple[Array, Array]:
    """Return singular values (n,), falling, and right vectors (n, n) as rows of J.

    From the Gram matrix J^T J, which resolves ratios of singular values down to 1e-7 and costs a
    fraction of a decomposition of J.
    """
    squares, vectors = np.linalg.eigh(gram)
    return np.sqrt(np.maximum(squares[::-1], 0.0)), vectors[:, ::-1].T


class _Quadratic:
    """The local model of the cost, |r + J d|^2, and its damped minimum inside a box."""

    def __init__(self, jacobian: Jacobian, residual: Array, scale: Array, low: Array,
                 high: Array) -> None:
        norms = column_norms(jacobian, scale)
        self.norms = np.where(np.isfinite(norms), norms, 1.0)
        seen = np.isfinite(norms)
        gram = jacobian.T @ jacobian
        self.gram = dense(gram) / np.outer(self.norms, self.norms)
        self.gradient = (jacobian.T @ residual) / self.norms
        self.gradient[~seen] = 0.0
        self.low, self.high = low * self.norms, high * self.norms

    def step(self, damping: float, held: NDArray[np.bool_]) -> tuple[Array, float]:
        """Return the step (n,) and the fall of the cost that goes with it.

        Where the minimum lies outside the box, the first entries to leave it stop at its wall and
        the others are found anew.
        """
        fixed = held.copy()
        d = np.zeros(fixed.size)
        for _ in range(fixed.size + 1):
            free = ~fixed
            d[free] = self._minimum(free, self.gradient + self.gram[:, fixed] @ d[fixed], damping)
            outside = free & ((d < self.low) | (d > self.high))
            if not np.any(outside):
                break
            d[outside] = np.clip(d, self.low, self.high)[outside]
            fixed |= outside
        fall = -float(2.0 * self.gradient @ d + d @ self.gram @ d)
        return d / self.norms, fall

    def _minimum(self, free: NDArray[np.bool_], gradient: Array, damping: float) -> Array:
        if not np.any(free):
            return np.empty(0)
        singular, right = spectral(self.gram[np.ix_(free, free)])
        kept = singular > RANK_TOLERANCE * singular[0]
        part = right[kept]
        return np.asarray(-part.T @ ((part @ gradient[free]) / (singular[kept] ** 2 + damping)))
