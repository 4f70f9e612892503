"""Gather the evidence of a diagnosis: whatever must be fitted, simulated or compared is, here."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.diagnosis.alike import gives_way, shares_class
from dfm_stage.diagnosis.candidates import excluded, shown_by_none
from dfm_stage.diagnosis.decisions import (
    AS_GIVEN,
    BLOCK_MARGIN,
    LEAST_HEARD,
    SAYS_NOTHING,
    SCATTERING,
    STEP_GRID,
)
from dfm_stage.diagnosis.effect_fits import quiet_weights
from dfm_stage.diagnosis.evidence import (
    Candidate,
    Comparison,
    EffectEvidence,
    Errors,
    Evidence,
    Judged,
    ModelEvidence,
    Motion,
    Noise,
    Offset,
    RivalEvidence,
    Which,
)
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.margins import (
    Constancy,
    Score,
    Signal,
    constancy,
    margin_between,
    power,
    score_by_blocks,
    score_with_remainder,
)
from dfm_stage.diagnosis.missing_force import missing_force
from dfm_stage.diagnosis.next_experiment import propose
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.other_form import has_forms
from dfm_stage.diagnosis.remainder import describe
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.search_decisions import NEAR_NOISE
from dfm_stage.diagnosis.spectra import lattice
from dfm_stage.diagnosis.verification import Prediction, joint, predict
from dfm_stage.diagnosis.witness import Witness
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.residuals import noise_floor_from_periods
from dfm_stage.model import EFFECTS, Model


def gather(trial: Trial, h: Hypothesis, warnings: Sequence[str] = (), split: bool = False,
           graded: bool = False) -> Evidence:
    """Do all that every verdict needs.

    `warnings` are those of the records; `split` says that parts of these are held out, `graded`
    that the effects leave a remainder: then blocks and the remainder set the intervals; blocks
    alone where what is left has a colour.
    """
    search = trial.search
    runs, weight = search.runs, search.weights[0][0]
    repeats = runs[0].periodicity
    quiet = quiet_weights(h.fit)[0][0].rms if h.fit.ok else 0.0
    judged = judged_in(h, quiet, trial.lag)
    given = trial.predicted(search.model)
    fitted_given = predict(search.model, runs, search.weights, search.noise)
    seen = given, trial.predicted(h.bare.model), trial.predicted(h.fit.model)
    retuned = _of_model(trial, h.bare, seen[1], judged, ask_colour=graded or not h.names)
    extended = replace(retuned, held_out=_errors(seen[2], judged)) if h.fit is h.bare else \
        _of_model(trial, h.fit, seen[2], judged, _score(h.fit, quiet, graded))
    if not h.names:  # the same model, weighed anew where an effect was dropped
        retuned = replace(retuned, parameters=extended.parameters, findings=extended.findings,
                          description=retuned.description or extended.description)
    return Evidence(
        tuple(r.record for r in _whole(runs)), runs[0].unit,
        Noise(weight.rms, weight.source, noise_floor_from_periods(
            h.fit.residuals[0][0], repeats.period) if repeats is not None else None,
            quiet if graded or extended.remainder else None),
        _motion(runs),
        ModelEvidence(_errors(fitted_given, judged), _errors(given, judged)),
        retuned, extended, _effects(trial, h, extended.parameters, seen[2], judged),
        base_shares={n: h.fit.model.base.get(n, 1.0) / search.model.base[n]
                     for n in ("damping", "stiffness", "force_constant")
                     if n in search.free and search.model.base.get(n, 0.0) != 0.0},
        linear=all(EFFECTS[n].parity == "linear" for n in h.names),
        offset=_offset(h.bare, search.library),
        library=tuple(_library(trial)), limits=_limits(search),
        comparisons=tuple(_comparisons(trial, h, fitted_given, seen)), warnings=tuple(warnings),
        split=split, not_compared=search.not_compared, judged=judged,
        graded=graded, conventions=tuple(
            r.convention.to_dict(r.record)
            for r in _whole([*runs, *(() if split else trial.held)])))


def with_colour(trial: Trial, h: Hypothesis, evidence: Evidence) -> Evidence:
    """Ask, too, whether the gap is mere colour of the noise, which `gather` does not where there
    are effects that may leave only noise: what stands on held-out records is none."""
    return evidence if not h.names else replace(evidence, retuned=_of_model(
        trial, h.bare, trial.predicted(h.bare.model), evidence.judged))


def _whole(runs: Sequence[Observation]) -> list[Observation]:
    """The runs, but of the stretches of one record the first alone."""
    return [r for k, r in enumerate(runs) if not r.of or r.of not in {a.of for a in runs[:k]}]


def judged_in(h: Hypothesis, noise: float, lag: int) -> Judged:
    """The signal in which held-out powers are compared: the output, but a body without a spring
    drifts by whatever small force there is, and its position is judged in velocity, over `lag`
    samples. `noise` is the RMS of high frequencies."""
    system = h.fit.system if h.fit.ok else h.bare.system
    lag = lag if system.drifts else 0
    signal: Signal = "velocity" if lag else system.runs[0].measures
    period = system.runs[0].sample_period
    window = max(run.window for run in system.runs) * period
    return Judged(signal, window or None, noise**2 * (2.0 if lag else 1.0), lag=lag,
                  velocity_s=lag * period or None)


def with_witness(evidence: Evidence, seen: Witness | None) -> Evidence:
    """Add what the force domain says: shares of effects, and how much of the gap a black box would
    predict."""
    if seen is None or seen.cannot_tell:
        return evidence
    noise, gap = evidence.judged.noise_power, evidence.retuned.held_out.power
    predictable = math.sqrt(noise + (1.0 - seen.predictable_share) * max(gap - noise, 0.0))
    named = {x.name for x in evidence.effects}
    alone = {e.names[0]: e.share for e in seen.singles}
    evidence = with_confirmation(evidence, seen)
    effects = tuple(_heard(x, seen, alone, named) for x in evidence.effects)
    library = tuple(replace(c, share=alone.get(c.name)) for c in evidence.library)
    told = {e.names[0]: e.share for e in seen.singles if e.names[0] in named | {*seen.best.names}}
    return replace(evidence, effects=effects, library=library, witness={
        "effects": list(seen.best.names), "share": seen.best.share, "alone": told,
        "predictable": seen.predictable_share, "margins": seen.nearest},
        judged=replace(evidence.judged, predictable=predictable))


def with_confirmation(evidence: Evidence, seen: Witness | None) -> Evidence:
    """Add which effects the force domain has in its best set."""
    if seen is None or seen.cannot_tell:
        return evidence
    return replace(evidence, effects=tuple(
        replace(x, confirmed=x.name in seen.best.names) for x in evidence.effects))


def with_surface(trial: Trial, model: Model, evidence: Evidence) -> Evidence:
    """Add the force that `model` with its sizes re-estimated misses. What of that can be predicted
    could be predicted of the gap, too."""
    trial.search.step("describing what is left")
    runs, held = ([replace(r, window=0) for r in each] for each in (trial.search.runs, trial.held))
    surface, judged = missing_force(runs, model, held), evidence.judged
    if surface is not None and evidence.effects and judged.predictable is not None:
        left = max(evidence.extended.held_out.power - judged.noise_power, 0.0)
        best = judged.noise_power + (1.0 - max(surface.predictable_share, 0.0)) * left
        judged = replace(judged, predictable=min(judged.predictable, math.sqrt(best)))
    hidden = tuple(x.name for x in evidence.effects if surface is None
                   and has_forms(EFFECTS[x.name]))
    return replace(evidence, surface=surface, judged=judged, form_hidden=hidden)


def _heard(x: EffectEvidence, seen: Witness, alone: Mapping[str, float],
           named: Collection[str]) -> EffectEvidence:
    """The effect, of those `named`, with what the force domain says of it; there, a lag or delay
    of the actuator is a nuisance that is fitted away, and what is not proportional to its size is
    not known."""
    predictable, effect = seen.predictable_share, EFFECTS[x.name]
    if x.name not in alone or effect.late is not None or predictable < LEAST_HEARD \
            or not effect.is_linear({n: q.value for n, q in x.parameters.items()}):
        return x
    own = next((n for n in (x.name, *seen.best.names) if n in seen.best.names
                and (n == x.name or shares_class(n, x.name))), None)
    margins = seen.nearest if own is None else seen.margins[own]
    lead = min((m for n, m in margins.items() if not shares_class(n, x.name)), default=math.inf)
    ahead = {n for n in seen.best.names if seen.margins[n].get(x.name, 0.0) > BLOCK_MARGIN
             and {*seen.best.names} <= {n, *named}}
    return replace(x, force_share=alone[x.name] / predictable, force_margin=lead,
                   in_best=own is not None,
                   rivals=tuple(replace(r, ahead=r.name in ahead) for r in x.rivals))


def with_joint_fit(trial: Trial, h: Hypothesis, evidence: Evidence) -> Evidence:
    """Add what one fit to fitted and held-out records leaves of each."""
    search = trial.search
    return replace(evidence, joint=joint(
        h.fit.model, search.parameters(h.fit.model), search.runs, trial.held, search.weights,
        trial.held_weights, h.fit, search.noise))


def with_next_experiment(trial: Trial, h: Hypothesis, evidence: Evidence,
                         undecided: Sequence[str]) -> Evidence:
    """Add an experiment that would part the names that are `undecided`; without any, one that
    shows more of what the given model lacks."""
    search = trial.search
    best = h.fit.model if undecided else search.model
    rivals = [r.fit for each in h.rivals.values() for r in each if r.name in undecided]
    return replace(evidence, next_experiment=propose(
        undecided, best, rivals, search.runs, search.weights[0][0],
        [search.parameters(rival.model) for rival in rivals], search.noise))


def _errors(seen: Prediction, judged: Judged) -> Errors:
    return Errors(seen.rms, seen.chi2, seen.count, power(seen.residuals, judged.lag))


def _motion(runs: Sequence[Observation]) -> Motion:
    return Motion(max(float(np.std(r.output)) for r in runs),
                  not any(r.driven for r in runs))


def has_colour(found: Fit, quiet: float) -> bool:
    """Whether a fit leaves more than the white noise that high frequencies show, `quiet` (RMS):
    colour may be a small remainder. Not asked of a position that drifts, which always has one."""
    return not found.system.drifts and found.rms**2 > NEAR_NOISE * quiet**2


def _of_model(trial: Trial, found: Fit, seen: Prediction, judged: Judged,
              score: Score | None = None, ask_colour: bool = True) -> ModelEvidence:
    fitted = Errors(found.rms, found.chi2, found.white.size,
                    power(found.residuals, judged.lag))
    if not found.ok:
        return ModelEvidence(fitted, _errors(seen, judged))
    evidence = ModelEvidence(fitted, _errors(seen, judged), _values(found, score),
                             trial.findings(found, ask_colour))
    return replace(evidence, description=describe(trial.search.runs, found.residuals)
                   if evidence.remainder else None)


def _score(found: Fit, quiet: float, graded: bool) -> Score | None:
    """The score's covariance that sets intervals, where what is left is no white noise."""
    if not found.ok:
        return None
    if graded:
        return score_with_remainder(found)
    return score_by_blocks(found) if has_colour(found, quiet) else None


