"""From records and a model to a diagnosis: search, test, gather evidence, judge, tell."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.diagnosis.alike import shares_class
from dfm_stage.diagnosis.clear_force import by_force, clear_force
from dfm_stage.diagnosis.decisions import (
    FAR_BEHIND,
    FIRST_SHARE,
    FURTHER,
    FURTHER_PART,
    GROSS_GAP,
    GROSS_REMAINDER,
    LEAST_STEPS,
    MOST_STEPS,
    NEAR_NOISE,
    PARTIAL_SHARE,
    RESTART_ABOVE,
    STRETCHES_FITTED,
    STRETCHES_HELD,
)
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import DropReason, Evidence
from dfm_stage.diagnosis.fit import Fit, rms
from dfm_stage.diagnosis.formula_offer import (
    accepted_in,
    wants_formulas,
    with_accepted,
    with_formulas,
)
from dfm_stage.diagnosis.gather import (
    gather,
    with_confirmation,
    with_joint_fit,
    with_next_experiment,
    with_surface,
)
from dfm_stage.diagnosis.grading import beside_main, graded
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import (
    Observation,
    alike,
    in_windows,
    observe,
    split_by_time,
)
from dfm_stage.diagnosis.other_convention import (
    by_other_conventions,
    clearest,
    has_linear_effect,
    is_simpler,
    late_samples,
    may_be_simpler,
)
from dfm_stage.diagnosis.result import Diagnosis, told
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.stretches import Stretches, changes, is_long, observe_stretches
from dfm_stage.diagnosis.verdict import (
    explained_share,
    is_clearly_more,
    is_coloured_noise,
    leaves_open,
    main_effect,
    needs_grading,
    needs_joint_fit,
    small_parts,
    stays_open,
    verdict,
)
from dfm_stage.diagnosis.wording import lost_samples
from dfm_stage.identification.model_fit import default_free
from dfm_stage.identification.system import steps_taken
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.formula import Formula
from dfm_stage.model.registry import ALL, UNCOMMON, library_of
from dfm_stage.recording import Record

Judgement = tuple[Trial, Hypothesis, Evidence]
"""What was tried, what was found, and the evidence for it."""
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
    labels = [*names, *[""] * (len(records) + len(holdout) - len(names))]
    wanted = [(r, one, chosen if chosen in r.axes else axis, n or None)
              for r, n in zip((*records, *holdout), labels, strict=True)]
    runs, held, chosen_of = _observed(wanted[:len(records)], wanted[len(records):])
    warnings = [*(each.words for each in chosen_of), *(
        f"{r.provenance.source}: {w}" for r in (*records, *holdout) for w in r.warnings)]
    both = alike([*runs, *held], late_samples(one))
    runs, held = both[:len(runs)], both[len(runs):]
    warnings += [lost_samples(run.name, run.lost_s) for run in (*runs, *held) if run.lost_s]
    whole = [run for run in runs if not run.of]
    if not holdout:
        parts = split_by_time(whole)
        runs, held = ([run for run in each if run.of] + part
                      for each, part in zip((runs, held), parts, strict=True))
    freed = tuple(n for n in (default_free(one) if free is None else free) if n not in fixed)
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
                             f"{search.runs[0].name}: the motion escapes or the parameters leave "
                             "their limits; correct the model")
    if not is_noise(first):
        trial, first = clearest(trial, first)
    found = _judged(trial, first, warnings, split)
    if has_linear_effect(found[1], verdict(found[2])):
        found = _simplest(found, warnings, split)
    trial, hypothesis, evidence = found
    search = trial.search
    models = {"given": search.model, "retuned": hypothesis.bare.model,
              "extended": hypothesis.fit.model}
    settled = verdict(evidence)
    if settled.remainder:
        evidence = with_surface(trial, models[settled.model], evidence)
        settled = verdict(evidence)
    if leaves_open(settled):
        evidence = with_next_experiment(trial, hypothesis, evidence, settled.undecided)
    if wants_formulas(settled):
        evidence = with_formulas(*_as_judged(trial, hypothesis, evidence), evidence, settled)
    if accepted[1]:
        evidence = with_accepted(trial, *accepted, evidence)
    model = models[settled.model]
    drifts = changes(model, search.runs, search.free, search.weights, search.noise)
    evidence = replace(evidence, warnings=(*evidence.warnings, *drifts))
    search.step("judging")
    return told(evidence, settled, model)


def _simplest(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found, or what another convention of the input makes of it if that is simpler;
    of those that leave less before any effect is added."""
    for trial in by_other_conventions(found[0]):
        first = trial.search.begin()
        if first.ok and first.rms < found[1].bare.rms and may_be_simpler(trial, first, found[1]):
            other = _judged(trial, first, warnings, split)
            if is_simpler(other[1:], found[1:]):
                found = other
    return found


