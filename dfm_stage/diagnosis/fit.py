"""Output-error fits with weights held fixed, so that chi-squares of rival models compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.system import System
from dfm_stage.diagnosis.weighting import Weights
from dfm_stage.identification.coordinates import to_physical
from dfm_stage.identification.identifiability import Identifiability
from dfm_stage.identification.least_squares import RANK_TOLERANCE, column_norms, minimise
from dfm_stage.identification.noise import score_covariance
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.result import Estimate
from dfm_stage.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """`model` with fitted values, what it leaves of each run and channel, and its chi-square.

    `jacobian` (N, n) and `white` (N,) are weighted, all runs in a row; `x` (n,) are the unknowns
    of `system`.
    """

    model: Model
    system: System
    x: Array
    residuals: list[list[Array]]
    white: Array
    jacobian: Array
    chi2: float
    converged: bool

    @property
    def rms(self) -> float:
        """RMS of the output's residual over all runs."""
        return rms([parts[0] for parts in self.residuals])

    @property
    def locals(self) -> dict[tuple[str, int], float]:
        """What was fitted to single runs."""
        return self.system.locals_of(self.x)

    @property
    def ok(self) -> bool:
        """Whether the model could be simulated at all."""
        return math.isfinite(self.chi2)


def rms(parts: Sequence[Array]) -> float:
    """RMS of several arrays together."""
    total = sum(float(p @ p) for p in parts)
    return math.sqrt(total / max(sum(p.size for p in parts), 1))


