"""Residual tests: rarely wrong about noise, and awake to what is left over."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from dfm_stage.identification import input_correlation, line_residuals, whiteness
from dfm_stage.identification.residuals import noise_floor_from_periods


def rejected(test, *signals):
    return np.mean([not test(*(s(seed) for s in signals)).passed for seed in range(300)])


def white(seed):
    return np.random.default_rng(seed).standard_normal(3000)


def test_false_alarms_come_as_often_as_the_level_says(multisine):
    assert rejected(whiteness, white) <= 0.03
    assert rejected(input_correlation, white, lambda s: white(s + 1000)) <= 0.03
    band = multisine(np.arange(1, 71, 2), 1000, 3)
    assert rejected(input_correlation, white, lambda s: band) <= 0.03


def test_colour_and_input_are_seen(multisine):
    assert not whiteness(lfilter([1.0], [1.0, -0.2], white(0))).passed
    u = white(1)
    left = white(2)
    left[3:] += 0.15 * u[:-3]
    found = input_correlation(left, u)
    assert not found.passed
    assert int(found.lags[np.argmax(np.abs(found.correlation))]) == 3
    assert np.mean(np.abs(found.correlation) > found.band) < 0.2


def test_the_present_input_does_not_count():
    """Feedback makes the input follow the noise: only what came before is the model's fault."""
    e = white(3)
    assert input_correlation(e, e).passed


def test_lines_that_repeat_are_model_error(multisine):
    lines = np.arange(1, 71, 2)
    noise = np.random.default_rng(0).standard_normal(12_000)
    assert line_residuals(noise, 1000, lines, 1e-3).passed
    t = np.arange(12_000)
    found = line_residuals(noise + 0.3 * np.sin(2 * np.pi * 21 * t / 1000), 1000, lines, 1e-3)
    assert not found.passed
    assert found.frequency_hz[np.argmax(found.ratio)] == pytest.approx(21.0)
    assert line_residuals(noise[:2500], 1000, lines, 1e-3) is None


def test_noise_floor_from_periods(multisine):
    wave = multisine(np.arange(1, 71, 2), 1000, 12)
    noise = 0.01 * np.random.default_rng(0).standard_normal(wave.size)
    assert noise_floor_from_periods(wave + noise, 1000) == pytest.approx(0.01, rel=0.03)
    assert noise_floor_from_periods(wave[:1500], 1000) is None
    settling = np.exp(-np.arange(wave.size) / 80.0) * np.sin(0.05 * np.arange(wave.size))
    for size in (2000, wave.size):
        assert noise_floor_from_periods((wave + noise + settling)[:size], 1000) == pytest.approx(
            0.01, rel=0.07)


def test_nothing_depends_on_an_input_that_stands():
    found = input_correlation(np.random.default_rng(1).standard_normal(2000), np.zeros(2000))
    assert found.passed
    assert found.to_dict()["p_value"] == 1.0
