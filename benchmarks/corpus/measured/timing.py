"""Records whose timing is to be found: the groups `held` and `convention`.

    from benchmarks.corpus.measured import convention_record, held_record
    record, truth = held_record(index=7, seed=1)

A record is arrays (N,) time_s, input_v, position_m, with a loop reference_m; with its sample
period it is all that is shown. The truth says by which convention it was made.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.corpus.measured import inputs
from benchmarks.corpus.measured.plant import BAND_LIMITED, HELD, LINEAR, STEPS
from benchmarks.corpus.measured.stage import (
    Outcome,
    Run,
    Stage,
    closed_run,
    coloured_noise,
    draw_stage,
    open_run,
    perform,
    with_mount,
)
from benchmarks.corpus.stage import log_uniform

Columns = dict[str, Any]
HOLD_NAMES = {HELD: "zero", LINEAR: "first", BAND_LIMITED: "band_limited"}
FOUND_BELOW = 0.2
"""Lag and delay together, in samples, below which a convention must be found (the issue)."""
HOLD_TOLD = 100.0
"""Chi-square from which the kind of hold is asked for; below, only how late the input acts."""
MOST_DRAWS = 20
HELD_KINDS = ("linear", "linear", "coulomb", "cubic", "second_mode", "closed", "free", "quantised",
              "coloured", "damped")
SHIFTS = (-1.0, -0.5, 0.0, 0.0, 0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Convention:
    """How a record was made, as `conventions` of diagnosis.json has it.

    shift: the value that acts at t_k is column(t_k - shift T), samples; late: lag and delay of
    the plant, samples; told: by how much (chi-square) the next best kind of hold explains the
    noise-free linear record worse.
    """

    hold: str
    shift: float
    late: float
    told: float

    @property
    def must_be_found(self) -> bool:
        """Whether it can be told from a lag at all: a column that is late is a delay, too."""
        return self.late + max(self.shift, 0.0) < FOUND_BELOW

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a file."""
        return {"input_hold": self.hold, "input_shift_samples": self.shift,
                "late_samples": self.late, "must_be_found": self.must_be_found,
                "hold_told": self.told, "hold_must_be_found": self.told >= HOLD_TOLD}


def held_record(index: int, seed: int) -> tuple[Columns, dict[str, Any]]:
    """A record of a held input, with whatever else may be there: any correction is false.

    Raises ValueError if MOST_DRAWS draws gave no usable record.
    """
    kind = HELD_KINDS[index % len(HELD_KINDS)]
    for rng in _draws(seed, 11, index):
        try:
            stage, run, effects = _held(rng, kind)
            samples = len(run.command)
            noise = stage.sensor.noise * coloured_noise(rng, samples, stage.sensor.colour)
            p = stage.physics(**effects)
            columns = logged(stage, run, perform(stage, run, p, stage.physics(), noise))
        except ValueError:
            continue
        return columns, {"group": "held", "kind": kind, "index": index, "seed": seed,
                         "sample_period": stage.period, "input": run.kind, "input_hold": "zero",
                         "input_shift_samples": 0.0, "late_samples": stage.late,
                         "effects": effects, "base": stage.base, "noise": stage.sensor.noise}
    raise ValueError(f"held record {index} of seed {seed}: no usable draw")


def convention_record(index: int, seed: int) -> tuple[Columns, dict[str, Any]]:
    """A record of a stage by any convention, alone or with one effect.

    Raises ValueError if MOST_DRAWS draws gave no usable record.
    """
    for rng in _draws(seed, 12, index):
        try:
            stage, run, kind, effects = convention_setup(rng, index)
            noise = stage.sensor.noise * coloured_noise(rng, len(run.command),
                                                        stage.sensor.colour)
            outcome = perform(stage, run, stage.physics(**effects), stage.physics(), noise)
        except ValueError:
            continue
        truth = convention_of(stage, run)
        return logged(stage, run, outcome), {
            "group": "convention", "kind": kind, "index": index, "seed": seed,
            "sample_period": stage.period, "input": run.kind, **truth.to_dict(),
            "effects": effects, "base": stage.base, "noise": stage.sensor.noise}
    raise ValueError(f"convention record {index} of seed {seed}: no usable draw")


