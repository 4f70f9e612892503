"""Another convention of the input than the estimated one.

A held input cannot act before half a sample; one that is not held may act later, with a lag of the
stage behind it. The kind of hold is then told by what the model leaves with each. What an error of
the input's timing leaves looks like a mode far above the motion: where such a mode is found and
another kind explains as much without it, the records are judged by that kind, too. So they are
where the effects found leave more than noise, unless the input acts late: what is late is a delay.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

from dfm_stage.diagnosis.decisions import FIRST
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.evidence import Evidence
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.search_decisions import (
    CONVENTION_PRICE,
    CONVENTION_WORSE,
    FARTHEST_SHIFT,
    FIRST_SHARE,
    HOLDS_DIFFER,
    MOST_STEPS,
    PER_PARAMETER,
)
from dfm_stage.diagnosis.verdict import Verdict
from dfm_stage.identification.convention import LATENESS, Convention, Hold, reinterpreted
from dfm_stage.identification.coordinates import late_parameters, lateness
from dfm_stage.identification.decisions import EARLY_SHIFT, HOLD_CLEAR
from dfm_stage.identification.system import is_nonlinear
from dfm_stage.model import EFFECTS, Model


def clearest(trial: Trial, first: Fit) -> tuple[Trial, Fit]:
    """The trial by the kind of hold that leaves clearly least before any effect is added, with
    that fit; only where the model has a lag or delay to fit, because an effect that is late would
    stand for a kind otherwise. An input that acts late may be held behind another stage than that
    given: another kind must then leave half of all."""
    search, best, least = trial.search, (trial, first), first
    if not late_parameters(search.model, search.free) or not _may_be_another(trial):
        return best
    noise = 0.0 if _acts_late(trial) else float(first.white.size)
    for other in by_other_conventions(trial):
        looked = search.fit_like(first, other.search.runs)
        if _is_clearer(looked, first, noise) and looked.chi2 < least.chi2 \
                and (found := other.search.begin()).rms < first.rms:
            best, least = (other, found), looked
    return best if least is first else timed(*best)


def _may_be_another(trial: Trial) -> bool:
    """Whether the input may be of another kind. Not where it acts half a sample late, as a held
    one does, or so much later as the model given is: another kind needs another lag of the stage
    for that, and fits it to what the model lacks."""
    return not acts_as_given(trial) and not any(
        run.convention.acts_when_held() for run in trial.search.runs)


def acts_as_given(trial: Trial) -> bool:
    """Whether an input acts as a held one does behind the stage as given."""
    late = late_samples(trial.search.model)
    return any(run.convention.acts_when_held(late) for run in trial.search.runs)


def _acts_late(trial: Trial) -> bool:
    """Whether an input that may be held acts later than behind the stage as given."""
    late = late_samples(trial.search.model)
    return any(c.hold == "zero" and c.source == "estimated" and c.late is not None
               and c.late > late for c in (run.convention for run in trial.search.runs))


def _is_clearer(other: Fit, first: Fit, noise: float) -> bool:
    """Whether one fit leaves clearly less above the chi-square of noise than another, by the same
    weights."""
    return other.ok and first.chi2 - other.chi2 > FIRST \
        and other.chi2 - noise < HOLD_CLEAR * (first.chi2 - noise)


def clearer_kind(trial: Trial, h: Hypothesis) -> tuple[Trial, Fit] | None:
    """The trial by another kind of hold by which the effects of a hypothesis leave clearly less of
    the fitted records, and its fit without effects; by the kind that leaves least. Not of an input
    that acts late: a remainder may pass for a kind. Records in windows are not asked: how much
    they leave says nothing of the whole."""
    search = trial.search
    if search.runs[0].window or not _may_be_another(trial) or _acts_late(trial):
        return None
    best, own = None, search.fit_like(h.fit, search.runs)
    least = own
    for other in by_other_conventions(trial):
        first = other.search.begin()
        looked = search.fit_like(_left(other.search, trial, h), other.search.runs)
        if first.ok and _is_clearer(looked, own, float(own.white.size)) \
                and looked.chi2 < least.chi2:
            best, least = (other, first), looked
    return best


def _left(search: Search, trial: Trial, h: Hypothesis) -> Fit:
    """The fit with the effects of a hypothesis; where a held input would surely act before it is
    set, as none does, with one more if that helps. A short search, because a whole one takes as
    long as that of `h` did."""
    if not any(run.convention.before_it_is_set for run in (*trial.search.runs, *trial.held)):
        return h.fit
    found = search.fitted(h.names, h.fit)
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    return search.grown(h.names, found, rounds=1)[1]


def leaves_less(other: tuple[Hypothesis, Evidence], found: tuple[Hypothesis, Evidence]) -> bool:
    """Whether one leaves less of the fitted and of the held-out records."""
    new, old = other[1].extended, found[1].extended
    return new.fitted.power < old.fitted.power and new.held_out.power < old.held_out.power


def timed(trial: Trial, first: Fit) -> tuple[Trial, Fit]:
    """The trial with estimated shifts of the input moved to where the model leaves least, with
    that fit: all by the same share of their standard errors. The estimate knows no model, and a
    long record shows an error far below its standard error: as a lag."""
    if not any(_is_moved(run.convention) for run in (*trial.search.runs, *trial.held)):
        return trial, first
    tried = [_tried(_moved(trial, by)) for by in (-1.0, 1.0)]
    before, here, after = tried[0][1].rms**2, first.rms**2, tried[1][1].rms**2
    bend = before - 2.0 * here + after
    if math.isfinite(bend) and bend > 0.0:
        least = 0.5 * (before - after) / bend
        tried.append(_tried(_moved(trial, min(max(least, -FARTHEST_SHIFT), FARTHEST_SHIFT))))
    return min(((trial, first), *tried), key=lambda each: each[1].rms if each[1].ok else math.inf)


def _is_moved(known: Convention) -> bool:
    return known.source in ("estimated", "others") and known.shift != 0.0 \
        and known.sigma is not None


def _moved(trial: Trial, by: float) -> Trial:
    """The trial with every estimated shift that is not zero later `by` its standard errors; what
    is late is a delay, and no shift."""
    def moved(known: Convention) -> Convention:
        return replace(known, shift=min(known.shift + by * (known.sigma or 0.0), 0.0))

    return trial.on(*([run.by(moved(run.convention)) if _is_moved(run.convention) else run
                       for run in runs] for runs in (trial.search.runs, trial.held)))


def _tried(trial: Trial) -> tuple[Trial, Fit]:
    return trial, trial.search.begin()


def has_fast_mode(h: Hypothesis, told: Verdict) -> bool:
    """Whether an effect is told that may stand for another kind of hold."""
    return any(_stands_for_timing(h, found.name) for found in told.effects)


def _stands_for_timing(h: Hypothesis, name: str) -> bool:
    """Whether an effect is a linear part of several parameters, so fast that kinds of hold differ
    there."""
    effect = EFFECTS[name]
    return effect.stamp is not None and effect.wave is None and not is_nonlinear(name) \
        and len(effect.parameters) > CONVENTION_PRICE and _is_fast(h, name)


def _is_fast(h: Hypothesis, name: str) -> bool:
    values = h.fit.model.parameters()
    rates = {"Hz": lambda value: value, "s": lambda value: 0.5 / (math.pi * value)}
    return all(rates[p.unit](values[f"{name}.{p.name}"]) * h.fit.model.sample_period > HOLDS_DIFFER
               for p in EFFECTS[name].parameters if p.unit in rates)


def by_other_conventions(trial: Trial) -> Iterator[Trial]:
    """The trial by every other kind of hold, where the kind was not given by hand."""
    runs, held = trial.search.runs, trial.held
    known = [run.convention for run in (*runs, *held)]
    if any(c.source == "given" for c in known) or not any(run.driven for run in runs):
        return
    for kind in LATENESS:
        if any(c.hold != kind for c in known):
            yield trial.on(*(_by(each, kind, trial.search.model) for each in (runs, held)))


def _by(runs: Sequence[Observation], kind: Hold, model: Model) -> list[Observation]:
    late = late_samples(model)
    return [replace(run.by(reinterpreted(run.convention, kind).behind(late)), window=0)
            for run in runs]


def late_samples(model: Model) -> float:
    """By how many samples a stage is late by what its model says."""
    return lateness(model, tuple(model.parameters())) / model.sample_period


def may_be_simpler(trial: Trial, first: Fit, h: Hypothesis) -> bool:
    """Whether the effects of a hypothesis without its fast modes explain the fitted records as
    well by another kind of hold, whose fit without effects is `first`: with a delay where the
    input acts late."""
    names, model = _without_modes(trial, h)
    return _as_well(trial.search.fitted(names, replace(first, model=model)), h)


def _without_modes(trial: Trial, h: Hypothesis) -> tuple[Names, Model]:
    """The effects of a hypothesis without its fast modes, and a model with these that is as late
    as the records of the trial say."""
    names, model = tuple(n for n in h.names if not _stands_for_timing(h, n)), h.fit.model
    for name in set(h.names) - set(names):
        model = model.without_effect(name)
    shown = [run.convention.late for run in trial.search.runs if run.convention.late is not None]
    missing = (sum(shown) / max(len(shown), 1) - late_samples(model)) * model.sample_period
    free = late_parameters(model, h.fit.system.free)
    delay = next((n for n, kind in free.items() if kind == "delay"), None)
    if delay is not None:
        longer = max(model.parameters()[delay] + missing, 0.0)
        return names, model.with_parameters({delay: longer})
    added = next((n for n in trial.search.library if EFFECTS[n].late == "delay"), None)
    if added is None or missing < EARLY_SHIFT * model.sample_period:
        return names, model
    return (*names, added), model.with_effect(added, {EFFECTS[added].parameters[0].name: missing})


def _as_well(other: Fit, h: Hypothesis) -> bool:
    """Whether a fit with fewer parameters leaves as much as that of a hypothesis: no more
    chi-square than these parameters are worth."""
    spared = len(h.fit.system.free) - len(other.system.free)
    worse = h.fit.white.size * ((other.rms / h.fit.rms) ** 2 - 1.0)
    return other.ok and spared > CONVENTION_PRICE and worse < PER_PARAMETER * spared


def is_simpler(other: tuple[Hypothesis, Evidence], found: tuple[Hypothesis, Evidence]) -> bool:
    """Whether one explains the fitted records as well with fewer parameters, by more than a
    convention counts for, and predicts those held out as well."""
    return _as_well(other[0].fit, found[0]) \
        and other[1].extended.held_out.rms <= CONVENTION_WORSE * found[1].extended.held_out.rms
