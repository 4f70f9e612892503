"""The weighted, whitened residual of a problem and its sensitivities."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.least_squares import STUCK, Solution, minimise
from dfm_stage.identification.noise import fit_noise, whiten
from dfm_stage.identification.problem import Problem, Segment

Array = NDArray[np.float64]

ROUGH, ACCURATE = 1e-2, 1e-4
"""A search ends when the next step would lower chi-square by less than this."""


class Criterion:
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
        self.noise: list[Array] = [np.empty(0)] * len(problem.segments)
        self.frozen = False
        self._outputs: dict[tuple[int, bytes], Array] = {}
        self._slopes: dict[tuple[int, bytes, bool], Array] = {}
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
            free = 0 if self.frozen else order
            noises.append(slice(at, at + free))
            at += free
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
            gap = segment.output - self.simulated(i, values)
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
        for place, coefficients in zip(noises, self.noise, strict=True):
            if not self.frozen:
                fresh[place] = coefficients
        return fresh

    def whitener(self, index: int, x: Array) -> Array:
        """Return the polynomial A of one segment: part of `x`, or as it was last set."""
        if self.frozen:
            return np.concatenate(([1.0], self.noise[index]))
        _, noises, _ = self.layout()
        return np.concatenate(([1.0], x[noises[index]]))

    def simulated(self, index: int, values: Array) -> Array:
        """Return the output (N,) of one segment for unknowns `values`; the last few are kept."""
        key = (index, values.tobytes())
        if key not in self._outputs:
            found = np.asarray(self.problem.simulate(index, values[None, :])[0], dtype=float)
            _keep(self._outputs, key, found, 3 * len(self.problem.segments))
        return self._outputs[key]

    def gap(self, index: int, x: Array) -> Array:
        """Return measured minus simulated (N - skip,) of one segment."""
        trends, _, _ = self.layout()
        segment = self.problem.segments[index]
        total = self.simulated(index, x[: self.count]) + x[trends[index]] @ self.trends[index]
        return np.asarray(segment.output - total)[segment.skip:]

    def closest(self, index: int, x: Array) -> Array:
        """Return the gap of one segment with its own unknowns fitted to it as if noise were white.

        Whitening hardly sees how a body without a spring starts to drift; this is for looking at
        the simulated output, not for inference.
        """
        gap = self.gap(index, x)
        if not self.orders[index]:
            return gap
        trends, _, _ = self.layout()
        segment = self.problem.segments[index]
        own = [j for j, u in enumerate(self.problem.unknowns) if u.segment == index]
        active = self._active(index)
        slopes = self._sensitivities(index, x[: self.count], central=True)
        columns = np.vstack([slopes[[active.index(j) for j in own]],
                             self.trends[index]])[:, segment.skip:]
        norms = np.linalg.norm(columns, axis=1)
        columns, norms = columns[norms > 0.0], norms[norms > 0.0]
        places = np.array([*own, *range(trends[index].start, trends[index].stop)])
        if not norms.size or norms.size != places.size:
            return gap
        change = np.linalg.lstsq((columns / norms[:, None]).T, gap, rcond=1e-9)[0] / norms
        moved = x.copy()
        moved[places] += change
        closer = self.gap(index, moved)
        return closer if float(closer @ closer) < float(gap @ gap) else gap

    def residual(self, x: Array) -> Array:
        return np.concatenate([
            whiten(self.gap(i, x), self.whitener(i, x)) / self.sigma[i]
            for i in range(len(self.problem.segments))])

    def jacobian(self, x: Array, *_: Array, central: bool = False) -> Array:
        """Return the derivative of the residual: good enough to search by, or by `central`
        differences."""
        trends, noises, total = self.layout()
        blocks = []
        for i, segment in enumerate(self.problem.segments):
            polynomial = self.whitener(i, x)
            columns = np.zeros((total, segment.output.size - segment.skip))
            active = self._active(i)
            columns[active] = -self._sensitivities(i, x[: self.count], central)[:, segment.skip:]
            columns[trends[i]] = -self.trends[i][:, segment.skip:]
            white = np.zeros((total, columns.shape[1] - self.orders[i]))
            moved = [*active, *range(trends[i].start, trends[i].stop)]
            white[moved] = whiten(columns[moved], polynomial)
            if self.orders[i] and not self.frozen:
                gap = self.gap(i, x)
                lagged = np.lib.stride_tricks.sliding_window_view(gap[:-1], self.orders[i])
                white[noises[i]] = lagged[:, ::-1].T
            blocks.append(white.T / self.sigma[i])
        jacobian = np.vstack(blocks)
        self._choose_steps(jacobian)
        return jacobian

    def _active(self, index: int) -> list[int]:
        """Return the unknowns that a segment depends on."""
        return [j for j, u in enumerate(self.problem.unknowns) if u.segment in (None, index)]

    def _sensitivities(self, index: int, values: Array, central: bool) -> Array:
        """Return the derivative (active unknowns, N) of the simulated output, all in one batch.

        One-sided differences unless `central`; where the model cannot be simulated on a side, the
        other one. Kept for the last point, so that a search may begin where another ended.
        """
        key = (index, values.tobytes(), central)
        if key in self._slopes:
            return self._slopes[key]
        active, centre = self._active(index), self.simulated(index, values)
        slopes = np.zeros((len(active), centre.size))
        if not active:
            return slopes
        ends = np.empty((2, len(active)))
        for k, j in enumerate(active):
            ends[0, k] = min(values[j] + self.steps[j], self.high[j])
            ends[1, k] = max(values[j] - self.steps[j], self.low[j])
            if not central:
                ends[int(ends[0, k] - values[j] > 0.5 * self.steps[j]), k] = values[j]
        moved = [(side, k) for side in (0, 1) for k, j in enumerate(active)
                 if ends[side, k] != values[j]]
        rows = np.repeat(values[None, :], len(moved), axis=0)
        for row, (side, k) in zip(rows, moved, strict=True):
            row[active[k]] = ends[side, k]
        outputs = np.asarray(self.problem.simulate(index, rows), dtype=float)
        for output, (side, k) in zip(outputs, moved, strict=True):
            if np.isfinite(output[-1]):
                slopes[k] += (1 - 2 * side) * (output - centre)
            else:
                ends[side, k] = values[active[k]]
        width = ends[0] - ends[1]
        if not central and not np.all(width):
            return self._sensitivities(index, values, central=True)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes /= width[:, None]
        _keep(self._slopes, key, slopes, 2 * len(self.problem.segments))
        return slopes

    def _choose_steps(self, jacobian: Array) -> None:
        """Set each step to half of what the data could resolve with all else known."""
        norms = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))[: self.count]
        with np.errstate(divide="ignore", invalid="ignore"):
            wanted = 0.5 / norms
        wanted = np.where(np.isfinite(wanted), wanted, np.inf)
        if all(s == 1.0 for s in self.sigma):
            wanted = wanted * self.output_scale * 1e-2
        self.steps = np.clip(wanted, 1e-7 * self.scale, 1e-2 * self.scale)

    def minimise(self, start: Array, max_iterations: int,
                 tolerance: float = ACCURATE) -> Solution:
        _, noises, total = self.layout()
        scale = np.full(total, self.output_scale)
        scale[: self.count] = self.scale
        low, high = np.full(total, -np.inf), np.full(total, np.inf)
        low[: self.count], high[: self.count] = self.low, self.high
        for place in noises:
            scale[place] = 1.0
        found = minimise(self.residual, self.jacobian, start, scale, low, high,
                         max_iterations=max_iterations, tolerance=tolerance)
        if found.reason != STUCK:
            return found
        return minimise(self.residual, partial(self.jacobian, central=True), found.x, scale, low,
                        high, max_iterations=max_iterations, tolerance=tolerance)

    def with_central_differences(self, found: Solution) -> Solution:
        """Return `found` with the derivatives that inference wants."""
        return replace(found, jacobian=self.jacobian(found.x, central=True))

    def renew_noise(self, x: Array, max_order: int | None) -> bool:
        """Fit noise models to the residuals anew; return whether they call for another search.

        After a joint search they do only where an order has become too small or far too large, or
        where records weigh each other by noise that has changed.
        """
        models = [fit_noise(self.gap(i, x), max_order)
                  for i in range(len(self.problem.segments))]
        tiny = 1e-9 * self.output_scale
        again = self.frozen
        for old, model, sigma in zip(self.orders, models, self.sigma, strict=True):
            again |= model.order > old or 2 * model.order + 5 < old
            again |= len(models) > 1 and not 0.98 < max(model.sigma, tiny) / sigma < 1.02
        if again:
            self.orders = [m.order for m in models]
            self.sigma = [max(m.sigma, tiny) for m in models]
            self.noise = [m.coefficients for m in models]
        return again

    def renew_weights(self, x: Array) -> None:
        for i in range(len(self.problem.segments)):
            rms = float(np.sqrt(np.mean(self.gap(i, x) ** 2)))
            self.sigma[i] = max(rms, 1e-9 * self.output_scale)


def _keep(store: dict[Any, Array], key: object, value: Array, count: int) -> None:
    """Put into `store`, which forgets the oldest beyond `count`."""
    store[key] = value
    while len(store) > count:
        del store[next(iter(store))]


def _trend_columns(segment: Segment) -> Array:
    """Return Legendre-like columns (trend + 1, N) in time from -1 to 1."""
    time = np.linspace(-1.0, 1.0, segment.output.size)
    return np.array([time**k for k in range(segment.trend + 1)]).reshape(-1, time.size)
