"""Step response against the closed form of a second-order stage, and python-control."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.step_response import step_response

DT = 1e-3


def answer(ratio, omega, seconds=12.0, size=2e-3, start=500, noise=0.0):
    time = np.arange(round(seconds / DT)) * DT
    damped = omega * math.sqrt(1.0 - ratio**2)
    y = size * (1.0 - np.exp(-ratio * omega * time) * (
        np.cos(damped * time) + ratio * omega / damped * np.sin(damped * time)))
    full = np.concatenate((np.zeros(start), y))
    full += noise * np.random.default_rng(0).standard_normal(full.size)
    return np.where(np.arange(full.size) < start, 0.0, 1.0), full


@pytest.mark.parametrize(("ratio", "omega"), [(0.035, 24.5), (0.3, 10.0), (0.6, 5.0)])
def test_figures_of_a_second_order_stage(ratio, omega):
    command, y = answer(ratio, omega, noise=1e-8)
    found = step_response(command, y, DT)
    time = np.arange(12000) * DT
    peer = control.step_info(control.tf([omega**2], [1, 2 * ratio * omega, omega**2]), T=time,
                             SettlingTimeThreshold=0.02)
    assert found.rise_time.value == pytest.approx(peer["RiseTime"], abs=1.5 * DT)
    assert found.settling_time.value == pytest.approx(peer["SettlingTime"], abs=1.5 * DT)
    assert found.overshoot.value == pytest.approx(peer["Overshoot"], rel=1e-3)
    assert found.peak_time.value == pytest.approx(math.pi / omega / math.sqrt(1 - ratio**2),
                                                  rel=1e-3)
    assert found.damping.value == pytest.approx(ratio, rel=2e-3)
    assert found.natural_frequency.value == pytest.approx(omega, rel=2e-3)
    assert found.final.value == pytest.approx(2e-3, rel=1e-4)


def test_intervals_hold_the_truth_and_grow_with_the_noise():
    command, y = answer(0.2, 24.5, seconds=2.0)
    truth = step_response(command, y, DT).rise_time.value
    widths = []
    for noise in (1e-7, 1e-6):
        hits = 0
        for seed in range(25):
            rng = np.random.default_rng(seed)
            found = step_response(command, y + noise * rng.standard_normal(y.size), DT)
            hits += found.rise_time.covers(truth)
        assert hits >= 20
        widths.append(found.rise_time.half_width)
    assert widths[1] > 5.0 * widths[0]


def test_downwards_and_without_overshoot():
    command, y = answer(0.3, 10.0)
    up, down = step_response(command, y, DT), step_response(1.0 - command, 1e-3 - y, DT)
    assert down.overshoot.value == pytest.approx(up.overshoot.value, rel=1e-6)
    time = np.arange(8000) * DT
    slow = step_response(command[:8000], np.where(time < 0.5, 0.0,
                                                  1.0 - np.exp(-(time - 0.5) / 0.4)), DT)
    assert slow.overshoot.value < 0.1
    assert math.isnan(slow.damping.value)
    assert slow.rise_time.value == pytest.approx(0.4 * math.log(9.0), rel=1e-2)


def test_nothing_to_respond_to():
    with pytest.raises(IdentificationError, match="never steps"):
        step_response(np.zeros(1000), np.zeros(1000), DT)
    with pytest.raises(IdentificationError, match="record longer"):
        step_response(np.arange(100.0), np.zeros(100), DT)
