"""Where an effect begins in the place of another: where it does what that one does.

Fitted without the effect that it replaces, all others bend until the stage moves otherwise. What a
linear screen promises there leads to far minima.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.candidates import starts
from dfm_stage.diagnosis.fit import Fit, weighted_output
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.screen import off, span
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.effect import Parameters

PART = 0.01
"""Share of the effects whose response is compared: along nearly the same motion, the responses to
forces are in proportion to them."""


def most_alike(other: str, gone: Sequence[str], found: Fit, runs: Sequence[Observation],
               noise: float) -> Parameters:
    """Return the starting point of an effect in the place of others, at its size there.

    It is the point whose response along the motion of a fit is nearest to that of the effects
    `gone` and of what the fit leaves, if all other parameters of the fit follow; the first point
    where none moves the stage. `runs` are those of the fit, `noise` is the RMS of the
    output's (m).
    """
    def output(model: Model) -> Array | None:
        return weighted_output(model, found, runs, found.weights, noise)

    less = found.model
    for name in gone:
        use = less.effect(name)
        assert use is not None  # noqa: S101 (who calls has found it)
        less = less.with_effect(name, use.effect.scaled(dict(use.parameters), 1.0 - PART))
    points = starts(other, found.system.at) or [dict(EFFECTS[other].defaults)]
    whole, reduced, best = output(found.model), output(less), (math.inf, points[0])
    if whole is None or reduced is None or EFFECTS[other].searched:
        return best[1]
    basis = span(found.jacobian[:, [
        u.name.partition(".")[0] not in gone for u in found.system.unknowns]])
    wanted = off(basis, whole - reduced + PART * found.white)
    for point in points:
        moved = output(found.model.with_effect(other, point))
        if moved is None:
            continue
        change = off(basis, moved - whole)
        size = float(change @ wanted) / max(float(change @ change), 1e-300)
        if size > 0.0 or not EFFECTS[other].one_sided:
            left = float(np.sum((wanted - size * change) ** 2))
            best = min(best, (left, EFFECTS[other].scaled(point, size / PART)),
                       key=lambda each: each[0])
    return best[1]