def _values(found: Fit, score: Score | None) -> dict[str, Quantity]:
    """Free parameters: the intervals about the values that the model has."""
    values = found.model.parameters()
    told = found.quantities if score is None else found.quantities_over(*score)
    return {n: replace(q, value=float(values.get(n, q.value))) for n, q in told.items()}


def _effects(trial: Trial, h: Hypothesis, values: Mapping[str, Quantity], seen: Prediction,
             judged: Judged) -> tuple[EffectEvidence, ...]:
    """What speaks for each effect of a hypothesis whose fit leaves `seen` of held-out records;
    the constancy is that of all sizes together."""
    if not h.names:
        return ()
    steady = constancy(h.fit, [f"{n}.{EFFECTS[n].sizes[0]}" for n in h.names])
    return tuple(_effect(trial, h, name, values, seen, judged, steady) for name in h.names)


def _effect(trial: Trial, h: Hypothesis, name: str, values: Mapping[str, Quantity],
            seen: Prediction, judged: Judged, steady: Constancy | None) -> EffectEvidence:
    search, fit = trial.search, h.fit
    rest = tuple(n for n in h.names if n != name)
    without = search.fitted(rest, fit) if rest else h.bare
    missed = trial.predicted(without.model)
    rivals = (_rival(trial, h, name, r, seen, judged) for r in h.rivals.get(name, ()))
    return EffectEvidence(
        name, _own(trial, h, name, values),
        ModelEvidence(Errors(without.rms, without.chi2, without.white.size,
                             power=power(without.residuals, judged.lag)),
                      _errors(missed, judged)),
        tuple(rivals), name not in h.not_exercised,
        margin_between(missed.residuals, seen.residuals, judged.lag), steady)


