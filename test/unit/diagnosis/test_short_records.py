"""As few as a hundred samples: a large effect shows, and none is made up."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import diagnose
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, OMEGA, ZETA, SIZE_M = 1e-2, 100, 2.0 * math.pi * 4.0, 0.03, 2e-3
MODEL = Model("stage", PERIOD, base={"mass": 1.0, "damping": 2.6 * ZETA * OMEGA,
                                     "stiffness": 1.05 * OMEGA**2, "force_constant": 1.0})
FORCES = {"none": lambda x, v: 0.0 * x,
          "cubic_stiffness": lambda x, v: -OMEGA**2 * x**3 / SIZE_M**2,
          "quadratic_damping": lambda x, v: -6.0 * ZETA * abs(v) * v / SIZE_M}


def record(seed, force):
    """A multisine of 0.5 to 10 Hz for a second, held, by an independent integration."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(SIZE)
    feed = sum(np.cos(2.0 * math.pi * f * time + rng.uniform(0.0, 2.0 * math.pi))
               for f in np.arange(0.5, 10.0, 1.0))
    feed *= 0.5 * SIZE_M * OMEGA**2 / np.std(feed)
    state, motion = np.zeros(2), []
    for u in feed:
        motion.append(state[0])
        state = solve_ivp(
            lambda _, s, u=u: [s[1], u - 2.0 * ZETA * OMEGA * s[1] - OMEGA**2 * s[0]
                               + force(s[0], s[1])],
            (0.0, PERIOD), state, rtol=1e-8, atol=1e-12).y[:, -1]
    noise = 3e-3 * np.std(motion) * rng.standard_normal(SIZE)
    return Record(time, PERIOD, {"x": AxisRecord(feed, np.array(motion) + noise)},
                  Provenance(f"run {seed}", "csv"))


@pytest.mark.parametrize("name", ["none", "cubic_stiffness", "quadratic_damping"])
@pytest.mark.parametrize("held_out", [True, False])
def test_a_hundred_samples_are_diagnosed(name, held_out):
    fitted = [record(seed, FORCES[name]) for seed in ((7, 8) if held_out else (7,))]
    found = diagnose(fitted, MODEL, holdout=[record(9, FORCES[name])] if held_out else [])
    assert found.names == (() if name == "none" else (name,))
    assert found.verdict == ("retune" if name == "none" else "named")
    assert any("100 samples are few" in each for each in found.warnings)


def test_what_few_samples_cannot_foretell_is_not_taken_for_noise():
    """A linear model leaves six tenths of the motion; a black box needs more samples."""
    runs = [record(seed, FORCES["cubic_stiffness"]) for seed in (1, 2, 3)]
    assert diagnose(runs[:2], MODEL, holdout=runs[2:]).verdict == "unknown"