def _judged(trial: Trial, first: Fit, warnings: Sequence[str], split: bool) -> Judgement:
    """What the effects of the search explain; where they leave a remainder, what these and the
    uncommon ones do, if that is clearly more; where they do not, one uncommon effect that does in
    the place of several. Before that search a first look says whether it is worth while."""
    alone = _one_uncommon(trial, first, warnings, split)
    if alone is not None:
        return alone
    found = _explained(trial, first, warnings, split)
    said = verdict(found[2])
    relatives = _relatives(trial, found[1]) if said.complete else set()
    coloured = is_coloured_noise(found[2])
    if not trial.uncommon or (said.complete and not relatives and not coloured):
        return found
    trial.search.step("looking for uncommon effects, too")
    search = trial.search.widened(trial.uncommon)
    first, wide = search.begin(), Trial(search, trial.held, trial.seed)
    if coloured:
        return _in_the_colour(wide, first, found, warnings, split)
    if said.complete:
        return _one_for_all(wide, first, found, relatives, warnings, split)
    heard = said.kind != "named" and _may_explain(wide, found)
    if heard or _leaves_less(wide, first, found):
        among_all = _explained(wide, first, warnings, split)
        if is_clearly_more(among_all[2], found[2]):
            return among_all
    return _beside_main(trial, found, warnings, split)


def _one_uncommon(trial: Trial, first: Fit, warnings: Sequence[str],
                  split: bool) -> Judgement | None:
    """One uncommon effect that leaves only noise where no common one does by itself; a search for
    several common ones would end in more than noise, and late."""
    search = trial.search
    if not trial.uncommon or search.runs[0].window or is_noise(first):
        return None
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    _, common = search.alone(first)
    if is_noise(common):
        return None
    search.step("looking for uncommon effects, too")
    wide = Trial(search.widened(trial.uncommon), trial.held, trial.seed)
    names, found = wide.search.alone_of(trial.uncommon, first, common)
    if not may_stand_alone(search, found, common):
        return None
    other = wide, *_to_noise(wide, names, found, MOST_STEPS, warnings, split)
    return other if len(other[1].names) == 1 and verdict(other[2]).complete else None


def _in_the_colour(wide: Trial, first: Fit, found: Judgement, warnings: Sequence[str],
                   split: bool) -> Judgement:
    """The verdict on coloured noise, or an uncommon effect that leaves only noise: what acts
    rarely does not repeat with the input, and passes for noise with a colour."""
    if not _leaves_less(wide, first, found):
        return found
    other = _explained(wide, first, warnings, split)
    said = verdict(other[2])
    return other if other[1].names and said.complete else found


def _beside_main(trial: Trial, found: Judgement, warnings: Sequence[str],
                 split: bool) -> Judgement:
    """What was found to explain a part, with the effects beside the main one compared with the
    uncommon ones, too. In windows the force domain alone proposes rivals, and it has done so."""
    own, h, evidence = found
    if len(h.names) < 2 or not evidence.graded or evidence.heard is not None \
            or own.search.runs[0].window:
        return found
    own.search.step("comparing uncommon effects, too")
    wide = Trial(own.search.widened(trial.uncommon), own.held, own.seed, dropped=own.dropped)
    wide.witness = own.witness
    return wide, *beside_main(wide, h, main_effect(evidence).name, own.search.library, warnings,
                              split)


def _relatives(trial: Trial, h: Hypothesis) -> set[str]:
    """The uncommon effects that may stand behind what was found: behind several effects those of
    the class of one, behind a single one those that can be the same motion."""
    return {n for n in trial.uncommon for own in h.names
            if n in EFFECTS[own].twins or (len(h.names) > 1 and shares_class(n, own))}