def _own(trial: Trial, h: Hypothesis, name: str,
         values: Mapping[str, Quantity]) -> dict[str, Quantity]:
    """The parameters of one effect; a step that a search found has the interval of that, what a
    fit held otherwise, or what trades with the others, has none."""
    model = h.fit.model
    use = model.effect(name)
    assert use is not None  # noqa: S101 (it was added by the search)
    own: dict[str, Quantity] = {}
    for parameter in EFFECTS[name].told(use.parameters):
        if parameter in shown_by_none(name, trial.search.runs):
            continue
        address, value = f"{name}.{parameter}", use.parameters[parameter]
        searched = None
        if EFFECTS[name].rounds:
            half = value * _searched_to(trial, value)
            searched = value - half, value + half
        held = Quantity(value, model.parameter(address).unit, searched)
        told = values.get(address, held)
        own[parameter] = replace(told, value=float(value),
                                 ci95=told.ci95 if told.bounded else None)
    return own


def _searched_to(trial: Trial, value: float) -> float:
    """Half the relative interval of a step that was found by search and held.

    One read off the set of values that occur is known to their own rounding over the travel; any
    other to the grid it was looked for on.
    """
    output = trial.search.runs[0].output
    travel = max(float(np.ptp(output)), value)
    seen = lattice(output)
    if seen is not None and math.isclose(seen, value):
        return max(AS_GIVEN, trial.search.model.base.get("encoder_resolution", 0.0) / travel)
    return STEP_GRID * value / travel


