"""The effects that brake free swings, beside what was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dfm_stage.diagnosis.alike import shares_class
from dfm_stage.diagnosis.decisions import BLOCK_MARGIN
from dfm_stage.diagnosis.explaining import Judgement
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.free_swing import braking
from dfm_stage.diagnosis.gather import gather, with_witness
from dfm_stage.diagnosis.margins import margin_between
from dfm_stage.diagnosis.verdict import verdict
from dfm_stage.model import EFFECTS, Model


def braked(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found to leave a remainder of free swings, with what brakes them by their energy.
    Sizes are as there, and as the force domain has them; all else is fitted to the motion, from
    the damping on that they leave. As found where nothing new brakes, or held-out blocks are not
    clearly predicted better."""
    trial, h, before = found
    said, search = verdict(before), trial.search
    runs, held = ([replace(run, window=0) for run in each] for each in (search.runs, trial.held))
    if not (said.effects and said.remainder) or any(
            run.driven or run.order for run in (*runs, *held)):
        return found
    search.step("balancing the energy of free swings")
    told = braking(runs, held, h.fit.model, search.library)
    if told is None or any(_may_brake_for(n, h.fit.model) for n in told.sizes):
        return found
    model = h.fit.model
    if "damping" in search.free:
        model = model.with_parameters({"damping": model.parameter("damping").inside(told.damping)})
    for name, size in told.sizes.items():
        model = model.with_effect(name, {**EFFECTS[name].defaults, _size(name): size.value})
    known = {x.name: x.parameters for x in before.effects if before.heard is not None}
    free = [n for n in search.parameters(model)
            if n.partition(".")[0] not in {*told.sizes, *known}]
    fitted = fit(model, search.runs, free, search.weights, earlier=h.fit.locals,
                 noise=search.noise)
    if not fitted.ok:
        return found
    without, left = (trial.predicted(each.model).residuals for each in (h.fit, fitted))
    if margin_between(without, left, before.judged.lag) < BLOCK_MARGIN:
        return found
    other = replace(h, names=(*h.names, *told.sizes), fit=fitted)
    after = with_witness(gather(trial, other, warnings, split, graded=True), trial.witness)
    rivals = {x.name: x.rivals for x in before.effects}
    known |= {n: {_size(n): size} for n, size in told.sizes.items()}
    effects = tuple(replace(x, parameters=known.get(x.name, x.parameters),
                            rivals=rivals.get(x.name, ())) for x in after.effects)
    return trial, other, replace(after, effects=effects, heard=before.heard, braking=told,
                                 judged=before.judged)


def _may_brake_for(name: str, model: Model) -> bool:
    """Whether the model has an effect of the same class, or one whose force no position tells: a
    memory, a further mode, a linear formula."""
    return any(name == use.name or shares_class(name, use.name) or use.effect.memory
               or use.effect.stamp is not None for use in model.effects)


def _size(name: str) -> str:
    return EFFECTS[name].sizes[0]
