"""A fast look at every candidate: how much chi-square its response could take from the residual.

The response of the model to a small amount of an effect is projected off everything that the free
parameters, initial states and offsets can do; its best multiple is then a matter of one linear
step (a score test). Pairs are screened jointly, because a single effect may stand in for two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.candidates import (
    FIXED_SIZE,
    ONE_SIDED,
    TWO_PHASED,
    Parameters,
    Scales,
    Shape,
    shapes,
)
from dfm_stage.diagnosis.decisions import STEP_GRID
from dfm_stage.diagnosis.fit import Fit, weighted_sensitivities
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.spectra import frequency_peaks, position_peaks, read_off
from dfm_stage.diagnosis.system import PER_RUN, System
from dfm_stage.diagnosis.weighting import Weights
from dfm_stage.model import Model

Array = NDArray[np.float64]

SMALL_SHARE, HALF = 1e-4, 0.5
"""Share of a second mode that is small; share from which a search for it begins at most: beyond
it the response is not nearly linear in it."""
SHARP_MODES = (0.003, 0.01)
"""Damping ratios of modes looked for at the residual's own frequencies."""
LEAST_TRAVEL = 10.0
"""Motion over noise below which errors of the scale cannot be seen."""


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

    def share_of(self, total: float) -> float:
        """The part of chi-square it could take."""
        return self.gain / total if total > 0.0 else 0.0