def convention_setup(rng: np.random.Generator,
                     index: int) -> tuple[Stage, Run, str, dict[str, float]]:
    """Stage, run, kind and effects: a third of the records without lag, half with an effect."""
    hold = (HELD, LINEAR, BAND_LIMITED, BAND_LIMITED)[index % 4]
    late = (0.0, 0.19, 1.0)[(index // 4) % 3]
    stage = draw_stage(rng, late=late)
    if late == 1.0 and rng.random() < 0.2:
        stage = with_mount(rng, stage)
    shift = float(rng.choice(SHIFTS))
    if rng.random() < 0.3:
        shift = float(rng.integers(-STEPS, 2 * STEPS + 1)) / STEPS
    if hold == BAND_LIMITED and rng.random() < 0.5:
        shift = 0.0
    kinds = inputs.SMOOTH_KINDS if hold == BAND_LIMITED else inputs.KINDS
    samples = 100 * int(rng.integers(40, 121))
    run = open_run(rng, stage, str(rng.choice(kinds)), samples, hold=hold,
                   shift=round(shift * STEPS))
    kind = str(rng.choice(["complete", "complete", "cubic", "coulomb", "damped"]))
    return stage, run, kind, simple_effect(rng, stage, kind)


def convention_of(stage: Stage, run: Run) -> Convention:
    """The truth about a run's record."""
    return Convention(HOLD_NAMES[run.hold], run.shift / STEPS, stage.late, hold_told(stage, run))


def simple_effect(rng: np.random.Generator, stage: Stage, kind: str) -> dict[str, float]:
    """Parameters of an effect of 1 to 30 % of the stage's own forces."""
    x, m = stage.amplitude, stage.base["mass"]
    w = 2.0 * math.pi * stage.natural / stage.period
    force = m * w * w * x * log_uniform(rng, 0.01, 0.3)
    if kind == "cubic":
        return {"k3": force / x**3}
    if kind == "coulomb":
        return {"coulomb": 0.1 * force}
    if kind == "damped":
        return {"drag": force / (w * x) ** 2}
    if kind == "second_mode":
        return {"share": log_uniform(rng, 0.005, 0.1), "mode_zeta": log_uniform(rng, 0.003, 0.03),
                "mode_hz": stage.natural / stage.period * rng.uniform(1.6, 5.0)}
    return {}


def _held(rng: np.random.Generator, kind: str) -> tuple[Stage, Run, dict[str, float]]:
    stage = draw_stage(rng, free=kind == "free")
    sensor = stage.sensor
    if kind == "quantised":
        sensor = replace(sensor, resolution=stage.amplitude * log_uniform(rng, 1e-4, 1e-2))
    elif kind == "coloured":
        sensor = replace(sensor, colour=rng.uniform(0.5, 1.0),
                         noise=stage.amplitude * log_uniform(rng, 1e-4, 1e-2))
    elif kind == "linear":
        sensor = replace(sensor, noise=stage.amplitude * log_uniform(rng, 1e-5, 1e-1))
    stage = replace(stage, sensor=sensor)
    if kind != "second_mode" and rng.random() < 0.1:
        stage = with_mount(rng, stage)
    samples = 100 * int(rng.integers(30, 121))
    if kind in ("closed", "free"):
        run = closed_run(rng, stage, samples)
        effects = simple_effect(rng, stage, str(rng.choice(["none", "coulomb", "cubic"])))
    else:
        run = open_run(rng, stage, str(rng.choice(inputs.KINDS)), samples)
        effects = simple_effect(rng, stage, kind)
    if stage.free:
        effects.pop("k3", None)
    return stage, run, effects


def _draws(seed: int, group: int, index: int) -> list[np.random.Generator]:
    source = np.random.SeedSequence(seed, spawn_key=(group, index))
    return [np.random.default_rng(child) for child in source.spawn(MOST_DRAWS)]


def logged(stage: Stage, run: Run, outcome: Outcome) -> Columns:
    """The columns of a record."""
    columns = {"time_s": stage.period * np.arange(len(run.command)),
               "input_v": outcome.command.copy(), "position_m": outcome.seen.copy()}
    if run.closed:
        columns["reference_m"] = run.reference.copy()
    return columns


def hold_told(stage: Stage, run: Run) -> float:
    """Chi-square by which the best other kind of hold explains the noise-free record of the
    linear stage worse, at its best delay, gain, stiffness and damping (one linear step); 0 in
    closed loop, where the input is always held and nothing else is asked.

    Between samples the kinds differ by the filter that makes the input from them: sinc for a held
    one, sinc squared for a linear one, none below half the rate for a band-limited one; images
    above half the rate are left out, as the stage hardly follows them.
    """
    if run.closed:
        return 0.0
    n = len(run.command)
    spectrum = np.fft.rfft(run.command)
    f = np.arange(spectrum.size) / n
    s = 2j * math.pi * np.maximum(f, 0.5 / n) / stage.period
    base = stage.base
    compliance = 1.0 / (base["mass"] * s * s + base["damping"] * s + base.get("stiffness", 0.0))
    motion = spectrum * base["force_constant"] * compliance
    shapes = {HELD: np.sinc(f) * np.exp(-1j * math.pi * f), LINEAR: np.sinc(f) ** 2,
              BAND_LIMITED: np.ones_like(f)}
    wanted = shapes[run.hold] * motion
    best = math.inf
    for hold, shape in shapes.items():
        if hold == run.hold:
            continue
        lateness = 0.5 * ((run.hold == HELD) - (hold == HELD))
        other = shape * motion * np.exp(-2j * math.pi * f * lateness)
        columns = np.stack([other, 1j * f * other, compliance * other, s * compliance * other], 1)
        columns = np.vstack([columns.real, columns.imag])
        columns /= np.linalg.norm(columns, axis=0)
        target = np.concatenate([wanted.real, wanted.imag])
        left = target - columns @ np.linalg.lstsq(columns, target, rcond=1e-12)[0]
        best = min(best, 2.0 / n * float(left @ left))
    return best / stage.sensor.noise**2


__all__ = ["Convention", "convention_record", "held_record"]
