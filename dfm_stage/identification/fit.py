"""A model fitted to runs with the weights held, so that chi-squares of rival models compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.coordinates import to_physical
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.decisions import (
    CREPT_SHARE,
    FORETOLD,
    IN_A_ROW,
    NEAR,
    RANK_TOLERANCE,
)
from dfm_stage.identification.inference import assemble
from dfm_stage.identification.least_squares import Jacobian, Solution, dense, minimise
from dfm_stage.identification.problem import Signals
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.result import Estimate
from dfm_stage.identification.system import System
from dfm_stage.identification.weights import Weights
from dfm_stage.model import Model


@dataclass(frozen=True)
class Fit:
    """`model` with fitted values, what it leaves of each run and signal, and its chi-square.

    `slopes` (N, n) and `white` (N,) are weighted, all runs in a row; `x` (n,) are the unknowns of
    `system`, weighted by `weights`.
    """

    model: Model
    system: System
    weights: Weights
    x: Array
    residuals: list[list[Array]]
    white: Array
    slopes: Jacobian
    chi2: float
    converged: bool
    cut: bool = False
    """Whether the work allowed to a search, rather than to this fit, ended it."""

    @cached_property
    def jacobian(self) -> Array:
        """The slopes (N, n) with all that is zero."""
        return dense(self.slopes)

    @property
    def rms(self) -> float:
        """RMS of the output's residual over all runs; infinite where it cannot be simulated."""
        return rms([parts[0] for parts in self.residuals]) if self.ok else math.inf

    @property
    def locals(self) -> dict[tuple[str, int], float]:
        """What was fitted to single runs."""
        return self.system.locals_of(self.x)

    @property
    def ok(self) -> bool:
        """Whether the model could be simulated at all."""
        return math.isfinite(self.chi2)

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Every free parameter of the model with its 95 % interval, as `identify` gives it."""
        return self._physical(self._estimate)

    def quantities_over(self, middle: Array, dof: float) -> dict[str, Quantity]:
        """The same where the score's covariance is `middle` (n, n) with `dof` degrees of freedom;
        no interval is narrower than in `quantities`."""
        norms = np.linalg.norm(self.jacobian, axis=0)
        norms[norms == 0.0] = 1.0
        scaled = self.jacobian / norms
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=RANK_TOLERANCE**2) / np.outer(norms,
                                                                                       norms)
        inverse = inverse[self.system.told]
        wider = self._physical(replace(self._estimate, covariance=inverse @ middle @ inverse.T,
                                       determined=None, dof=dof))
        return {n: max(q, wider[n], key=_width) for n, q in self.quantities.items()}

    @cached_property
    def _estimate(self) -> Estimate:
        solution = Solution(self.x, self.white, self.jacobian, self.chi2, 0, self.converged,
                            np.zeros(self.x.size, bool), "")
        return assemble(Criterion(self.system, self.weights), solution, {}, 0, judged=False)

    def _physical(self, estimate: Estimate) -> dict[str, Quantity]:
        found = to_physical(estimate, self.system.groups, self.model)
        return {name: found.quantity(name) for name in self.system.free}


def _width(quantity: Quantity) -> float:
    """The width of an interval; infinite where there is none."""
    return math.inf if quantity.ci95 is None else quantity.ci95[1] - quantity.ci95[0]


def rms(parts: Sequence[Array]) -> float:
    """RMS of several arrays together."""
    total = sum(float(p @ p) for p in parts)
    return math.sqrt(total / max(sum(p.size for p in parts), 1))


def search(system: System, weights: Weights, start: Array, *, iterations: int = 25,
           tolerance: float = 1e-2, exact: bool = False, allowance: float = math.inf) -> Fit:
    """Estimate the unknowns of a system from `start` (n,), with the weights held.

    `tolerance` is the fall in chi-square at which the search ends. `exact` takes the base's
    sensitivities with nonlinear effects on. When the work (`System.work`) exceeds `allowance`,
    the search ends where it is.
    """
    light = not exact and system.barely_nonlinear(start)
    begun = system.work

    def spent() -> bool:
        return system.work - begun > allowance

    kept = _KeptSlopes(system, light)
    criterion = Criterion(system, weights, slopes=kept.slopes)

    def residual(z: Array) -> Array:
        return np.array([math.inf]) if spent() else criterion.residual(z)

    def minimum(jacobian: Callable[[Array, Array], Jacobian], x: Array, most: int) -> Solution:
        return minimise(residual, jacobian, x, system.scale, system.low, system.high,
                        max_iterations=most, tolerance=tolerance, least_share=CREPT_SHARE)

    in_windows = any(u.part is not None for u in system.unknowns)
    chord = None if in_windows or (system.nonlinear and light and not system.slow) \
        else _Chord(criterion.jacobian)
    found = minimum(chord or criterion.derivative, start, iterations)
    if chord is not None and chord.stale and not spent():
        found = minimum(criterion.jacobian, found.x, max(iterations // 2, 3))
    grown = light and iterations > 0 and math.isfinite(found.cost) \
        and not system.barely_nonlinear(found.x)
    if grown and not spent():  # the effects bend the base's slopes now
        return search(system, weights, found.x, iterations=iterations, tolerance=tolerance,
                      exact=True, allowance=allowance - (system.work - begun))
    if not math.isfinite(found.cost):
        return Fit(system.model, system, weights, start, [], found.residual, found.jacobian,
                   math.inf, False)
    return Fit(system.fitted_model(found.x), system, weights, found.x,
               system.residuals(found.x), found.residual, found.jacobian, found.cost,
               found.converged)


class _KeptSlopes:
    """Sensitivities of a system; those by nonlinear effects are used again while the effects'
    parameters hardly move, where the base's are taken without these effects (`light`)."""

    def __init__(self, system: System, light: bool) -> None:
        self.system, self.light = system, light
        self.own = np.array([k for k, u in enumerate(system.unknowns) if system.is_own(u)],
                            dtype=np.int64)
        self.rows = [system.rows[k] for k in self.own]
        self.useful = light and self.own.size > 0
        self.at: Array | None = None
        self.columns: dict[int, list[Array]] = {}

    def slopes(self, index: int, x: Array, exact: bool) -> Signals:
        """The derivatives of one run's signals, each (n, N - skip)."""
        known = self._near(x) and index in self.columns
        if not known and self.useful and (self.at is None or not self._near(x)):
            self.at, self.columns = x[self.own].copy(), {}
        found = self.system.sensitivities(index, x, exact, self.light, own=not known)
        if known:
            for columns, before in zip(found, self.columns[index], strict=True):
                columns[self.rows] = before
        elif self.useful:
            self.columns[index] = [columns[self.rows].copy() for columns in found]
        return found

    def _near(self, x: Array) -> bool:
        """Whether the kept derivatives still serve at `x`."""
        if not self.useful or self.at is None:
            return False
        moved = np.abs(x[self.own] - self.at)
        return bool(np.all(moved <= NEAR * np.maximum(np.abs(self.at), 1e-300)))


class _Chord:
    """A Jacobian (N, n) that follows the residual by Broyden's update (1965) where that foretells
    it well, and is taken anew where not: a third of the simulations of slow models."""

    def __init__(self, exact: Callable[[Array, Array], Array]) -> None:
        self.exact = exact
        self.stale = 0
        self.known: tuple[Array, Array, Array] | None = None

    def __call__(self, x: Array, r: Array) -> Array:
        """The derivative at `x` (n,), where the residual is `r` (N,)."""
        if self.known is not None and self.stale < IN_A_ROW:
            before, left, j = self.known
            step = x - before
            missed = r - left - j @ step
            if float(missed @ missed) < FORETOLD**2 * float((r - left) @ (r - left)):
                norms = np.einsum("ij,ij->j", j, j)
                along = norms * step
                j = j + np.outer(missed, along / max(float(along @ step), 1e-300))
                self.known, self.stale = (x.copy(), r, j), self.stale + 1
                return j
        j = self.exact(x, r)
        self.known, self.stale = (x.copy(), r, j), 0
        return j
