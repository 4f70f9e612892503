"""Tuning on the running loop against the exact ultimate gain, and its ways out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dfm_stage.control import ControlError, Guard, sample_model, ultimate
from dfm_stage.control.tuning_runs import GainRaising, RelayRun, TuningRun
from dfm_stage.model import Model, Plant, load_model


def run(model: Model, tuning: TuningRun, seed: int = 1,
        gain_sign: float = 1.0) -> tuple[float, float]:
    """Return the duration and the largest excursion, the ring-down after the end included."""
    plant, furthest, k = Plant(model, seed=seed), 0.0, 0
    ended = 0
    while ended < 3000:
        sample = plant.sample()
        furthest = max(furthest, abs(sample.position_m))
        plant.advance(gain_sign * tuning.step(sample.reading_m))
        k += 1
        ended += tuning.ended
    assert tuning.step(1.0) == 0.0
    return (k - ended) * model.sample_period, furthest


@pytest.mark.parametrize("make", [GainRaising, RelayRun])
@pytest.mark.parametrize("name", ["paper_stage", "raster_bench"])
def test_the_ultimate_gain_is_found(name: str, make: type[TuningRun]) -> None:
    model = load_model(name)
    exact = ultimate(sample_model(model))
    tuning = make(model.sample_period)
    duration, furthest = run(model, tuning)
    assert tuning.failure == ""
    assert tuning.outcome is not None
    assert tuning.outcome.gain_v_m == pytest.approx(exact.gain_v_m, rel=0.03)
    assert tuning.outcome.period_s == pytest.approx(exact.period_s, rel=0.02)
    assert duration < 60.0
    assert furthest < 2e-3


def test_an_offset_of_encoder_and_force_does_not_matter() -> None:
    model = load_model("paper_stage").with_parameters({"encoder_zero": 3e-3})
    tuning = RelayRun(1e-3)
    run(model, tuning)
    assert tuning.outcome is not None
    assert tuning.outcome.gain_v_m == pytest.approx(683.6, rel=0.03)


@pytest.mark.parametrize("make", [GainRaising, RelayRun])
def test_it_stops_where_the_stage_goes_too_far(make: type[TuningRun]) -> None:
    model = load_model("paper_stage")
    tuning = make(1e-3, tuning_travel_m=1e-4, tuning_voltage_v=2.0)
    _, furthest = run(model, tuning)
    assert "mm from rest" in tuning.failure
    assert furthest < 1.5e-3                     # let go at 0.1 mm, it coasts on its spring


def test_a_loop_with_the_wrong_sign_is_stopped() -> None:
    tuning = GainRaising(1e-3, tuning_gain_v_m=1e3)
    _, furthest = run(load_model("paper_stage"), tuning, gain_sign=-1.0)
    assert "mm from rest" in tuning.failure
    assert furthest < 7.7e-3


def test_a_start_beyond_the_limit_is_named() -> None:
    tuning = GainRaising(1e-3, tuning_gain_v_m=900.0)
    _, furthest = run(load_model("paper_stage"), tuning)
    assert "start from a lower" in tuning.failure
    assert furthest < 7.7e-3


def test_without_delay_there_is_no_result_and_it_ends() -> None:
    model = Model("m", 1e-3, {"mass": 1.0, "damping": 60.0, "stiffness": 600.0,
                              "force_constant": 1.0})
    tuning = GainRaising(1e-3, tuning_time_s=3.0)
    duration, _ = run(model, tuning)
    assert "no result within 3 s" in tuning.failure
    assert duration == pytest.approx(3.0, abs=0.01)


def test_bad_numbers_end_it() -> None:
    tuning = RelayRun(1e-3)
    assert tuning.step(math.nan) == 0.0
    assert "finite" in tuning.failure
    with pytest.raises(ControlError, match="tuning_factor"):
        GainRaising(1e-3, tuning_factor=1.0)


def test_the_guard_lets_a_scan_pass_and_stops_what_would_leave_the_travel() -> None:
    guard = Guard(1e-3)
    t = np.arange(4000) * 1e-3
    for y in 5e-3 * np.sin(2.0 * math.pi * 2.0 * t):
        assert guard.check(float(y), 1.0, 10.0)
    for y in 5e-3 + 0.3 * np.arange(30) * 1e-3:               # 0.3 m/s outwards
        passed = guard.check(float(y), 1.0, 10.0)
    assert not passed
    assert "leave the travel" in guard.tripped
    assert not guard.check(0.0, 0.0, 10.0)
    guard.reset()
    assert guard.check(0.0, 0.0, 10.0)


def test_a_fast_way_back_from_afar_passes_and_coasting_out_does_not() -> None:
    guard = Guard(1e-3)
    y = 5e-3 - 0.25 * np.arange(40) * 1e-3                     # 0.25 m/s inwards, then out again
    passed = [guard.check(float(each), -10.0, 10.0) for each in y]
    assert all(passed[:20])
    assert not passed[-1]
    assert y[passed.index(False)] > -3e-3


def test_one_wrong_reading_does_not_trip_the_guard() -> None:
    guard = Guard(1e-3)
    for k in range(100):
        assert guard.check(0.02 if k == 50 else 0.0, 0.0, 10.0)


def test_the_guard_stops_a_loop_that_swings_between_its_limits() -> None:
    guard = Guard(1e-3)
    passed = [guard.check(1e-4, 10.0 if k // 10 % 2 else -10.0, 10.0) for k in range(100)]
    assert passed.count(True) == 60
    slow = Guard(1e-3)
    assert all(slow.check(1e-4, 10.0 if k // 200 % 2 else -10.0, 10.0) for k in range(3000))
    off = Guard(1e-3, divergence_window_s=0.0, travel_limit_m=0.0)
    assert all(off.check(1.0, 10.0 if k // 10 % 2 else -10.0, 10.0) for k in range(300))
