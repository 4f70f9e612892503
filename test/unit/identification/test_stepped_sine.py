"""Stepped sine and the fits to it against a stage simulated by SciPy alone."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification import LinearPlant, Mode, Quantity
from dfm_stage.identification.constrained_fit import _response, fit_constrained
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.stepped_sine import segments_in, stepped_sine_response

DT = 1e-3
FREQUENCIES = (60.0, 30.0, 15.0, 8.0, 5.0, 4.2, 3.9, 3.7, 3.0, 2.0, 1.0)
SETTLE, MEASURE = 500, 1000


def excited(frequencies=FREQUENCIES, amplitude=0.08):
    volts, segments, phase = [], [], 0.0
    for i, f in enumerate(frequencies):
        k = np.arange(SETTLE + MEASURE)
        volts.append(amplitude * np.sin(phase + 2 * np.pi * f * DT * k))
        phase += 2 * np.pi * f * DT * k.size
        first = i * k.size
        segments.append((f, first + SETTLE, first + k.size))
    return np.concatenate(volts), segments


@pytest.fixture(scope="module")
def record():
    def make(stage, noise=5e-8, seed=0, **kwargs):
        volts, segments = excited(**kwargs)
        rng = np.random.default_rng(seed)
        _, y = stage.simulate(volts, noise=noise * rng.standard_normal(volts.size))
        return volts, y, segments
    return make


def test_response_while_the_stage_still_rings(reference_stage, record):
    stage = reference_stage()
    volts, y, segments = record(stage)
    found = stepped_sine_response(volts, y, DT, segments)
    truth = stage.response(found.omega)
    deviation = np.abs(found.response - truth) / np.sqrt(found.variance)
    assert np.max(deviation) < 4.0
    assert np.max(np.abs(found.response / truth - 1.0)[:9]) < 1e-3
    # Without taking the free motion out it would not do.
    naive = stepped_sine_response(volts, y, DT, segments, modes=0)
    assert np.max(np.abs(naive.response / truth - 1.0)) > 0.05


def test_two_modes_that_ring(reference_stage, record):
    stage = reference_stage(second=(0.07, 16.0, 0.01))
    frequencies = (60.0, 30.0, 20.0, 16.5, 16.0, 15.5, 12.0, 8.0, 5.0, 4.2, 3.9, 3.7, 3.0, 1.5)
    volts, y, segments = record(stage, frequencies=frequencies)
    found = stepped_sine_response(volts, y, DT, segments)
    truth = stage.response(found.omega)
    assert np.max(np.abs(found.response - truth) / np.sqrt(found.variance)) < 5.0


@pytest.mark.parametrize(("lag", "delay"), [(1e-3, 1e-3), (2.3e-3, 1.7e-3), (0.0, 0.4e-3)])
def test_partial_fractions_agree_with_the_matrix_exponential(lag, delay):
    omega = 2 * np.pi * np.array(FREQUENCIES)
    plant = LinearPlant((Mode(1.0, 1.705, 600.7),), lag, delay)
    ours = _response(np.array([1.0, 1.705, 600.7, lag, delay]), omega, DT)
    assert np.allclose(ours, plant.sampled_response(omega, DT), rtol=1e-8, atol=0.0)


def test_constrained_minimisation_finds_the_transfer_function(reference_stage, record):
    stage = reference_stage()
    volts, y, segments = record(stage)
    fit = fit_constrained(stepped_sine_response(volts, y, DT, segments))
    m, c, k = stage.mass, stage.damping, stage.stiffness
    assert fit.numerator.value == pytest.approx(stage.force_constant / m, rel=0.01)
    assert fit.damping.value == pytest.approx(c / m, rel=0.01)
    assert fit.stiffness.value == pytest.approx(k / m, rel=1e-3)
    assert fit.stiffness.covers(k / m)
    assert fit.status == "converged"


def test_the_static_gain_can_be_imposed(reference_stage, record):
    volts, y, segments = record(reference_stage())
    measured = stepped_sine_response(volts, y, DT, segments)
    wrong = Quantity(1.0e-3, "m/V", (0.99e-3, 1.01e-3))
    fit = fit_constrained(measured, static_gain=wrong)
    assert 0.99e-3 * (1 - 1e-6) <= fit.static_gain.value <= 1.01e-3 * (1 + 1e-6)
    assert any("gain" in name for name in fit.active)


def test_a_mode_too_few_shows_in_misfit_and_interval(reference_stage, record):
    one, two = (fit_constrained(stepped_sine_response(*record(stage)[:2], DT, excited()[1]))
                for stage in (reference_stage(), reference_stage(second=(0.2, 10.0, 0.02))))
    assert two.misfit > 20.0 * one.misfit
    assert two.numerator.half_width > 20.0 * one.numerator.half_width


def test_what_cannot_be_analysed_is_refused():
    volts, segments = excited()
    with pytest.raises(IdentificationError, match="at least one"):
        stepped_sine_response(volts, volts, DT, [])
    with pytest.raises(IdentificationError, match="does not lie inside"):
        stepped_sine_response(volts[:2000], volts[:2000], DT, segments)
    with pytest.raises(IdentificationError, match="does not move"):
        stepped_sine_response(np.zeros_like(volts), volts, DT, segments)
    with pytest.raises(IdentificationError, match="stepped sine"):
        segments_in({"/stage/x/trajectory_generator": {"run": {"excitation": {}}}}, "x")
