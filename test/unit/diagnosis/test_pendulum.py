"""A pendulum without any spring: the model's stiffness ends at its lower limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import diagnose
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, INERTIA, DAMPING, WEIGHT = 2e-3, 3000, 0.02, 0.004, 0.3
MODEL = Model("pendulum", PERIOD, position_unit="rad", base={
    "mass": INERTIA, "damping": 0.005, "stiffness": 0.28, "force_constant": 1.0})


def swing(seed, angle, zero=0.0):
    """A free swing about where the encoder reads `zero`, by an independent integration."""
    time = PERIOD * np.arange(SIZE)
    x = solve_ivp(lambda _, s: [s[1], (-WEIGHT * np.sin(s[0]) - DAMPING * s[1]) / INERTIA],
                  (0.0, time[-1]), [angle, 0.0], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(SIZE)
    return Record(time, PERIOD, {"x": AxisRecord(np.zeros(SIZE), x + noise + zero,
                                                 position_unit="rad")},
                  Provenance(f"swing {seed}", "csv"))


@pytest.mark.parametrize("zero", [0.0, 0.5])
def test_a_free_swing_is_that_of_a_pendulum(zero):
    """With a longer pendulum of the same softening the spring would be below zero: the length had
    no slope and no interval, and the right name was dropped for it."""
    found = diagnose([swing(1, 2.0, zero), swing(2, 1.5, zero)], MODEL,
                     holdout=[swing(3, 1.8, zero)])
    assert found.verdict == "named"
    assert found.names == ("gravity",)
    told = found.effects[0].parameters
    assert told["weight"].covers(WEIGHT)
    assert told["length"].covers(1.0)
    assert told["length"].half_width < 0.02
