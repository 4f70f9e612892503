"""From a specification to records, the model its user starts from, and the label apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.corpus.measured import inputs, plant
from benchmarks.corpus.measured.effects import (
    CLOSED_LOOP,
    DOCUMENTED,
    LAGS,
    LIBRARY,
    OUTSIDE,
    Fields,
    Scales,
    with_like,
)
from benchmarks.corpus.measured.gap import (
    as_motion,
    force_parts,
    force_share,
    linear_refit,
    position_share,
)
from benchmarks.corpus.measured.nuisance import LATE, NUISANCES
from benchmarks.corpus.measured.plan import GROUPS, MeasuredSpec
from benchmarks.corpus.measured.plant import STEPS
from benchmarks.corpus.measured.stage import (
    Outcome,
    Run,
    Sensor,
    Stage,
    closed_run,
    coloured_noise,
    draw_stage,
    open_run,
    perform,
    pink,
    with_mount,
)
from benchmarks.corpus.measured.timing import (
    Columns,
    convention_of,
    convention_setup,
    logged,
)
from benchmarks.corpus.plan import class_of
from benchmarks.corpus.severity import scale_for
from benchmarks.corpus.stage import log_uniform

SHORTEST, LONGEST = 5000, 12_000
MOST_DRAWS = 25
LEAST_GAP, MOST_GAP = 3.0, 100.0
"""Gap over noise."""
MOST_NOISE = 0.01
"""Noise over RMS motion."""
LEAST_MOTION = 1e-4
"""Gap over RMS motion, below which nothing is missing."""
STRENGTH = (0.02, 0.3)
"""Of the motor's force, what an effect makes."""
BACKGROUND = 0.15
"""Share of the cases whose sensor sits on a mount, and of those with 1/f noise beside."""
COARSE = (3e-3, 3e-2)
"""Steps of a reading of low resolution over the peak motion."""
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


@dataclass
class Setup:
    """Truth: the stage, its runs, what it has beyond the model, and how it is judged.

    known: true base parameters that the model has. gap (m), share: of the fitted runs.
    """

    stage: Stage
    train: list[Run]
    held: list[Run]
    known: dict[str, float]
    effect: Fields = field(default_factory=dict)
    rest: Fields = field(default_factory=dict)
    wander: list[Any] = field(default_factory=list)
    gap: float = 0.0
    share: float = 0.0

    @property
    def runs(self) -> list[Run]:
        """Fitted and held-out runs."""
        return [*self.train, *self.held]

    @property
    def judged(self) -> str:
        """In what a gap is measured."""
        return "force" if any(run.closed for run in self.train) else "position"

    @property
    def effect_there(self) -> bool:
        """Whether an effect of the library is there beside the rest."""
        return bool(self.effect) or self.stage.base != self.known

    def left(self, outcomes: Sequence[Outcome]) -> Any:
        """What a linear refit leaves of the fitted runs (m), in a row."""
        return linear_refit(self.known, self.stage, self.train, [o.clean for o in outcomes],
                            offsets="offset" not in self.effect)

    def simulate(self, number: int, *, rest: bool = True, noise: Any = None,
                 fields: Fields | None = None) -> Outcome:
        """Run `number`, with or without the remainder."""
        run = self.runs[number]
        without = self.stage.physics(**self.effect)
        chosen = self.rest if fields is None else fields
        p = without._replace(**chosen) if rest else without
        quiet = replace(self.stage, sensor=Sensor(0.0)) if noise is None else self.stage
        silence = np.zeros(len(run.command)) if noise is None else noise
        return perform(quiet, run, p, without, silence, self.wander[number])


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


def make_setup(spec: MeasuredSpec) -> tuple[Setup, np.random.Generator]:
    """The truth of a case, noise level included, and the generator that draws its noise."""
    source = np.random.SeedSequence(spec.seed, spawn_key=(
        21, GROUPS.index(spec.group), spec.index))
    reason = ""
    for attempt in source.spawn(MOST_DRAWS):
        rng = np.random.default_rng(attempt)
        try:
            return _setup(spec, rng), rng
        except ValueError as error:
            reason = str(error)
    raise ValueError(f"case {spec.index} of seed {spec.seed} ({spec.group} {spec.effect} "
                     f"{spec.kind}): {reason}")


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


def _setup(spec: MeasuredSpec, rng: np.random.Generator) -> Setup:
    if spec.group == "convention":
        stage, run, _, effects = convention_setup(rng, spec.index)
        setup = Setup(stage, [run], [replace(open_run(
            rng, stage, run.kind, len(run.command), hold=run.hold, shift=run.shift))],
            dict(stage.base), effects)
        setup.wander = [np.zeros(len(r.command)) for r in setup.runs]
        if not math.isfinite(float(np.sum(setup.simulate(1).clean))):
            raise ValueError("the motion escapes")
        return setup
    setup = _stage_and_runs(spec, rng)
    setup.wander = [pink(rng, len(run.command)) for run in setup.runs]
    if spec.group == "nuisance":
        if spec.kind == "low_resolution":
            step = setup.stage.amplitude * log_uniform(rng, *COARSE)
            setup.stage = replace(setup.stage, sensor=replace(setup.stage.sensor,
                                                              resolution=step))
        for i in range(len(setup.runs)):
            setup.simulate(i)
        return setup
    scales = _scales(setup)
    _draw_effects(spec, setup, scales, rng)
    _set_noise(setup, rng)
    return setup


