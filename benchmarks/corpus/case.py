"""From a specification to records, the model its user believes in, and the label apart."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.corpus import plant, uncommon
from benchmarks.corpus.linear import response
from benchmarks.corpus.plan import CaseSpec, class_of
from benchmarks.corpus.severity import Refit, left_by_refit, rms, scale_for
from benchmarks.corpus.stage import (
    PERIOD,
    SAMPLES,
    CaseRun,
    Stage,
    closed_loop,
    draw_runs,
    draw_stage,
    log_uniform,
    open_loop,
)
from benchmarks.corpus.truth import Draw, Parameters, draw, plant_values
from benchmarks.corpus.wide.draws import draw_uncommon
from benchmarks.corpus.wide.labels import expected_of_uncommon, left_out, said_of

FINEST, SEARCH = 50e-6, 100e-6
LINEAR_BASE = {"amplifier_bandwidth": "amplifier_time_constant", "transport_delay": "delay",
               "coil_inductance": "coil_inductance"}
NOTHING = np.zeros(0)


@dataclass(frozen=True)
class Case:
    """One blind trial. Everything but `label` may be shown to a diagnosis.

    records, holdout: per run the arrays (N,) time_s, input_v, position_m and, where there are,
    current_a, reference_m; with a neighbouring axis other_input_v and other_position_m too.
    model: what its user believes, as a model.yaml holds it; with a neighbour it has the axes x
    (which is asked about) and y. remove: effects that the library must do without.
    """

    spec: CaseSpec
    sample_period: float
    records: list[dict[str, Any]]
    holdout: list[dict[str, Any]]
    model: dict[str, Any]
    remove: tuple[str, ...]
    label: dict[str, Any]


@dataclass
class Setup:
    """Truth: a stage, its runs, the neighbour's motion, the effects, and how noise is made."""

    stage: Stage
    train: list[CaseRun]
    held: list[CaseRun]
    neighbour: Stage | None = None
    other: dict[int, tuple[Any, Any]] = field(default_factory=dict)
    effects: dict[str, Parameters] = field(default_factory=dict)
    noise: dict[int, Any] = field(default_factory=dict)
    jitter_s: float = 0.0
    lead: int = 0

    def runs(self) -> list[CaseRun]:
        """All of them; the place in this list is a run's number."""
        return [*self.train, *self.held]


@dataclass(frozen=True)
class Truth:
    """What lies behind a case: setup, the plant's rows per run, severities reached."""

    spec: CaseSpec
    setup: Setup
    outputs: list[Any]
    severities: dict[str, float]
    rng: np.random.Generator


class NoUsableDrawError(ValueError):
    """A case that cannot be made: an effect of which no size has the severity asked for."""


def make_truth(spec: CaseSpec, samples: int = SAMPLES) -> Truth:
    """Draw and simulate what a specification asks for: the same every time.

    Raises NoUsableDrawError if twelve draws in a row gave no usable case.
    """
    source = np.random.SeedSequence(spec.seed, spawn_key=(spec.stream, spec.index))
    reason = ""
    for attempt in source.spawn(12):
        rng = np.random.default_rng(attempt)
        try:
            return _attempt(spec, rng, samples)
        except ValueError as error:
            reason = str(error)
    raise NoUsableDrawError(f"case {spec.index} of seed {spec.seed} ({spec.kind}): {reason}")


def _attempt(spec: CaseSpec, rng: np.random.Generator, samples: int) -> Truth:
    setup = _setup(spec, rng, samples)
    severities = _fit_severities(spec, setup, rng)
    outputs = [perform(setup, i, setup.effects, rng) for i in range(len(setup.runs()))]
    for run, out in zip(setup.runs(), outputs, strict=True):
        peak = float(np.max(np.abs(out[4])))
        if not math.isfinite(peak) or peak > 6.0 * setup.stage.amplitude:
            raise ValueError(f"{run.kind}: the motion does not stay in its range")
    return Truth(spec, setup, outputs, severities, rng)


def make_case(spec: CaseSpec, samples: int = SAMPLES) -> Case:
    """The case of a specification, with records of so many samples: the same every time.

    Raises ValueError if twelve draws in a row gave no usable case.
    """
    return shown(make_truth(spec, samples))


