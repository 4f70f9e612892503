"""From a specification to records, the model its user starts from, and the label apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.measured import plant
from benchmarks.corpus.measured.effects import DOCUMENTED, OUTSIDE, with_like
from benchmarks.corpus.measured.nuisance import LATE, NUISANCES
from benchmarks.corpus.measured.plan import MeasuredSpec
from benchmarks.corpus.measured.stage import Outcome, Stage, coloured_noise, pink
from benchmarks.corpus.measured.timing import Columns, convention_of, logged
from benchmarks.corpus.measured.truth import Setup, make_setup
from benchmarks.corpus.plan import class_of

EFFECT_OF = {"k3": "cubic_stiffness", "coulomb": "coulomb_friction", "drag": "quadratic_damping"}
"""Of the effects that `convention` cases have."""


@dataclass(frozen=True)
class MeasuredCase:
    """One case. Everything but `label` may be shown to a diagnosis.

    records, holdout: per run the columns time_s, input_v, position_m, with a loop reference_m;
    model: what its user starts from, as a model.yaml holds it.
    """

    spec: MeasuredSpec
    sample_period: float
    records: list[Columns]
    holdout: list[Columns]
    model: dict[str, Any]
    label: dict[str, Any]


def make_case(spec: MeasuredSpec) -> MeasuredCase:
    """The case of a specification: the same every time.

    Raises ValueError if MOST_DRAWS draws in a row gave no usable case.
    """
    setup, rng = make_setup(spec)
    runs = [_record(spec, setup, i, rng) for i in range(len(setup.runs))]
    cut = len(setup.train)
    model = _believed(spec, setup, rng)
    return MeasuredCase(spec, setup.stage.period, runs[:cut], runs[cut:], model,
                        _label(spec, setup, model))


def long_records(spec: MeasuredSpec, factor: int) -> list[Columns]:
    """Of a case in open loop, `factor` other runs for each fitted one, without noise: as much as
    a record `factor` times as long. What a fit to them gives is the pseudo-true value."""
    setup, rng = make_setup(spec)
    found = []
    for number, run in enumerate(setup.train):
        for _ in range(factor):
            setup.train[number] = run.again(rng)
            setup.wander[number] = pink(rng, len(run.command))
            found.append(logged(setup.stage, setup.train[number], setup.simulate(number)))
    return found


def _record(spec: MeasuredSpec, setup: Setup, number: int,
            rng: np.random.Generator) -> Columns:
    """The log of a run, with what happens to logs."""
    run, sensor = setup.runs[number], setup.stage.sensor
    noise = sensor.noise * coloured_noise(rng, len(run.command), sensor.colour)
    outcome = setup.simulate(number, noise=noise)
    columns = logged(setup.stage, run, outcome)
    if spec.group != "nuisance":
        return columns
    if spec.kind == "in_motion":
        first = int(rng.uniform(0.1, 0.4) * len(run.command))
        columns = {name: values[first:] for name, values in columns.items()}
        columns["time_s"] = columns["time_s"] - columns["time_s"][0]
    elif spec.kind == "jitter_samples":
        columns = _jittered(columns, outcome, setup.stage, rng)
    if spec.kind == "wrong_scale":  # one scale for all records
        rng = np.random.default_rng([spec.seed, spec.index])
    return NUISANCES[spec.kind].apply(rng, columns, sensor.noise)


def _jittered(columns: Columns, outcome: Outcome, stage: Stage,
              rng: np.random.Generator) -> Columns:
    """Sampled late, now and then, by up to a tenth of a period; the stamps say so."""
    late = np.minimum(np.abs(rng.standard_normal(len(columns["time_s"]))) * 0.03, 0.1)
    late *= stage.period
    moved = late * outcome.rows[plant.SPEED]
    moved += 0.5 * late**2 * outcome.rows[plant.ACCELERATION]
    return {**columns, "time_s": columns["time_s"] + late,
            "position_m": columns["position_m"] + moved}


def _believed(spec: MeasuredSpec, setup: Setup, rng: np.random.Generator) -> dict[str, Any]:
    """The user's model: no effects; half of the time its numbers are wrong by up to 15 %."""
    base = dict(setup.known)
    wrong = rng.random() < 0.5 if spec.group != "nuisance" else spec.kind == "retune"
    for name in ("damping", "stiffness", "force_constant"):
        change = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.15))
        if wrong and name in base:
            base[name] *= 1.0 + change
    if rng.random() < 0.5 and spec.kind in ("", "complete", "retune", *OUTSIDE):
        base["noise"] = setup.stage.sensor.noise
    resolution = setup.stage.sensor.resolution
    if resolution > 0.0 and (spec.kind != "low_resolution" or rng.random() < 0.5):
        base["encoder_resolution"] = resolution
    if spec.effect == "force_offset":
        base["encoder_zero"] = 0.0
    return {"dfm_model": 1, "name": f"measured_{spec.group}_{spec.seed}_{spec.index}",
            "sample_period": setup.stage.period, "base": base}


