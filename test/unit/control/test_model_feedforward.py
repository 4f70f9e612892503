"""Feedforward from a model: closed forms, the simulator, a reference of constant acceleration."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dfm_stage.control import (
    ControlError,
    EffectInput,
    Pid,
    feedforward_gains,
    inverse_of,
    law_of,
    pid_for,
    run_on_model,
    sample_model,
    tune_pid,
)
from dfm_stage.model import Model, Simulator, load_model

H = 1e-3
BASE = {"mass": 1.0, "damping": 1.7, "stiffness": 573.0, "force_constant": 1.3,
        "delay": 1.4e-3, "amplifier_time_constant": 5e-4}
MODE = {"share": 0.07, "frequency": 16.02, "damping_ratio": 0.01}
LINEAR = Model("m", H, BASE).with_effect("second_mode", MODE)
t = np.arange(4000) * H
W = 2.0 * math.pi * 1.0
RISE = np.clip(t, 0.0, 1.0)**3 * (10.0 - 15.0 * np.clip(t, 0.0, 1.0)
                                  + 6.0 * np.clip(t, 0.0, 1.0)**2)
SWING = 2.5e-3 * RISE * np.sin(W * t)
VELOCITY = np.gradient(SWING, H)
ACCELERATION = np.gradient(VELOCITY, H)


@pytest.mark.parametrize(("weight", "share"), [(1.0, 1.0), (0.6, 0.0), (0.0, 0.5)])
def test_nothing_is_left_on_a_reference_of_constant_acceleration(weight, share) -> None:
    stage = sample_model(LINEAR)
    gains = pid_for(LINEAR.base, 10.0).gains.changed(
        {"ki": 0.0, "setpoint_weight": weight, "derivative_weight": share})
    position, velocity, acceleration = feedforward_gains(stage, gains)
    pid = Pid(gains.changed({"feedforward_position": position, "feedforward_velocity": velocity,
                             "feedforward_acceleration": acceleration, "output_limit_v": 1e6}), H)
    x, error = np.zeros(stage.b.size), 0.0
    for k in range(6000):
        r, v = 0.5 * 1e-3 * (k * H)**2, 1e-3 * k * H
        error = r - float(stage.c @ x)
        x = stage.a @ x + stage.b * pid.step(r, r - error, v, 1e-3)
    assert abs(error) < 1e-10


def test_the_input_of_effects_in_closed_form() -> None:
    x, v, a = 2e-3, 0.01, 0.3
    force = a + 1.7 * v + 573.0 * x
    one = Model("m", H, BASE)
    expected = {
        ("cubic_stiffness", "k3", 1e7): 1e7 * x**3,
        ("quadratic_stiffness", "k2", 1e5): 1e5 * x**2,
        ("coulomb_friction", "force", 0.05): 0.05,
        ("force_offset", "force", 0.2): -0.2,
        ("quadratic_damping", "coefficient", 30.0): 30.0 * v * v,
        ("force_constant_slope", "slope", 20.0): force / (1.0 + 20.0 * x) - force,
        ("force_constant_droop", "droop", 3e3): force / (1.0 - 3e3 * x * x) - force,
    }
    for (name, parameter, value), newtons in expected.items():
        found = EffectInput(one.with_effect(name, {parameter: value}))
        assert found.covers == (name,)
        assert found.at(x, v, a) == pytest.approx(newtons / 1.3, rel=1e-9), name
    assert EffectInput(one.with_effect("coulomb_friction", {"force": 0.05})).at(
        x, -v, a) == pytest.approx(-0.05 / 1.3)
    assert not EffectInput(LINEAR).any
    assert EffectInput(one).ahead_s == pytest.approx(1.4e-3 + 5e-4 + 0.5 * H)


@pytest.mark.parametrize(("effects", "share"), [
    ({"cubic_stiffness": {"k3": 2e7}}, 0.05),
    ({"force_constant_slope": {"slope": 15.0}, "quadratic_damping": {"coefficient": 50.0}}, 0.1),
    ({"coulomb_friction": {"force": 0.03}, "cubic_stiffness": {"k3": 1e7}}, 0.25),
])
def test_the_inverse_moves_the_simulator_along(effects, share) -> None:
    model = LINEAR.with_parameters({"damping": 12.0})
    for name, parameters in effects.items():
        model = model.with_effect(name, parameters)
    linear = Model("l", H, model.base).with_effect("second_mode", MODE)

    def error(design: Model) -> float:
        u = inverse_of(design, SWING, VELOCITY, ACCELERATION)
        return float(np.sqrt(np.mean((Simulator(model).run(u).position - SWING)**2)))

    assert error(model) < share * error(linear)


def test_the_inverse_of_a_movement_that_repeats_does_too() -> None:
    model = Model("m", H, BASE).with_effect("cubic_stiffness", {"k3": 5e6})
    n = 1000
    s = np.arange(n) * H
    r, v, a = (2e-3 * np.sin(W * s), 2e-3 * W * np.cos(W * s), -2e-3 * W * W * np.sin(W * s))
    u = inverse_of(model, r, v, a, repeats=True)
    found = Simulator(model).run(u, steady_state=True).position
    assert np.sqrt(np.mean((found - r)**2)) < 3e-3 * 2e-3
    plain = inverse_of(Model("m", H, BASE), r, v, a, repeats=True)
    found = Simulator(model).run(plain, steady_state=True).position
    assert np.sqrt(np.mean((found - r)**2)) > 0.02 * 2e-3


def test_a_redesign_on_the_extended_model_follows_better() -> None:
    stage = load_model("raster_bench")
    real = stage.with_effect("cubic_stiffness", {"k3": 2e7}).with_effect(
        "coulomb_friction", {"force": 0.02}).with_effect("force_constant_slope", {"slope": 10.0})
    error = {}
    for name, model in (("before", stage), ("after", real)):
        tuned = tune_pid(model, model_name="given.yaml")
        assert (tuned.parameters.get("feedforward") == "model") == (name == "after")
        law, forward = law_of(tuned.parameters, model)
        y = run_on_model(real, law, SWING, VELOCITY, ACCELERATION, forward=forward)
        error[name] = np.sqrt(np.mean((y - SWING)[1000:]**2))
    assert error["after"] < 0.2 * error["before"]
    assert "coulomb_friction" in " ".join(tuned.reasons)


def test_feedforward_on_a_model_needs_its_name() -> None:
    with pytest.raises(ControlError, match="needs the model's name"):
        tune_pid(LINEAR, feedforward="inverse")
    with pytest.raises(ControlError, match="must be auto, gains"):
        tune_pid(LINEAR, feedforward="magic")


def test_an_amplifier_bandwidth_lags_behind_the_amplifier_of_the_base() -> None:
    model = LINEAR.with_effect("amplifier_bandwidth", {"time_constant": 2e-3})
    stage, u = sample_model(model), np.random.default_rng(0).normal(size=300)
    x, found = np.zeros(stage.b.size), np.empty(300)
    for k, each in enumerate(u):
        found[k] = stage.c @ x
        x = stage.a @ x + stage.b * each
    expected = Simulator(model).run(u).position
    assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))