def shown(truth: Truth) -> Case:
    """What is shown of a truth, and its label; call it once for a truth."""
    spec, setup, rng = truth.spec, truth.setup, truth.rng
    runs = [_record(setup, i, out, rng) for i, out in enumerate(truth.outputs)]
    cut = len(setup.train)
    remove = tuple(sorted(left_out(spec.effects[0]))) if spec.kind == "left_out" else ()
    return Case(spec, PERIOD, runs[:cut], runs[cut:], _believed(spec, setup, rng), remove,
                _label(spec, setup, truth.severities, remove))


def _setup(spec: CaseSpec, rng: np.random.Generator, samples: int) -> Setup:
    stage = draw_stage(rng, spec.effects)
    setup = Setup(stage, *draw_runs(rng, stage, samples))
    if spec.trap == "rest":
        zero = CaseRun("rest", NOTHING, np.zeros(samples))
        setup.train, setup.held = [zero], [zero]
    elif spec.trap == "feedback_noise":
        stage = Stage(stage.base, stage.amplitude, log_uniform(rng, 2e-7, 1e-6),
                      stage.current_noise)
        setup.stage = stage
        setup.train = [closed_loop(rng, stage, stage.amplitude, 0.05 * stage.amplitude,
                                   samples)]
        setup.held = [closed_loop(rng, stage, 0.6 * stage.amplitude, 0.1 * stage.amplitude,
                                  samples)]
    elif spec.trap == "free_stage":
        stage = _freed(stage)
        setup.stage = stage
        setup.train = [closed_loop(rng, stage, size * stage.amplitude, 0.1 * stage.amplitude,
                                   samples) for size in (1.0, 0.5)]
        setup.held = [closed_loop(rng, stage, 0.7 * stage.amplitude, 0.0, samples)]
    elif spec.trap == "transient":
        setup.lead = int(rng.integers(300, 3000))
    if "cross_axis_coupling" in spec.effects:
        setup.neighbour = draw_stage(rng, ())
    for i in range(len(setup.runs())):
        if setup.neighbour is not None:
            setup.other[i] = _neighbour(rng, setup.neighbour, samples)
        white = rng.standard_normal(samples)
        if spec.trap in ("coloured_noise", "feedback_noise"):
            pole = rng.uniform(0.5, 0.98)
            coloured = lfilter([1.0], [1.0, -pole], rng.standard_normal(samples + 2000))[2000:]
            white = 0.6 * white + 0.8 * coloured * math.sqrt(1.0 - pole * pole)
        setup.noise[i] = stage.noise * white
    if spec.trap == "jitter":
        motion = response(stage.base, PERIOD, setup.train[0].feed)
        speed = rms(np.gradient(motion, PERIOD))
        setup.jitter_s = min(rng.uniform(0.3, 1.0) * stage.noise / speed, 5e-5)
    return setup


def _freed(stage: Stage) -> Stage:
    """The stage without its spring: on air bearings, damped by what there is."""
    base = {name: value for name, value in stage.base.items() if name != "stiffness"}
    return Stage(base, stage.amplitude, stage.noise, stage.current_noise)


def _neighbour(rng: np.random.Generator, stage: Stage,
               samples: int) -> tuple[Any, Any]:
    """Input (N,) and true position on the fine grid of another axis that moves on its own."""
    kind = "multisine" if rng.random() < 0.5 else "scan"
    feed = open_loop(rng, stage, kind, stage.amplitude, samples).feed
    base = {n: v for n, v in stage.base.items() if n not in ("encoder_zero", "delay")}
    fine = plant.OTHER_PER_SAMPLE
    return feed, response(base, PERIOD / fine, np.repeat(feed, fine))


def perform(setup: Setup, number: int, effects: dict[str, Parameters],
            rng: np.random.Generator | None = None, finest: float = FINEST) -> Any:
    """Run experiment `number` with these effects: the rows of `plant.run`, (6, N)."""
    run = setup.runs()[number]
    values = plant_values(setup.stage.base, effects)
    p = plant.numbers(values)
    lead = setup.lead
    start, past = _start(p, values), 0.0
    feed, noise, reference = run.feed, setup.noise[number], run.reference
    if not run.closed:
        reference = np.zeros(len(feed))
    if lead:
        feed, noise, reference = (np.concatenate([a[-lead:], a]) for a in (feed, noise, reference))
    jitter = np.zeros(len(feed))
    if setup.jitter_s > 0.0 and rng is not None:
        jitter = setup.jitter_s * rng.standard_normal(len(feed))
    other = setup.other[number][1] if number in setup.other else NOTHING
    out = np.empty((6, len(feed)))
    lags = [p[plant.SECOND_LAG],
            p[plant.INDUCTANCE] / p[plant.RESISTANCE] if p[plant.RESISTANCE] > 0.0 else 0.0]
    finest = min([finest, *(0.5 * lag for lag in lags if lag > 0.0)])
    plant.run(p, PERIOD, max(finest, 2e-7), reference, feed, run.gains, noise, jitter, other,
              start, past, out)
    return out[:, lead:]


