"""Where an effect begins in the place of another, and the noise of fits in windows."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.diagnosis.candidates import starts
from dfm_stage.diagnosis.effect_fits import first_weights, quiet_weights
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.same_motion import most_alike
from dfm_stage.identification.weights import white_weights
from dfm_stage.model import EFFECTS, Model, Simulator
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, NOISE = 1e-3, 4000, 1e-7
TIME = PERIOD * np.arange(SIZE)
STAGE = Model("s", PERIOD, {"mass": 1.0, "damping": 4.0, "stiffness": 2000.0,
                            "force_constant": 1.0})


def fitted(model, free):
    """A model fitted to a record of itself, with noise."""
    rng = np.random.default_rng(3)
    u = 2.0 * sum(np.sin(2.0 * np.pi * f * TIME + p)
                  for f, p in zip((2.25, 5.5, 7.0, 9.75), rng.uniform(0.0, 6.0, 4), strict=True))
    x = Simulator(model).run(u).position + NOISE * rng.standard_normal(SIZE)
    run = observe(Record(TIME, PERIOD, {"x": AxisRecord(u, x)}, Provenance("run", "csv")), STAGE)
    parts = white_weights([[NOISE * rng.standard_normal(SIZE - run.skip)]])
    found = fit(model, [run], free, parts)
    return found, [run]


def share_of(shape, force, base):
    """How much of a `shape` (N,) is in a `force` (N,), beside what the `base` (N,) can do."""
    return np.linalg.lstsq(np.column_stack((shape, base)), force, rcond=None)[0][0]


def test_a_pendulum_begins_with_what_a_softening_spring_gives_beside_the_base() -> None:
    found, runs = fitted(STAGE.with_effect("cubic_stiffness", {"k3": -4e5}), ("stiffness",))
    begun = most_alike("gravity", ["cubic_stiffness"], found, runs, NOISE)
    x = runs[0].output
    assert begun["weight"] == pytest.approx(
        share_of(-np.sin(x / begun["length"]), 4e5 * x**3, x), rel=0.03)


def test_a_stribeck_curve_begins_with_what_dry_friction_gives_beside_the_base() -> None:
    found, runs = fitted(STAGE.with_effect("coulomb_friction", {"force": 0.02}), ("damping",))
    begun = most_alike("stribeck_friction", ["coulomb_friction"], found, runs, NOISE)
    v = np.gradient(runs[0].output, PERIOD)
    curve = begun["sliding_ratio"] + (1.0 - begun["sliding_ratio"]) * np.exp(
        -np.abs(v / begun["stribeck_velocity"]) ** begun["exponent"])
    expected = share_of(curve * np.sign(v), 0.02 * np.sign(v), v)
    assert begun["force"] == pytest.approx(expected, rel=0.25)  # resonant motion counts more


def test_an_effect_without_a_size_begins_at_its_first_point() -> None:
    found, runs = fitted(STAGE.with_effect("coulomb_friction", {"force": 0.02}), ("damping",))
    begun = most_alike("encoder_quantization", ["coulomb_friction"], found, runs, NOISE)
    points = starts("encoder_quantization", found.system.at)
    assert begun == next(iter(points), EFFECTS["encoder_quantization"].defaults)


def window_fit(window, jump=0.1, drifts=False):
    """A fit whose residual jumps every 200 samples, of a motion measured with a noise of 1e-5."""
    rng = np.random.default_rng(5)
    noise = 1e-5 * rng.standard_normal(SIZE)
    residual = noise + jump * (np.arange(SIZE) // 200 % 2)
    run = SimpleNamespace(window=window, skip=0,
                          compared={"position": np.sin(5.0 * TIME) + noise})
    return SimpleNamespace(residuals=[[residual]],
                           system=SimpleNamespace(runs=[run], drifts=drifts))


def test_jumps_from_window_to_window_are_no_noise() -> None:
    jumping = white_weights(window_fit(200).residuals)[0][0].rms
    assert jumping > 3e-5
    assert quiet_weights(window_fit(200))[0][0].rms == pytest.approx(1e-5, rel=0.05)
    assert quiet_weights(window_fit(200, 0.0))[0][0].rms == pytest.approx(1e-5, rel=0.05)
    assert quiet_weights(window_fit(0))[0][0].rms == jumping  # no window, no jump: a disturbance


def test_a_body_that_drifts_is_weighed_by_its_change() -> None:
    assert first_weights(window_fit(200))[0][0].order == 0
    assert first_weights(window_fit(200, drifts=True))[0][0].order == 1
