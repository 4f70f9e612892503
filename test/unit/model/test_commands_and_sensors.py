"""Effects on the command and on the reading: against equations and closed forms of our own."""

from __future__ import annotations

import numpy as np
from stage_equations import integrate

from dfm_stage.model import Model, Simulator

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