def _start(p: Any, values: dict[str, float]) -> Any:
    """The stage at rest where its constant force holds it, shaken as long before as after."""
    start = np.zeros(plant.STATES)
    if "offset" in values:
        start[plant.X1] = values["offset"] / values["stiffness"]
    if p.size > plant.COMMON:
        start[plant.X1] += uncommon.at_rest(p[plant.COMMON:], values["stiffness"])
    start[plant.CREEP] = start[plant.X1]
    if p[plant.SHAKE] != 0.0 and p[plant.COULOMB] == 0.0:
        w = 2.0 * math.pi * p[plant.SHAKE_HZ]
        turning = p[plant.SHAKE] * np.exp(1j * (p[plant.SHAKE_PHASE] - 0.5 * math.pi)) / (
            p[plant.STIFFNESS] - p[plant.MASS] * w * w + 1j * w * p[plant.DAMPING])
        start[plant.X1] += turning.real
        start[plant.V1] += (1j * w * turning).real
    return start


def _fit_severities(spec: CaseSpec, setup: Setup, rng: np.random.Generator) -> dict[str, float]:
    """Scale each effect until it alone has the severity asked for; fills setup.effects."""
    target, found = spec.severity, {}
    names = spec.effects
    if spec.trap == "weak":
        names = (str(rng.choice(["cubic_stiffness", "quadratic_damping", "saturation",
                                 "force_constant_droop", "force_constant_slope"])),)
        target = 10.0
    for name in names:
        largest = perform(setup, 0, {}, finest=SEARCH)
        drawing = draw_uncommon if name in uncommon.PARAMETERS else draw
        drawn = drawing(name, rng, setup.stage, largest[4], largest[0])
        by_scale = _linear_severity if name in LINEAR_BASE else _severity
        scale, value = scale_for(by_scale(setup, drawn), target)
        setup.effects[name] = drawn.of(scale)
        found[name] = value
    if spec.trap == "weak":
        few = rng.uniform(0.005, 0.02)
        setup.train, setup.held = ([_smaller(run, few) for run in runs]
                                   for runs in (setup.train, setup.held))
        found = {}
    return found


def _smaller(run: CaseRun, factor: float) -> CaseRun:
    return CaseRun(run.kind, factor * run.reference, factor * run.feed, run.gains)


def _severity(setup: Setup, drawn: Draw) -> Callable[[float], float]:
    """Severity by scale, over the training runs together: of the reading over its noise, and of
    back-EMF with a current record, of the current over its noise."""
    stage = setup.stage
    trusted = "encoder_zero" in stage.base
    numbers = range(len(setup.train))
    kept: list[Refit] = []

    def severity(scale: float) -> float:
        parameters = drawn.of(scale)
        outs = [perform(setup, i, {drawn.name: parameters}, finest=SEARCH) for i in numbers]
        if not all(np.all(np.isfinite(out)) for out in outs):
            return math.inf
        if drawn.name == "back_emf" and stage.current_noise is not None:
            # a refit of the damping hides it in the position; the current shows it
            scale_a = parameters["constant"] / stage.base["coil_resistance"]
            return scale_a * rms(np.concatenate([o[5] for o in outs])) / stage.current_noise
        if not kept or any(run.closed for run in setup.train):
            kept[:] = [Refit.of(stage.base, PERIOD, [out[0] for out in outs], not trusted)]
        if drawn.name == "encoder_quantization":
            seen = [out[1] - setup.noise[i] for i, out in enumerate(outs)]
        else:
            seen = [out[2] for out in outs]
        if not refitted(drawn.name, stage):
            return rms(kept[0].before(seen)) / stage.noise
        return rms(left_by_refit(stage.base, PERIOD, [out[0] for out in outs], seen, not trusted)
                   ) / stage.noise

    return severity


