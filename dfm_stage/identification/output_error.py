"""Output-error estimation on one or several records, in open or closed loop.

The model is simulated over the whole record from the measured input; what remains is the noise
v = y - y(theta). Where v is coloured, the squares of A(q) v are minimised jointly over theta and
the coefficients of A, one autoregression per record: the direct prediction-error method (Ljung,
System Identification, 2nd ed., sec. 7.2 and 13.4). It stays consistent when v is fed back into the
input, because A(q) v(t) is then white and the simulated output depends on past inputs only; plain
output error does not. Intervals come from the sandwich covariance of the whitened residuals.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.criterion import ACCURATE, ROUGH, Criterion
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.inference import assemble, failed
from dfm_stage.identification.least_squares import Solution
from dfm_stage.identification.problem import Problem
from dfm_stage.identification.result import Estimate

Array = NDArray[np.float64]


def estimate(problem: Problem, *, noise: str = "auto", starts: Sequence[Array] = (),
             held: dict[str, float] | None = None, max_iterations: int = 60,
             max_order: int | None = None, tolerance: float = ACCURATE) -> Estimate:
    """Estimate the unknowns of `problem`.

    `noise` is "auto" (an autoregression per record, its order chosen by the data) or "white".
    `starts` are alternative starting points (p,), each tried for a few iterations. The search
    ends when the next step would lower chi-square by less than `tolerance`, or when eight steps
    together lowered it by less than 500 times that: 0.01 is enough to compare models. A failed
    search is told by the status of the result, not by an exception.

    Raises
    ------
    IdentificationError
        If a record is too short for the number of unknowns or holds values that are not finite.
    """
    _check(problem, noise)
    criterion = Criterion(problem)
    first = tolerance if noise == "white" and len(problem.segments) == 1 else ROUGH
    solution = _best_start(criterion, starts, max_iterations, first)
    iterations = solution.iterations
    if not math.isfinite(solution.cost):
        return failed(problem, held or {}, "the model cannot be simulated from its starting "
                       "values: start from others or tighten the bounds")
    if noise == "auto":
        solution, spent = _with_noise(criterion, solution, max_iterations, max_order,
                                      tolerance)
        iterations += spent
    elif len(problem.segments) > 1:
        for _ in range(3):
            criterion.renew_weights(solution.x)
            solution = criterion.minimise(solution.x, max_iterations, tolerance)
            iterations += solution.iterations
    if math.isfinite(solution.cost):
        solution = criterion.with_central_differences(solution)
    if not (math.isfinite(solution.cost) and np.all(np.isfinite(solution.jacobian))):
        return failed(problem, held or {}, f"{solution.reason}: tighten the bounds or start from "
                       "other values")
    return assemble(criterion, solution, held or {}, iterations)


def _with_noise(criterion: Criterion, solution: Solution, max_iterations: int,
                max_order: int | None, tolerance: float) -> tuple[Solution, int]:
    """Estimate noise models and unknowns: in turn, which is cheap, and then jointly."""
    spent = 0
    criterion.frozen = True
    for _ in range(2):
        criterion.renew_noise(solution.x, max_order)
        if len(criterion.orders) == 1 and not criterion.orders[0]:
            break
        solution = criterion.minimise(criterion.start_from(solution.x), max_iterations,
                                      max(ROUGH, tolerance))
        spent += solution.iterations
    criterion.renew_noise(solution.x, max_order)
    criterion.frozen = False
    for _ in range(3):
        solution = criterion.minimise(criterion.start_from(solution.x), max_iterations, tolerance)
        spent += solution.iterations
        if not criterion.renew_noise(solution.x, max_order):
            break
    else:
        solution = criterion.minimise(criterion.start_from(solution.x), max_iterations, tolerance)
    return solution, spent


def _check(problem: Problem, noise: str) -> None:
    if noise not in ("auto", "white"):
        raise IdentificationError(f"noise must be auto or white, not {noise!r}")
    if not problem.segments:
        raise IdentificationError("no record to estimate from: give at least one")
    for segment in problem.segments:
        used = segment.output.size - segment.skip
        if used < 4 * (len(problem.unknowns) + segment.trend + 2):
            raise IdentificationError(f"{segment.name}: {used} samples are too few for "
                                      f"{len(problem.unknowns)} unknowns: record longer")
        if not np.all(np.isfinite(segment.output)):
            raise IdentificationError(f"{segment.name}: the output holds values that are not "
                                      "finite: cut or interpolate them first")


def _best_start(criterion: Criterion, starts: Sequence[Array], max_iterations: int,
                tolerance: float) -> Solution:
    given = np.array([u.start for u in criterion.problem.unknowns], dtype=float)
    if not starts:
        return criterion.minimise(criterion.start(given), max_iterations, tolerance)
    tried = []
    for values in (given, *starts):
        criterion.steps = 1e-4 * criterion.scale
        x = criterion.start(np.asarray(values, dtype=float))
        tried.append(criterion.minimise(x, 8, tolerance))
    best = min(tried, key=lambda s: s.cost)
    return best if best.converged else criterion.minimise(best.x, max_iterations, tolerance)
