"""From a minimum to an estimate: covariance, intervals, what can be told apart, status."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.identifiability import Identifiability, judge
from dfm_stage.identification.least_squares import (
    RANK_TOLERANCE,
    Solution,
    column_norms,
    spectral,
)
from dfm_stage.identification.noise import NoiseModel, score_covariance
from dfm_stage.identification.problem import Problem
from dfm_stage.identification.result import Estimate, SegmentFit

Array = NDArray[np.float64]


def assemble(criterion: Criterion, solution: Solution, held: dict[str, float],
              iterations: int) -> Estimate:
    problem, x = criterion.problem, solution.x
    trends, noises, total = criterion.layout()
    segments, row = [], 0
    scale = np.concatenate((criterion.scale, np.full(total - criterion.count, 1.0)))
    inverse, lost, blind = _inverse(solution.jacobian, scale)
    middle = np.zeros((total, total))
    dof = math.inf
    for i, segment in enumerate(problem.segments):
        gap = criterion.closest(i, x)
        used = gap.size - criterion.orders[i]
        rows = slice(row, row + used)
        row += used
        part, part_dof = score_covariance(solution.jacobian[rows], solution.residual[rows],
                                          inverse)
        middle += part
        dof = part_dof if math.isinf(dof) else dof + part_dof
        innovations = solution.residual[rows] * criterion.sigma[i]
        segments.append(SegmentFit(
            segment.name, segment.output[segment.skip:], segment.output[segment.skip:] - gap,
            innovations, NoiseModel(x[noises[i]], float(np.std(innovations))), segment.skip,
            segment.sample_period))
    dof = min(dof, float(max(row - total, 1)))
    covariance = inverse @ middle @ inverse
    determined = covariance.copy() if np.any(lost) else None
    covariance[lost, :] = covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    names, units = _labels(problem, trends)
    shown = trends[-1].stop if trends else criterion.count
    verdict = _verdict(criterion, solution)
    at_bound = tuple(problem.unknowns[j].name
                     for j in np.flatnonzero(solution.at_bound[: criterion.count]))
    status, message = _status(solution, verdict, at_bound)
    unbounded = np.full(shown - criterion.count, np.inf)
    return Estimate(
        names, units, x[:shown].copy(), covariance[:shown, :shown],
        np.concatenate((criterion.low, -unbounded)), np.concatenate((criterion.high, unbounded)),
        held, dof, verdict, tuple(segments), solution.cost, status, message, iterations, at_bound,
        determined=None if determined is None else determined[:shown, :shown],
        blind=blind[:, :shown])


def _inverse(jacobian: Array, scale: Array) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return (J^T J)+ (p, p), which unknowns have a share in a direction that is lost, and those
    directions (k, p)."""
    norms = column_norms(jacobian, scale)
    scaled = jacobian / norms
    singular, right = spectral(scaled.T @ scaled)
    kept = singular > RANK_TOLERANCE * singular[0]
    inverse = (right[kept].T / singular[kept] ** 2) @ right[kept]
    unseen = ~np.isfinite(norms)
    lost = np.any(np.abs(right[~kept]) > 1e-3, axis=0) | unseen
    blind = np.vstack([right[~kept] / norms, np.eye(norms.size)[unseen]])
    blind[:, unseen] = np.where(blind[:, unseen] == 1.0, 1.0, 0.0)
    return np.asarray(inverse / np.outer(norms, norms)), lost, blind


def _verdict(criterion: Criterion, solution: Solution) -> Identifiability:
    common = [j for j, u in enumerate(criterion.problem.unknowns) if u.segment is None]
    rest = [j for j in range(solution.x.size) if j not in common]
    names = [criterion.problem.unknowns[j].name for j in common]
    units = [criterion.problem.unknowns[j].unit for j in common]
    variance = solution.cost / max(solution.residual.size - solution.x.size, 1)
    weighted = solution.jacobian / math.sqrt(variance) if variance > 0.0 else solution.jacobian
    return judge(names, solution.x[common], units, criterion.scale[common],
                 weighted[:, common], weighted[:, rest])


def _labels(problem: Problem, trends: list[slice]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    names = [u.name for u in problem.unknowns]
    units = [u.unit for u in problem.unknowns]
    words = ("offset", "drift")
    for segment, place in zip(problem.segments, trends, strict=True):
        for k in range(place.stop - place.start):
            names.append(f"{words[k] if k < 2 else f'trend{k}'}[{segment.name}]")
            units.append(problem.output_unit)
    return tuple(names), tuple(units)


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
    count = len(problem.unknowns)
    return Estimate(
        tuple(u.name for u in problem.unknowns), tuple(u.unit for u in problem.unknowns),
        np.array([u.start for u in problem.unknowns]), np.diag(np.full(count, np.inf)),
        np.array([u.low for u in problem.unknowns]), np.array([u.high for u in problem.unknowns]),
        held, 1.0, Identifiability((), "nothing was estimated"), (), math.inf, "failed", message,
        0)
