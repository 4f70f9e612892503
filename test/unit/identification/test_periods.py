"""Period, excited lines and transient are found in the record itself."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification.periods import (
    excited_lines,
    find_period,
    settled_from,
    without_transient,
)

RNG = np.random.default_rng(3)


@pytest.mark.parametrize(("period", "count"), [(1000, 8), (437, 5), (2500, 3), (64, 40)])
def test_period_of_a_multisine(multisine, period, count):
    lines = np.arange(1, period // 10, 2)
    found = find_period(multisine(lines, period, count))
    assert (found.period, found.count, found.start) == (period, count, 0)


def test_rest_before_and_after_is_left_out(multisine):
    wave = multisine(np.arange(1, 60), 500, 6)
    found = find_period(np.concatenate((np.zeros(730), wave, np.zeros(1210))))
    assert found.period == 500
    assert found.count in (5, 6)
    assert found.start >= 730
    assert found.start + found.count * 500 <= 730 + wave.size


@pytest.mark.parametrize("level", [1e-3, 0.03, 0.1])
def test_measured_input_with_noise(multisine, level):
    wave = multisine(np.arange(1, 100, 2), 1000, 10)
    found = find_period(wave + level * RNG.standard_normal(wave.size))
    assert found.period == 1000
    assert found.count >= 9


def test_a_sine_repeats_with_its_own_period():
    assert find_period(np.sin(2 * np.pi * np.arange(4000) / 80)).period == 80


@pytest.mark.parametrize("signal", [
    RNG.standard_normal(5000), np.cumsum(RNG.standard_normal(5000)),
    np.sin(np.linspace(0, 30, 5000) ** 2), np.concatenate((np.zeros(100), np.ones(4900))),
    np.zeros(1000), np.linspace(0, 1, 3000)])
def test_what_does_not_repeat_has_no_period(signal):
    assert find_period(signal) is None


def test_lines_of_exact_and_of_noisy_spectra(multisine):
    lines = np.setdiff1d(np.arange(1, 71, 2), [11, 27, 55])
    wave = multisine(lines, 1000, 1)
    clean = np.abs(np.fft.rfft(wave)) / 1000
    assert list(excited_lines(clean)) == list(lines)
    noisy = np.abs(np.fft.rfft(wave + 0.3 * RNG.standard_normal(1000))) / 1000
    assert list(excited_lines(noisy)) == list(lines)


def test_lines_with_falling_amplitude():
    amplitude = np.zeros(300)
    amplitude[1:101:2] = np.geomspace(1.0, 5e-3, 50)
    amplitude += 1e-6
    assert list(excited_lines(amplitude)) == list(range(1, 101, 2))


def transient(count=12, period=1000, size=3e-3):
    t = np.arange(count * period) * 1e-3
    return size * np.exp(-0.85 * t) * np.cos(24.5 * t + 0.3)


def test_transient_periods_are_counted(multisine):
    wave = 1e-4 * multisine(np.arange(1, 71, 2), 1000, 12)
    noise = 1e-6 * RNG.standard_normal(wave.size)
    lines = np.arange(1, 71, 2)

    def spectra(signal):
        return np.fft.rfft(signal.reshape(12, 1000), axis=1)[:, lines] / 1000

    assert settled_from(spectra(wave + noise)) == 0
    # 3e-3 exp(-0.85 t) falls below the noise of a line (5e-8) after about ten periods.
    assert settled_from(spectra(wave + noise + transient(size=1e-5))) in range(2, 7)


def test_known_poles_take_the_transient_out(multisine):
    wave = 1e-4 * multisine(np.arange(1, 71, 2), 1000, 12)
    noise = 1e-6 * RNG.standard_normal(wave.size)
    found = find_period(wave)
    pole = -0.85 + 24.5j
    cleaned = without_transient(wave + noise + transient(), found, (pole, pole.conjugate()), 1e-3)
    assert np.sqrt(np.mean((cleaned - wave - noise) ** 2)) < 5e-8
