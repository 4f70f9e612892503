"""The effects of one search that bring a gap to the noise, or explain most of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.diagnosis.clear_force import by_force, clear_force
from dfm_stage.diagnosis.decisions import (
    FAR_BEHIND,
    GROSS_GAP,
    GROSS_REMAINDER,
    OUT_OF_REACH,
    PARTIAL_SHARE,
)
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.evidence import DropReason, Evidence
from dfm_stage.diagnosis.fit import Fit, rms
from dfm_stage.diagnosis.gather import gather, with_colour, with_confirmation, with_joint_fit
from dfm_stage.diagnosis.grading import graded
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.margins import judged_signal
from dfm_stage.diagnosis.observation import in_windows
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.search_decisions import (
    FIRST_SHARE,
    GRADING_STEPS,
    LEAST_STEPS,
    MOST_STEPS,
    NEAR_NOISE,
    RESTART_ABOVE,
)
from dfm_stage.diagnosis.verdict import (
    explained_share,
    judge_hypothesis,
    needs_grading,
    needs_joint_fit,
    small_parts,
    stays_open,
)
from dfm_stage.identification.system import steps_taken

Judgement = tuple[Trial, Hypothesis, Evidence]
"""What was tried, what was found, and the evidence for it."""


def explained(trial: Trial, first: Fit, warnings: Sequence[str], split: bool) -> Judgement:
    """The effects that bring the gap to the noise; where none do, those that explain most.

    The latter come first where the first effects found leave a gross remainder, and before any
    search where positions, or phases, are carried away and the force domain can tell.
    """
    begun = steps_taken()
    part: Judgement | None = None
    free = first.system.springless or not any(run.driven for run in first.system.runs)
    if free and is_gross(first, trial.lag) and (
            trial.witness is not None and not trial.witness.cannot_tell):
        own = _in_windows(trial)
        bare = own.search.begin()
        part = own, *graded(own, Hypothesis((), bare, bare), warnings, split)
        if stays_open(part[2]):
            return part
    search = trial.search
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    names, found = search.alone(first)
    if not is_noise(found):
        names, found = search.grown((), first, rounds=1)
    if part is None and leaves_gross(found):
        part = _explaining(trial, Hypothesis(names, found, first), warnings, split)
        if stays_open(part[2]) and leaves_gross(part[1].fit):
            return part
        if part[0] is trial and part[1].names:
            names, found = part[1].names, part[1].fit
        elif not part[1].names and leaves_gross(found := _begun_anew(search, names, found)):
            return _by_force(trial, Hypothesis((), first, first), warnings, split) or part
    elif part is not None and not part[1].names and is_out_of_reach(found):
        return _where_windows_tell_nothing(trial, Hypothesis(names, found, first), warnings,
                                           split) or part
    h, evidence = to_noise(trial, names, found, MOST_STEPS - (steps_taken() - begun), warnings,
                           split)
    if not needs_grading(evidence):
        return trial, h, evidence
    if part is None:
        part = _near_noise(h, _explaining(trial, h, warnings, split), warnings, split)
    elif h.names and not part[1].names:
        part = _near_noise(h, (trial, *graded(trial, h, warnings, split)), warnings, split)
    forced = None if part[1].names else _by_force(trial, h, warnings, split)
    if part[1].names or forced is not None:
        return forced or part
    return trial, h, replace(evidence, witness=part[2].witness, judged=part[2].judged)


def _near_noise(h: Hypothesis, part: Judgement, warnings: Sequence[str],
                split: bool) -> Judgement:
    """Effects that explain a part, or what a search finds that begins with them, if they come near
    the noise and its effects stand; what the search that ended in `h` dropped is not held against
    them."""
    trial, other, _ = part
    if trial.search.runs[0].window or not other.names or set(other.names) == set(h.names) \
            or other.fit.chi2 > NEAR_NOISE * other.fit.white.size:
        return part
    own = replace(trial, search=replace(trial.search, barred=set()), dropped={})
    found = to_noise(own, other.names, other.fit, GRADING_STEPS, warnings, split)
    return (own, *found) if judge_hypothesis(found[1]).stands else part


def _where_windows_tell_nothing(trial: Trial, h: Hypothesis, warnings: Sequence[str],
                                split: bool) -> Judgement | None:
    """What explains a part of whole records, or of the force balance, by which of the two leaves
    less of what is held out; None where neither does."""
    forced = _by_force(trial, Hypothesis((), h.bare, h.bare), warnings, split)
    told = [each for each in (_explaining(trial, h, warnings, split), forced)
            if each is not None and each[1].names]
    return min(told, key=lambda each: each[2].extended.held_out.power, default=None)


def _begun_anew(search: Search, names: Names, found: Fit) -> Fit:
    """A fit that begins with each effect screened beside the others, where that leaves less. A fit
    in a far minimum explains no part, though its effects are the right ones."""
    search.begin_work(LEAST_STEPS)
    return search.restarted(names, found) or found


def to_noise(trial: Trial, names: Names, found: Fit, steps: float, warnings: Sequence[str],
             split: bool) -> tuple[Hypothesis, Evidence]:
    """The effects that a search goes on to, with the evidence for them."""
    search = trial.search
    search.begin_work(max(steps, LEAST_STEPS))
    h = trial.no_worse(trial.run(*search.grown(names, found)))
    evidence = _judged(trial, h, warnings, split)
    small = small_parts(evidence) and small_parts(with_confirmation(evidence, trial.witness))
    if small:
        for name in small:
            trial.dropped[name] = DropReason.SMALL_PART
            h = h.without(name, search)
        h = trial.compared(h)
        evidence = _judged(trial, h, warnings, split)
    return h, evidence


def _judged(trial: Trial, h: Hypothesis, warnings: Sequence[str], split: bool) -> Evidence:
    """The evidence for what a search to the noise found, with a joint fit where that decides."""
    evidence = gather(trial, h, warnings, split)
    if needs_joint_fit(evidence):
        evidence = with_joint_fit(trial, h, evidence)
    return evidence if judge_hypothesis(evidence).stands else with_colour(trial, h, evidence)


def _explaining(trial: Trial, h: Hypothesis, warnings: Sequence[str],
                split: bool) -> Judgement:
    """What explains most: beside the base as given where held-out records refute other values and
    nothing stands beside these; in windows where much of the motion is missed and the fits stay
    far behind the force domain, because long simulations have many local minima then."""
    found = trial, *graded(trial, h, warnings, split)
    if not found[1].names and trial.search.free and not found[1].bare.system.free:
        own = trial.on(trial.search.runs, trial.held, free=())
        own.witness = trial.witness  # forces do not know what is free
        bare = own.search.begin()
        found = own, *graded(own, Hypothesis((), bare, bare), warnings, split)
    seen = trial.witness
    if seen is None or seen.cannot_tell or trial.search.runs[0].window \
            or not is_gross(h.bare, trial.lag) \
            or seen.best.share < PARTIAL_SHARE \
            or explained_share(found[2]) > FAR_BEHIND * seen.best.share:
        return found
    own, bare = begun_in_windows(trial)
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
    if is_gross(bare, trial.lag) and not trial.search.runs[0].window:
        trial, bare = begun_in_windows(trial)
    found = by_force(trial, bare, seen, heard, warnings, split) if bare.ok else None
    return None if found is None else (trial, *found)


def is_noise(found: Fit) -> bool:
    """Whether a fit leaves no more than the noise by which it is weighed."""
    return found.ok and found.chi2 <= RESTART_ABOVE * found.white.size


def leaves_gross(found: Fit) -> bool:
    """Whether a fit leaves much more than the noise by which it is weighed."""
    return found.ok and found.chi2 > GROSS_REMAINDER**2 * found.white.size


def is_out_of_reach(found: Fit) -> bool:
    """Whether a fit leaves so much more that no further effects are looked for to explain all."""
    return found.ok and found.chi2 > OUT_OF_REACH**2 * found.white.size


def is_gross(bare: Fit, lag: int) -> bool:
    """Whether much of the motion is missed; of what drifts, of its velocity over `lag` samples.
    Whatever small force there is carries the position away, and noise decides its change from
    sample to sample."""
    motion = max(float(np.std(judged_signal(run.output, lag))) for run in bare.system.runs)
    return rms([judged_signal(parts[0], lag) for parts in bare.residuals]) > GROSS_GAP * motion


def begun_in_windows(trial: Trial) -> tuple[Trial, Fit]:
    """The same in windows, with work of its own and the fit without effects."""
    own = _in_windows(trial)
    own.search.begin_work(LEAST_STEPS)
    return own, own.search.begin()


def _in_windows(trial: Trial) -> Trial:
    """The same with states that start anew in every window."""
    own = trial.on([in_windows(r) for r in trial.search.runs],
                   [in_windows(r) for r in trial.held])
    own.witness = trial.witness  # forces know no windows
    return own
