"""The best description of the force that a model misses, whatever its physics.

It is seen in the force domain beside the base parameters, the effects that the model has, and
general functions of position and velocity, all fitted together: the mass is not bent by a force
that it does not make.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.black_box import features, position_velocity
from dfm_stage.diagnosis.blocks import Blocks, Solution
from dfm_stage.diagnosis.decisions import SWAMPED
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_candidates import RIDGES, SAME, Candidates
from dfm_stage.diagnosis.force_domain import WIDTHS, RunForces, Terms
from dfm_stage.diagnosis.force_setting import Setting, least_squares, settled
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.other_form import other_forms
from dfm_stage.diagnosis.surface import Surface, binned
from dfm_stage.model import Model

LINEAR: dict[str, Callable[[RunForces], Array]] = {
    "stiffness": lambda run: run.trajectory.x, "damping": lambda run: run.trajectory.v}
"""Base parameters whose force is one of position and velocity."""


def missing_force(runs: Sequence[Observation], model: Model,
                  held: Sequence[Observation] = ()) -> Surface | None:
    """Describe the force that `model` with its sizes re-estimated misses on `runs`.

    Records in `held` are predicted and never fitted; they count in the shares alone. None where
    the records are too short, the input does nothing, or noise swamps what is missing.
    """
    forces = [RunForces(run, WIDTHS[0]) for run in (*runs, *held)]
    width, noise = 0.0, 1.0
    while noise >= SWAMPED:  # what is left may need a wider filter than the whole gap does
        try:
            found, noise, _ = settled(forces, model, len(runs), width)
            candidates = Candidates(found, model, len(runs), ())
        except DiagnosisError:
            return None
        noise *= _linear_left(found) / max(float(np.mean(candidates.missing**2)), 1e-300)
        width = found.runs[0].width
    return _described(candidates, noise)


def _linear_left(found: Setting) -> float:
    """Power that base parameters alone leave, of which the noise is a known share."""
    left = found.target - found.columns @ least_squares(found.columns, found.target)
    return float(np.mean(left**2))


def _described(candidates: Candidates, noise: float) -> Surface | None:
    found, base, missing = candidates.setting, candidates.base, candidates.missing
    plain, black = (found.stacked_features(of) for of in (position_velocity, features))
    own = candidates.off_base(plain)
    blocks = Blocks(np.column_stack((base, missing, own, candidates.off_base(black))),
                    candidates.edges, candidates.fitted)
    k, m = base.shape[1], base.shape[1] + 1 + own.shape[1]
    first = range(k)
    by_motion = blocks.ridge_fit(first, range(k + 1, m), k, RIDGES)
    by_all = blocks.ridge_fit(first, range(m, m + black.shape[1]), k, RIDGES)
    shares = [_share(blocks, k, each, noise) for each in (by_motion, by_all)]
    plane = _Plane(candidates)
    fitted = np.repeat(candidates.fitted, blocks.sizes)
    edges = np.concatenate(([0], np.cumsum(blocks.sizes[candidates.fitted])))
    of = [plane.off(missing + (plane.functions - own) @ c[k:])[fitted]
          for c in (by_motion.coefficients, *by_motion.left_out)]
    x, v = (np.concatenate([s[run.kept] for run, s in zip(found.runs, signals, strict=True)])
            for signals in ([r.trajectory.x for r in found.runs],
                            [r.trajectory.v for r in found.runs]))
    bins = binned(x[fitted], v[fitted], -of[0], -np.array(of[1:]), edges)
    if bins is None:
        return None
    lines, first_run = candidates.at.frequencies, found.runs[0]
    history = (first_run.run.time[first_run.kept], -missing[:first_run.kept.size])
    return Surface(found.runs[0].run.unit, bins.x, bins.v, bins.force, bins.standard_error,
                   bins.samples, shares[0], max(shares), float(np.sqrt(np.mean(of[0]**2))),
                   lines[0] if lines else None, _form_shares(candidates, noise), history)


def _share(blocks: Blocks, base: int, found: Solution, noise: float) -> float:
    """Share of the held-out power above the noise that a fit explains of what the first `base`
    columns leave."""
    whole = float(blocks.fit(range(base), base).errors @ blocks.sizes)
    explained = 1.0 - float(found.errors @ blocks.sizes) / whole
    return min(max(explained / (1.0 - noise), 0.0), 1.0)


def _form_shares(candidates: Candidates, noise: float) -> dict[str, float]:
    """That share of each effect of the model in other forms."""
    base, shares = candidates.base, {}
    for use in candidates.model.effects:
        forms = other_forms(candidates, use)
        if forms is not None:
            k = base.shape[1]
            columns = np.column_stack((base, candidates.missing, candidates.off_base(forms)))
            blocks = Blocks(columns, candidates.edges, candidates.fitted)
            fitted = blocks.ridge_fit(range(k), range(k + 1, k + 1 + forms.shape[1]), k, RIDGES)
            shares[use.name] = _share(blocks, k, fitted, noise)
    return shares


class _Plane:
    """General functions (n, c) along the motion, behind no filter that would round a sharp force,
    and what is to be taken off them: all that is linear in position and speed, and the effects
    that the model has."""

    def __init__(self, candidates: Candidates) -> None:
        found = candidates.setting
        # one level for all records: where each has an offset of its own it is not known
        sharp = replace(found, runs=[run.sharp() for run in found.runs], offset=False)
        self.functions = sharp.stacked_features(position_velocity)
        terms = Terms(sharp.runs, candidates.model, found.linear, found.timing)
        parts = [terms.parts(use.name, use.parameters) for use in candidates.model.effects
                 if use.effect.late is None]
        columns = np.column_stack([sharp.stacked(part) for part in (
            *(of for name, of in LINEAR.items() if name in found.names),
            *(part for part in parts if part is not None),
            *([lambda run: np.ones(run.grid.size)] if found.offset else []))])
        norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        left, values, _ = np.linalg.svd(columns / norms, full_matrices=False)
        self.space = left[:, values > SAME * values[0]]

    def off(self, force: Array) -> Array:
        """`force` (n,) without it."""
        return np.asarray(force - self.space @ (self.space.T @ force))
