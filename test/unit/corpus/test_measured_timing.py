"""Conventions of the measured-like records, by other ways to compute the linear stage."""

import math

import numpy as np
import pytest
from scipy.signal import lsim

from benchmarks.corpus.linear import response
from benchmarks.corpus.measured import convention_record, held_record
from benchmarks.corpus.measured.gap import linear_response
from benchmarks.corpus.measured.plant import BAND_LIMITED, HELD, LINEAR, STEPS
from benchmarks.corpus.measured.stage import NO_LOOP, Run, Sensor, Stage, open_run, perform
from benchmarks.corpus.measured.timing import HOLD_TOLD, Convention, hold_told

PERIOD = 1e-3
BASE = {"mass": 0.8, "damping": 3.0, "stiffness": 0.8 * (2 * math.pi * 12.0) ** 2,
        "force_constant": 2.0, "amplifier_time_constant": 0.3e-3, "delay": 0.25e-3}


def stage(**changed: float) -> Stage:
    return Stage({**BASE, **changed}, PERIOD, 1e-3, Sensor(0.0))


def clean(run: Run, of: Stage) -> tuple[np.ndarray, np.ndarray]:
    outcome = perform(of, run, of.physics(), of.physics(), np.zeros(len(run.command)))
    return outcome.command, outcome.clean


def drawn(kind: str, hold: int, shift: int) -> Run:
    return open_run(np.random.default_rng(3), stage(), kind, 3000, hold=hold, shift=shift)


@pytest.mark.parametrize("shift", [-0.5, 0.0, 1.35])
@pytest.mark.parametrize("kind", ["multisine", "noise"])
def test_band_limited_record_is_the_stage_s_frequency_response(kind: str, shift: float) -> None:
    column, position = clean(drawn(kind, BAND_LIMITED, round(shift * STEPS)), stage())
    padded = 4 * len(column)
    s = 2j * math.pi * np.fft.rfftfreq(padded) / PERIOD
    gain = BASE["force_constant"] / (
        (BASE["mass"] * s * s + BASE["damping"] * s + BASE["stiffness"])
        * (1.0 + s * BASE["amplifier_time_constant"]))
    gain *= np.exp(-s * (BASE["delay"] + shift * PERIOD))
    expected = np.fft.irfft(np.fft.rfft(column, padded) * gain)[:len(column)]
    assert np.std(expected - position) < 3e-4 * np.std(position)


@pytest.mark.parametrize("shift", [0.0, 0.4, 2.0])
def test_held_record_is_the_exactly_discretised_stage(shift: float) -> None:
    column, position = clean(drawn("prbs", HELD, round(shift * STEPS)), stage())
    base = {**BASE, "delay": BASE["delay"] + shift * PERIOD}
    assert np.std(response(base, PERIOD, column) - position) < 3e-5 * np.std(position)


@pytest.mark.parametrize("hold", [HELD, LINEAR, BAND_LIMITED])
def test_the_refit_s_linear_stage_is_the_plant_s(hold: int) -> None:
    # between steps of the plant, too: its delay is no whole number of them
    run, of = drawn("noise", hold, -7), stage()
    moved = {**BASE, "delay": BASE["delay"] + 0.3 * PERIOD / STEPS}
    _, position = clean(run, of)
    assert np.std(linear_response(BASE, PERIOD, run) - position) < 1e-4 * np.std(position)
    expected = position - 0.3 * PERIOD / STEPS * np.gradient(position, PERIOD)
    assert np.std(linear_response(moved, PERIOD, run) - expected) < 1e-4 * np.std(position)


def test_early_input_is_the_column_moved() -> None:
    column, position = clean(drawn("steps", HELD, -STEPS), stage())
    expected = response(BASE, PERIOD, np.append(column[1:], 0.0))
    assert np.std(expected - position) < 3e-5 * np.std(position)


def test_linear_record_is_that_of_lsim() -> None:
    column, position = clean(drawn("scan", LINEAR, 0), stage(delay=0.0))
    tau = BASE["amplifier_time_constant"]
    second = [BASE["mass"], BASE["damping"], BASE["stiffness"]]
    system = ([BASE["force_constant"]], np.polymul(second, [tau, 1.0]))
    expected = lsim(system, column, PERIOD * np.arange(len(column)))[1]
    assert np.std(expected - position) < 3e-5 * np.std(position)


def test_dry_friction_stops_at_the_level_of_its_force() -> None:
    # pushed slowly: it sticks, then follows the spring behind by the friction's force
    of = stage(delay=0.0, amplifier_time_constant=0.0)
    ramp = np.linspace(0.0, 1.0, 4000)
    run = Run("ramp", ramp, np.zeros(4000), NO_LOOP)
    p = of.physics(coulomb=0.3)
    out = perform(Stage({**of.base, "damping": 150.0}, PERIOD, 1e-3, Sensor(0.0)), run,
                  p._replace(damping=150.0), p, np.zeros(4000))
    stuck = 2.0 * ramp < 0.299
    assert np.all(out.clean[stuck] == 0.0)
    slope = 2.0 / BASE["stiffness"] / 4.0
    wanted = (2.0 * ramp[-1] - 0.3 - 150.0 * slope) / BASE["stiffness"]
    assert out.clean[-1] == pytest.approx(wanted, rel=2e-3)


def test_kinds_of_hold_are_told_where_the_record_shows_them() -> None:
    loud = Stage(BASE, PERIOD, 1e-3, Sensor(1e-7))
    faint = Stage(BASE, PERIOD, 1e-3, Sensor(1e-4))
    run = drawn("prbs", HELD, 0)
    assert hold_told(faint, run) < HOLD_TOLD < hold_told(loud, run)


def test_records_are_the_same_by_seed_and_say_nothing_of_the_truth() -> None:
    for make in (held_record, convention_record):
        (one, truth), (two, again) = make(5, 9), make(5, 9)
        assert truth == again
        assert all(np.array_equal(one[name], two[name]) for name in one)
        assert set(one) <= {"time_s", "input_v", "position_m", "reference_m"}
        assert make(5, 10)[1]["base"] != truth["base"]


def test_truths_of_held_records() -> None:
    for index in range(10):
        columns, truth = held_record(index, 2)
        assert (truth["input_hold"], truth["input_shift_samples"]) == ("zero", 0.0)
        assert ("reference_m" in columns) == (truth["kind"] in ("closed", "free"))
        assert np.all(np.isfinite(columns["position_m"]))


def test_a_convention_is_asked_for_below_a_fifth_of_a_sample_of_lag() -> None:
    assert Convention("zero", -1.0, 0.19, 0.0).must_be_found
    assert not Convention("zero", -1.0, 0.2, 0.0).must_be_found
    assert not Convention("zero", 0.5, 0.0, 0.0).must_be_found
    lates = [convention_record(4 * i, 3)[1] for i in range(6)]
    assert any(t["must_be_found"] for t in lates)
    late = [t["late_samples"] + max(t["input_shift_samples"], 0.0) for t in lates]
    assert [t["must_be_found"] for t in lates] == [each < 0.2 for each in late]
