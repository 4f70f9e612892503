"""The truth of a case: its stage, its runs, what it has beyond the model, and its noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.corpus.measured import inputs, plant
from benchmarks.corpus.measured.effects import CLOSED_LOOP, LAGS, LIBRARY, OUTSIDE, Fields, Scales
from benchmarks.corpus.measured.gap import (
    as_motion,
    force_parts,
    force_share,
    linear_refit,
    position_share,
)
from benchmarks.corpus.measured.plan import GROUPS, MeasuredSpec
from benchmarks.corpus.measured.plant import STEPS
from benchmarks.corpus.measured.stage import (
    Outcome,
    Run,
    Sensor,
    Stage,
    closed_run,
    draw_stage,
    open_run,
    perform,
    pink,
    with_mount,
)
from benchmarks.corpus.measured.timing import convention_setup
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


@dataclass
class Setup:
    """Truth: the stage, its runs, what it has beyond the model, and how it is judged.

    known: true base parameters that the model has. gap (m) and the remainder's share of its power
    are of the fitted runs, held_share of those held out.
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
    held_share: float = 0.0

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

    @property
    def fitted(self) -> range:
        """Numbers of the fitted runs."""
        return range(len(self.train))

    @property
    def held_out(self) -> range:
        """Numbers of the runs held out."""
        return range(len(self.train), len(self.runs))

    def left(self, numbers: range, outcomes: Sequence[Outcome]) -> Any:
        """What a linear refit leaves of some runs (m), in a row."""
        return linear_refit(self.known, self.stage, [self.runs[i] for i in numbers],
                            [o.clean for o in outcomes], offsets="offset" not in self.effect)

    def share_of(self, numbers: range) -> float:
        """The remainder's share of the gap's power over some runs."""
        found = [self.simulate(i) for i in numbers]
        if self.judged == "force":
            return force_share(found)
        if not self.effect_there:
            return 1.0
        return position_share(self.left(numbers, found), self.left(
            numbers, [self.simulate(i, rest=False) for i in numbers]))

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
    numbers = setup.fitted
    alone = [setup.simulate(i, rest=False) for i in numbers]
    without = setup.left(numbers, alone) if setup.judged == "position" else np.zeros(0)

    def root(scale: float) -> float:
        try:
            found = [setup.simulate(i, fields=fields(scale)) for i in numbers]
        except ValueError:
            return math.inf
        if setup.judged == "force":
            return math.sqrt(force_share(found))
        return math.sqrt(position_share(setup.left(numbers, found), without))

    return root


def _set_noise(setup: Setup, rng: np.random.Generator) -> None:
    """Draw the noise so that the gap is LEAST_GAP to MOST_GAP times as large; note the shares."""
    found = [setup.simulate(i) for i in setup.fitted]
    if setup.judged == "force":
        missing, _ = force_parts(found)
        if not np.any(missing):
            raise ValueError("nothing is missing")
        gap = float(np.std(as_motion(missing, setup.stage, setup.train[0])))
    else:
        gap = float(np.sqrt(np.mean(setup.left(setup.fitted, found) ** 2)))
    motion = float(np.std(found[0].clean))
    least = max(LEAST_GAP, gap / (MOST_NOISE * motion))
    if least > MOST_GAP or gap < LEAST_MOTION * motion:
        raise ValueError("the gap is as large as the motion, or none")
    noise = gap / log_uniform(rng, least, MOST_GAP)
    old = setup.stage.sensor
    step = noise * rng.uniform(0.3, 1.5) if old.resolution > 0.0 else 0.0
    setup.stage = replace(setup.stage, sensor=Sensor(noise, old.colour, step))
    setup.gap, setup.share = gap, setup.share_of(setup.fitted)
    setup.held_share = setup.share_of(setup.held_out)
    for i in range(len(setup.runs)):  # with its noise in the loop, and held out
        setup.simulate(i, noise=noise * rng.standard_normal(len(setup.runs[i].command)))
