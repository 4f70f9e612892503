"""A fast look at every candidate: how much chi-square its response could take from the residual.

The response of the model to a small amount of an effect is projected off everything that the free
parameters, initial states and offsets can do; its best multiple is then a matter of one linear
step (a score test). Pairs are screened jointly, because a single effect may stand in for two.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.candidates import shown_by_none, starts
from dfm_stage.diagnosis.decisions import COARSER, FEWEST_CYCLES, STEP_GRID
from dfm_stage.diagnosis.fit import Fit, system_of, weighted_output
from dfm_stage.diagnosis.force_response import ForceResponse
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.search_decisions import (
    LEAST_TRAVEL,
    LOOKED_CLOSELY,
    MOVES_ALIKE,
    SCREEN_RANK,
    UNSEEN_PART,
)
from dfm_stage.diagnosis.spectra import frequency_peaks, position_peaks, read_off
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.weights import Weights
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import Parameters

BATCH = 400_000
"""Samples of all responses that are simulated at once, for what they take of memory."""


@dataclass(frozen=True)
class Hit:
    """One effect at its best starting point: the fall in chi-square and the parameters.

    `columns` (N, c) is its projected weighted response, `multiples` (c,) the best sizes of it.
    """

    name: str
    gain: float
    parameters: dict[str, float]
    columns: Array
    multiples: Array
    rescalable: bool = True
    """Whether one multiple makes its size."""

    @classmethod
    def at(cls, name: str, parameters: Mapping[str, float]) -> Hit:
        """An effect to begin with that no screen has looked at."""
        return cls(name, 0.0, dict(parameters), np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True)
class Seen:
    """Responses (c, N) as `rows` that are seen beside the free parameters; of what these cannot
    follow the products with each other, `gram` (c, c), and with the residual, `score` (c,)."""

    rows: Array
    gram: Array
    score: Array


class Screen:
    """Screens candidates against the residual of a fit."""

    def __init__(self, base: Fit, runs: Sequence[Observation], weights: Weights,
                 noise: float, linear: Model | None = None) -> None:
        """`linear` is a model that moves alike, for a first look beside nonlinear effects; it
        answers for one that is slow to simulate."""
        self.base, self.runs, self.weights, self.noise = base, tuple(runs), weights, noise
        system = base.system
        light = system.barely_nonlinear(base.x)
        self.model = base.model
        for name in system.nonlinear if light else ():
            self.model = self.model.without_effect(name)
        if linear is not None and not light and system.slow:
            self.model = linear
        criterion = Criterion(system, weights, slopes=lambda i, x, exact: system.sensitivities(
            i, x, exact, light))
        jacobian = criterion.jacobian(base.x)
        self.basis = span(jacobian)
        white = base.white
        self.residual = off(self.basis, white)
        self.edges = self._edges()
        self.plain = self._outputs(self.model)
        self.at = self._conditions()
        self._strengths: list[tuple[str, Parameters, float]] = []
        self._forced = self._force_response()
        self._first = self._beside(linear) if linear is not None and not light and (
            self.model is not linear) else None

    def _beside(self, linear: Model) -> Screen | None:
        """The same, with the effects beside a linear model; None where it moves otherwise."""
        other = copy.copy(self)
        other.model, other.plain, other._strengths = linear, self._outputs(linear), []
        other._forced = other._force_response()
        if self.plain is None or other.plain is None or np.linalg.norm(
                self.plain - other.plain) > MOVES_ALIKE * np.linalg.norm(self.plain):
            return None
        return other

    def _edges(self) -> list[tuple[int, int]]:
        found, at = [], 0
        for run, ws in zip(self.runs, self.weights, strict=True):
            size = sum(run.input.size - run.skip - w.polynomial.size + 1 for w in ws)
            found.append((at, at + size))
            at += size
        return found

    def _outputs(self, model: Model) -> Array | None:
        """The weighted output (N,) of a model at the base's local values; None if impossible."""
        return weighted_output(model, self.base, self.runs, self.weights, self.noise)

    def _force_response(self) -> ForceResponse | None:
        """What small forces add to the motion of the model; None beside nonlinear effects."""
        system = system_of(self.model, self.runs, (), self.noise)
        if self.plain is None or not ForceResponse.serves(system):
            return None
        return ForceResponse(system, system.started(self.base.locals))

    def project(self, columns: Array) -> Array:
        """Take out of `columns` (N, c) what the free parameters can do."""
        return off(self.basis, columns)

    def hits(self, name: str, keep: int | None = 2) -> list[Hit]:
        """The best starting points of one effect, best first; all where `keep` is None."""
        points = starts(name, self.at)
        if self._first is not None and len(points) > LOOKED_CLOSELY:
            looks = self._first._looked_at(name, points)
            promise = [-math.inf if h is None else h.gain for h in looks]
            points = [points[k] for k in sorted(np.argsort(promise)[-LOOKED_CLOSELY:])]
        found = self._looked_at(name, points)
        best = sorted((h for h in found if h is not None), key=lambda h: -h.gain)[:keep]
        return [replace(h, columns=self.project(h.columns)) for h in best]

    def _looked_at(self, name: str, points: Sequence[Parameters]) -> list[Hit | None]:
        """The hit of each starting point of one effect, with responses that are not projected;
        None where there is none."""
        effect = EFFECTS[name]
        model, plain = self.model, self.plain
        if effect.rounds:  # at the motion itself, to a part of a step
            model = self.base.model
            plain = self._outputs(model)
        if plain is None or not points:
            return [None] * len(points)
        if shown_by_none(name, self.runs) and not any(run.window for run in self.runs):
            return [self._in_free_motion(model, name, p) for p in points]
        directions = [effect.directions(p, self.at) for p in points]
        changes = self._changes(model, plain, name, [p for group in directions for p in group])
        found: list[Hit | None] = []
        at_once = max(BATCH // self.residual.size, 1)
        for first in range(0, len(points), at_once):
            some = directions[first:first + at_once]
            rows = [self._by_run(name, [next(changes) for _ in group]) for group in some]
            found += [self._hit(name, parameters, group, each) for parameters, group, each in zip(
                points[first:first + at_once], some, self._seen(rows), strict=True)]
        return found

    def _seen(self, groups: Sequence[Array]) -> Iterator[Seen]:
        """Each group of responses (c, N); none where one is not finite. All groups at once: the
        basis is long."""
        rows = np.concatenate(groups)
        known = np.isfinite(np.einsum("ij,ij->i", rows, rows))
        rows[~known] = 0.0
        followed, scores = rows @ self.basis, rows @ self.residual
        ends = np.cumsum([0, *(len(group) for group in groups)])
        for first, end in pairwise(ends):
            own, moved, score = rows[first:end], followed[first:end], scores[first:end]
            whole = np.einsum("ij,ij->i", own, own)
            if len(own) > 1:    # products of what is left of several lose what parts these
                own -= moved @ self.basis.T
            gram = own @ own.T - (moved @ moved.T if len(own) == 1 else 0.0)
            seen = np.diag(gram) > UNSEEN_PART**2 * np.maximum(whole, 1e-300)
            if not np.all(known[first:end]):
                seen[:] = False
            yield Seen(own, gram, score) if np.all(seen) else Seen(
                own[seen], gram[np.ix_(seen, seen)], score[seen])

    def _in_free_motion(self, model: Model, name: str, parameters: Parameters) -> Hit | None:
        """The hit of an effect that nothing drives: its states at the beginning of each run, not
        a size, are what the residual tells."""
        hidden = {n: EFFECTS[name].defaults[n] for n in shown_by_none(name, self.runs)}
        parameters = {**parameters, **hidden}
        system = system_of(model.with_effect(name, parameters), self.runs, (), self.noise)
        x = system.started(self.base.locals)
        columns = []
        for i, ((a, b), ws) in enumerate(zip(self.edges, self.weights, strict=True)):
            own = [k for k, u in enumerate(system.unknowns)
                   if u.run == i and u.name.startswith(f"initial.{name}.")]
            rows = np.tile(x, (len(own) + 1, 1))
            rows[range(1, len(own) + 1), own] += [system.unknowns[k].scale for k in own]
            weighted = np.concatenate([[w.apply(row) for row in out] for out, w in zip(
                system.signals(i, rows), ws, strict=True)], axis=1)
            for row in weighted[1:]:
                column = np.zeros(self.residual.size)
                column[a:b] = row - weighted[0]
                columns.append(column)
        if not columns or not np.all(np.isfinite(columns)):
            return None
        projected = self.project(np.array(columns).T)
        multiples, gain = _best(projected.T @ projected, projected.T @ self.residual)
        return Hit(name, gain, parameters, (projected @ multiples)[:, None], np.ones(1), False)

    def _changes(self, model: Model, plain: Array, name: str,
                 points: Sequence[Parameters]) -> Iterator[Array]:
        """What one effect adds to the weighted outputs (N,) at each of several points."""
        if self._forced is not None and ForceResponse.tells(EFFECTS[name]):
            for point in points:
                yield self._weighted(self._forced.changes(name, point))
        else:
            for response in self._responses(model, name, points):
                yield response - plain

    def _weighted(self, signals: Sequence[Sequence[Array]]) -> Array:
        """The signals of each run, weighted, in a row (N,)."""
        return np.concatenate([w.apply(signal) for run, ws in zip(
            signals, self.weights, strict=True) for signal, w in zip(run, ws, strict=True)])

    def _responses(self, model: Model, name: str,
                   points: Sequence[Parameters]) -> Iterator[Array]:
        """The weighted outputs (N,) of a model with one effect at each of several points."""
        alike = all(p.keys() == points[0].keys() for p in points)
        at_once = max(BATCH // sum(run.input.size for run in self.runs), 1) if alike else 1
        for first in range(0, len(points), at_once):
            some = points[first:first + at_once]
            system = system_of(model.with_effect(name, some[0]), self.runs, (), self.noise)
            x = system.started(self.base.locals)
            values = {f"{name}.{n}": np.array([p[n] for p in some]) for n in some[0]}
            parts = [[[w.apply(row) for row in out] for out, w in zip(
                system.varied(i, x, values), ws, strict=True)]
                for i, ws in enumerate(self.weights)]
            for k in range(len(some)):
                yield np.concatenate([rows[k] for signals in parts for rows in signals])

    def smallest(self, limit: float) -> dict[str, Parameters]:
        """Size of each effect screened so far at which chi-square is expected to rise by `limit`.

        To first order in the size, at the starting point that shows best; where the effect is
        there, half of all records show it more clearly. Without those of no free size.
        """
        found: dict[str, Parameters] = {}
        for name, parameters, strength in self._strengths:
            if strength <= 0.0:
                continue
            effect = EFFECTS[name]
            grown = effect.scaled(parameters, math.sqrt(limit) / strength)
            sizes = {n: abs(v) for n, v in grown.items() if v and n in effect.sizes}
            first = next(iter(sizes))
            if sizes[first] < found.get(name, {}).get(first, math.inf):
                found[name] = sizes
        return found

    def _conditions(self) -> Conditions:
        """Sizes in the runs, and what stands out in the residual: lines over time, patterns over
        position, and steps of the reading."""
        model = self.base.model
        at = Conditions.of(model.base, model.drive, self.runs, self.weights[0][0].rms,
                           model.position_unit)
        first = [self.residual[a:a + run.input.size - run.skip - ws[0].order]
                 for (a, _), run, ws in zip(self.edges, self.runs, self.weights, strict=True)]
        lines = frequency_peaks(first, at.sample_period, lowest_hz=FEWEST_CYCLES / at.duration)
        residuals = [parts[0] for parts in self.base.residuals]
        positions = [run.simulated_position(r) for run, r in zip(self.runs, residuals,
                                                                 strict=True)]
        at = replace(at, frequencies=tuple(lines))
        travel = max(float(np.ptp(p)) for p in positions)
        if self.runs[0].order or travel < LEAST_TRAVEL * at.noise:
            return at
        periods = position_peaks(positions, residuals)
        return replace(at, periods=tuple(periods), steps=tuple(self._steps(
            periods, positions[0], residuals[0], at)))

    def _steps(self, periods: Sequence[float], position: Array, residual: Array,
               at: Conditions) -> list[float]:
        """Steps (m) that the reading may count in: read off it, or the best near `periods`."""
        known = at.base.get("encoder_resolution", 0.0)
        step = read_off(self.runs[0].output, known)
        if step is not None:
            return [step] if step > at.noise else []
        grid = np.arange(-20, 21) * STEP_GRID
        tried = [p for period in periods for p in period * (1.0 + grid * period / at.travel)]
        best = sorted(tried, key=lambda p: -_staircase(position, residual, p))[:2]
        return [float(p) for p in best if p > max(at.noise, COARSER * known)]

    def _hit(self, name: str, parameters: Parameters, directions: Sequence[Parameters],
             seen: Seen) -> Hit | None:
        effect = EFFECTS[name]
        if not seen.score.size:
            return None
        if effect.searched:
            gain = float(2.0 * seen.score[0] - seen.gram[0, 0])
            return Hit(name, gain, dict(parameters), seen.rows.T, np.ones(1))
        phases = 2.0 if effect.wave else 1.0
        own = np.trace(seen.gram) if effect.wave else seen.gram[0, 0]
        self._strengths.append((name, parameters, math.sqrt(own / phases)))
        multiples, gain = _best(seen.gram, seen.score)
        if effect.one_sided and not effect.wave and multiples[0] <= 0.0:
            return None
        return Hit(name, gain, effect.combined(directions, multiples[:len(directions)]),
                   seen.rows.T, multiples, len(directions) == 1)

    def _by_run(self, name: str, responses: Sequence[Array]) -> Array:
        """Responses as rows (c, N); one a run of an effect that differs by run."""
        together = np.array(responses)
        if not EFFECTS[name].per_run or len(self.runs) == 1:
            return together
        split = np.zeros((len(self.edges), *together.shape))
        for own, (a, b) in zip(split, self.edges, strict=True):
            own[:, a:b] = together[:, a:b]
        return split.reshape(-1, together.shape[1])


def span(jacobian: Array) -> Array:
    """Orthonormal columns (N, r) of what the parameters with these slopes (N, n) can do."""
    norms = np.linalg.norm(jacobian, axis=0)
    seen = norms > UNSEEN_PART**2 * max(float(norms.max(initial=0.0)), 1e-300)
    left, values, _ = np.linalg.svd(jacobian[:, seen] / norms[seen], full_matrices=False)
    return np.asarray(left[:, values > SCREEN_RANK * values.max(initial=0.0)])


def off(basis: Array, columns: Array) -> Array:
    """`columns` (N,) or (N, c) without what a `basis` (N, r) of orthonormal columns can do."""
    return np.asarray(columns - basis @ (basis.T @ columns))


def _staircase(position: Array, residual: Array, step: float) -> float:
    """How well rounding `position` (N,) to `step` explains `residual` (N,)."""
    d = step * np.rint(position / step) - position
    return float(2.0 * d @ residual - d @ d)


def _best(gram: Array, score: Array) -> tuple[Array, float]:
    """The sizes (c,) of responses that explain a residual best, and what they take of it."""
    norms = np.sqrt(np.diag(gram))
    solved = np.linalg.lstsq(gram / np.outer(norms, norms), score / norms, rcond=1e-9)[0]
    return np.asarray(solved / norms), float(score / norms @ solved)


def best_of_each(hits: Sequence[Hit]) -> list[Hit]:
    """The best hit of each effect, best first."""
    best: dict[str, Hit] = {}
    for hit in sorted(hits, key=lambda h: -h.gain):
        best.setdefault(hit.name, hit)
    return list(best.values())


def pair_gains(hits: Sequence[Hit], residual: Array,
               keep: int = 6) -> list[tuple[float, tuple[Hit, Hit]]]:
    """The best pairs of different effects by what both together could take, best first."""
    stacked = np.hstack([h.columns for h in hits])
    ends = np.cumsum([0, *(h.columns.shape[1] for h in hits)])
    gram, score = stacked.T @ stacked, stacked.T @ residual
    norms = np.sqrt(np.diag(gram))
    gram, score = gram / np.outer(norms, norms), score / norms
    found: dict[tuple[str, str], tuple[float, tuple[Hit, Hit]]] = {}
    for i, j in combinations(range(len(hits)), 2):
        if hits[i].name == hits[j].name:
            continue
        at = np.r_[ends[i]:ends[i + 1], ends[j]:ends[j + 1]]
        solved = np.linalg.lstsq(gram[np.ix_(at, at)], score[at], rcond=1e-9)[0]
        first, second = solved[0], solved[ends[i + 1] - ends[i]]
        if any(_positive(hit) and size <= 0.0
               for hit, size in ((hits[i], first), (hits[j], second))):
            continue
        gain = float(score[at] @ solved)
        sizes = solved / norms[at]
        width = ends[i + 1] - ends[i]
        a = _rescaled(hits[i], sizes[:width])
        b = _rescaled(hits[j], sizes[width:])
        key = (min(a.name, b.name), max(a.name, b.name))
        if key not in found or gain > found[key][0]:
            found[key] = (gain, (a, b))
    return sorted(found.values(), key=lambda p: -p[0])[:keep]


def _positive(hit: Hit) -> bool:
    """Whether the multiple of a hit's response cannot be negative."""
    return EFFECTS[hit.name].one_sided and EFFECTS[hit.name].wave is None


def _rescaled(hit: Hit, multiples: Array) -> Hit:
    """The hit at the size it has in company; as it is where several directions make its size."""
    if not hit.rescalable:
        return hit
    factor = float(multiples[0] / hit.multiples[0]) if hit.multiples[0] else 1.0
    return replace(hit, parameters=EFFECTS[hit.name].scaled(hit.parameters, factor))
