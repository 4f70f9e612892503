"""Effects on the command and on the reading: against equations and closed forms of our own."""

from __future__ import annotations

import numpy as np
from stage_equations import integrate

from dfm_stage.model import Model, Simulator
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