def _label(spec: MeasuredSpec, setup: Setup, model: dict[str, Any]) -> dict[str, Any]:
    stage = setup.stage
    expected, right, allowed, note = _expected(spec, setup)
    documented = {spec.effect: {name: _true_value(setup, f) for name, f in
                                DOCUMENTED[spec.effect].items()}} if spec.effect else {}
    early = 1.0 if spec.kind == "output_early" else 0.0
    late = 1.0 if spec.kind == "output_late" else 0.0
    conventions = [convention_of(stage, run).to_dict() for run in setup.runs]
    for convention in conventions:
        convention["input_shift_samples"] += late - early
    return {
        **spec.to_dict(), "expected": expected, "right": sorted(right),
        "allowed": sorted(with_like(right | allowed)), "note": note, "true_effects": documented,
        "plant": {**setup.effect, **setup.rest}, "true_base": stage.base,
        "noise": stage.sensor.noise, "colour": stage.sensor.colour,
        "resolution": stage.sensor.resolution, "mount": stage.mount, "gap": setup.gap,
        "gap_over_noise": setup.gap / stage.sensor.noise, "remainder_share": setup.share,
        "remainder_share_held_out": setup.held_share,
        "judged": setup.judged, "free": stage.free, "train": [r.kind for r in setup.train],
        "held_out": [r.kind for r in setup.held], "conventions": conventions,
        "model_is_true": all(model["base"].get(n) == v for n, v in setup.known.items())}


def _true_value(setup: Setup, name: str) -> float:
    if name == "lag":
        return setup.stage.base.get("amplifier_time_constant", 0.0)
    if name == "delay":
        return setup.stage.base.get("delay", 0.0)
    return setup.effect[name]


def _expected(spec: MeasuredSpec,
              setup: Setup) -> tuple[list[str], frozenset[str], frozenset[str], str]:
    """Verdicts that are right, the names of which one is asked, others that are right beside."""
    # a mount that resonates is a second mode, and far below its resonance a lag
    extra = LATE | {"second_mode"} if setup.stage.mount else frozenset()
    if spec.group == "remainder":
        beside = OUTSIDE[spec.kind]
        return ["named", "partial", "ambiguous"], class_of(spec.effect), (
            beside.relatives | beside.own | extra), beside.reason
    if spec.group == "outsider":
        kind = OUTSIDE[spec.kind]
        verdicts = ["named", "partial", "ambiguous"] if kind.own else ["unknown", "partial"]
        return verdicts, kind.own, kind.relatives | extra, kind.reason
    if spec.group == "nuisance":
        found = NUISANCES[spec.kind]
        # a model with a delay or lag of its own takes a mount's into it
        verdicts = sorted({*found.verdicts, "retune"}) if extra else list(found.verdicts)
        return verdicts, frozenset(), found.allowed | extra, found.reason
    names = [name for field, name in EFFECT_OF.items() if field in setup.effect]
    late = LATE if setup.train[0].shift > 0 else frozenset()
    right = class_of(names[0]) if names else frozenset()
    verdicts = ["named", "partial", "ambiguous"] if names else ["none", "retune"]
    if late:
        verdicts = sorted({*verdicts, "named", "ambiguous"})
    return verdicts, right, frozenset(late | extra), "late input is not to be told from a delay"
