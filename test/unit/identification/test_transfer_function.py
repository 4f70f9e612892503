"""The fitted transfer function against the stage, and its intervals against repetition."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification import (
    FrequencyResponse,
    IdentificationError,
    LinearPlant,
    Mode,
    fit_transfer_function,
)
from dfm_stage.identification.paper import compare_with_paper
from dfm_stage.identification.quantity import Quantity

PAPER = LinearPlant((Mode(1.0, 1.705, 600.7),), lag=1e-3, delay=1e-3)


LINES = np.arange(2, 141, 2)


def measured(plant, seed, sigma=0.01, lines=LINES):
    omega = np.pi * lines
    rng = np.random.default_rng(seed)
    exact = plant.sampled_response(omega, 1e-3)
    scale = sigma * np.abs(exact)
    noise = (rng.standard_normal(omega.size) + 1j * rng.standard_normal(omega.size)) / np.sqrt(2)
    return FrequencyResponse(omega, exact + scale * noise, scale**2, 100.0, 1e-3, lines, 5, 5,
                             "V", "m", "periods")


def test_every_coefficient_and_how_often_its_interval_holds():
    truth = {"numerator": 1.0, "damping": 1.705, "stiffness": 600.7, "lag": 1e-3, "delay": 1e-3}
    fits = [fit_transfer_function(measured(PAPER, seed)) for seed in range(60)]
    assert all(f.ok for f in fits)
    hits = {n: np.mean([f.quantity(n).covers(v) for f in fits]) for n, v in truth.items()}
    assert np.mean(list(hits.values())) == pytest.approx(0.95, abs=0.035)
    assert min(hits.values()) > 0.86
    assert np.mean([f.misfit for f in fits]) == pytest.approx(1.0, abs=0.05)
    frequency = [f.natural_frequency_hz() for f in fits]
    assert np.mean([q.covers(np.sqrt(600.7) / 2 / np.pi) for q in frequency]) > 0.86
    assert fits[0].static_gain().unit == "m/V"
    assert fits[0].static_gain().value == pytest.approx(1 / 600.7, rel=0.01)
    assert fits[0].damping_ratio().value == pytest.approx(0.03478, rel=0.05)


def test_the_hold_is_part_of_the_model():
    """The same record read as continuous G(s) would hide half a sample in the delay."""
    no_delay = LinearPlant((Mode(1.0, 1.705, 600.7),))
    found = fit_transfer_function(measured(no_delay, 0, sigma=1e-3))
    assert found.plant.delay + found.plant.lag < 0.05e-3


def test_two_modes():
    plant = LinearPlant((Mode(0.93, 1.705, 600.7), Mode(0.07, 0.4, 100.63**2)), lag=1e-3)
    found = fit_transfer_function(measured(plant, 0, sigma=2e-3), modes=2, delay=False)
    modes = sorted(found.plant.modes, key=lambda m: m.stiffness)
    assert found.ok
    for ours, theirs in zip(modes, plant.modes, strict=True):
        assert ours.numerator == pytest.approx(theirs.numerator, rel=0.02)
        assert ours.natural_frequency_hz == pytest.approx(theirs.natural_frequency_hz, rel=1e-3)


def test_free_body_with_a_flexible_mode():
    plant = LinearPlant((Mode(20.0, 3.0, 0.0), Mode(-20.0, 10.0, 480.0**2)), delay=0.4e-3)
    lines = np.arange(20, 500, 2)
    found = fit_transfer_function(measured(plant, 0, lines=lines), modes=2, free_body=True,
                                  lag=False)
    assert found.ok
    assert found.plant.modes[0].numerator == pytest.approx(20.0, rel=0.02)
    assert found.plant.modes[1].natural_frequency_hz == pytest.approx(480 / 2 / np.pi, rel=2e-3)
    assert not np.isfinite(found.static_gain().value)


def test_a_missing_mode_shows_in_the_misfit_and_widens_the_intervals():
    plant = LinearPlant((Mode(0.93, 1.705, 600.7), Mode(0.07, 0.4, 100.63**2)), lag=1e-3)
    found = fit_transfer_function(measured(plant, 0, sigma=2e-3))
    assert found.misfit > 5.0
    assert "missing" in found.message


def test_too_few_lines_are_refused():
    with pytest.raises(IdentificationError, match="too few"):
        fit_transfer_function(measured(PAPER, 0, lines=np.array([3, 5, 9])))


def test_comparison_with_the_paper():
    found = fit_transfer_function(measured(PAPER, 0))
    rows = compare_with_paper(*(found.quantity(n) for n in ("numerator", "damping", "stiffness")))
    assert [r.paper for r in rows] == [1.0, 1.705, 600.7]
    assert all(abs(r.deviation_percent) < 5.0 for r in rows)
    assert set(rows[0].to_dict()) >= {"paper", "ours", "deviation_percent"}


@pytest.mark.parametrize("other", [(2.1, 1.705, 600.7), (1.0, 0.8, 600.7), (1.0, 1.705, 6e4)])
def test_another_stage_is_not_compared_with_the_paper(other):
    assert not compare_with_paper(*(Quantity(v, "") for v in other))
