"""Whether the missing force follows another law than that of the effects found.

Effects that stand on held-out blocks may still stand in for another law: friction that depends on
direction for a reading that is curved. So one term of the dictionary of formulas, or a reading
curved by a power of the position, is tried in the place of all effects that were found, in the
force domain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import log_ratio
from dfm_stage.diagnosis.decisions import BLOCK_MARGIN, FURTHER_PART, PARTIAL_SHARE
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import Evidence, OtherLaw
from dfm_stage.diagnosis.force_domain import RunForces
from dfm_stage.diagnosis.formula_search import Regression, next_terms
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.other_form import has_forms
from dfm_stage.model import Model
from dfm_stage.model.description import EffectUse

CURVED = {2: "a reading that is curved by the square of the position",
          3: "a reading that is curved by the cube of the position"}
"""Powers of a reading's error, as the next terms of its series, and what they are called."""


def with_other_law(trial: Trial, h: Hypothesis, evidence: Evidence) -> Evidence:
    """Add the law that does better than all effects of the hypothesis, where there is one.

    A lag or a mode is no force along the measured motion that could be compared, and brakes that
    the energy of swings bears out are small beside other forces.
    """
    search, seen = trial.search, trial.witness
    found = [use for use in h.fit.model.effects if search.model.effect(use.name) is None]
    forces = bool(found) and all(has_forms(use.effect) for use in found)
    if not forces or evidence.braking is not None:
        return evidence
    search.step("looking for another law")
    offsets = {run: value for (name, run), value in h.fit.locals.items() if name == "offset"}
    zero = float(np.mean([*offsets.values()])) if offsets else 0.0
    runs = [replace(run, window=0, output=run.output - (offsets.get(k, zero) if run.order == 0
                                                        else 0.0))
            for k, run in enumerate((*search.runs, *trial.held))]
    known = max((each.share for each in seen.singles), default=0.0) if seen is not None else 0.0
    return replace(evidence, other_law=other_law(runs, search.model, found, known))


def other_law(runs: Sequence[Observation], model: Model, found: Sequence[EffectUse],
              known: float = 0.0) -> OtherLaw | None:
    """The law that explains most of the missing force by itself, with no more parameters than all
    effects `found` beside `model`, clearly more than these on held-out blocks.

    It must take FURTHER_PART of what these leave, and of what the effect of the library leaves
    that explains most, a share `known`; the effects must take less of what the law leaves.
    None where there is no such law, or where the force domain does not see the effects at all.
    """
    try:
        regression = Regression(runs, model, {})
    except DiagnosisError:
        return None
    own = _columns(regression, found)
    if own is None:
        return None
    many = sum(len(use.effect.parameters) for use in found)
    laws = {f"a force like {column.term.text}": regression.fitted([column])[0].values
            for column in next_terms(regression) if 1 + len(column.shapes) <= many}
    if not any(run.order for run in runs):
        laws |= {words: _curved(regression, power) for power, words in CURVED.items()}
    words = min(laws, key=lambda w: float(np.sum(regression.left([laws[w]])**2)), default="")
    if not words:
        return None
    bare, by_effects, by_law, by_both = (regression.on_blocks(columns).errors for columns in (
        [], own, [laws[words]], [laws[words], *own]))
    sizes = np.diff(regression.candidates.edges)
    effects_leave, law_leaves, both_leave = (
        float(errors @ sizes) / float(bare @ sizes) for errors in (by_effects, by_law, by_both))
    mean, error = log_ratio(by_law, by_effects)
    rest = 1.0 - FURTHER_PART
    if mean <= BLOCK_MARGIN * error or law_leaves > rest * min(effects_leave, 1.0 - known) \
            or both_leave < rest * law_leaves or 1.0 - effects_leave < PARTIAL_SHARE:
        return None
    return OtherLaw(words, 1.0 - law_leaves, 1.0 - effects_leave)


def _columns(regression: Regression, found: Sequence[EffectUse]) -> list[Array] | None:
    """The forces (n,) of effects, off the base; None where one has none along the motion."""
    parts = [regression.candidates.terms.parts(use.name, use.parameters) for use in found]
    columns = [regression.off(regression.setting.stacked(part)) for part in parts
               if part is not None]
    seen = [bool(np.all(np.isfinite(each)) and np.any(each)) for each in columns]
    return columns if len(columns) == len(found) and all(seen) else None


def _curved(regression: Regression, power: int) -> Array:
    """The force (n,) that would have moved the stage as a curved reading says."""
    linear = regression.candidates.terms.linear
    middle = float(np.mean(np.concatenate([run.trajectory.x for run in regression.runs])))

    def force(run: RunForces) -> Array:
        x = run.trajectory.x - middle
        return run.grid.signal(run.grid.spectrum(x**power) * run.gauss
                               * linear.operator(run.grid.omega))

    return regression.off(regression.setting.stacked(force))
