"""The static test against springs that are known: linear, with backlash, still ringing."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.static import find_levels, static_test

DT = 1e-3


def staircase(levels, hold=800):
    return np.repeat(np.asarray(levels, dtype=float), hold)


CYCLE = [0, 1, 2, 3, 2, 1, 0, -1, -2, -3, -2, -1, 0, 1, 2, 3, 2, 1, 0]


def test_stiffness_and_offset_of_a_spring_within_their_intervals():
    rng = np.random.default_rng(3)
    volts = staircase(CYCLE)
    hits = offsets = 0
    for _ in range(200):
        x = 1.5 * volts / 650.0 + 2e-6 + 1e-6 * rng.standard_normal(volts.size)
        found = static_test(volts, x, DT, 1.5)
        hits += found.stiffness.covers(650.0)
        offsets += found.offset_m.covers(2e-6)
    assert found.stiffness.value == pytest.approx(650.0, rel=1e-4)
    assert hits > 180
    assert offsets > 180


def test_ringing_that_outlives_the_level_is_taken_out():
    volts = staircase(CYCLE)
    x = volts / 650.0
    since = np.arange(volts.size) % 800 * DT
    step = np.repeat(np.concatenate(([0.0], np.diff(CYCLE))), 800) / 650.0
    ringing = x - 0.02 * step * np.exp(-0.85 * since) * np.cos(24.5 * since)
    rng = np.random.default_rng(0)
    found = static_test(volts, ringing + 5e-8 * rng.standard_normal(x.size), DT, 1.0)
    assert found.stiffness.value == pytest.approx(650.0, rel=1e-6)
    assert abs(found.hysteresis.value) < 5e-8


def test_a_loop_and_its_width():
    volts = staircase(CYCLE)
    direction = np.sign(np.concatenate(([1.0], np.diff(CYCLE))))
    x = volts / 650.0 - np.repeat(direction, 800) * 1e-5
    found = static_test(volts, x + 1e-8 * np.random.default_rng(1).standard_normal(x.size), DT,
                        1.0)
    assert found.hysteresis.value == pytest.approx(2e-5, rel=1e-2)
    assert found.hysteresis.ci95[0] > 0.0
    assert found.hysteresis_percent.value == pytest.approx(100 * 2e-5 / found.travel_m, rel=1e-2)


def test_a_cubic_spring_is_not_linear():
    volts = staircase(CYCLE)
    x = volts / 650.0
    bent = x - 2e3 * x**3
    found = static_test(volts, bent, DT, 1.0)
    line = np.polyfit(x[::800], bent[::800], 1)
    expected = np.max(np.abs(bent[::800] - np.polyval(line, x[::800])))
    assert found.linearity.value == pytest.approx(100 * expected / np.ptp(bent), rel=1e-3)


def test_deflection_at_a_load_and_outside():
    volts = staircase(CYCLE)
    found = static_test(volts, volts / 650.0, DT, 1.0)
    assert found.deflection_at(-3.0).value == pytest.approx(-3.0 / 650.0)
    assert found.deflection_at(1.5).value == pytest.approx(1.5 / 650.0)
    with pytest.raises(IdentificationError, match="outside"):
        found.deflection_at(4.0)


def test_too_few_levels_are_refused_and_short_ones_left_out():
    with pytest.raises(IdentificationError, match="too few"):
        static_test(np.ones(5000), np.ones(5000), DT, 1.0)
    volts = np.concatenate((np.zeros(900), np.linspace(0, 1, 500), np.ones(900)))
    levels = find_levels(volts, volts, DT, 300)
    assert [level.input for level in levels] == [0.0, 1.0]
    assert levels[1].rising is True
