"""Several laws of speed found at once, and the one law that they may stand in for.

A sum of drags and frictions bends to nearly any curve over speed. Where one curve of a family that
no effect of the library has does better than several laws, the true force has another form.
"""

from __future__ import annotations

from dataclasses import replace

from dfm_stage.diagnosis.alike import laws_of_speed
from dfm_stage.diagnosis.decisions import BLOCK_MARGIN, MARGIN, OTHER_FORM
from dfm_stage.diagnosis.evidence import Judged
from dfm_stage.diagnosis.explaining import Judgement
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.hypothesis import Trial
from dfm_stage.diagnosis.margins import margin_between, power
from dfm_stage.diagnosis.search_decisions import LEAST_STEPS
from dfm_stage.model import EFFECTS
from dfm_stage.model.formula import formula_of

LAW = formula_of({
    "name": "one_law_in_the_place_of_several",
    "force": "-c * v / (1 + (v / s)**2)**q",
    "parameters": {"c": {"value": 0.0, "unit": "N s/m", "range": [0.0, 1e9]},
                   "s": {"value": 0.1, "unit": "m/s", "range": [1e-9, 1e6]},
                   "q": {"value": 0.25, "unit": "1", "range": [-1.0, 0.5]}}})
"""Viscous at low speed, a power 1 - 2 q of the speed at high speed: from dry friction (q = 1/2)
over fluid dampers and drag (q = -1/2) to the cube, and never less at a higher speed. Ravindra and
Mallik, Phys. Rev. E 49 (1994) 4950, for damping with a power of the speed."""


def with_one_law(found: Judgement) -> Judgement:
    """What was found, with the note that its laws of speed stand in for one: where there are
    several, and one law by itself does better on fitted and on held-out records."""
    trial, h, evidence = found
    laws = laws_of_speed(h.names)
    if len(laws) < 2 or evidence.heard is not None or evidence.braking is not None:
        return found   # sizes from a balance of force or energy are held in the fit
    search = trial.search
    search.begin_work(LEAST_STEPS)
    search.step(f"fitting one law of speed in the place of {' and '.join(laws)}")
    effect = LAW.effect()
    EFFECTS.hold(effect)
    names = (*(n for n in h.names if n not in laws), effect.name)
    least = h.fit if h.fit.weights is search.weights else search.fitted(h.names, h.fit)
    other = search.in_place_of(laws[0], effect.name, names, least)
    if other.ok:
        other = search.polished(names, other)
    search.unfinished.pop(frozenset(names), None)  # it is no name to tell
    better = other.ok and (_takes_the_rest(trial, evidence.judged, other, search.polished(
        h.names, least)) if evidence.graded else _likelier(trial, other, least))
    return (trial, h, replace(evidence, one_law=laws)) if better else found


def _likelier(trial: Trial, other: Fit, own: Fit) -> bool:
    """Whether a fit in the place of one that leaves only noise is better by the margin, on fitted
    and held-out records together, parameters paid for."""
    score = trial.search.score
    seen, before = (trial.predicted(each.model).chi2 for each in (other, own))
    return score(other) + seen < score(own) + before - MARGIN and seen <= before + MARGIN


def _takes_the_rest(trial: Trial, judged: Judged, other: Fit, own: Fit) -> bool:
    """Whether a fit in the place of one that leaves a remainder takes much of that, on held-out
    records clearly so: what is left then is an error of the laws' form."""
    left, before = (trial.predicted(each.model).residuals for each in (other, own))
    rest, whole = (power(each, judged.lag) - judged.noise_power for each in (left, before))
    return other.chi2 < own.chi2 and rest < (1.0 - OTHER_FORM) * whole and margin_between(
        before, left, judged.lag) > BLOCK_MARGIN
