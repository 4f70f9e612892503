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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.identifiability import Identifiability, judge
from dfm_stage.identification.least_squares import (
    RANK_TOLERANCE,
    Solution,
    column_norms,
    minimise,
    spectral,
)
from dfm_stage.identification.noise import NoiseModel, fit_noise, score_covariance, whiten
from dfm_stage.identification.result import Estimate, SegmentFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Unknown:
    """One parameter to estimate: where it starts, how large it typically is, where it may go.

    An unknown that belongs to one record only (an initial state) names it in `segment`.
    """

    name: str
    start: float
    scale: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    segment: int | None = None


@dataclass(frozen=True)
class Segment:
    """One record to be explained: `output` (N,), of which the first `skip` samples do not count.

    `trend` is the degree of the polynomial in time that is fitted along with it: -1 none, 0 an
    offset, 1 an offset and a drift.
    """

    output: Array
    sample_period: float
    name: str = "record"
    skip: int = 0
    trend: int = 0


@dataclass(frozen=True)
class Problem:
    """Unknowns, records and the simulation that ties them together.

    `simulate(segment, values)` takes parameter rows (P, p) and returns outputs (P, N) of that
    segment, NaN in a row that cannot be simulated.
    """

    unknowns: tuple[Unknown, ...]
    segments: tuple[Segment, ...]
    simulate: Callable[[int, Array], Array]
    output_unit: str = "m"


def estimate(problem: Problem, *, noise: str = "auto", starts: Sequence[Array] = (),
             held: dict[str, float] | None = None, max_iterations: int = 60,
             max_order: int | None = None) -> Estimate:
    """Estimate the unknowns of `problem`.

    `noise` is "auto" (an autoregression per record, its order chosen by the data) or "white".
    `starts` are alternative starting points (p,), each tried for a few iterations. A failed
    search is told by the status of the result, not by an exception.

    Raises
    ------
    IdentificationError
        If a record is too short for the number of unknowns or holds values that are not finite.
    """
    _check(problem, noise)
    criterion = _Criterion(problem)
    solution = _best_start(criterion, starts, max_iterations)
    iterations = solution.iterations
    if not math.isfinite(solution.cost):
        return _failed(problem, held or {}, "the model cannot be simulated from its starting "
                       "values: start from others or tighten the bounds")
    if noise == "auto":
        for _ in range(4):
            changed = criterion.renew_noise(solution.x, max_order)
            if not changed:
                break
            solution = criterion.minimise(criterion.start_from(solution.x), max_iterations)
            iterations += solution.iterations
    elif len(problem.segments) > 1:
        for _ in range(3):
            criterion.renew_weights(solution.x)
            solution = criterion.minimise(solution.x, max_iterations)
            iterations += solution.iterations
    if not (math.isfinite(solution.cost) and np.all(np.isfinite(solution.jacobian))):
        return _failed(problem, held or {}, f"{solution.reason}: tighten the bounds or start from "
                       "other values")
    return _assemble(criterion, solution, held or {}, iterations)


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


