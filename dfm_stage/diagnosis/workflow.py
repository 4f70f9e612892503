"""From records and a model to a diagnosis: measure, retune, search, verify, answer."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from dfm_stage.diagnosis.answer import MARGIN, Case, answer
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.experiment import Experiment, experiment, split_by_time
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.remainder import findings
from dfm_stage.diagnosis.result import Diagnosis
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.verification import predict, spoiled, weights_like
from dfm_stage.identification.model_fit import default_free
from dfm_stage.identification.periods import find_period
from dfm_stage.identification.weights import Weights
from dfm_stage.model import EFFECTS, Model
from dfm_stage.recording import Record


def diagnose(records: Sequence[Record], model: Model, *, holdout: Sequence[Record] = (),
             axis: str | None = None, library: Sequence[str] | None = None,
             free: Sequence[str] | None = None, fixed: Sequence[str] = (),
             names: Sequence[str] = (), seed: int = 0,
             step: Callable[[str], None] | None = None) -> Diagnosis:
    """Find what is missing in `model` by records it should explain.

    Parameters
    ----------
    records : to fit; `holdout` : to predict and never to fit. Without one, the last 30 % of each
        record are held out, and a warning says so.
    model : of one axis, or of several with `axis` naming one.
    library : effects that may be named, by default all of `dfm_stage.model.EFFECTS`.
    free : base parameters to re-estimate (default: damping, stiffness, force constant, lag and
        delay where the model has them, and the effects it has), without those in `fixed`.
    names : of the records, for the report; held-out ones follow the fitted ones.
    seed : fixes what is shuffled.
    step : called with the name of each step as it begins.

    Raises
    ------
    DiagnosisError, ModelError, RecordError
        If data, model or request cannot be used.
    """
    begun = time.monotonic()
    tell = step or (lambda _: None)
    if not records:
        raise DiagnosisError("no record was given; name at least one")
    chosen = axis if axis is not None or not model.axes else \
        ("x" if "x" in model.axes else None)
    one = model.axis(chosen)
    known = tuple(EFFECTS) if library is None else tuple(library)
    for name in known:
        if name not in EFFECTS:
            raise DiagnosisError(f"library: there is no effect {name}; choose among "
                                 f"{', '.join(EFFECTS)}")
    tell("reading")
    labels = [*names, *[""] * (len(records) + len(holdout) - len(names))]
    runs = [experiment(r, one, chosen if chosen in r.axes else axis, n or None)
            for r, n in zip(records, labels, strict=False)]
    held = [experiment(r, one, chosen if chosen in r.axes else axis, n or None)
            for r, n in zip(holdout, labels[len(records):], strict=True)]
    warnings = [f"{r.provenance.source}: {w}" for r in (*records, *holdout) for w in r.warnings]
    if not held:
        runs, held = split_by_time(runs)
        warnings.append("no hold-out record was given: the last 30 % of each record are held "
                        "out; a record of another kind would be a harder test")
    freed = tuple(n for n in (default_free(one) if free is None else free) if n not in fixed)
    found = _search(one, runs, held, freed, known, tell, warnings, seed)
    return replace(found, seconds=time.monotonic() - begun)


def _search(model: Model, runs: list[Experiment], held: list[Experiment],
            free: tuple[str, ...], library: tuple[str, ...], tell: Callable[[str], None],
            warnings: list[str], seed: int) -> Diagnosis:
    search = Search(model, runs, free, library=library, step=tell)
    tell("measuring the gap")
    names, current = search.run()
    if not current.ok:
        raise DiagnosisError(f"model {model.name}: cannot be simulated on {runs[0].name}: the "
                             "motion escapes or the parameters leave their limits; correct the "
                             "model")
    dropped: dict[str, str] = {}
    while True:
        names, current, bare = search.settle(names, current)
        tell("comparing rivals")
        names, current, rivals = search.compare(names, current)
        weights = weights_like(held, search.weights)
        tell("predicting held-out records")
        names, current, rivals = _exchanged(search, names, current, rivals, held, weights)
        current = search.polished(names, current)
        names, current, silent = _held_out(search, names, current, held, weights, seed, dropped)
        names, current = _unlocked(search, names, current, dropped)
        names, current = _bounded(search, names, current, dropped)
        if search.barred == set(dropped):
            break
        search.barred = set(dropped)
        tell("screening what is left")
        second = search.second(names, current)
        if second is None:
            break
        names, current = second
    if search.cut_short:
        warnings.append("candidates that are slow to simulate were not all tried: the work grew "
                        "beyond its limit; diagnose shorter records or fewer effects (--without)")
    rivals = {n: r for n, r in rivals.items() if n in names}
    case = Case(model=model, runs=runs, held=held, search=search, names=names, fit=current,
                bare=bare, rivals=rivals, held_weights=weights,
                dropped=dropped, silent=silent,
                before=predict(model, held, weights), retuned=predict(bare.model, held, weights),
                after=predict(current.model, held, weights, search.noise),
                before_fit=predict(model, runs, search.weights), warnings=warnings)
    return answer(case, tell)


def _exchanged(search: Search, names: Names, current: Fit, rivals: dict[str, list[Rival]],
               held: Sequence[Experiment], weights: Weights
               ) -> tuple[Names, Fit, dict[str, list[Rival]]]:
    """Put a rival in the place of an effect that fits as well, where the held-out records part
    them: fitted and held out together it must be better by the margin."""
    for name in names:
        close = [r for r in rivals[name] if r.price(current) <= MARGIN]
        if not close:
            continue
        own = predict(current.model, held, weights, search.noise).chi2
        scores = [r.price(current) + predict(r.fit.model, held, weights, search.noise).chi2
                  for r in close]
        if min(scores) >= own - MARGIN:
            continue
        better = close[scores.index(min(scores))]
        kept = {n: [replace(r, cost=r.fit.chi2 - better.fit.chi2) for r in found]
                for n, found in rivals.items() if n != name}
        kept[better.name] = [Rival(name, -better.cost, current)]
        return tuple(better.name if n == name else n for n in names), better.fit, kept
    return names, current, rivals


def _unlocked(search: Search, names: Names, current: Fit,
              dropped: dict[str, str]) -> tuple[Names, Fit]:
    """Drop a vibration at a line of the input where the model leaves more than noise: it may be
    no more than the model's own error there."""
    name = "periodic_disturbance"
    run = search.runs[0]
    if name not in names or len(names) == 1:
        return names, current
    repeated = run.periodicity or find_period(run.input)  # a measured input repeats but for noise
    if repeated is None:
        return names, current
    period = repeated.period * run.sample_period
    lines = current.model.parameters()[f"{name}.frequency"] * period
    nearest = 0.5 * period / (run.input.size * run.sample_period)
    left = findings(run, current.residuals[0][0], None)
    if abs(lines - round(lines)) > nearest or not any(f.real for f in left):
        return names, current
    dropped[name] = "stands at a line of the input, as the model's own error does"
    rest = tuple(n for n in names if n != name)
    return rest, search.fitted(rest, current)


