"""From a minimum to an estimate: covariance, intervals, what can be told apart, status."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.decisions import RANK_TOLERANCE, SHARE_OF_LOST
from dfm_stage.identification.identifiability import Identifiability, judge
from dfm_stage.identification.least_squares import (
    Solution,
    column_norms,
    spectral,
)
from dfm_stage.identification.noise import NoiseModel, score_covariance
from dfm_stage.identification.problem import Problem
from dfm_stage.identification.result import Estimate, SegmentFit

Places = NDArray[np.int64]


@dataclass(frozen=True)
class Uncertainty:
    """Covariance (k, k) of those unknowns that are wanted, with its degrees of freedom; which of
    all (n,) have a share in a direction that the data do not see, and those directions (m, n)."""

    covariance: Array
    dof: float
    lost: NDArray[np.bool_]
    blind: Array


def uncertainty(criterion: Criterion, solution: Solution, wanted: Places) -> Uncertainty:
    """The sandwich covariance of the weighted residuals of the unknowns `wanted` (k,), the
    score's spectrum taken run by run."""
    extra = solution.x.size - criterion.problem.start.size
    scale = np.concatenate((criterion.problem.scale, np.ones(extra)))
    root, lost, blind = _inverse_root(solution.jacobian, scale)
    covariance = np.zeros((wanted.size, wanted.size))
    dof, row = 0.0, 0
    for size in _sizes(criterion, solution.x):
        rows = slice(row, row + size)
        row += size
        taken = solution.jacobian[rows] @ root
        part, part_dof = score_covariance(taken @ root[wanted].T, solution.residual[rows], taken)
        covariance += part
        dof += part_dof
    return Uncertainty(covariance, min(dof, float(max(row - lost.size, 1))), lost, blind)


def _sizes(criterion: Criterion, z: Array) -> list[int]:
    """The number of weighted residuals of each run and signal."""
    return [m.size - criterion.polynomial(i, s, z).size + 1
            for i, run in enumerate(criterion.problem.runs) for s, m in enumerate(run.measured)]


def assemble(criterion: Criterion, solution: Solution, held: dict[str, float],
             iterations: int, fits: tuple[SegmentFit, ...] = (), *,
             judged: bool = True) -> Estimate:
    """The estimate that a minimum stands for; the weights' own coefficients and the states of
    windows are left out. `fits` are those of `run_fits`, where they are wanted; unless `judged`,
    nothing is said of what cannot be told apart."""
    problem, shown = criterion.problem, criterion.problem.told
    unknowns = [problem.unknowns[k] for k in shown]
    found = uncertainty(criterion, solution, shown)
    covariance, lost = found.covariance, found.lost[shown]
    determined = covariance.copy() if np.any(found.lost) else None
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    names = tuple(u.name if u.run is None else f"{u.name}[{problem.runs[u.run].name}]"
                  for u in unknowns)
    verdict = _verdict(criterion, solution) if judged else Identifiability((), "not judged")
    at_bound = tuple(names[j] for j in np.flatnonzero(solution.at_bound[shown]))
    status, message = _status(solution, verdict, at_bound)
    return Estimate(
        names, tuple(u.unit for u in unknowns), solution.x[shown], covariance,
        problem.low[shown], problem.high[shown], held, found.dof, verdict, fits, solution.cost,
        status, message, iterations, at_bound, determined=determined,
        blind=found.blind[:, shown])


def run_fits(criterion: Criterion, solution: Solution) -> tuple[SegmentFit, ...]:
    """How the output of each run was explained."""
    fits, row = [], 0
    sizes = iter(_sizes(criterion, solution.x))
    for i, run in enumerate(criterion.problem.runs):
        size = next(sizes)
        white = solution.residual[row:row + size]
        row += size + sum(next(sizes) for _ in run.measured[1:])
        innovations = white * criterion.weights[i][0].sigma
        polynomial = criterion.polynomial(i, 0, solution.x)
        noise = NoiseModel(polynomial[1:], float(np.std(innovations)))
        measured = run.measured[0]
        fits.append(SegmentFit(run.name, measured, measured - closest(criterion, i, solution.x),
                               innovations, noise, run.skip, run.sample_period))
    return tuple(fits)