class _Criterion:
    """The weighted, whitened residual over (unknowns, trends, noise coefficients)."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.count = len(problem.unknowns)
        self.scale = np.array([u.scale for u in problem.unknowns], dtype=float)
        self.low = np.array([u.low for u in problem.unknowns], dtype=float)
        self.high = np.array([u.high for u in problem.unknowns], dtype=float)
        self.steps = 1e-4 * self.scale
        self.orders = [0] * len(problem.segments)
        self.sigma = [1.0] * len(problem.segments)
        self.noise_start: list[Array] = [np.empty(0)] * len(problem.segments)
        self.trends = [_trend_columns(s) for s in problem.segments]
        spread = max(float(np.std(s.output[s.skip:])) for s in problem.segments)
        self.output_scale = spread if spread > 0.0 else 1.0

    def layout(self) -> tuple[list[slice], list[slice], int]:
        """Return the slices of trend and noise coefficients per segment, and the total."""
        at, trends, noises = self.count, [], []
        for columns in self.trends:
            trends.append(slice(at, at + columns.shape[0]))
            at += columns.shape[0]
        for order in self.orders:
            noises.append(slice(at, at + order))
            at += order
        return trends, noises, at

    def start(self, values: Array) -> Array:
        """Return the full starting vector for unknowns `values`, trends fitted linearly."""
        trends, _, total = self.layout()
        x = np.zeros(total)
        x[: self.count] = values
        for i, (segment, columns) in enumerate(zip(self.problem.segments, self.trends,
                                                   strict=True)):
            if not columns.shape[0]:
                continue
            gap = segment.output - self.simulated(i, values[None, :])[0]
            if np.all(np.isfinite(gap)):
                x[trends[i]] = np.linalg.lstsq(columns[:, segment.skip:].T, gap[segment.skip:],
                                               rcond=None)[0]
        return x

    def start_from(self, x: Array) -> Array:
        """Carry unknowns and trends of an earlier vector over to the present noise orders."""
        trends, noises, total = self.layout()
        fresh = np.zeros(total)
        kept = trends[-1].stop if trends else self.count
        fresh[:kept] = x[:kept]
        for place, coefficients in zip(noises, self.noise_start, strict=True):
            fresh[place] = coefficients
        return fresh

    def simulated(self, index: int, rows: Array) -> Array:
        return np.asarray(self.problem.simulate(index, rows), dtype=float)

    def gap(self, index: int, x: Array) -> Array:
        """Return measured minus simulated (N - skip,) of one segment."""
        trends, _, _ = self.layout()
        segment = self.problem.segments[index]
        simulated = self.simulated(index, x[None, : self.count])[0]
        total = simulated + x[trends[index]] @ self.trends[index]
        return np.asarray(segment.output - total)[segment.skip:]

    def residual(self, x: Array) -> Array:
        _, noises, _ = self.layout()
        parts = []
        for i, place in enumerate(noises):
            polynomial = np.concatenate(([1.0], x[place]))
            parts.append(whiten(self.gap(i, x), polynomial) / self.sigma[i])
        return np.concatenate(parts)

    def jacobian(self, x: Array, _: Array) -> Array:
        trends, noises, total = self.layout()
        blocks = []
        for i, segment in enumerate(self.problem.segments):
            polynomial = np.concatenate(([1.0], x[noises[i]]))
            columns = np.zeros((total, segment.output.size - segment.skip))
            active = [j for j, u in enumerate(self.problem.unknowns) if u.segment in (None, i)]
            columns[active] = -self._sensitivities(i, x[: self.count], active)[:, segment.skip:]
            columns[trends[i]] = -self.trends[i][:, segment.skip:]
            white = np.zeros((total, columns.shape[1] - self.orders[i]))
            moved = [*active, *range(trends[i].start, trends[i].stop)]
            white[moved] = whiten(columns[moved], polynomial)
            if self.orders[i]:
                gap = self.gap(i, x)
                lagged = np.lib.stride_tricks.sliding_window_view(gap[:-1], self.orders[i])
                white[noises[i]] = lagged[:, ::-1].T
            blocks.append(white.T / self.sigma[i])
        jacobian = np.vstack(blocks)
        self._choose_steps(jacobian)
        return jacobian

    def _sensitivities(self, index: int, values: Array, active: list[int]) -> Array:
        """Return the derivative (len(active), N) of the simulated output by central differences.
        """
        if not active:
            return np.empty((0, self.problem.segments[index].output.size))
        count = len(active)
        rows = np.repeat(values[None, :], 2 * count + 1, axis=0)
        for k, j in enumerate(active):
            rows[k, j] = min(values[j] + self.steps[j], self.high[j])
            rows[count + k, j] = max(values[j] - self.steps[j], self.low[j])
        outputs = self.simulated(index, rows)
        for k, j in enumerate(active):
            for side in (k, count + k):
                if not np.isfinite(outputs[side, -1]):
                    rows[side, j], outputs[side] = values[j], outputs[-1]
        width = np.array([rows[k, j] - rows[count + k, j] for k, j in enumerate(active)])
        return np.asarray((outputs[:count] - outputs[count:-1]) / width[:, None])

    def _choose_steps(self, jacobian: Array) -> None:
        """Set each step to half of what the data could resolve with all else known."""
        norms = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))[: self.count]
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = 0.5 / norms
        wanted = np.where(np.isfinite(wanted), wanted, np.inf)
        if all(s == 1.0 for s in self.sigma):
            wanted = wanted * self.output_scale * 1e-2
        self.steps = np.clip(wanted, 1e-7 * self.scale, 1e-2 * self.scale)

    def minimise(self, start: Array, max_iterations: int) -> Solution:
        _, noises, total = self.layout()
        scale = np.full(total, self.output_scale)
        scale[: self.count] = self.scale
        low, high = np.full(total, -np.inf), np.full(total, np.inf)
        low[: self.count], high[: self.count] = self.low, self.high
        for place in noises:
            scale[place] = 1.0
        return minimise(self.residual, self.jacobian, start, scale, low, high,
                        max_iterations=max_iterations)

    def renew_noise(self, x: Array, max_order: int | None) -> bool:
        """Fit a noise model to each residual; return whether the fit has to be repeated."""
        changed = False
        for i in range(len(self.problem.segments)):
            model = fit_noise(self.gap(i, x), max_order)
            sigma = model.sigma if model.sigma > 0.0 else self.output_scale * 1e-9
            ratio = sigma / self.sigma[i]
            if model.order != self.orders[i] or not 0.99 < ratio < 1.01:
                changed = True
            self.orders[i], self.sigma[i] = model.order, sigma
            self.noise_start[i] = model.coefficients
        return changed

    def renew_weights(self, x: Array) -> None:
        for i in range(len(self.problem.segments)):
            rms = float(np.sqrt(np.mean(self.gap(i, x) ** 2)))
            self.sigma[i] = max(rms, 1e-9 * self.output_scale)


def _trend_columns(segment: Segment) -> Array:
    """Return Legendre-like columns (trend + 1, N) in time from -1 to 1."""
    time = np.linspace(-1.0, 1.0, segment.output.size)
    return np.array([time**k for k in range(segment.trend + 1)]).reshape(-1, time.size)


def _best_start(criterion: _Criterion, starts: Sequence[Array], max_iterations: int) -> Solution:
    given = np.array([u.start for u in criterion.problem.unknowns], dtype=float)
    if not starts:
        return criterion.minimise(criterion.start(given), max_iterations)
    tried = []
    for values in (given, *starts):
        criterion.steps = 1e-4 * criterion.scale
        tried.append(criterion.minimise(criterion.start(np.asarray(values, dtype=float)), 8))
    best = min(tried, key=lambda s: s.cost)
    return best if best.converged else criterion.minimise(best.x, max_iterations)


def _assemble(criterion: _Criterion, solution: Solution, held: dict[str, float],
              iterations: int) -> Estimate:
    problem, x = criterion.problem, solution.x
    trends, noises, total = criterion.layout()
    segments, row = [], 0
    middle = np.zeros((total, total))
    dof = math.inf
    for i, segment in enumerate(problem.segments):
        gap = criterion.gap(i, x)
        used = gap.size - criterion.orders[i]
        rows = slice(row, row + used)
        row += used
        part, part_dof = score_covariance(solution.jacobian[rows], solution.residual[rows])
        middle += part
        dof = part_dof if math.isinf(dof) else dof + part_dof
        innovations = solution.residual[rows] * criterion.sigma[i]
        segments.append(SegmentFit(
            segment.name, segment.output[segment.skip:], segment.output[segment.skip:] - gap,
            innovations, NoiseModel(x[noises[i]], float(np.std(innovations))), segment.skip,
            segment.sample_period))
    middle *= row / max(row - total, 1)
    dof = min(dof, float(max(row - total, 1)))
    scale = np.concatenate((criterion.scale, np.full(total - criterion.count, 1.0)))
    covariance = _sandwich(solution.jacobian, middle, scale)
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
        held, dof, verdict, tuple(segments), solution.cost, status, message, iterations, at_bound)


def _sandwich(jacobian: Array, middle: Array, scale: Array) -> Array:
    """Return H+ M H+ with H = J^T J; infinite variance where a lost direction has a share."""
    norms = column_norms(jacobian, scale)
    singular, right = spectral((jacobian / norms).T @ (jacobian / norms))
    kept = singular > RANK_TOLERANCE * singular[0]
    inverse = (right[kept].T / singular[kept] ** 2) @ right[kept]
    scaled = inverse @ (middle / np.outer(norms, norms)) @ inverse
    covariance = scaled / np.outer(norms, norms)
    lost = np.any(np.abs(right[~kept]) > 1e-3, axis=0) | ~np.isfinite(norms)
    covariance[np.ix_(lost, lost)] = np.nan
    covariance[lost, :] = np.nan
    covariance[:, lost] = np.nan
    covariance[lost, lost] = np.inf
    return np.asarray(covariance)


def _verdict(criterion: _Criterion, solution: Solution) -> Identifiability:
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


def _failed(problem: Problem, held: dict[str, float], message: str) -> Estimate:
    count = len(problem.unknowns)
    return Estimate(
        tuple(u.name for u in problem.unknowns), tuple(u.unit for u in problem.unknowns),
        np.array([u.start for u in problem.unknowns]), np.diag(np.full(count, np.inf)),
        np.array([u.low for u in problem.unknowns]), np.array([u.high for u in problem.unknowns]),
        held, 1.0, Identifiability((), "nothing was estimated"), (), math.inf, "failed", message,
        0)
