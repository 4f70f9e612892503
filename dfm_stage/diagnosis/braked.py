"""The effects that brake free swings, beside what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dfm_stage.diagnosis.alike import shares_class
from dfm_stage.diagnosis.evidence import Braking
from dfm_stage.diagnosis.explaining import Judgement
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.free_swing import braking
from dfm_stage.diagnosis.gather import gather, with_witness
from dfm_stage.diagnosis.hypothesis import Hypothesis
from dfm_stage.diagnosis.verdict import verdict
from dfm_stage.model import EFFECTS


def braked(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found to leave a remainder of free swings, with what brakes them by their energy.
    Sizes are as there, and as the force domain has them; all else is fitted to the motion. As
    found where nothing new brakes, or where held-out records are predicted worse with it."""
    trial, h, before = found
    said, search = verdict(before), trial.search
    runs = [replace(run, window=0) for run in (*search.runs, *trial.held)]
    if not (said.effects and said.remainder) or any(run.driven or run.order for run in runs):
        return found
    search.step("balancing the energy of free swings")
    told = _new(braking(runs, h.fit.model, search.library), h)
    if told is None:
        return found
    model = h.fit.model
    for name, size in told.sizes.items():
        model = model.with_effect(name, {**EFFECTS[name].defaults, _size(name): size.value})
    known = {x.name: x.parameters for x in before.effects if before.heard is not None}
    free = [n for n in search.parameters(model)
            if n.partition(".")[0] not in {*told.sizes, *known}]
    fitted = fit(model, search.runs, free, search.weights, earlier=h.fit.locals,
                 noise=search.noise)
    if not fitted.ok:
        return found
    other = Hypothesis((*h.names, *told.sizes), fitted, h.bare, h.rivals)
    after = with_witness(gather(trial, other, warnings, split, graded=True), trial.witness)
    if after.extended.held_out.power > before.extended.held_out.power:
        return found
    known |= {n: {_size(n): size} for n, size in told.sizes.items()}
    effects = tuple(replace(x, parameters=known.get(x.name, x.parameters)) for x in after.effects)
    return trial, other, replace(after, effects=effects, heard=before.heard, braking=told,
                                 judged=before.judged)


def _new(told: Braking | None, h: Hypothesis) -> Braking | None:
    """Of what brakes, the effects of which the model has none of the kind."""
    if told is None:
        return None
    names = [n for n in told.sizes if not any(
        n == own.name or shares_class(n, own.name) for own in h.fit.model.effects)]
    return replace(told, sizes={n: told.sizes[n] for n in names}) if names else None


def _size(name: str) -> str:
    return EFFECTS[name].sizes[0]