class Screen:
    """Screens candidates against the residual of a fit."""

    def __init__(self, base: Fit, runs: Sequence[Observation], weights: Weights,
                 dither: float, linear: Model | None = None) -> None:
        """`linear` is a model that moves alike and answers for one that is slow to simulate."""
        self.base, self.runs, self.weights, self.dither = base, tuple(runs), weights, dither
        self.scales = Scales.of(base.model, runs, weights[0][0].rms)
        light = base.system.use_light(base.x)
        self.model = base.model
        for costly in base.system.costly if light else ():
            self.model = self.model.without_effect(costly)
        if linear is not None and not light and base.system.cost > 1.0:
            self.model = linear
        if base.system.pushed:
            self.model = self.model.without_effect("force_offset")
        jacobian = weighted_sensitivities(base.system, base.x, weights, light)
        norms = np.linalg.norm(jacobian, axis=0)
        seen = norms > 1e-12 * max(float(norms.max()), 1e-300)
        left, values, _ = np.linalg.svd(jacobian[:, seen] / norms[seen], full_matrices=False)
        self.basis = np.asarray(left[:, values > 1e-7 * values[0]])
        white = base.white
        self.residual = white - self.basis @ (self.basis.T @ white)
        self.edges = self._edges()
        self.plain = self._outputs(self.model)
        self._strengths: list[tuple[Shape, float]] = []
        self._peaks: list[float] | None = None

    def _edges(self) -> list[tuple[int, int]]:
        found, at = [], 0
        for run, ws in zip(self.runs, self.weights, strict=True):
            size = sum(run.input.size - run.skip - w.polynomial.size + 1 for w in ws)
            found.append((at, at + size))
            at += size
        return found

    def _outputs(self, model: Model) -> Array | None:
        """The weighted output (N,) of a model at the base's local values; None if impossible."""
        system = System(model, self.runs, (), self.dither)
        locals_ = self.base.locals
        x = np.array([locals_.get((p.name, p.run), 0.0 if p.name != "current.gain" else 1.0)
                      for p in system.places])
        per_run = system._coordinates()
        for k, p in enumerate(system.places):
            if (p.name, p.run) not in locals_ and p.name in per_run:
                x[k] = per_run[p.name]
        parts = []
        for i, ws in enumerate(self.weights):
            for out, w in zip(system.simulate(i, x[None, :]), ws, strict=True):
                if not np.all(np.isfinite(out)):
                    return None
                parts.append(w.apply(out[0]))
        return np.concatenate(parts)

    def project(self, columns: Array) -> Array:
        """Take out of `columns` (N, c) what the free parameters can do."""
        return np.asarray(columns - self.basis @ (self.basis.T @ columns))

    def hits(self, name: str, keep: int = 2) -> list[Hit]:
        """The best starting points of one effect, best first."""
        found = []
        for shape in self._shapes(name):
            hit = self._hit(shape)
            if hit is not None:
                found.append(hit)
        return sorted(found, key=lambda h: -h.gain)[:keep]

    def smallest(self, limit: float) -> dict[str, Parameters]:
        """Size of each effect screened so far at which chi-square is expected to rise by `limit`.

        To first order in the size, at the starting point that shows best; where the effect is
        there, half of all records show it more clearly. Without those of no free size.
        """
        found: dict[str, Parameters] = {}
        for shape, strength in self._strengths:
            if strength <= 0.0:
                continue
            sizes = {n: abs(v) for n, v in shape.sizes(math.sqrt(limit) / strength).items() if v}
            first = next(iter(sizes))
            if sizes[first] < found.get(shape.name, {}).get(first, math.inf):
                found[shape.name] = sizes
        return found

    def _strength(self, shape: Shape, projected: Array) -> float:
        """Root of the rise of chi-square for the shape once, the mean over its phase."""
        if shape.name == "cross_axis_coupling":
            return float(np.linalg.norm(projected[:, 0]))
        phases = 2.0 if shape.name in TWO_PHASED else 1.0
        return float(np.linalg.norm(projected)) / math.sqrt(phases)

    def _shapes(self, name: str) -> list[Shape]:
        s = self.scales
        if name == "periodic_disturbance":
            return [Shape(name, {"amplitude": 1e-3 * s.force, "frequency": f, "phase": 0.0})
                    for f in self._frequencies()]
        if name == "second_mode":  # the grid is coarser than a sharp resonance
            sharp = [Shape(name, {"share": SMALL_SHARE, "frequency": f, "damping_ratio": zeta})
                     for f in self._frequencies() for zeta in SHARP_MODES]
            return [*shapes(name, self.base.model, self.runs, s), *sharp]
        if name in ("encoder_periodic_error", "encoder_quantization"):
            return self._scale_errors(name)
        return shapes(name, self.base.model, self.runs, s)

    def _frequencies(self) -> list[float]:
        """Frequencies (Hz) at which the residual of the output stands out."""
        if self._peaks is None:
            first = [self.residual[a:a + run.input.size - run.skip - ws[0].polynomial.size + 1]
                     for (a, _), run, ws in zip(self.edges, self.runs, self.weights, strict=True)]
            self._peaks = frequency_peaks(first, self.runs[0].sample_period,
                                          lowest_hz=2.0 / self.scales.duration)
        return self._peaks

    def _scale_errors(self, name: str) -> list[Shape]:
        positions, residuals = [], []
        for run, parts in zip(self.runs, self.base.residuals, strict=True):
            positions.append(run.output[run.skip:] - parts[0])
            residuals.append(parts[0])
        if max(float(np.ptp(p)) for p in positions) < LEAST_TRAVEL * self.scales.noise:
            return []
        periods = position_peaks(positions, residuals)
        if name == "encoder_periodic_error":
            return [Shape(name, {"amplitude": 0.1 * self.scales.noise, "period": p, "phase": 0.0})
                    for p in periods]
        known = self.base.model.base.get("encoder_resolution", 0.0)
        step = read_off(self.runs[0].output, known)
        if step is not None:
            return [Shape(name, {"step": step})] if step > self.scales.noise else []
        grid = np.arange(-20, 21) * STEP_GRID
        steps = [p for period in periods for p in
                 period * (1.0 + grid * period / self.scales.travel)]
        steps = sorted(steps, key=lambda p: -_staircase(positions[0], residuals[0], p))[:2]
        least = max(self.scales.noise, 1.5 * known)
        return [Shape(name, {"step": float(p)}) for p in steps if p > least]

    def _hit(self, shape: Shape) -> Hit | None:
        columns = self._columns(shape)
        if columns is None:
            return None
        projected = self.project(columns)
        size = np.linalg.norm(projected, axis=0)
        kept = size > 1e-6 * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        if not np.any(kept):
            return None
        projected = projected[:, kept]
        if shape.name in FIXED_SIZE:
            d = projected[:, 0]
            gain = float(2.0 * d @ self.residual - d @ d)
            return Hit(shape.name, gain, dict(shape.parameters), projected, np.ones(1))
        self._strengths.append((shape, self._strength(shape, projected)))
        multiples, gain = _best(projected, self.residual)
        if shape.name in ONE_SIDED and multiples[0] <= 0.0:
            return None
        return Hit(shape.name, gain, self._sized(shape, multiples), projected, multiples)

    def _sized(self, shape: Shape, multiples: Array) -> dict[str, float]:
        if shape.name in TWO_PHASED:
            size = float(np.hypot(multiples[0], multiples[1])) if multiples.size > 1 \
                else abs(float(multiples[0]))
            phase = float(np.arctan2(multiples[1], multiples[0])) if multiples.size > 1 else 0.0
            return {**shape.scaled(size), "phase": phase}
        if shape.name == "cross_axis_coupling" and multiples.size == 2:
            return {"ratio": shape.parameters["ratio"] * float(multiples[0]),
                    "stiffness": self._coupling() * float(multiples[1])}
        if shape.name == "second_mode":
            most = HALF / shape.parameters["share"]
            return shape.scaled(float(np.clip(multiples[0], -most, most)))
        return shape.scaled(float(multiples[0]))

    def _coupling(self) -> float:
        return 1e-3 * self.scales.stiffness

    def _columns(self, shape: Shape) -> Array | None:
        """Weighted responses (N, c) to the effect; of per-run effects one column for each run."""
        variants = [shape.parameters]
        if shape.name in TWO_PHASED:
            variants.append({**shape.parameters, "phase": 0.5 * math.pi})
        elif shape.name == "cross_axis_coupling":
            variants.append({"ratio": 0.0, "stiffness": self._coupling()})
        columns = []
        model, plain = self.model, self.plain
        if shape.name == "encoder_quantization":  # at the motion itself, to a part of a step
            model = self.base.model
            plain = self._outputs(model)
        for parameters in variants:
            shifted = self._outputs(model.with_effect(shape.name, parameters))
            if shifted is None or plain is None:
                return None
            columns.append(shifted - plain)
        if shape.name not in PER_RUN or len(self.runs) == 1:
            return np.asarray(np.array(columns).T)
        split = []
        for a, b in self.edges:
            for column in columns:
                own = np.zeros_like(column)
                own[a:b] = column[a:b]
                split.append(own)
        return np.asarray(np.array(split).T)


def _staircase(position: Array, residual: Array, step: float) -> float:
    """How well rounding `position` (N,) to `step` explains `residual` (N,)."""
    d = step * np.rint(position / step) - position
    return float(2.0 * d @ residual - d @ d)


def _best(columns: Array, residual: Array) -> tuple[Array, float]:
    norms = np.linalg.norm(columns, axis=0)
    gram = (columns.T @ columns) / np.outer(norms, norms)
    score = (columns.T @ residual) / norms
    solved = np.linalg.lstsq(gram, score, rcond=1e-9)[0]
    return np.asarray(solved / norms), float(score @ solved)


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
        if (hits[i].name in ONE_SIDED and first <= 0.0) or (
                hits[j].name in ONE_SIDED and second <= 0.0):
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


def _rescaled(hit: Hit, multiples: Array) -> Hit:
    """The hit at the size it has in company."""
    if hit.name in FIXED_SIZE or hit.name in TWO_PHASED or hit.name == "cross_axis_coupling":
        return hit
    factor = float(multiples[0] / hit.multiples[0]) if hit.multiples[0] else 1.0
    return replace(hit, parameters=Shape(hit.name, hit.parameters).scaled(factor))