def _stage_and_runs(spec: MeasuredSpec, rng: np.random.Generator) -> Setup:
    """Open loop on a spring, or closed loop where that shows what is asked for."""
    closed = rng.random() < 0.35
    if spec.group == "remainder":
        closed = closed and spec.effect in CLOSED_LOOP and OUTSIDE[spec.kind].force
    elif spec.group == "outsider":
        closed = closed and OUTSIDE[spec.kind].force
    elif spec.kind in ("in_motion", "output_early", "output_late", "jitter_samples"):
        closed = False
    needs_spring = spec.kind in OUTSIDE and OUTSIDE[spec.kind].spring
    free = closed and not needs_spring and rng.random() < 0.5
    stage = draw_stage(rng, free=free, late=0.0 if spec.effect in LAGS else None)
    if rng.random() < BACKGROUND and not closed:
        stage = with_mount(rng, stage)
    hold = plant.HELD if closed else int(rng.choice([plant.HELD] * 7 + [plant.LINEAR] + [
        plant.BAND_LIMITED] * 2))
    samples = 100 * int(rng.integers(SHORTEST // 100, LONGEST // 100 + 1))
    sizes = [1.0, *rng.permutation([0.5, 0.3, 0.15])[:int(rng.choice([0, 0, 1, 2]))]]
    kinds = inputs.SMOOTH_KINDS if hold == plant.BAND_LIMITED else inputs.KINDS

    def draw(size: float) -> Run:
        if closed:
            return closed_run(rng, stage, samples).scaled(size)
        kind = str(rng.choice(kinds))
        return open_run(rng, stage, kind, samples, hold=hold).scaled(size)

    train = [draw(size) for size in sizes]
    if closed:
        train = [replace(run, gains=train[0].gains) for run in train]
    held = [draw(rng.uniform(0.6, 1.0))]
    if closed:
        held = [replace(held[0], gains=train[0].gains)]
    return Setup(stage, train, held, dict(stage.base))


def _scales(setup: Setup) -> Scales:
    """Of the largest fitted run of the linear stage."""
    setup.wander[0], kept = 0.0 * setup.wander[0], setup.wander[0]
    outcome = setup.simulate(0, rest=False)
    setup.wander[0] = kept
    return Scales.of(setup.stage, outcome.rows[plant.POSITION], outcome.command)


def _draw_effects(spec: MeasuredSpec, setup: Setup, scales: Scales,
                  rng: np.random.Generator) -> None:
    strength = log_uniform(rng, *STRENGTH)
    if spec.group == "outsider":
        setup.rest = OUTSIDE[spec.kind].draw(rng, scales, strength)
        return
    drawn = LIBRARY[spec.effect](rng, scales, strength)
    if spec.effect in ("transport_delay", "amplifier_bandwidth"):
        setup.stage = _late(setup.stage, drawn)
    else:
        setup.effect = drawn
    kind, source = OUTSIDE[spec.kind], int(rng.integers(2**31))
    # a remainder's amplitude goes about as the root of its share

    def fields(scale: float) -> Fields:
        return kind.draw(np.random.default_rng(source), scales, 10.0 * scale * strength)

    scale, _ = scale_for(_root_share(setup, fields), math.sqrt(spec.share))
    setup.rest = fields(scale)


def _late(stage: Stage, drawn: Fields) -> Stage:
    """The stage with a delay on the plant's grid, or a lag, that its model does not have."""
    base = dict(stage.base)
    if "delay" in drawn:
        step = stage.period / STEPS
        base["delay"] = max(round(drawn["delay"] / step), 1) * step
    else:
        base["amplifier_time_constant"] = max(drawn["lag"], 0.1 * stage.period)
    return replace(stage, base=base)


def _root_share(setup: Setup, fields: Callable[[float], Fields]) -> Callable[[float], float]:
    """Root of the remainder's share of the gap's power over the fitted runs, by scale."""
    numbers = range(len(setup.train))
    alone = [setup.simulate(i, rest=False) for i in numbers]
    without = setup.left(alone) if setup.judged == "position" else np.zeros(0)

    def root(scale: float) -> float:
        try:
            found = [setup.simulate(i, fields=fields(scale)) for i in numbers]
        except ValueError:
            return math.inf
        if setup.judged == "force":
            return math.sqrt(force_share(found))
        return math.sqrt(position_share(setup.left(found), without))

    return root


def _set_noise(setup: Setup, rng: np.random.Generator) -> None:
    """Draw the noise so that the gap is LEAST_GAP to MOST_GAP times as large; note the shares."""
    numbers = range(len(setup.train))
    found = [setup.simulate(i) for i in numbers]
    if setup.judged == "force":
        missing, rest = force_parts(found)
        if not np.any(missing):
            raise ValueError("nothing is missing")
        gap = float(np.std(as_motion(missing, setup.stage, setup.train[0])))
        setup.share = float(rest @ rest) / float(missing @ missing)
    else:
        whole = setup.left(found)
        gap = float(np.sqrt(np.mean(whole**2)))
        setup.share = position_share(whole, setup.left(
            [setup.simulate(i, rest=False) for i in numbers])) if setup.effect_there else 1.0
    motion = float(np.std(found[0].clean))
    least = max(LEAST_GAP, gap / (MOST_NOISE * motion))
    if least > MOST_GAP or gap < LEAST_MOTION * motion:
        raise ValueError("the gap is as large as the motion, or none")
    noise = gap / log_uniform(rng, least, MOST_GAP)
    old = setup.stage.sensor
    step = noise * rng.uniform(0.3, 1.5) if old.resolution > 0.0 else 0.0
    setup.stage = replace(setup.stage, sensor=Sensor(noise, old.colour, step))
    setup.gap = gap
    for i in range(len(setup.runs)):  # with its noise in the loop, and held out
        setup.simulate(i, noise=noise * rng.standard_normal(len(setup.runs[i].command)))


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

