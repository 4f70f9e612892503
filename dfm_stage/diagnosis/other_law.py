"""Whether the missing force follows a law that no effect of the library has.

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
from dfm_stage.diagnosis.decisions import BLOCK_MARGIN, FURTHER_PART
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
    """Add the law that does better than all effects of the hypothesis, where there is one."""
    known = {use.name for use in h.bare.model.effects}
    found = [use for use in h.fit.model.effects if use.name not in known]
    if not found or not all(has_forms(use.effect) for use in found):
        return evidence   # a lag or a mode is no force along the measured motion
    trial.search.step("looking for another law")
    runs = [replace(run, window=0) for run in (*trial.search.runs, *trial.held)]
    return replace(evidence, other_law=other_law(runs, h.bare.model, found))


def other_law(runs: Sequence[Observation], model: Model,
              found: Sequence[EffectUse]) -> OtherLaw | None:
    """The law that explains most by itself with no more parameters than all effects `found` beside
    `model`, if it takes FURTHER_PART of what these leave, clearly so on held-out blocks. None
    where there is none, or the force domain tells nothing."""
    try:
        regression = Regression(runs, model, {})
    except DiagnosisError:
        return None
    terms, setting = regression.candidates.terms, regression.setting
    parts = [terms.parts(use.name, use.parameters) for use in found]
    own = [regression.off(setting.stacked(part)) for part in parts if part is not None]
    many = sum(len(use.effect.parameters) for use in found)
    laws = {f"a force like {column.term.text}": regression.fitted([column])[0].values
            for column in next_terms(regression) if 1 + len(column.shapes) <= many}
    laws |= {words: _curved(regression, power) for power, words in CURVED.items()}
    words = min(laws, key=lambda each: float(np.sum(regression.left([laws[each]])**2)))
    bare, by_effects, by_law = (regression.on_blocks(columns).errors
                                for columns in ([], own, [laws[words]]))
    sizes = np.diff(regression.candidates.edges)
    shares = [1.0 - float(errors @ sizes) / float(bare @ sizes) for errors in (by_law, by_effects)]
    mean, error = log_ratio(by_law, by_effects)
    takes = shares[0] - shares[1] > FURTHER_PART * (1.0 - shares[1])
    return OtherLaw(words, *shares) if takes and mean > BLOCK_MARGIN * error else None


def _curved(regression: Regression, power: int) -> Array:
    """The force (n,) that would have moved the stage as a curved reading says."""
    linear = regression.candidates.terms.linear

    def force(run: RunForces) -> Array:
        x = run.trajectory.x - np.mean(run.trajectory.x)
        return run.grid.signal(run.grid.spectrum(x**power) * run.gauss
                               * linear.operator(run.grid.omega))

    return regression.off(regression.setting.stacked(force))