def closest(criterion: Criterion, index: int, z: Array) -> Array:
    """Measured minus simulated output (N - skip,) of one run with its own unknowns fitted to it as
    if noise were white.

    Whitening hardly sees how a body without a spring starts to drift; this is for looking at the
    simulated output, not for inference.
    """
    problem = criterion.problem
    x = z[:problem.start.size]
    gap = problem.residuals(x)[index][0]
    own = [k for k, u in enumerate(problem.unknowns) if u.run == index]
    if criterion.polynomial(index, 0, z).size == 1 or not own:
        return gap
    slopes = problem.sensitivities(index, x)[0]
    columns = np.array([problem.slope(slopes, k, index) for k in own])
    norms = np.linalg.norm(columns, axis=1)
    if not np.all(norms > 0.0):
        return gap
    moved = x.copy()
    moved[own] += np.linalg.lstsq((columns / norms[:, None]).T, gap, rcond=1e-9)[0] / norms
    closer = problem.residuals(moved)[index][0]
    return closer if float(closer @ closer) < float(gap @ gap) else gap


def _inverse_root(jacobian: Array, scale: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return R (n, r) with (J^T J)+ = R R^T, so that J R is orthonormal, which unknowns have a
    share in a direction that is lost, and those directions (m, n)."""
    norms = column_norms(jacobian, scale)
    scaled = jacobian / norms
    singular, right = spectral(scaled.T @ scaled)
    kept = singular > RANK_TOLERANCE * singular[0]
    root = (right[kept] / singular[kept, None] / norms).T
    unseen = ~np.isfinite(norms)
    lost = np.any(np.abs(right[~kept]) > SHARE_OF_LOST, axis=0) | unseen
    blind = np.vstack([right[~kept] / norms, np.eye(norms.size)[unseen]])
    blind[:, unseen] = np.where(blind[:, unseen] == 1.0, 1.0, 0.0)
    return np.asarray(root), lost, blind


def _verdict(criterion: Criterion, solution: Solution) -> Identifiability:
    unknowns = criterion.problem.unknowns
    common = [j for j, u in enumerate(unknowns) if u.run is None]
    rest = [j for j in range(solution.x.size) if j not in common]
    variance = solution.cost / max(solution.residual.size - solution.x.size, 1)
    weighted = solution.jacobian / math.sqrt(variance) if variance > 0.0 else solution.jacobian
    return judge([unknowns[j].name for j in common], solution.x[common],
                 [unknowns[j].unit for j in common], criterion.problem.scale[common],
                 weighted[:, common], weighted[:, rest])


def _status(solution: Solution, verdict: Identifiability,
            at_bound: tuple[str, ...]) -> tuple[str, str]:
    if not solution.converged:
        return "not_converged", (f"{solution.reason}: start closer, hold a parameter, or allow "
                                 "more iterations")
    blind = [d for d in verdict.directions if math.isinf(d.std)]
    if blind:
        return "not_identifiable", "; ".join(d.text for d in blind)
    if at_bound:
        return "at_bound", limit_message(at_bound)
    return "converged", "converged"


def limit_message(names: Sequence[str]) -> str:
    """Say which parameters ended on their limit and what to do."""
    return f"{', '.join(names)} ended on the limit: hold or widen it"


def failed(problem: Problem, held: dict[str, float], message: str) -> Estimate:
    """What stands in the place of an estimate where a search failed."""
    return Estimate(
        tuple(u.name for u in problem.unknowns), tuple(u.unit for u in problem.unknowns),
        problem.start, np.diag(np.full(problem.start.size, np.inf)), problem.low, problem.high,
        held, 1.0, Identifiability((), "nothing was estimated"), (), math.inf, "failed", message,
        0)
