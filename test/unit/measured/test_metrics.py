"""Figures on recorded data against closed forms and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim, lsim

from benchmarks.measured.metrics import (
    Convention,
    acting,
    force_error,
    offset_of,
    parameter_of,
    rmse,
    simulated,
)
from dfm_stage.model import Model

T = 1e-3
STAGE = Model("stage", T, base={"mass": 2.0, "damping": 30.0, "stiffness": 9000.0,
                                "force_constant": 5.0})
BODY = (np.array([[0.0, 1.0], [-4500.0, -15.0]]), np.array([[0.0], [2.5]]),
        np.array([[1.0, 0.0]]), np.array([[0.0]]))
"""STAGE as a state space, by hand."""
CYCLES = (3, 17, 101)


def multisine(at: np.ndarray, size: int) -> np.ndarray:
    """Whole cycles in `size` samples, at times in samples."""
    return sum(np.cos(2 * np.pi * n * at / size + n) for n in CYCLES)


def test_a_band_limited_input_is_followed_between_its_samples():
    size = 2000
    fine, finer = acting(multisine(np.arange(size), size), Convention("band_limited"))
    at = (np.arange(size * finer) + 0.5) / finer
    inner = slice(200 * finer, -200 * finer)
    assert np.allclose(fine[inner], multisine(at, size)[inner], atol=2e-3)


def test_a_linear_input_lies_on_the_lines_and_an_early_column_acts_before():
    samples = np.array([0.0, 2.0, -2.0, 0.0])
    fine, finer = acting(samples, Convention("first"))
    assert fine[0] == pytest.approx(2.0 * 0.5 / finer)
    early, _ = acting(samples, Convention("zero", -1.0))
    assert early[:finer].tolist() == [2.0] * finer


def test_a_held_input_is_left_as_it_is():
    samples = np.arange(5.0)
    assert acting(samples, Convention()) == (pytest.approx(samples), 1)


def test_a_prediction_is_that_of_scipy_from_the_same_start():
    size, start = 3000, np.array([2e-3, -0.1])
    drive = multisine(np.arange(size), size)
    held = cont2discrete(BODY, T)
    _, y, _ = dlsim(held, drive, x0=start)
    columns = {"time_s": T * np.arange(size), "input_v": drive, "position_m": y[:, 0] + 0.01}
    offset = offset_of(STAGE, columns, Convention(), 50)
    assert offset == pytest.approx(0.01, rel=1e-6)
    assert rmse(STAGE, columns, Convention(), 50, offset) < 1e-9
    wrong = STAGE.with_parameters({"stiffness": 9900.0})
    assert rmse(wrong, columns, Convention(), 50, offset) > 1e-5
    assert rmse(STAGE, columns, Convention(), 50, 0.0) > 5e-3


def test_a_band_limited_record_is_predicted_only_with_its_convention():
    size = 4000
    fine = np.arange(size * 50) / 50
    _, y, _ = lsim(BODY, multisine(fine, size), T * fine)
    columns = {"input_v": multisine(np.arange(size), size), "position_m": y[::50]}
    kept = slice(300, -300)
    errors = [np.std((simulated(STAGE, columns, each, 50) - y[::50])[kept])
              for each in (Convention("band_limited"), Convention())]
    assert errors[0] < 0.05 * errors[1]


def test_inverse_dynamics_needs_the_force_that_was_applied():
    time = T * np.arange(20_000)
    slow, fast = 2 * np.pi * 0.7, 2 * np.pi * 15.0
    x = 0.1 * np.sin(slow * time) + 1e-3 * np.sin(fast * time)
    v = 0.1 * slow * np.cos(slow * time) + 1e-3 * fast * np.cos(fast * time)
    a = -0.1 * slow**2 * np.sin(slow * time) - 1e-3 * fast**2 * np.sin(fast * time)
    force = 95.0 * a + 200.0 * v + 20.0 * np.sign(v) - 3.0
    volts = force / 35.0
    # held from half a sample before on, an input has on average the value of its sample
    columns = {"input_v": np.interp(time + T / 2, time, volts), "position_m": x}
    model = Model("axis", T, base={"mass": 95.0, "damping": 200.0, "force_constant": 35.0})
    whole = model.with_effect("coulomb_friction", {"force": 20.0}).with_effect(
        "force_offset", {"force": 3.0})
    assert force_error(whole, columns, 40.0) < 1.0
    without = force_error(model, columns, 40.0)
    lost = 100 * np.linalg.norm(20.0 * np.sign(v) - 3.0) / np.linalg.norm(force)
    assert without == pytest.approx(lost, rel=0.05)
    with pytest.raises(ValueError, match="memory"):
        force_error(model.with_effect("presliding_friction", {
            "force": 20.0, "stiffness": 1e6}), columns, 40.0)


def test_the_convention_is_that_of_the_record_or_else_of_the_first():
    given = {"conventions": [
        {"record": "out/train.csv", "input_hold": "band_limited",
         "input_shift_samples": {"value": -0.5}},
        {"record": "test.csv", "input_hold": "zero", "input_shift_samples": {"value": 2.0}}]}
    assert Convention.of(given, "train") == Convention("band_limited", -0.5)
    assert Convention.of(given, "test") == Convention()  # a late column is a delay of the model
    assert Convention.of(given, "other") == Convention("band_limited", -0.5)
    assert Convention.of({}, "train") == Convention()


def test_parameters_are_found_by_address():
    given = {"base": {"mass": {"value": 1.0}},
             "effects": [{"name": "coulomb_friction", "parameters": {"force": {"value": 2.0}}}]}
    assert parameter_of(given, "mass") == {"value": 1.0}
    assert parameter_of(given, "coulomb_friction.force") == {"value": 2.0}
    assert parameter_of(given, "cubic_stiffness.k3") is None
    assert parameter_of(given, "damping") is None
