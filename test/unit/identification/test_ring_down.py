"""Free decay against the closed form of a damped swing."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.ring_down import (
    damping_ratio,
    damping_ratio_as_printed,
    ring_down,
)

DT = 1e-3
RATIO, OMEGA = 0.0348, 24.51
TRUE = 2.0 * math.pi * RATIO / math.sqrt(1.0 - RATIO**2)


def swing(noise=5e-8, seed=0, offset=2e-6, release=1500, seconds=7.0, size=2e-3):
    time = np.arange(round(seconds / DT)) * DT
    damped = OMEGA * math.sqrt(1.0 - RATIO**2)
    free = offset + size * np.exp(-RATIO * OMEGA * time) * (
        np.cos(damped * time) + RATIO / math.sqrt(1 - RATIO**2) * np.sin(damped * time))
    y = np.concatenate((np.full(release, offset + size), free))
    return y + noise * np.random.default_rng(seed).standard_normal(y.size), release


def test_decrement_frequency_and_offset():
    y, release = swing()
    found = ring_down(y, DT, release=release)
    assert found.decrement.value == pytest.approx(TRUE, rel=1e-4)
    assert found.damping.value == pytest.approx(RATIO, rel=1e-4)
    assert found.natural_frequency.value == pytest.approx(OMEGA, rel=1e-4)
    assert found.offset.value == pytest.approx(2e-6, abs=2e-7)
    assert found.two_point == pytest.approx(TRUE, rel=1e-2)
    assert found.early.value == pytest.approx(found.late.value, rel=1e-2)


def test_intervals_cover_the_truth():
    hits = rates = 0
    for seed in range(100):
        y, release = swing(noise=2e-6, seed=seed)
        found = ring_down(y, DT, release=release)
        hits += found.decrement.covers(TRUE)
        rates += found.natural_frequency.covers(OMEGA)
    assert hits >= 88
    assert rates >= 88


def test_the_release_is_the_last_change_of_the_input():
    y, release = swing()
    volts = np.where(np.arange(y.size) < release, 1.5, 0.0)
    assert ring_down(y, DT, input_=volts).release == release
    with pytest.raises(IdentificationError, match="no release"):
        ring_down(y, DT, input_=np.zeros(y.size))
    with pytest.raises(IdentificationError, match="extremes"):
        ring_down(np.zeros(3000), DT, release=100)


def test_the_number_of_cycles_can_be_set():
    y, release = swing()
    assert ring_down(y, DT, release=release, cycles=5).cycles == 5.0


def test_friction_shows_as_a_decrement_that_grows():
    time = np.arange(7000) * DT
    size = np.maximum(2e-3 - 3.5e-4 * time, 0.0)                # linear decay: dry friction
    y = size * np.cos(OMEGA * time)
    found = ring_down(y, DT, release=0, smallest=0.2)
    assert found.late.value > 1.5 * found.early.value


def test_both_forms_of_equation_2():
    assert damping_ratio(0.218308) == pytest.approx(0.034724, abs=5e-7)
    assert damping_ratio_as_printed(0.218308) == pytest.approx(0.034766, abs=5e-7)