def _linear_severity(setup: Setup, drawn: Draw) -> Callable[[float], float]:
    """The same for effects that leave the stage linear: by matrix exponentials, on the inputs
    as they are without the effect."""
    stage = setup.stage
    commands = [perform(setup, i, {}, finest=SEARCH)[0] for i in range(len(setup.train))]
    field = LINEAR_BASE[drawn.name]

    def severity(scale: float) -> float:
        base = dict(stage.base)
        base[field] = base.get(field, 0.0) + next(iter(drawn.of(scale).values()))
        return rms(left_by_refit(stage.base, PERIOD, commands, [
            response(base, PERIOD, u) for u in commands], "encoder_zero" not in stage.base)
                   ) / stage.noise

    return severity


def refitted(name: str, stage: Stage) -> bool:
    """Whether severity is measured after the refit: not for what the refit absorbs by nature."""
    return name != "back_emf" and (name != "force_offset" or "encoder_zero" in stage.base)


def _record(setup: Setup, number: int, out: Any, rng: np.random.Generator) -> dict[str, Any]:
    run, stage = setup.runs()[number], setup.stage
    record = {"time_s": PERIOD * np.arange(out.shape[1]), "input_v": out[0].copy(),
              "position_m": out[1].copy()}
    if stage.current_noise is not None:
        record["current_a"] = out[3] + stage.current_noise * rng.standard_normal(out.shape[1])
    if run.closed:
        record["reference_m"] = run.reference.copy()
    if number in setup.other and setup.neighbour is not None:
        feed, position = setup.other[number]
        record["other_input_v"] = feed.copy()
        record["other_position_m"] = (position[::plant.OTHER_PER_SAMPLE]
                                      + setup.neighbour.noise * rng.standard_normal(out.shape[1]))
    return record


def _believed(spec: CaseSpec, setup: Setup, rng: np.random.Generator) -> dict[str, Any]:
    """The user's model: no effects; its numbers wrong where the kind says so."""
    base = dict(setup.stage.base)
    judged = ["damping", "stiffness", "force_constant"]
    if spec.kind == "retune":
        for name in rng.permutation(judged)[:int(rng.integers(1, 4))]:
            base[name] *= 1.0 + float(rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.2))
    elif spec.kind in ("effect", "pair", "left_out") and rng.random() < 0.5:
        for name in judged:
            base[name] *= 1.0 + float(rng.uniform(-0.15, 0.15))
    if rng.random() < 0.5:
        base["noise"] = setup.stage.noise
    head = {"dfm_model": 1, "name": f"case_{spec.seed}_{spec.index}", "sample_period": PERIOD}
    if setup.neighbour is None:
        return {**head, "base": base}
    other = {n: v for n, v in setup.neighbour.base.items() if n != "delay"}
    return {**head, "axes": {"x": {"base": base}, "y": {"base": other}}}


def _label(spec: CaseSpec, setup: Setup, severities: dict[str, float],
           remove: tuple[str, ...]) -> dict[str, Any]:
    expected, group, note = _expected(spec, setup)
    return {
        "index": spec.index, "seed": spec.seed, "kind": spec.kind, "trap": spec.trap,
        "expected": expected, "effects": list(spec.effects), "class": group,
        "severity": spec.severity, "severities": severities, "removed": list(remove),
        "true_effects": setup.effects, "true_base": setup.stage.base,
        "noise": setup.stage.noise, "current_noise": setup.stage.current_noise,
        "jitter_s": setup.jitter_s, "train": [run.kind for run in setup.train],
        "held_out": [run.kind for run in setup.held], "note": note, **said_of(spec)}


def _expected(spec: CaseSpec, setup: Setup) -> tuple[list[str], list[str], str]:
    """Verdicts that are right, the class that may be named as ambiguous, and why."""
    if spec.effects and spec.effects[0] in uncommon.PARAMETERS:
        return expected_of_uncommon(spec, setup.stage)
    if spec.kind == "left_out":
        return ["unknown"], [], "the effect's class is not in the library"
    if spec.kind == "retune":
        return ["retune"], [], ""
    if spec.trap == "rest":
        return ["not_excited"], [], "no input: nothing can be seen"
    if spec.trap == "weak":
        return ["none", "not_excited"], [], "the motion is too small to show the effect"
    if spec.kind in ("none", "trap"):
        return ["none"], [], ""
    if spec.kind == "effect":
        name = spec.effects[0]
        if name == "back_emf" and setup.stage.current_noise is None:
            return ["retune"], [], "without a current record back-EMF is viscous damping"
        if name == "force_offset" and "encoder_zero" not in setup.stage.base:
            return ["ambiguous"], ["force_offset", "encoder_zero"], (
                "on a linear spring a constant force is an encoder zero")
        return ["named"], sorted(class_of(name)), ""
    return ["named"], [], ""
