"""From fits and predictions to one verdict, with the reasons."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.candidates import excluded
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.experiment import Experiment
from dfm_stage.diagnosis.fit import Fit, rms
from dfm_stage.diagnosis.next_experiment import next_experiment
from dfm_stage.diagnosis.remainder import Description, Finding, describe, findings
from dfm_stage.diagnosis.result import Diagnosis, Gap, NamedEffect, Rejected, Trace, Verdict
from dfm_stage.diagnosis.search import FIRST, Rival, Search
from dfm_stage.diagnosis.spectra import STEP_GRID, lattice
from dfm_stage.diagnosis.verification import SILENT, Prediction, joint, predict
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.weights import Weights
from dfm_stage.model import EFFECTS, Model

Array = NDArray[np.float64]

MARGIN = 16.0
"""Chi-square by which a rival must lose (fitted and held out together) not to be ambiguous."""
RETUNED = 60.0
"""Fall in chi-square that makes new values of the base parameters worth telling."""
FLOOR = 1.2
"""Held-out RMS over the noise floor up to which a model explains everything."""
GROSS, MOST_OF = 0.05, 0.9
"""A gap of this share of the motion, of which a model takes this share of power, is named even
where a remainder stays."""
UNSEEN = 3.0
"""Pre-sliding distance over the noise below which it is not seen."""
REST = 12.0
"""Motion over noise below which a record cannot show an effect."""
OFFSET_SIGMAS = 6.0
PARTED = ("on a linear spring a constant force and an encoder zero are the same; give "
          "encoder_zero in the model if it is known")


@dataclass(frozen=True)
class Case:
    """All that was measured, for one verdict."""

    model: Model
    runs: list[Experiment]
    held: list[Experiment]
    search: Search
    names: Names
    fit: Fit
    bare: Fit
    rivals: dict[str, list[Rival]]
    held_weights: Weights
    before: Prediction
    retuned: Prediction
    after: Prediction
    before_fit: Prediction
    dropped: Mapping[str, str]
    silent: tuple[str, ...]
    warnings: list[str]

    @property
    def floor(self) -> float:
        """RMS of the noise of the first run."""
        return self.search.weights[0][0].rms


def answer(case: Case, tell: Callable[[str], None]) -> Diagnosis:
    """Judge a case."""
    names = case.names
    left = _findings(case.runs, case.fit.residuals, case.fit.model)
    confirmed, doubts = _confirmed(case, left)
    remainder = _real(left)
    if names and not confirmed:
        left = _findings(case.runs, case.bare.residuals, case.model)
        remainder = _real(left)
    tell("judging")
    warnings = [*case.warnings, *doubts]
    members = {n: _members(case, n) for n in names}
    values = _with_values(case.fit.quantities(), case.fit.model)
    offset = _offset(case)
    verdict: Verdict
    description: Description | None = None
    if names and confirmed:
        verdict = "ambiguous" if any(len(m) > 1 for m in members.values()) else "named"
        if remainder:
            description = describe(case.runs, case.fit.residuals)
    elif remainder:
        verdict = "unknown"
        description = describe(case.runs, case.bare.residuals)
    elif _at_rest(case):
        verdict = "not_excited"
    elif offset:
        verdict = "ambiguous"
    elif _retuned(case):
        verdict = "retune"
    else:
        verdict = "none"
    effects: tuple[NamedEffect, ...] = ()
    model = case.bare.model if verdict == "retune" else case.model
    if verdict in ("named", "ambiguous") and names:
        effects = tuple(sorted((_named(case, n, members[n], values) for n in names),
                               key=lambda e: -e.chi2))
        model = case.fit.model
    elif verdict == "ambiguous":
        effects = (offset,) if offset else ()
    shown = case.fit if effects and names else case.bare
    base = values
    if shown is case.bare and names:
        base = _with_values(case.bare.quantities(), case.bare.model)
    quiet = verdict in ("none", "not_excited", "retune")
    after = case.after if shown is case.fit else case.retuned
    gap = Gap(case.runs[0].unit, case.floor, case.search.weights[0][0].source,
              (case.before_fit.rms, case.bare.rms, shown.rms),
              (case.before.rms, case.retuned.rms, after.rms))
    open_members = [m for n in names for m in members[n] if len(members[n]) > 1]
    if verdict == "ambiguous" and offset and not names:
        open_members = ["force_offset", "encoder_zero"]
    return Diagnosis(
        verdict, _sentence(verdict, effects, gap, description), effects,
        {n: q for n, q in base.items() if "." not in n}, _rejected(case, effects),
        gap, description, _next(case, verdict, open_members),
        tuple(warnings), _signed(model, effects, case), left,
        _limits(case) if quiet else {},
        _traces(case, shown))


def _next(case: Case, verdict: str, members: Sequence[str]) -> dict[str, Any] | None:
    best = case.fit.model if verdict == "ambiguous" else case.model
    members = members if verdict == "ambiguous" else ()
    rivals = [r.fit for found in case.rivals.values() for r in found if r.name in members]
    free = [case.search.parameters(rival.model) for rival in rivals]
    return next_experiment(verdict, members, best, rivals, case.runs,
                           case.search.weights[0][0], free, MARGIN, case.search.noise)


def _with_values(found: Mapping[str, Quantity], model: Model) -> dict[str, Quantity]:
    """The intervals about the values that the model has."""
    values = model.parameters()
    return {n: replace(q, value=float(values.get(n, q.value))) for n, q in found.items()}


def _findings(runs: Sequence[Experiment], residuals: Sequence[Sequence[Array]],
              model: Model) -> dict[str, list[Finding]]:
    counted = model.effect("encoder_quantization") is not None
    noise = None if counted else model.base.get("noise")
    return {run.name: findings(run, parts[0], noise)
            for run, parts in zip(runs, residuals, strict=True)}


def _real(left: Mapping[str, Sequence[Finding]]) -> bool:
    return any(f.real for each in left.values() for f in each)


def _at_floor(case: Case) -> bool:
    return case.after.rms <= FLOOR * case.floor


def _confirmed(case: Case, left: Mapping[str, Sequence[Finding]]) -> tuple[bool, list[str]]:
    """Whether held-out data and what is left over bear out the effects; and doubts."""
    if not case.names:
        return True, []
    doubts: list[str] = []
    all_names = " and ".join(case.names)
    if case.silent:
        doubts.append(f"the held-out records do not exercise {' and '.join(case.silent)}: what "
                      "is said of it rests on the fitted records")
        if case.bare.chi2 - case.fit.chi2 < 2.0 * FIRST:
            return False, doubts
    better = case.after.chi2 < case.retuned.chi2 + (SILENT if case.silent else 0.0)
    if better and _takes_most_of_a_gross_gap(case) and not _cornered(case):
        return True, doubts
    if not better:
        return False, [f"{all_names}: lowers the fitted gap, not the held-out one"]
    if _real(left):
        return False, [f"{all_names}: comes near, but leaves more than noise"]
    if _at_floor(case):
        return True, doubts
    fitted, held = joint(case.fit.model, case.search.parameters(case.fit.model), case.runs,
                         case.held, case.search.weights, case.held_weights, case.fit,
                         case.search.noise)
    if held <= FLOOR * case.floor and fitted <= 1.05 * case.fit.rms:
        doubts.append("held-out data are predicted at "
                      f"{case.after.rms / case.floor:.1f} times the noise floor, as far as the "
                      "parameters are known")
        return True, doubts
    doubts.append(f"{all_names}: explains the fitted records, but not the held-out ones")
    return False, doubts


def _takes_most_of_a_gross_gap(case: Case) -> bool:
    """In position; without a spring in velocity, since whatever small force there is drifts, and
    only against the retuned model."""
    if case.bare.system.springless:
        motion = max(float(np.std(np.diff(r.output))) for r in case.runs)
        gap, first, after = (_speed(r) for r in (
            case.bare.residuals, case.retuned.residuals, case.after.residuals))
    else:
        motion = max(float(np.std(r.output)) for r in case.runs)
        gap = min(case.bare.rms, case.before_fit.rms)
        first, after = min(case.retuned.rms, case.before.rms), case.after.rms
    return gap > GROSS * motion and 1.0 - (after / max(first, 1e-300)) ** 2 > MOST_OF


def _speed(residuals: Sequence[Sequence[Array]]) -> float:
    return rms([np.diff(parts[0]) for parts in residuals]) if residuals else math.inf


def _cornered(case: Case) -> bool:
    """Whether the fit pushed damping, stiffness or the actuator to nothing: no such stage."""
    base = case.fit.model.base
    return any(base.get(n, 1.0) <= 1e-9 * abs(case.model.base[n])
               for n in ("damping", "stiffness", "force_constant")
               if n in case.search.free and case.model.base.get(n, 0.0) != 0.0)


def _members(case: Case, name: str) -> tuple[str, ...]:
    """The effect and the rivals that the data do not part from it."""
    found = [name]
    for rival in case.rivals.get(name, ()):
        if _degenerate(rival, case.floor):
            continue
        cost = rival.price(case.fit)
        if cost > MARGIN:
            continue
        seen = predict(rival.fit.model, case.held, case.held_weights, case.search.noise)
        if cost + seen.chi2 - case.after.chi2 <= MARGIN:
            found.append(rival.name)
    return tuple(found)


def _degenerate(rival: Rival, floor: float) -> bool:
    """Whether a rival is at its own limit: bristles stiffer than can be seen are dry friction."""
    use = rival.fit.model.effect("presliding_friction")
    if rival.name != "presliding_friction" or use is None:
        return False
    return use.parameters["force"] / use.parameters["stiffness"] < UNSEEN * floor


def _named(case: Case, name: str, members: tuple[str, ...],
           values: Mapping[str, Quantity]) -> NamedEffect:
    own: dict[str, Quantity] = {}
    use = case.fit.model.effect(name)
    assert use is not None  # noqa: S101 (it was added by the search)
    for parameter, value in use.parameters.items():
        address = f"{name}.{parameter}"
        unit = case.fit.model.parameter(address).unit
        half = value * _unsure(case, address, value)
        held = Quantity(value, unit, (value - half, value + half))
        own[parameter] = replace(values.get(address, held), value=float(value))
    rest = tuple(n for n in case.names if n != name)
    without = case.search.fitted(rest, case.fit)
    loss = without.chi2 - case.fit.chi2
    share = loss / max(case.bare.chi2 - case.fit.white.size, 1.0)
    seen = predict(without.model, case.held, case.held_weights, case.search.noise)
    unit = case.runs[0].unit
    evidence = [
        f"chi-square rises by {loss:.0f} without it (limit {FIRST:g})",
        f"held-out RMS {seen.rms:.3g} {unit} without it, {case.after.rms:.3g} {unit} with it",
        f"{EFFECTS[name].meaning}: {EFFECTS[name].equation}"]
    evidence += [f"{rival.name} in its place costs {rival.cost:.0f} in chi-square"
                 for rival in case.rivals.get(name, ())[:2]]
    return NamedEffect(name, members, own, min(max(share, 0.0), 1.0), tuple(evidence), loss)


def _unsure(case: Case, address: str, value: float) -> float:
    """Half the relative interval of a parameter that was found by search and held.

    A step read off the set of values that occur is known to their own rounding over the travel;
    any other to the grid it was looked for on.
    """
    if address != "encoder_quantization.step":
        return 1e-6
    output = case.runs[0].output
    travel = max(float(np.ptp(output)), value)
    seen = lattice(output)
    if seen is not None and abs(seen / value - 1.0) < 1e-9:
        return max(1e-6, case.model.base.get("encoder_resolution", 0.0) / travel)
    return STEP_GRID * value / travel


def _offset(case: Case) -> NamedEffect | None:
    """A constant that the model does not have: a force or an encoder zero, on a linear spring."""
    system = case.bare.system
    if system.trusted or system.springless or "force_offset" not in case.search.library:
        return None
    places = [k for k, p in enumerate(system.unknowns) if p.name == "offset"]
    gram = case.bare.jacobian.T @ case.bare.jacobian
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    covariance = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-10) / np.outer(scale,
                                                                                       scale)
    values = case.bare.x[places]
    sigmas = np.sqrt(np.diag(covariance)[places])
    mean = float(np.sum(values / sigmas**2) / np.sum(sigmas**-2.0))
    spread = float(np.sum(sigmas**-2.0)) ** -0.5
    if abs(mean) < OFFSET_SIGMAS * spread or abs(mean) < 0.1 * case.floor:
        return None
    stiffness = case.bare.model.base.get("stiffness", 0.0)
    half = 1.96 * spread * stiffness
    force = mean * stiffness
    return NamedEffect(
        "force_offset", ("force_offset", "encoder_zero"),
        {"force": Quantity(force, "N", (force - half, force + half))}, 1.0,
        (f"the readings lie {mean:.3g} {case.runs[0].unit} from where the model has them",
         PARTED), (mean / spread) ** 2)


def _at_rest(case: Case) -> bool:
    moved = max(float(np.std(r.output)) for r in case.runs)
    inputs = all(float(np.ptp(r.input)) == 0.0 for r in case.runs)
    return moved < REST * case.floor or (inputs and moved < 30.0 * case.floor)


def _retuned(case: Case) -> bool:
    gain = case.before_fit.chi2 - case.bare.chi2
    return gain > RETUNED and case.before_fit.rms > 1.002 * case.bare.rms


def _limits(case: Case) -> dict[str, dict[str, Quantity]]:
    """Size that each effect would have needed to be named, with its unit."""
    found = {}
    for name, sizes in case.search.smallest.items():
        model = case.model.with_effect(name, EFFECTS[name].defaults)
        found[name] = {n: Quantity(v, model.parameter(f"{name}.{n}").unit)
                       for n, v in sizes.items()}
    return found


def _rejected(case: Case, effects: Sequence[NamedEffect]) -> tuple[Rejected, ...]:
    found: list[Rejected] = []
    named = {e.name for e in effects}
    for name, rivals in case.rivals.items():
        for rival in rivals:
            if rival.name in named:
                continue
            seen = predict(rival.fit.model, case.held, case.held_weights, case.search.noise)
            found.append(Rejected(rival.name, seen.rms,
                                  f"in place of {name}: chi-square {rival.cost:+.0f}"))
    told = {r.name for r in found} | named
    total = max(case.bare.chi2 - case.bare.white.size, 1.0)
    for name in case.search.library:
        if name in told:
            continue
        reason = excluded(name, case.model, case.bare.system.at)
        hit = case.search.hits.get(name)
        if reason is None and name in case.dropped:
            reason = case.dropped[name]
        if reason is None and name in case.names:
            reason = "explains the fitted records, but does not pass on held-out ones"
        if reason is None:
            reason = "no response that the data show" if hit is None or hit.gain <= 0.0 else (
                f"could take {min(hit.gain / total, 1.0):.0%} of the gap at best"
                if total > FIRST and hit.gain > FIRST
                else f"chi-square falls by {max(hit.gain, 0.0):.0f}, below the limit {FIRST:g}")
        found.append(Rejected(name, None, reason))
    return tuple(found)


def _sentence(verdict: str, effects: Sequence[NamedEffect], gap: Gap,
              description: Description | None) -> str:
    ratio = gap.held_out[2] / max(gap.noise_floor, 1e-300)
    names = " and ".join(e.name.replace("_", " ") for e in effects)
    if verdict == "named":
        tail = "; a remainder stays" if description is not None else ""
        return (f"The model lacks {names}: with it the held-out gap falls to {ratio:.2f} times "
                f"the noise floor{tail}.")
    if verdict == "ambiguous":
        kinds = "; ".join(" or ".join(m.replace("_", " ") for m in e.members) for e in effects)
        return f"Something is missing that these data do not tell apart: {kinds}."
    if verdict == "unknown":
        return ("The gap is real, and no effect of the library explains it on data it was not "
                "fitted to.")
    if verdict == "retune":
        return ("No physics is missing: the gap closes when the model's own parameters are "
                "re-estimated.")
    if verdict == "not_excited":
        return ("These data could not have shown a missing effect: the stage hardly moves above "
                "its noise.")
    return "Nothing is missing: what the model leaves over is noise."


def _signed(model: Model, effects: Sequence[NamedEffect], case: Case) -> Model:
    source = [r.name for r in case.runs]
    for e in effects:
        use = model.effect(e.name)
        if use is None:
            continue
        intervals = {n: _plain(q.ci95) for n, q in e.parameters.items() if q.ci95 is not None}
        model = model.with_effect(e.name, dict(use.parameters),
                                  {"diagnosed_from": source, "ci95": intervals})
    return model


def _plain(limits: tuple[float, float]) -> list[float | None]:
    return [float(v) if math.isfinite(v) else None for v in limits]


def _traces(case: Case, shown: Fit) -> tuple[Trace, ...]:
    found = []
    for i, run in enumerate(case.runs):
        before = case.before_fit.residuals[i][0] if case.before_fit.residuals else run.output * 0
        found.append(_trace(run, before, shown.residuals[i][0], False))
    after = case.after if shown is case.fit else case.retuned
    for i, run in enumerate(case.held):
        if case.before.residuals and after.residuals:
            found.append(_trace(run, case.before.residuals[i][0], after.residuals[i][0], True))
    return tuple(found)


def _trace(run: Experiment, before: Array, after: Array, held: bool) -> Trace:
    measured = run.output[run.skip:]
    return Trace(run.name, held, run.sample_period, run.time[run.skip:], measured,
                 measured - before, measured - after)
