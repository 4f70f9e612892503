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
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.criterion import ACCURATE, ROUGH, Criterion
from dfm_stage.identification.decisions import (
    FAINTEST,
    FIRST_LOOK,
    LIKE,
    ORDER_ROOM,
    SAMPLES_EACH,
    WEIGHINGS,
)
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.inference import assemble, failed, run_fits
from dfm_stage.identification.least_squares import Solution
from dfm_stage.identification.noise import fit_noise
from dfm_stage.identification.problem import Problem
from dfm_stage.identification.result import Estimate
from dfm_stage.identification.weights import Weight, Weights


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
    white = tuple(_unweighted(r.measured) for r in problem.runs)
    criterion = Criterion(problem, white)
    alone = noise == "white" and sum(len(r.compared) for r in problem.runs) == 1
    solution = _best_start(criterion, starts, max_iterations, tolerance if alone else ROUGH)
    rounds = [solution]
    if not math.isfinite(solution.cost):
        return failed(problem, held or {}, "the model cannot be simulated from its starting "
                       "values: start from others or tighten the bounds")
    if noise == "auto":
        criterion, rounds = _with_noise(criterion, solution, max_iterations, max_order, tolerance)
    elif not alone:
        for _ in range(WEIGHINGS):
            criterion = Criterion(problem, _spreads(problem, rounds[-1].x))
            rounds.append(criterion.minimise(rounds[-1].x, max_iterations, tolerance))
    solution = rounds[-1]
    if math.isfinite(solution.cost):
        solution = replace(solution, jacobian=criterion.jacobian(solution.x, exact=True))
    if not (math.isfinite(solution.cost) and np.all(np.isfinite(solution.jacobian))):
        return failed(problem, held or {}, f"{solution.reason}: tighten the bounds or start from "
                       "other values")
    return assemble(criterion, solution, held or {}, sum(r.iterations for r in rounds),
                    run_fits(criterion, solution))




def _unweighted(measured: Sequence[Array]) -> tuple[Weight, ...]:
    """Weights before anything is known: several signals are brought to one size."""
    sizes = [1.0] if len(measured) == 1 else [float(np.std(m)) or 1.0 for m in measured]
    return tuple(Weight(np.ones(1), size, "") for size in sizes)


def _spreads(problem: Problem, x: Array) -> Weights:
    """White weights, as strong as what is left of each signal."""
    return tuple(tuple(Weight(np.ones(1), max(float(np.sqrt(np.mean(r**2))), least), "")
                       for r, least in zip(parts, _faintest(problem), strict=False))
                 for parts in problem.residuals(x))


def _faintest(problem: Problem) -> list[float]:
    """The least noise of each signal that is believed."""
    signals = zip_longest(*(r.measured for r in problem.runs), fillvalue=np.zeros(1))
    return [FAINTEST * (max(float(np.std(s)) for s in each) or 1.0) for each in signals]


def _noise_weights(problem: Problem, x: Array, max_order: int | None) -> Weights:
    """Weights by an autoregression of what is left of each signal."""
    found = []
    for parts in problem.residuals(x):
        models = [fit_noise(r, max_order) for r in parts]
        found.append(tuple(Weight(m.polynomial, max(m.sigma, least), "") for m, least in
                           zip(models, _faintest(problem), strict=False)))
    return tuple(found)


def _outdated(old: Weights, new: Weights) -> bool:
    """Whether new weights call for another joint search: where an order has become too small or
    far too large, or where records weigh each other by noise that has changed."""
    several = sum(map(len, old)) > 1
    return any(b.order > a.order or 2 * b.order + ORDER_ROOM < a.order
               or (several and abs(b.sigma / a.sigma - 1.0) > LIKE)
               for before, after in zip(old, new, strict=True)
               for a, b in zip(before, after, strict=True))


def _with_noise(criterion: Criterion, solution: Solution, max_iterations: int,
                max_order: int | None, tolerance: float) -> tuple[Criterion, list[Solution]]:
    """Estimate noise models and unknowns: in turn, which is cheap, and then jointly."""
    problem, rounds, count = criterion.problem, [solution], criterion.problem.start.size
    for _ in range(2):
        weights = _noise_weights(problem, rounds[-1].x[:count], max_order)
        if sum(map(len, weights)) == 1 and not weights[0][0].order:
            break
        rounds.append(Criterion(problem, weights).minimise(rounds[-1].x[:count], max_iterations,
                                                           max(ROUGH, tolerance)))
    weights = _noise_weights(problem, rounds[-1].x[:count], max_order)
    for _ in range(WEIGHINGS + 1):
        criterion = Criterion(problem, weights, joint=True)
        rounds.append(criterion.minimise(rounds[-1].x[:count], max_iterations, tolerance))
        renewed = _noise_weights(problem, rounds[-1].x[:count], max_order)
        if not _outdated(weights, renewed):
            break
        weights = renewed
    return criterion, rounds


def _check(problem: Problem, noise: str) -> None:
    if noise not in ("auto", "white"):
        raise IdentificationError(f"noise must be auto or white, not {noise!r}")
    if not problem.runs:
        raise IdentificationError("no record to estimate from: give at least one")
    for run in problem.runs:
        used = run.output.size - run.skip
        if used < SAMPLES_EACH * (len(problem.unknowns) + 1):
            raise IdentificationError(f"{run.name}: {used} samples are too few for "
                                      f"{len(problem.unknowns)} unknowns: record longer")
        if not np.all(np.isfinite(run.output)):
            raise IdentificationError(f"{run.name}: the output holds values that are not "
                                      "finite: cut or interpolate them first")




def _best_start(criterion: Criterion, starts: Sequence[Array], max_iterations: int,
                tolerance: float) -> Solution:
    given = criterion.problem.start
    if not starts:
        return criterion.minimise(given, max_iterations, tolerance)
    tried = [criterion.minimise(np.asarray(values, dtype=float), FIRST_LOOK, tolerance)
             for values in (given, *starts)]
    best = min(tried, key=lambda s: s.cost)
    return best if best.converged else criterion.minimise(best.x, max_iterations, tolerance)
