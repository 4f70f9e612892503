"""Records as the diagnosis takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.observation import Observation, observe, split_by_time
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

MODEL = Model("stage", 1e-3, {"mass": 1.0, "stiffness": 600.0})


def record(size: int = 2000, period: int = 0, **more) -> Record:
    rng = np.random.default_rng(1)
    wave = rng.standard_normal(period or size)
    return Record(1e-3 * np.arange(size), 1e-3, {"x": AxisRecord(
        np.resize(wave, size), rng.standard_normal(size), **more)}, Provenance("run", "csv"))


def test_a_periodic_input_is_recognised_and_a_short_period_is_not_used():
    assert observe(record(period=500), MODEL).periodicity.period == 500
    assert observe(record(period=50), MODEL).periodicity is None
    assert observe(record(), MODEL).periodicity is None


def test_a_current_that_says_nothing_is_left_out():
    assert observe(record(current=np.ones(2000)), MODEL).current is None
    assert observe(record(current=np.arange(2000.0)), MODEL).current is not None


@pytest.mark.parametrize(("given", "model", "said"), [
    (record(99), MODEL, "at least 100"),
    (record(), replace(MODEL, sample_period=2e-3), "sampled every"),
    (record(position_unit="rad"), MODEL, "output is in rad")])
def test_a_record_that_does_not_suit_is_refused(given, model, said):
    with pytest.raises(DiagnosisError, match=said):
        observe(given, model)


def test_an_input_that_is_no_number_is_refused_with_its_time():
    bad = record()
    bad.axes["x"].input[700] = np.nan
    with pytest.raises(DiagnosisError, match=r"not a number at 0\.7 s"):
        observe(bad, MODEL)


def test_a_part_keeps_its_time_and_whole_periods():
    part = observe(record(period=500), MODEL).part(600, 2000)
    assert part.skip == 40
    assert part.time[part.skip] == pytest.approx(0.6)
    assert part.input.size == 1440
    assert part.periodicity.count == 2
    assert observe(record(period=500), MODEL).part(600, 1200).periodicity is None


@pytest.mark.parametrize(("size", "lead"), [(100, 10), (300, 30), (400, 40), (2000, 40)])
def test_a_short_record_has_a_short_lead_in(size, lead):
    assert observe(record(size), MODEL).skip == lead
    assert observe(record(size), MODEL).part(0, size).skip == lead


def moving(output) -> Observation:
    return Observation("run", np.ones(output.size), output, 1e-3)


def test_the_last_part_is_held_out():
    fitted, held = split_by_time([moving(np.random.default_rng(2).standard_normal(2000))])
    assert [r.name for r in (*fitted, *held)] == ["run", "run, last 30 %"]
    assert held[0].time[held[0].skip] == pytest.approx(1.4)
    assert fitted[0].time[-1] == pytest.approx(1.399)


def test_of_a_motion_that_died_out_an_early_part_is_held_out():
    time = 1e-3 * np.arange(4000)
    fitted, held = split_by_time([moving(np.exp(-4.0 * time) * np.cos(30.0 * time))])
    assert [r.name for r in fitted] == ["run, beginning", "run, end"]
    assert held[0].name == "run, between"
    assert held[0].time[held[0].skip] == pytest.approx(0.4)


@pytest.mark.parametrize(("size", "first", "second"), [
    (100, 25, 45), (400, 100, 180), (1000, 100, 300)])
def test_of_a_short_motion_that_died_out_a_fifth_is_held_out(size, first, second):
    time = 1e-3 * np.arange(size) * 4000 / size
    fitted, held = split_by_time([moving(np.exp(-4.0 * time) * np.cos(30.0 * time))])
    assert fitted[0].input.size == first
    assert held[0].input.size - held[0].skip == second - first
    assert fitted[1].input.size - fitted[1].skip == size - second
    assert {r.record_size for r in (*fitted, *held)} == {size}