def _rival(trial: Trial, h: Hypothesis, name: str, rival: Rival, own: Prediction,
           judged: Judged) -> RivalEvidence:
    use = rival.fit.model.effect(rival.name)
    distance = math.inf if use is None else EFFECTS[rival.name].yields_within(use.parameters)
    seen = trial.predicted(rival.fit.model)
    larger = len(rival.fit.system.free) > len(h.fit.system.free)
    other_law = rival.name not in EFFECTS[name].twins
    return RivalEvidence(rival.name, rival.cost, rival.price(h.fit), _errors(seen, judged),
                         distance / trial.search.weights[0][0].rms,
                         margin_between(seen.residuals, own.residuals, judged.lag),
                         shares_class(rival.name, name), larger,
                         rival.name not in trial.search.not_compared,
                         repeats=larger and other_law and _makes_the_same(seen, own, judged),
                         rarer=gives_way(rival.name, name))


def _makes_the_same(one: Prediction, other: Prediction, judged: Judged) -> bool:
    """Whether the difference of two predictions drowns in the noise."""
    apart = [[a[0] - b[0]] for a, b in zip(one.residuals, other.residuals, strict=True)] \
        if one.residuals and other.residuals else []
    return power(apart, judged.lag) < SAYS_NOTHING * judged.noise_power


def _offset(bare: Fit, library: Sequence[str]) -> Offset | None:
    """The mean of the runs' offsets, where on a linear spring it may be a force."""
    system = bare.system
    names = [n for n in library if EFFECTS[n].adds_to == "constant_force"]
    if not bare.ok or system.trusted or system.springless or not names \
            or system.runs[0].order:
        return None
    places = [k for k, u in enumerate(system.unknowns) if u.name == "offset"]
    scale = np.sqrt(np.maximum(np.einsum("ij,ij->j", bare.jacobian, bare.jacobian), 1e-300))
    white = np.linalg.pinv(bare.jacobian.T @ bare.jacobian / np.outer(scale, scale), rcond=1e-10)
    coloured = white @ (score_by_blocks(bare)[0] / np.outer(scale, scale)) @ white
    variance = np.maximum(np.diag(white), np.diag(coloured))[places]
    sigmas = np.sqrt(variance) / scale[places]
    values, weight = bare.x[places], float(np.sum(sigmas**-2.0))
    sigma = weight ** -0.5
    if values.size >= SCATTERING:  # of many runs each has few blocks, but they scatter
        sigma = max(sigma, float(np.std(values, ddof=1)) / math.sqrt(values.size))
    return Offset(names[0], float(np.sum(values / sigmas**2) / weight), sigma,
                  bare.model.base.get("stiffness", 0.0))


def _library(trial: Trial) -> Iterator[Candidate]:
    at = trial.search.conditions(trial.search.model)
    for name in trial.search.library:
        hit = trial.search.hits.get(name)
        yield Candidate(name, excluded(name, trial.search.model, at, trial.search.again),
                        None if hit is None else hit.gain, trial.dropped.get(name),
                        above=trial.search.above)


def _limits(search: Search) -> dict[str, dict[str, Quantity]]:
    """Size that each effect would have needed to be named, with its unit."""
    found = {}
    for name, sizes in search.smallest.items():
        model = search.model.with_effect(name, EFFECTS[name].defaults)
        found[name] = {n: Quantity(v, model.parameter(f"{name}.{n}").unit)
                       for n, v in sizes.items()}
    return found


def _comparisons(trial: Trial, h: Hypothesis, fitted: Prediction,
                 held: Sequence[Prediction]) -> Iterator[Comparison]:
    """What the given, the retuned and the extended model leave of every record."""
    which: tuple[Which, ...] = ("given", "retuned", "extended")
    for runs, residuals, is_held in (
            (trial.search.runs, (fitted.residuals, h.bare.residuals, h.fit.residuals), False),
            (trial.held, [p.residuals for p in held], True)):
        for i, run in enumerate(runs):
            left = {w: each[i][0] for w, each in zip(which, residuals, strict=True) if each}
            yield Comparison(run.name, is_held, run.sample_period, run.time[run.skip:],
                             run.output[run.skip:], left, run.measures)
