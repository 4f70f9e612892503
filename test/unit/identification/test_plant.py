"""The sampled response against brute force, closed forms and SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, freqz

from dfm_stage.identification import LinearPlant, Mode

OMEGA = np.geomspace(0.5, 3000.0, 60)


@pytest.mark.parametrize("fifths", [0, 2, 5, 7])
def test_fractional_delay_lag_and_two_modes(reference_stage, fifths):
    stage = reference_stage(delay_fifths=fifths, second=(0.07, 16.0, 0.01))
    w = 2 * np.pi * 16.0
    gain = stage.force_constant / stage.mass
    plant = LinearPlant((
        Mode(0.93 * gain, stage.damping / stage.mass, stage.stiffness / stage.mass),
        Mode(0.07 * gain, 0.02 * w, w * w)), lag=stage.lag, delay=stage.delay)
    ours, theirs = plant.sampled_response(OMEGA, 1e-3), stage.response(OMEGA)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)


def test_without_lag_and_delay_it_is_scipys_zero_order_hold():
    plant = LinearPlant((Mode(1.0, 1.705, 600.7),))
    a, b = np.array([[0, 1], [-600.7, -1.705]]), np.array([[0.0], [1.0]])
    ad, bd, cd, *_ = cont2discrete((a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1))), 1e-3)
    poles = np.poly(ad)
    zeros = np.poly(ad - bd @ cd) - poles
    _, expected = freqz(zeros, poles, worN=OMEGA * 1e-3)
    # A transfer function in direct form loses digits near its double pole at one.
    np.testing.assert_allclose(plant.sampled_response(OMEGA, 1e-3), expected, rtol=1e-6)


def test_double_integrator_in_closed_form():
    z = np.exp(1j * OMEGA * 1e-3)
    expected = 3.0 * 0.5e-6 * (z + 1) / (z - 1) ** 2
    plant = LinearPlant((Mode(3.0, 0.0, 0.0),))
    np.testing.assert_allclose(plant.sampled_response(OMEGA, 1e-3), expected, rtol=1e-7)


def test_hold_costs_half_a_sample_of_phase():
    plant = LinearPlant((Mode(1.0, 1.705, 600.7),))
    late = np.angle(plant.sampled_response(OMEGA[:40], 1e-3)
                    / plant.continuous_response(OMEGA[:40]))
    np.testing.assert_allclose(late, -OMEGA[:40] * 0.5e-3, rtol=2e-3, atol=1e-6)


def test_figures_of_a_mode():
    mode = Mode(1.0, 1.705, 600.7)
    assert mode.natural_frequency_hz == pytest.approx(24.509 / (2 * np.pi), rel=1e-4)
    assert mode.damping_ratio == pytest.approx(0.03478, rel=1e-3)
    assert np.prod(mode.poles) == pytest.approx(600.7)
    assert LinearPlant((mode,)).static_gain == pytest.approx(1 / 600.7)
