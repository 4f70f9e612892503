"""From records and a model to a diagnosis: search, test, gather evidence, judge, tell."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from dfm_stage.diagnosis.braked import braked
from dfm_stage.diagnosis.candidates import shown_by_none
from dfm_stage.diagnosis.decisions import FEW_SAMPLES, STRETCHES_FITTED, STRETCHES_HELD
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import Evidence
from dfm_stage.diagnosis.explaining import Judgement, begun_in_windows, is_noise
from dfm_stage.diagnosis.formula_offer import (
    accepted_in,
    wants_formulas,
    with_accepted,
    with_formulas,
)
from dfm_stage.diagnosis.gather import with_next_experiment, with_surface
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.margins import velocity_lag
from dfm_stage.diagnosis.observation import Observation, alike, observe, split_by_time
from dfm_stage.diagnosis.one_law import with_one_law
from dfm_stage.diagnosis.other_convention import (
    by_other_conventions,
    clearer_kind,
    clearest,
    has_fast_mode,
    is_simpler,
    late_samples,
    leaves_less,
    may_be_simpler,
    timed,
)
from dfm_stage.diagnosis.other_law import with_other_law
from dfm_stage.diagnosis.result import Diagnosis, told
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.stretches import Stretches, changes, is_long, observe_stretches
from dfm_stage.diagnosis.uncommon import judged_among_all
from dfm_stage.diagnosis.verdict import leaves_open, verdict
from dfm_stage.diagnosis.wording import few_samples, lost_samples
from dfm_stage.identification.model_fit import default_free, expand_names
from dfm_stage.identification.weights import white_weights
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.formula import Formula
from dfm_stage.model.registry import ALL, UNCOMMON, library_of
from dfm_stage.recording import Record, at_period

Wanted = tuple[Record, Model, "str | None", "str | None"]
"""A record, the model of its axis, the axis, and the record's name."""


def diagnose(records: Sequence[Record], model: Model, *, holdout: Sequence[Record] = (),
             axis: str | None = None, library: Sequence[str] | None = None,
             without: Sequence[str] = (), free: Sequence[str] | None = None,
             fixed: Sequence[str] = (), names: Sequence[str] = (), seed: int = 0,
             accept: Sequence[Formula] = (),
             step: Callable[[str], None] | None = None) -> Diagnosis:
    """Find out which effects `model` lacks, from records that it should explain.

    Parameters
    ----------
    records
        Records to fit. Of one with more than LONG_RECORD samples, selected stretches are fitted.
        One that is sampled nearly as often as the model steps is brought to its period.
    model
        A model of one axis; or of several, with `axis` to choose one.
    holdout
        Records to predict and never to fit. Without one, the last 30 % of each record are held
        out, and a warning says so.
    library
        Effects that may be named. By default, those of `dfm_stage.model.EFFECTS`; the uncommon
        ones follow if these leave more than noise, or several are needed. `all` admits both from
        the beginning.
    without
        Effects that may not be named.
    free
        Base parameters to re-estimate, except those in `fixed`. By default damping, stiffness,
        force constant, lag and delay, as far as the model has them, and its effects.
    names
        Names of the records for the report: the fitted ones, then those held out.
    seed
        Seed of all random choices, so that a call can be repeated.
    accept
        Formulas to add to the model first. The gap is given without and with them.
    step
        Function to call with the name of each step when it begins.

    Raises
    ------
    DiagnosisError, ModelError, RecordError
        If data, model or request cannot be used.
    """
    begun = time.monotonic()
    tell = step or (lambda _: None)
    if not records:
        raise DiagnosisError("no record was given; name at least one")
    chosen = model.usual_axis(axis)
    unextended = model.axis(chosen)
    one = accepted_in(unextended, accept)
    known, uncommon = _libraries(library, without)
    tell("reading")
    records, holdout = ([at_period(record, one.sample_period) for record in each]
                        for each in (records, holdout))
    if len(names) > len(records) + len(holdout):
        raise DiagnosisError(f"there are {len(names)} names for {len(records) + len(holdout)} "
                             "records; give at most one for each")
    labels = [*names, *[""] * (len(records) + len(holdout) - len(names))]
    wanted = [(r, one, chosen if chosen in r.axes else axis, n or None)
              for r, n in zip((*records, *holdout), labels, strict=True)]
    runs, held, chosen_of = _observed(wanted[:len(records)], wanted[len(records):])
    warnings = [*(each.words for each in chosen_of), *(
        f"{r.provenance.source}: {w}" for r in (*records, *holdout) for w in r.warnings)]
    both = alike([*runs, *held], late_samples(one))
    runs, held = both[:len(runs)], both[len(runs):]
    warnings += [lost_samples(run.name, run.lost_s) for run in (*runs, *held) if run.lost_s]
    warnings += [few_samples(run.name, run.input.size) for run in (*runs, *held)
                 if run.input.size < FEW_SAMPLES]
    whole = [run for run in runs if not run.of]
    if not holdout:
        parts = split_by_time(whole)
        runs, held = ([run for run in each if run.of] + part
                      for each, part in zip((runs, held), parts, strict=True))
    hidden = {f"{use.name}.{n}" for use in one.effects for n in shown_by_none(use.name, runs)}
    held_fixed = expand_names(one, fixed)
    freed = tuple(n for n in (default_free(one) if free is None else free)
                  if n not in held_fixed and (free is not None or n not in hidden))
    search = Search(one, runs, freed, library=known, again=library is not None, step=tell)
    found = _diagnosis(Trial(search, held, seed, uncommon=uncommon), warnings,
                       bool(whole) and not holdout, (unextended, accept))
    return replace(found, stretches=chosen_of, seconds=time.monotonic() - begun)