def _one_for_all(wide: Trial, first: Fit, found: Judgement, relatives: set[str],
                 warnings: Sequence[str], split: bool) -> Judgement:
    """What was found to leave only noise, or one of its `relatives` that leaves no more, if that
    has fewer parameters or stands for several."""
    h, search = found[1], wide.search
    if len(h.names) > 1:
        hits = {hit.name: hit for hit in reversed(search.screened(first, ())[1])}
        fits = {n: search.fitted((n,), first, [hits[n]]) for n in sorted(relatives & hits.keys())}
    else:
        fits = {n: search.in_place_of(own, n, (n,), h.fit) for n in relatives for own in h.names}
    search.reweigh(found[0].search.weights, found[0].search.noise)
    fits = {n: search.fitted((n,), each) for n, each in fits.items() if each.ok}
    fits = {n: each for n, each in fits.items() if each.ok and (
        len(h.names) > 1 or len(each.system.free) < len(h.fit.system.free))}
    name = min(fits, key=lambda n: fits[n].rms, default="")
    if not name or fits[name].rms > h.fit.rms:
        return found
    other = wide, *_to_noise(wide, (name,), fits[name], MOST_STEPS, warnings, split)
    return other if len(other[1].names) == 1 and verdict(other[2]).complete else found


def _may_explain(wide: Trial, found: Judgement) -> bool:
    """Whether the force domain, which takes seconds, has not said that the effects of a search
    without the uncommon ones explain most."""
    seen = wide.witness
    return seen is None or not seen.explained_by(found[0].search.library)


def _leaves_less(wide: Trial, first: Fit, found: Judgement) -> bool:
    """Whether the first effects of a search among all leave clearly less above the noise than what
    was found."""
    if found[0].search.runs[0].window:
        return False
    _, other = wide.search.grown((), first, rounds=1)
    noise = found[2].noise.rms**2
    return other.rms**2 - noise < (1.0 - FURTHER_PART) * (found[1].fit.rms**2 - noise)


def _explained(trial: Trial, first: Fit, warnings: Sequence[str], split: bool) -> Judgement:
    """The effects that bring the gap to the noise; where none do, those that explain most.

    The latter come first where the first effects found leave a gross remainder, and before any
    search where positions, or phases, are carried away and the force domain can tell.
    """
    begun = steps_taken()
    part: Judgement | None = None
    free = first.system.springless or not any(run.driven for run in first.system.runs)
    if free and is_gross(first) and (
            trial.witness is not None and not trial.witness.cannot_tell):
        own = _in_windows(trial)
        bare = own.search.begin()
        part = own, *graded(own, Hypothesis((), bare, bare), warnings, split)
        if stays_open(part[2]):
            return part
    search = trial.search
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    names, found = search.grown((), first, rounds=1)
    if part is None and leaves_gross(found):
        part = _explaining(trial, Hypothesis(names, found, first), warnings, split)
        if stays_open(part[2]) and leaves_gross(part[1].fit):
            return part
        if part[0] is trial and part[1].names:
            names, found = part[1].names, part[1].fit
        elif not part[1].names and leaves_gross(found := _begun_anew(search, names, found)):
            return _by_force(trial, Hypothesis((), first, first), warnings, split) or part
    h, evidence = _to_noise(trial, names, found, MOST_STEPS - (steps_taken() - begun), warnings,
                            split)
    if not needs_grading(evidence):
        return trial, h, evidence
    if part is None:
        part = _explaining(trial, h, warnings, split)
    elif h.names and not part[1].names:
        part = trial, *graded(trial, h, warnings, split)
    forced = None if part[1].names else _by_force(trial, h, warnings, split)
    if part[1].names or forced is not None:
        return forced or part
    return trial, h, replace(evidence, witness=part[2].witness, judged=part[2].judged)


def _begun_anew(search: Search, names: Names, found: Fit) -> Fit:
    """A fit that begins with each effect screened beside the others, where that leaves less. A fit
    in a far minimum explains no part, though its effects are the right ones."""
    search.begin_work(LEAST_STEPS)
    return search.restarted(names, found) or found


def _to_noise(trial: Trial, names: Names, found: Fit, steps: float, warnings: Sequence[str],
              split: bool) -> tuple[Hypothesis, Evidence]:
    """The effects that a search goes on to, with the evidence for them."""
    search = trial.search
    search.begin_work(max(steps, LEAST_STEPS))
    h = trial.no_worse(trial.run(*search.grown(names, found)))
    evidence = gather(trial, h, warnings, split)
    if needs_joint_fit(evidence):
        evidence = with_joint_fit(trial, h, evidence)
    small = small_parts(evidence) and small_parts(with_confirmation(evidence, trial.witness))
    if small:
        for name in small:
            trial.dropped[name] = DropReason.SMALL_PART
            h = h.without(name, search)
        evidence = gather(trial, h, warnings, split)
    return h, evidence