def _bounded(search: Search, names: Names, current: Fit,
             dropped: dict[str, str]) -> tuple[Names, Fit]:
    """Drop effects of which a parameter has no interval: the fit ran to the edge of what the
    effect can be, and stands for something else there."""
    while True:
        values = current.quantities()
        for name in reversed(names):
            own = [q for address, q in values.items() if address.startswith(f"{name}.")]
            if any(q.ci95 is None or not all(map(math.isfinite, q.ci95)) for q in own):
                dropped[name] = "its parameters run to the edge of their range"
                names = tuple(n for n in names if n != name)
                current = search.fitted(names, current)
                break
        else:
            return names, current


def _held_out(search: Search, names: Names, current: Fit, held: Sequence[Experiment],
              weights: Weights, seed: int, dropped: dict[str, str]
              ) -> tuple[Names, Fit, tuple[str, ...]]:
    """Drop effects that do no better on held-out runs than their knock-offs.

    Returns what is left with its fit, and the effects that held-out runs do not exercise; of
    those found in place of dropped ones there are none: fitted records alone were wrong before.
    """
    while True:
        silent = []
        for name in names:
            seen = spoiled(current.model, name, held, weights, search.noise, seed)
            passed = seen.passed(bool(EFFECTS[name].per_run))
            if passed is None and not search.barred:
                silent.append(name)
            elif not passed:
                dropped[name] = (
                    "found second, and the held-out records do not exercise it"
                    if passed is None else "is not in the held-out data"
                    if EFFECTS[name].per_run
                    else "lowers the held-out error no more than when shifted")
                names = tuple(n for n in names if n != name)
                current = search.fitted(names, current)
                break
        else:
            return names, current, tuple(silent)