def _libraries(library: Sequence[str] | None,
               without: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The effects that may be named, and those where these leave more than noise."""
    known, uncommon = library_of(library), UNCOMMON if library is None else ()
    for option, names in (("library", known), ("without", without)):
        for name in names:
            if name not in EFFECTS:
                raise DiagnosisError(f"{option}: there is no effect {name}; choose among "
                                     f"{', '.join(library_of([ALL]))}")
    return (tuple(n for n in known if n not in without),
            tuple(n for n in uncommon if n not in without and n not in known))


def _observed(fitted: Sequence[Wanted], held: Sequence[Wanted]
              ) -> tuple[list[Observation], list[Observation], tuple[Stretches, ...]]:
    """The runs to fit and to predict, and what was chosen of long records: of these stretches,
    some of which are predicted where no record is held out."""
    fits, predicted, chosen = list[Observation](), list[Observation](), list[Stretches]()
    for group, is_held in ((fitted, False), (held, True)):
        many = max(sum(is_long(record) for record, *_ in group), 1)
        counts = (0 if is_held else max(STRETCHES_FITTED // many, 1),
                  0 if held and not is_held else max(STRETCHES_HELD // many, 1))
        for each in group:
            if is_long(each[0]):
                own, other, what = observe_stretches(*each, *counts)
                fits, predicted, chosen = fits + own, predicted + other, [*chosen, what]
            else:
                (predicted if is_held else fits).append(observe(*each))
    return fits, predicted, tuple(chosen)


def _diagnosis(trial: Trial, warnings: Sequence[str], split: bool,
               accepted: tuple[Model, Sequence[Formula]]) -> Diagnosis:
    """Search, test, gather the evidence, judge it and put it into words; `accepted` are the model
    without the formulas that were accepted, and these."""
    search = trial.search
    search.step("measuring the gap")
    first = search.begin()
    if not first.ok:
        raise DiagnosisError(f"model {search.model.name}: cannot be simulated on "
                             f"{search.runs[0].name}: the motion escapes, a force is too stiff, "
                             "or the parameters leave their limits; correct the model")
    if first.system.drifts:
        trial.lag = velocity_lag(first.residuals, white_weights(first.residuals)[0][0].rms**2)
    trial, first = timed(trial, first)
    if not is_noise(first):
        trial, first = clearest(trial, first)
    found = judged_among_all(trial, first, warnings, split)
    if has_fast_mode(found[1], verdict(found[2])):
        found = _simplest(found, warnings, split)
    if not verdict(found[2]).complete:
        found = braked(_clearest(found, warnings, split), warnings, split)
    if verdict(found[2]).kind in {"named", "ambiguous"}:
        found = with_one_law(found)
    trial, hypothesis, evidence = found
    search = trial.search
    models = {"given": search.model, "retuned": hypothesis.bare.model,
              "extended": hypothesis.fit.model}
    settled = verdict(evidence)
    if settled.remainder:
        if settled.kind != "unknown":
            evidence = with_other_law(trial, hypothesis, evidence)
            settled = verdict(evidence)
        evidence = with_surface(trial, models[settled.model], evidence)
        settled = verdict(evidence)
    model = models[settled.model]
    drifts = changes(model, search.runs, search.free, search.weights, search.noise)
    if leaves_open(settled):
        evidence = with_next_experiment(trial, hypothesis, evidence, settled.undecided)
    if wants_formulas(settled):
        evidence = with_formulas(*_as_judged(trial, hypothesis, evidence), evidence, settled)
    if accepted[1]:
        evidence = with_accepted(trial, *accepted, evidence)
    evidence = replace(evidence, warnings=(*evidence.warnings, *drifts))
    search.step("judging")
    return told(evidence, settled, model)


def _simplest(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found, or what another convention of the input makes of it if that is simpler."""
    for other in by_other_conventions(found[0]):
        trial, first = timed(other, other.search.begin())
        if first.ok and may_be_simpler(trial, first, found[1]):
            simpler = judged_among_all(trial, first, warnings, split)
            if is_simpler(simpler[1:], found[1:]):
                found = simpler
    return found


def _clearest(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found, or what is by the kind of hold that leaves clearly less."""
    kind = clearer_kind(*found[:2])
    if kind is None:
        return found
    other = judged_among_all(*kind, warnings, split)
    return other if leaves_less(other[1:], found[1:]) else found


def _as_judged(trial: Trial, h: Hypothesis, evidence: Evidence) -> tuple[Trial, Hypothesis]:
    """The trial in the windows in which the gap was judged, where it is not in them."""
    if evidence.judged.window_s is None or trial.search.runs[0].window:
        return trial, h
    own, bare = begun_in_windows(trial)
    return (own, Hypothesis((), bare, bare)) if bare.ok else (trial, h)