def _explaining(trial: Trial, h: Hypothesis, warnings: Sequence[str],
                split: bool) -> Judgement:
    """What explains most: beside the base as given where held-out records refute other values and
    nothing stands beside these; in windows where much of the motion is missed and the fits stay
    far behind the force domain, because long simulations have many local minima then."""
    found = trial, *graded(trial, h, warnings, split)
    if not found[1].names and trial.search.free and not found[1].bare.system.free:
        own = _anew(trial, trial.search.runs, trial.held, ())
        bare = own.search.begin()
        found = own, *graded(own, Hypothesis((), bare, bare), warnings, split)
    seen = trial.witness
    if seen is None or seen.cannot_tell or trial.search.runs[0].window or not is_gross(h.bare) \
            or seen.best.share < PARTIAL_SHARE \
            or explained_share(found[2]) > FAR_BEHIND * seen.best.share:
        return found
    own, bare = _begun_in_windows(trial)
    other = own, *graded(own, Hypothesis((), bare, bare), warnings, split)
    return other if other[1].names else found


def _by_force(trial: Trial, h: Hypothesis, warnings: Sequence[str],
              split: bool) -> Judgement | None:
    """What the force domain alone bears out, where the model with it predicts the held-out motion
    better; a motion that is grossly missed is compared in windows."""
    seen = trial.witness
    heard = None if seen is None else clear_force(seen)
    if seen is None or heard is None:
        return None
    bare = h.bare
    if is_gross(bare) and not trial.search.runs[0].window:
        trial, bare = _begun_in_windows(trial)
    found = by_force(trial, bare, seen, heard, warnings, split) if bare.ok else None
    return None if found is None else (trial, *found)


def may_stand_alone(search: Search, found: Fit, common: Fit) -> bool:
    """Whether one uncommon effect comes near the noise and explains more than the best common one
    does, its parameters paid for."""
    return found.chi2 <= NEAR_NOISE * found.white.size \
        and search.score(found) <= search.score(common) - FURTHER


def is_noise(found: Fit) -> bool:
    """Whether a fit leaves no more than the noise by which it is weighed."""
    return found.ok and found.chi2 <= RESTART_ABOVE * found.white.size


def leaves_gross(found: Fit) -> bool:
    """Whether a fit leaves much more than the noise by which it is weighed."""
    return found.ok and found.chi2 > GROSS_REMAINDER**2 * found.white.size


def is_gross(bare: Fit) -> bool:
    """Whether much of the motion is missed; of what drifts, of its change from sample to sample,
    because whatever small force there is carries the position away."""
    degree = 1 if bare.system.drifts else 0
    motion = max(float(np.std(np.diff(run.output, degree))) for run in bare.system.runs)
    return rms([np.diff(parts[0], degree) for parts in bare.residuals]) > GROSS_GAP * motion


def _as_judged(trial: Trial, h: Hypothesis, evidence: Evidence) -> tuple[Trial, Hypothesis]:
    """The trial in the windows in which the gap was judged, where it is not in them."""
    if evidence.judged.window_s is None or trial.search.runs[0].window:
        return trial, h
    own, bare = _begun_in_windows(trial)
    return (own, Hypothesis((), bare, bare)) if bare.ok else (trial, h)


def _begun_in_windows(trial: Trial) -> tuple[Trial, Fit]:
    """The same in windows, with work of its own and the fit without effects."""
    own = _in_windows(trial)
    own.search.begin_work(LEAST_STEPS)
    return own, own.search.begin()


def _in_windows(trial: Trial) -> Trial:
    """The same with states that start anew in every window."""
    return _anew(trial, [in_windows(r) for r in trial.search.runs],
                 [in_windows(r) for r in trial.held], trial.search.free)


def _anew(trial: Trial, runs: Sequence[Observation], held: Sequence[Observation],
          free: Names) -> Trial:
    """The same on other forms of the records, or with other base parameters free."""
    old = trial.search
    found = Trial(Search(old.model, runs, free, library=old.library, again=old.again,
                         step=old.step), held, trial.seed)
    found.witness = trial.witness  # forces know neither windows nor what is free
    return found
