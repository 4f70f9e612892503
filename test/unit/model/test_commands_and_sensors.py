"""Effects on the command and on the reading: against equations and closed forms of our own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from stage_equations import integrate

from dfm_stage.identification import Run, fit_model
from dfm_stage.identification.convention import Drive
from dfm_stage.identification.system import System
from dfm_stage.model import Model, Plant, Simulator
from dfm_stage.model.linear import linear_part

PERIOD = 1e-3
BASE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
        "amplifier_time_constant": 7e-4, "delay": 4e-4}
STAGE = Model("test", PERIOD, BASE)


def commands(samples: int, seed: int, amplitude: float = 1.0) -> np.ndarray:
    """A random-phase multisine from 2 to 40 Hz, V."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * PERIOD
    f = np.arange(2.0, 40.0, 2.0)
    signal = np.cos(2 * np.pi * f[:, None] * t + rng.uniform(0, 6.28, (len(f), 1))).sum(axis=0)
    return amplitude * signal / np.std(signal)


def error(ours: np.ndarray, reference: np.ndarray) -> float:
    return float(np.max(np.abs(ours - reference)) / np.max(np.abs(reference)))


def test_dead_zone() -> None:
    inputs = commands(250, 1)
    ours = Simulator(STAGE.with_effect("dead_zone", {"width": 0.4})).run(inputs).position
    passed = np.sign(inputs) * np.maximum(np.abs(inputs) - 0.4, 0.0)
    states, _ = integrate(BASE, passed, PERIOD)
    assert error(ours, states[:, 0]) < 1e-7


@pytest.mark.parametrize("rate", [40.0, 150.0])
def test_slew_limit(rate: float) -> None:
    inputs = commands(250, 2)
    assert np.mean(np.abs(np.diff(inputs)) > rate * PERIOD) > 0.2
    ours = Simulator(STAGE.with_effect("slew_limit", {"rate": rate})).run(inputs).position
    states, _ = integrate({**BASE, "slew_limit.rate": rate}, inputs, PERIOD)
    # the ramp inside a sample is held at its mean: the impulse is right, the place within
    # a sample is not
    assert error(ours, states[:, 0]) < 2e-4
    finer = Simulator(replace(STAGE, sample_period=PERIOD / 4).with_effect(
        "slew_limit", {"rate": rate})).run(np.repeat(inputs, 4)).position[::4]
    assert error(finer, states[:, 0]) < 1e-5


def test_a_fit_follows_a_slewing_output_within_its_samples() -> None:
    inputs, rate = commands(400, 2), 60.0
    states, _ = integrate({**BASE, "slew_limit.rate": rate}, inputs, PERIOD)
    moved = states[:inputs.size, 0]
    near = STAGE.with_effect("slew_limit", {"rate": 0.98 * rate})
    found = fit_model(near, [Run("r", inputs, moved, PERIOD)], ["stiffness", "slew_limit.rate"])
    assert found.model.parameters()["slew_limit.rate"] == pytest.approx(rate, rel=5e-4)
    assert np.std(found.fits[0].residual) < 5e-6 * np.max(np.abs(moved))


@pytest.mark.parametrize(("steps", "taken"), [(1, 4), (2, 4), (3, 6), (4, 4)])
def test_an_input_of_several_steps_a_sample_is_split_only_as_far_as_needed(steps: int,
                                                                          taken: int) -> None:
    inputs = commands(100, 2)
    run = Run("r", inputs, np.zeros(100), PERIOD, drive=Drive(np.repeat(inputs, steps), steps))
    system = System(STAGE.with_effect("slew_limit", {"rate": 60.0}), [run], ["stiffness"])
    system.residuals(system.start)
    assert {factor for factor, _ in system._finer} == {taken}


def test_plays_of_a_piezo() -> None:
    """Against stops, which are what a play leaves of its input, at exactly those distances."""
    inputs = commands(250, 3)
    weight, widest = 0.4, 1.5
    made, stops, last = [], np.zeros(6), 0.0
    for u in inputs:
        stops = np.clip(stops + u - last, -widest * np.arange(1, 7) / 6,
                        widest * np.arange(1, 7) / 6)
        last = u
        made.append(u - weight * float(np.mean(stops)))
    model = STAGE.with_effect("prandtl_ishlinskii", {"weight": weight, "range": widest})
    states, _ = integrate(BASE, np.array(made), PERIOD)
    assert error(Simulator(model).run(inputs).position, states[:, 0]) < 1e-7