def fit(model: Model, runs: Sequence[Observation], free: Sequence[str], weights: Weights, *,
        earlier: dict[tuple[str, int], float] | None = None, dither: float = 0.0,
        iterations: int = 25, tolerance: float = 1e-2, exact: bool = False,
        allowance: float = math.inf) -> Fit:
    """Estimate the parameters `free` and what belongs to single runs.

    `earlier` are values of single runs to begin from. `tolerance` is the fall in chi-square at
    which the search ends. `exact` takes the base's sensitivities with nonlinear effects on.
    When the work (`System.work`) exceeds `allowance`, the search ends where it is.
    """
    system = System(model, runs, free, dither)
    start = system.start(earlier)

    def residual(x: Array) -> Array:
        if system.work > allowance:
            return np.array([math.inf])
        return weighted(system.residuals(x), weights)

    light = not exact and system.use_light(start)
    system.work = 0.0
    kept = _Kept(system, light)

    def jacobian(x: Array, _: Array) -> Array:
        return weighted_sensitivities(system, x, weights, light, kept)

    scale = np.array([p.scale for p in system.places])
    low = np.array([p.low for p in system.places])
    high = np.array([p.high for p in system.places])
    chord = _Chord(jacobian) if system.costly and (not light or system.cost > 1.0) else None
    found = minimise(residual, chord or jacobian, start, scale, low, high,
                     max_iterations=iterations, tolerance=tolerance)
    if chord is not None and chord.stale and system.work <= allowance:
        found = minimise(residual, jacobian, found.x, scale, low, high,
                         max_iterations=max(iterations // 2, 3), tolerance=tolerance)
    if not math.isfinite(found.cost):
        return Fit(model, system, start, [], found.residual, found.jacobian, math.inf, False)
    fitted = _assigned(model, system, found.x)
    return Fit(fitted, system, found.x, system.residuals(found.x), found.residual,
               found.jacobian, found.cost, found.converged)


def weighted(residuals: Sequence[Sequence[Array]], weights: Weights) -> Array:
    """All residuals white and in standard deviations, in a row."""
    return np.concatenate([w.apply(r) for parts, ws in zip(residuals, weights, strict=True)
                           for r, w in zip(parts, ws, strict=True)])


class _Kept:
    """Sensitivities to costly effects, used again while their parameters hardly move."""

    def __init__(self, system: System, light: bool) -> None:
        self.costly = np.array([k for k, p in enumerate(system.places)
                                if system.is_own(p.name)], dtype=np.int64)
        self.useful = light and self.costly.size > 0
        self.at: Array | None = None
        self.columns: list[list[Array]] = []

    def near(self, x: Array) -> bool:
        """Whether the kept columns still serve at `x`."""
        if not self.useful or self.at is None:
            return False
        moved = np.abs(x[self.costly] - self.at)
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


FORETOLD = 0.3
"""Part of a residual's change that a Jacobian may miss and still be used again."""
IN_A_ROW = 3
"""How often it may be used before it is taken anew."""
NEAR = 0.03
"""Relative change of a costly effect's parameters up to which its sensitivities are kept."""


def weighted_sensitivities(system: System, x: Array, weights: Weights, light: bool,
                           kept: _Kept | None = None) -> Array:
    """The derivative (N, n) of the weighted residual."""
    blocks = []
    known = kept is not None and kept.near(x)
    found = [system.sensitivities(i, x, light, own=not known) for i in range(len(weights))]
    if kept is not None and kept.useful:
        if known:
            for fresh, old in zip(found, kept.columns, strict=True):
                for columns, before in zip(fresh, old, strict=True):
                    columns[kept.costly] = before
        else:
            kept.at = x[kept.costly].copy()
            kept.columns = [[columns[kept.costly].copy() for columns in fresh] for fresh in found]
    for i, ws in enumerate(weights):
        for columns, w in zip(found[i], ws, strict=True):
            own = [k for k, p in enumerate(system.places) if p.run in (-1, i)]
            columns[~np.isfinite(columns).all(axis=1)] = 0.0
            block = np.zeros((x.size, columns.shape[1] - w.polynomial.size + 1))
            block[own] = -w.apply(columns[own])
            blocks.append(block.T)
    return np.vstack(blocks)


def _assigned(model: Model, system: System, x: Array) -> Model:
    values = system.physical(x)
    for name in PER_RUN_ZERO:
        if name in values and not math.isfinite(values[name]):
            values[name] = 0.0
    return model.with_parameters(values) if values else model


PER_RUN_ZERO = ("periodic_disturbance.phase",)


def quantities(found: Fit) -> dict[str, Quantity]:
    """Every free parameter with its 95 % interval.

    Sandwich covariance of the weighted residuals, as in `identify`; carried to physical
    parameters by its coordinates.
    """
    system = found.system
    scale = np.array([p.scale for p in system.places])
    inverse, lost = _inverse_gram(found.jacobian, scale)
    middle, dof = score_covariance(found.jacobian, found.white, inverse)
    covariance = inverse @ middle @ inverse
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    count = system.count
    names = tuple(system.fitted)
    units = tuple(system.model.parameter(a).unit if f == a else ""
                  for f, a in zip(system.fitted, system.free, strict=True))
    part = slice(0, count)
    estimate = Estimate(
        names, units, found.x[part].copy(), covariance[part, part],
        np.array([p.low for p in system.places[:count]]),
        np.array([p.high for p in system.places[:count]]), {}, dof,
        Identifiability((), ""), (), found.chi2, "converged", "", 0)
    physical = to_physical(estimate, system.groups, system.model)
    return {name: physical.quantity(name) for name in system.free}


def _inverse_gram(jacobian: Array, scale: Array) -> tuple[Array, NDArray[np.bool_]]:
    """(J^T J)+ (n, n), and which unknowns have a share in a direction that the data do not see."""
    norms = column_norms(jacobian, scale)
    scaled = jacobian / norms
    squares, vectors = np.linalg.eigh(scaled.T @ scaled)
    seen = squares > RANK_TOLERANCE**2 * squares[-1]
    kept = vectors[:, seen]
    inverse = (kept / squares[seen]) @ kept.T
    lost = np.any(np.abs(vectors[:, ~seen]) > 1e-3, axis=1) | ~np.isfinite(norms)
    return np.asarray(inverse / np.outer(norms, norms)), np.asarray(lost)
