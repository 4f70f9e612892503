"""The measured-like plant against the other corpus's plant, and against scipy's integrator."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.corpus import plant as other
from benchmarks.corpus.measured.effects import DOCUMENTED, LIBRARY, OUTSIDE, Scales
from benchmarks.corpus.measured.plant import POSITION
from benchmarks.corpus.measured.stage import Run, Sensor, Stage, open_run, perform
from benchmarks.corpus.truth import plant_values

PERIOD, SAMPLES = 1e-3, 3000
BASE = {"mass": 0.8, "damping": 6.0, "stiffness": 0.8 * (2 * math.pi * 12.0) ** 2,
        "force_constant": 2.0}
STAGE = Stage(BASE, PERIOD, 1e-3, Sensor(0.0))
RUN = open_run(np.random.default_rng(3), STAGE, "multisine", SAMPLES)


def motion(stage: Stage, run: Run, **fields: float) -> np.ndarray:
    p = stage.physics(**fields)
    return perform(stage, run, p, p, np.zeros(SAMPLES)).clean


def scales() -> Scales:
    return Scales.of(STAGE, motion(STAGE, RUN), RUN.command)


@pytest.mark.parametrize("name", LIBRARY)
def test_library_effects_are_those_of_the_other_corpus(name: str) -> None:
    fields = LIBRARY[name](np.random.default_rng(1), scales(), 0.05)
    documented = {name: {theirs: fields[ours] for theirs, ours in DOCUMENTED[name].items()}}
    base = dict(BASE)
    if "lag" in fields:
        base["amplifier_time_constant"] = fields.pop("lag")
    if "delay" in fields:
        base["delay"] = round(fields.pop("delay") / PERIOD * 20) * PERIOD / 20
        documented[name]["delay"] = base["delay"]
    found = motion(replace(STAGE, base=base), RUN, **fields)
    start = np.zeros(other.STATES)
    start[[other.X1, other.CREEP]] = fields.get("offset", 0.0) / BASE["stiffness"]
    out, none = np.empty((6, SAMPLES)), np.zeros(SAMPLES)
    other.run(other.numbers(plant_values(BASE, documented)), PERIOD, 5e-5, none, RUN.command,
              np.zeros(4), none, none, np.zeros(0), start, 0.0, out)
    gap = np.std(out[2] - motion(STAGE, RUN)) + abs(np.mean(out[2]))
    assert gap > 0.0
    assert np.std(found - out[2]) < 5e-3 * gap


SMOOTH = {
    "position_damping": lambda p, t, x, v, u: -p["damping_x"] * x * v,
    "position_damping_even": lambda p, t, x, v, u: -p["damping_x2"] * x * x * v,
    "directional_damping": lambda p, t, x, v, u: -p["damping_direction"] * abs(v),
    "root_drag": lambda p, t, x, v, u: -p["root_drag"] * math.sqrt(abs(v)) * np.sign(v),
    "stiffness_drift": lambda p, t, x, v, u: -p["stiffness_rate"] * t * x,
    "odd_force_constant": lambda p, t, x, v, u: 2.0 * u * p["motor_wave"] * math.sin(
        x / p["motor_length"]),
    "load_dependent_gain": lambda p, t, x, v, u: -2.0 * u * p["soft_gain"] * abs(u),
    "dead_zone": lambda p, t, x, v, u: -2.0 * min(max(u, -p["dead_zone"]), p["dead_zone"]),
    "cogging": lambda p, t, x, v, u: p["cogging"] * math.sin(
        2 * math.pi * x / p["cogging_length"] + p["cogging_phase"]),
    "one_sided_cable": lambda p, t, x, v, u: -p["cable"] * max(x, 0.0),
    "sine_gravity": lambda p, t, x, v, u: -p["gravity"] * math.sin(x / p["gravity_length"]),
    "end_stop": lambda p, t, x, v, u: -p["stop_stiffness"] * (
        max(x - p["stop_gap"], 0.0) + min(x + p["stop_gap"], 0.0)),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_effects_outside_the_library_by_their_equations(name: str) -> None:
    p = OUTSIDE[name].draw(np.random.default_rng(1), scales(), 0.15)
    if "stop_gap" in p:
        p["stop_gap"] *= 0.1  # reached early
    samples = 400
    run = Run("part", RUN.command[:samples], np.zeros(samples))
    physics = STAGE.physics(**p)
    found = perform(STAGE, run, physics, physics, np.zeros(samples)).rows[POSITION]
    state, expected = np.zeros(2), np.zeros(samples)
    for k in range(samples):
        expected[k] = state[0]
        u = float(run.command[k])

        def slopes(t: float, y: np.ndarray, u: float = u) -> list[float]:
            force = 2.0 * u - BASE["damping"] * y[1] - BASE["stiffness"] * y[0]
            return [y[1], (force + SMOOTH[name](p, t, y[0], y[1], u)) / BASE["mass"]]

        state = solve_ivp(slopes, (k * PERIOD, (k + 1) * PERIOD), state, rtol=1e-8,
                          atol=1e-13).y[:, -1]
    gap = np.std(expected - motion(STAGE, RUN)[:samples])
    assert gap > 0.0
    assert np.std(found - expected) < 5e-3 * gap
