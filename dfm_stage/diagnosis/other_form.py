"""Whether what an effect leaves is an error of its own form.

A stand-in follows the true force where most of the motion is, and leaves what it gets wrong of it:
a cubic spring in the place of an end stop leaves a force that depends on position, too. So the
effect is asked whether a size that varies with position, or other values of what is no size of it,
would explain what it leaves. What it leaves of another effect's force is none of that. A size that
varies with speed is not asked for: friction by direction is told as friction and a remainder.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.force_candidates import Candidates
from dfm_stage.diagnosis.force_domain import RunForces, not_judged
from dfm_stage.model.description import EffectUse
from dfm_stage.model.effect import Effect

POWERS = 5
"""Up to this power of position a size may vary."""
BENDS = (-1.0, 0.0, 1.0)
"""Where it may bend, over the standard deviation of position, as contacts do."""
FACTORS = (1.0 / 3.0, 3.0)
"""By these other parameters than sizes are taken smaller and larger."""


def other_forms(candidates: Candidates, use: EffectUse) -> Array | None:
    """The forces (n, c) of an effect of the model in other forms; None of an effect that gives no
    force along the motion."""
    terms, found = candidates.terms, candidates.setting
    own = terms.parts(use.name, use.parameters)
    if own is None or use.effect.late is not None:
        return None
    position = np.concatenate([run.trajectory.x for run in found.runs])
    middle, spread = float(np.mean(position)), max(float(np.std(position)), 1e-300)
    others = [part for values in _reshaped(use)
              if (part := terms.parts(use.name, values)) is not None]

    def forms(run: RunForces) -> Array:
        force = own(run)
        return np.array([*(force * g for g in _functions((run.trajectory.x - middle) / spread)),
                         *(part(run) for part in others)])

    return found.stacked(forms)


def has_forms(effect: Effect) -> bool:
    """Whether an effect is a force that may stand in for another form of it: no lag, no mode, no
    vibration, no error of the reading."""
    return effect.late is None and effect.stamp is None and effect.sense is None \
        and not effect.frequency and not_judged(effect) is None


def _functions(z: Array) -> Iterator[Array]:
    yield from (z**power for power in range(1, POWERS + 1))
    yield from (np.maximum(z - at, 0.0) for at in BENDS)


def _reshaped(use: EffectUse) -> Iterator[dict[str, float]]:
    """The effect's parameters with one that is no size of it taken smaller and larger; none of
    one that has a frequency, because at another one it is another vibration."""
    if any(p.unit == "Hz" for p in use.effect.parameters):
        return
    for name, value in use.parameters.items():
        limits = use.effect.parameter(name)
        for other in (limits.inside(factor * value) for factor in FACTORS):
            if name not in use.effect.sizes and other != value:
                yield {**use.parameters, name: other}