@pytest.mark.parametrize(("name", "values"), [
    ("slew_limit", {"rate": 80.0}), ("supply_sag", {"sag": 0.1, "time_constant": 0.03}),
    ("prandtl_ishlinskii", {"weight": 0.3, "range": 1.0}),
    ("stiffness_drift", {"rate": 100.0}), ("sensor_mount", {"frequency": 50.0,
                                                            "damping_ratio": 0.02}),
    ("stribeck_friction", {"force": 0.1, "sliding_ratio": 0.5, "stribeck_velocity": 1e-2})])
def test_the_plant_moves_as_the_record_does(name: str, values: dict[str, float]) -> None:
    inputs, model = commands(60, 4), STAGE.with_effect(name, values)
    whole, plant, seen = Simulator(model).run(inputs).reading, Plant(model), []
    for _ in range(2):
        plant.reset()
        seen = []
        for u in inputs:
            seen.append(plant.sample().reading_m)
            plant.advance(float(u))
    np.testing.assert_allclose(seen, whole, rtol=0, atol=2e-12)


@pytest.mark.parametrize(("name", "values"), [
    ("slew_limit", {"rate": 150.0}), ("supply_sag", {"sag": 0.1, "time_constant": 0.3}),
    ("coil_heating", {"rise": 0.1, "time_constant": 0.5}),
    ("prandtl_ishlinskii", {"weight": 0.3, "range": 1.0})])
def test_steady_state_remembers_the_periods_before(name: str, values: dict[str, float]) -> None:
    inputs, model = commands(500, 5), STAGE.with_parameters({"damping": 40.0}).with_effect(
        name, values)
    ours = Simulator(model).run(inputs, steady_state=True).position
    long = Simulator(model).run(np.tile(inputs, 12)).position[-500:]
    assert error(ours, long) < 1e-6


def test_a_constant_input_before_the_record_has_lasted_for_long() -> None:
    held = np.full(50, 2.0)
    for name, values, gain in (("supply_sag", {"sag": 0.1, "time_constant": 5.0}, 0.8),
                               ("slew_limit", {"rate": 1.0}, 1.0)):
        place = gain * BASE["force_constant"] * 2.0 / BASE["stiffness"]
        ran = Simulator(STAGE.with_effect(name, values)).run(
            held, past_input=2.0, initial={"position": place, "amplifier": gain * 2.0})
        np.testing.assert_allclose(ran.position, place, rtol=1e-9)


def test_heated_coil_settles_where_power_and_loss_balance() -> None:
    """h (1 + h) = rise u^2 after many time constants."""
    model = STAGE.with_parameters({"damping": 200.0}).with_effect(
        "coil_heating", {"rise": 0.05, "time_constant": 0.1})
    held = Simulator(model).run(np.full(9000, 3.0)).position[-1]
    hot = 0.5 * (math.sqrt(1.0 + 4.0 * 0.05 * 9.0) - 1.0)
    assert held == pytest.approx(BASE["force_constant"] * 3.0 / (1.0 + hot) / 650.0, rel=1e-6)


def test_clipping_cuts_the_reading_and_not_the_motion() -> None:
    inputs = commands(300, 6)
    ours = Simulator(STAGE.with_effect("sensor_clipping", {"limit": 4e-4, "centre": 1e-4})).run(
        inputs)
    free = Simulator(STAGE).run(inputs).position
    assert np.array_equal(ours.position, free)
    np.testing.assert_allclose(ours.reading, np.clip(free, -3e-4, 5e-4), rtol=0, atol=1e-18)
    assert np.mean(ours.reading != free) > 0.05


def test_structural_damping_loses_the_same_at_every_frequency() -> None:
    """The loss modulus of the relaxations, from the transfer function of the linear part."""
    model = Model("m", PERIOD, {"mass": 1.0, "damping": 0.0, "stiffness": 500.0})
    omega = 2.0 * np.pi * np.geomspace(0.4, 100.0, 40)
    whole = linear_part(model.with_effect("structural_damping", {"loss_stiffness": 25.0}))
    stiffness = 1.0 / whole.response(omega) + omega**2
    np.testing.assert_allclose(stiffness.imag, 25.0, rtol=0.02)
