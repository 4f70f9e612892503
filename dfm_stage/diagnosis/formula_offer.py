"""Formulas for what has no name: proposed in the force domain, fitted and judged in simulation.

The regression only proposes. What is told of a formula comes from a fit of the whole model with it
on the fitted records, and from the simulation of records that this fit has not seen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from dfm_stage.diagnosis.decisions import BLOCK_MARGIN, OFFERED_SHARE
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import Accepted, Errors, Evidence, ModelEvidence, Offer
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.formula_search import RESAMPLES, Found, Regression, search
from dfm_stage.diagnosis.formula_terms import Over, formula_from
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.margins import margin_between, power, score_with_remainder
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.search_decisions import LEAST_STEPS
from dfm_stage.diagnosis.verdict import Verdict
from dfm_stage.diagnosis.verification import Prediction, predict, weights_like
from dfm_stage.model import EFFECTS, EffectUse, Model
from dfm_stage.model.effect import Effect
from dfm_stage.model.formula import Formula, FormulaEffect, formula_of
from dfm_stage.model.parameter import ModelError

MOST_OFFERED = 3
"""Formulas that are fitted and offered at most: each is compiled and fitted, and one at least,
though it may take all the work that is allowed."""


def wants_formulas(v: Verdict) -> bool:
    """Whether something is left that no effect of the library explains."""
    return v.remainder and v.kind in ("unknown", "partial", "named")


@dataclass(frozen=True)
class _Proposal:
    """Terms beside the effects `names`, whose fit is `start` and leaves `without` of held-out
    records."""

    found: Found
    names: Names
    start: Fit
    without: Prediction
    scales: Mapping[Over, float]


@dataclass(frozen=True)
class _Fitted:
    """A proposal as a formula, its fit, and what that leaves of held-out records."""

    proposal: _Proposal
    formula: Formula
    fit: Fit
    left: Prediction

    @property
    def size(self) -> int:
        """Parameters that are told: its own and those of the effects beside it."""
        return len(self.formula.parameters) + sum(
            len(EFFECTS[n].parameters) for n in self.proposal.names)


def with_formulas(trial: Trial, h: Hypothesis, evidence: Evidence, v: Verdict) -> Evidence:
    """Add the formulas that explain what is left, the simplest of the best first.

    They stand beside the effects found, or in the place of all of them: effects that stand in for
    another force are in the way of the formula for it.
    """
    if evidence.surface is None:
        return evidence
    own, lag = trial.search, evidence.judged.lag
    own.step("looking for a formula")
    own.begin_work(LEAST_STEPS)
    own.weigh_at_first(h.bare)
    trial.held_weights = weights_like(trial.held, own.weights)
    starts = [((), h.bare)] if v.model != "extended" else [(h.names, h.fit), ((), h.bare)]
    gap = power(trial.predicted(h.bare.model).residuals, lag) - evidence.judged.noise_power
    lists = [_proposals(trial, *start) for start in starts]
    proposals = [each[k] for k in range(MOST_OFFERED) for each in lists if k < len(each)]
    fits = [f for k, p in enumerate(proposals[:MOST_OFFERED])
            if (k == 0 or own.steps < own.most_steps)
            and (f := _fitted(trial, p, k, lag)) is not None and _pays(f, evidence)]
    offers = _ranked(fits, lag)
    taken = {*EFFECTS.keys(), *(use.name for use in own.model.effects)}
    free = [n for k in range(1, len(taken) + MOST_OFFERED + 1)
            if (n := f"formula_{k}") not in taken]
    return replace(evidence, formulas=tuple(
        _offer(f, name, lag, gap) for f, name in zip(offers, free, strict=False)))


def _proposals(trial: Trial, names: Names, start: Fit) -> list[_Proposal]:
    runs = [replace(r, window=0) for r in trial.search.runs]
    offsets = {run: value for (name, run), value in start.locals.items()
               if name == "offset" and runs[run].order == 0}
    model = start.model if names else trial.search.model
    try:
        regression = Regression(runs, model, offsets, "mass" in trial.search.free)
    except DiagnosisError:
        return []
    found = search(regression)
    without = trial.predicted(start.model) if found else None
    return [] if without is None else [
        _Proposal(f, names, start, without, regression.scales) for f in found]


def _fitted(trial: Trial, proposal: _Proposal, number: int, lag: int) -> _Fitted | None:
    """The model with the formula, fitted from what the force domain says; None where it cannot be
    simulated, or where the fit ends in a minimum that leaves more than the model without it."""
    own = trial.search
    formula = formula_from(f"proposed_{number}", proposal.found.parts, proposal.scales)
    effect = formula.effect()
    EFFECTS.hold(effect)
    own.step(f"fitting {formula.text}")
    names = (*proposal.names, formula.name)
    found = own.once(names, proposal.start, [Hit.at(formula.name, effect.defaults)],
                     dict(proposal.found.base))
    if not found.ok or power(found.residuals, lag) > power(proposal.start.residuals, lag):
        return None
    found = own.settled(names, found)
    left = trial.predicted(found.model)
    return _Fitted(proposal, formula, found, left) if left.residuals else None


def _pays(f: _Fitted, e: Evidence) -> bool:
    """Whether it takes enough of what is left of held-out records, on blocks beyond chance."""
    lag, noise = e.judged.lag, e.judged.noise_power
    before, after = (power(p.residuals, lag) - noise for p in (f.proposal.without, f.left))
    return before - after > OFFERED_SHARE * before and margin_between(
        f.proposal.without.residuals, f.left.residuals, lag) > BLOCK_MARGIN


def _ranked(fits: Sequence[_Fitted], lag: int) -> list[_Fitted]:
    """The simplest of those that held-out blocks do not part from the best first; none that has
    more parameters than one that does as well."""

    def level(f: _Fitted, other: _Fitted) -> bool:
        return margin_between(f.left.residuals, other.left.residuals, lag) < BLOCK_MARGIN

    kept = [f for f in fits if not any(
        level(g, f) and g.size < f.size for g in fits if g is not f)]
    kept.sort(key=lambda f: power(f.left.residuals, lag))
    return sorted(kept, key=lambda f: (not level(f, kept[0]), f.size if level(f, kept[0]) else 0))


def _offer(f: _Fitted, name: str, lag: int, gap: float) -> Offer:
    """What is told of a formula; `gap` is the held-out power above the noise without any."""
    use = f.fit.model.effect(f.formula.name)
    assert use is not None  # noqa: S101 (it was fitted)
    quantities = f.fit.quantities_over(*score_with_remainder(f.fit))
    values = {n: float(f"{v:.9g}") for n, v in use.parameters.items()}
    taken = power(f.proposal.without.residuals, lag) - power(f.left.residuals, lag)
    found = f.proposal.found
    return Offer(
        formula_of({**f.formula.to_dict(values), "name": name}),
        {n: replace(quantities[f"{f.formula.name}.{n}"], value=v) for n, v in values.items()
         if f"{f.formula.name}.{n}" in quantities},
        min(max(taken / max(gap, 1e-300), 0.0), 1.0), f.left.rms, found.all_back / RESAMPLES,
        tuple((p.term.text, n) for p, n in zip(found.parts, found.came_back, strict=True)),
        RESAMPLES, f.proposal.names)


def with_accepted(trial: Trial, model: Model, formulas: Sequence[Formula],
                  evidence: Evidence) -> Evidence:
    """Add what `model` leaves, which is the one without the `formulas` that were accepted."""
    own, lag = trial.search, evidence.judged.lag
    without = Search(model, own.runs, tuple(
        n for n in own.free if n.partition(".")[0] not in {f.name for f in formulas}))
    bare = without.begin()
    given = predict(model, own.runs, without.weights, without.noise)
    trial.held_weights = weights_like(trial.held, without.weights)

    def errors(seen: Prediction) -> Errors:
        return Errors(seen.rms, seen.chi2, seen.count, power(seen.residuals, lag))

    held = trial.predicted(model)
    left = [parts[0] for parts in (*given.residuals, *held.residuals)]
    comparisons = evidence.comparisons if len(left) < len(evidence.comparisons) else tuple(
        replace(c, left={**c.left, "given": own})
        for c, own in zip(evidence.comparisons, left, strict=True))
    return replace(evidence, comparisons=comparisons, accepted=Accepted(
        tuple(formulas), ModelEvidence(errors(given), errors(held)),
        ModelEvidence(Errors(bare.rms, bare.chi2, bare.white.size), errors(
            trial.predicted(bare.model if bare.ok else model)))))


def accepted_in(model: Model, formulas: Sequence[Formula]) -> Model:
    """A one-axis model with formulas added at the values that their files give, or replaced.

    Raises
    ------
    ModelError
        If one has the name of an effect of the library.
    """
    for formula in formulas:
        if isinstance(EFFECTS.get(formula.name), Effect) and not isinstance(
                EFFECTS[formula.name], FormulaEffect):
            raise ModelError(f"{formula.name} is an effect of the library; give the formula "
                             "another name")
        use = EffectUse(formula.name, {p.name: p.value for p in formula.parameters}, None, formula)
        model = replace(model, effects=(
            *(own for own in model.effects if own.name != formula.name), use))
    return model
