"""What an input does between its samples: followed exactly, found in records, never invented."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

from dfm_stage.identification import Run, Source, identify, input_timing
from dfm_stage.identification.convention import (
    HELD,
    Convention,
    agreed,
    drive_of,
    find_convention,
    interpolated,
)
from dfm_stage.identification.input_timing import (
    GRID,
    Motion,
    Waves,
    delayed_by,
    finer_from,
    lags_of,
    timing,
)
from dfm_stage.identification.source import agreeing
from dfm_stage.identification.system import System
from dfm_stage.model import Model, Simulator
from dfm_stage.recording import AxisRecord

PERIOD = 1e-3
LAG, DELAY = 0.3e-3, 0.25e-3
BASE = {"mass": 0.8, "damping": 3.0, "stiffness": 0.8 * (2 * math.pi * 12.0) ** 2,
        "force_constant": 2.0}
LATE = {**BASE, "amplifier_time_constant": LAG, "delay": DELAY}
STIFF = {**LATE, "stiffness": 0.8 * (2 * math.pi * 120.0) ** 2, "damping": 60.0}
"""Its resonance, too, is fast beside the sampling."""
HIGHEST = 0.2
"""Of the sampling rate: up to here the input of these records reaches."""


def multisine(count: int, seed: int = 3) -> np.ndarray:
    """Periodic in `count` samples, up to HIGHEST."""
    rng = np.random.default_rng(seed)
    spectrum = np.zeros(count // 2 + 1, dtype=complex)
    lines = np.arange(3, int(HIGHEST * count))
    spectrum[lines] = np.exp(2j * math.pi * rng.random(lines.size))
    wave = np.fft.irfft(spectrum, count)
    return wave / np.std(wave)


def steady(column: np.ndarray, base: dict[str, float], shift: float = 0.0) -> np.ndarray:
    """The stage's answer to a band-limited periodic input, by its frequency response."""
    s = 2j * math.pi * np.fft.rfftfreq(column.size) / PERIOD
    gain = base["force_constant"] / (base["mass"] * s * s + base["damping"] * s
                                     + base["stiffness"])
    gain /= 1.0 + s * base.get("amplifier_time_constant", 0.0)
    gain *= np.exp(-s * (base.get("delay", 0.0) + shift * PERIOD))
    return np.fft.irfft(np.fft.rfft(column) * gain, column.size)


def simulated(run: Run, base: dict[str, float], **values: float) -> np.ndarray:
    """What estimation takes for the output of a run."""
    system = System(Model("stage", PERIOD, base=base), [run], list(values))
    x = system.start.copy()
    return system.simulated(0, x[None, :])[0][0]


def left_of(run: Run, base: dict[str, float], wanted: np.ndarray) -> float:
    return float(np.std(simulated(run, base) - wanted) / np.std(wanted))


@pytest.mark.parametrize("shift", [0.0, -0.4, -1.0])
def test_a_band_limited_input_is_followed_between_its_samples(shift: float) -> None:
    column = multisine(2000)
    run = Run("bl", column, steady(column, STIFF, shift), PERIOD, start="periodic", period=2000)
    assert left_of(run.by(Convention("band_limited", shift)), STIFF, run.output) < 1e-4
    assert left_of(run, STIFF, run.output) > 0.02


def test_the_ends_of_a_band_limited_record_hardly_matter() -> None:
    column = multisine(4000)
    output = steady(column, BASE)
    run = Run("bl", column, output, PERIOD, start="rest").by(Convention("band_limited"))
    free = simulated(run, BASE)
    decay = 0.5 * BASE["damping"] / BASE["mass"]
    turns = math.sqrt(BASE["stiffness"] / BASE["mass"] - decay**2)
    decayed = np.exp(-decay * PERIOD * np.arange(4000))
    turning = turns * PERIOD * np.arange(4000)
    ringing = np.stack([decayed * np.cos(turning), decayed * np.sin(turning)]).T
    inner = slice(50, -50)
    left = (output - free)[inner]
    left -= ringing[inner] @ np.linalg.lstsq(ringing[inner], left, rcond=None)[0]
    assert np.std(left) < 3e-4 * np.std(output)


def test_a_straight_input_is_that_of_lsim() -> None:
    column = multisine(2000)
    base = {**STIFF, "delay": 0.0}
    system = ([base["force_constant"]], np.polymul(
        [base["mass"], base["damping"], base["stiffness"]], [LAG, 1.0]))
    wanted = lsim(system, column, PERIOD * np.arange(2000))[1]
    run = Run("foh", column, wanted, PERIOD, start="rest").by(Convention("first"))
    assert left_of(run, base, wanted) < 5e-4


@pytest.mark.parametrize(("shift", "late"), [(-1.0, 0.0), (-0.4, 0.6), (-1.25, 0.75)])
def test_a_held_input_that_is_early_is_exact(shift: float, late: float) -> None:
    column = multisine(2000)
    ahead = math.ceil(-shift)
    moved = np.append(column[ahead:], np.repeat(column[-1], ahead))
    base = {**LATE, "delay": DELAY + late * PERIOD}
    wanted = Simulator(Model("late", PERIOD, base=base)).run(moved, past_input=moved[0]).reading
    run = Run("early", column, wanted, PERIOD).by(Convention("zero", shift))
    assert left_of(run, LATE, wanted) < 1e-12


def test_a_delay_that_is_fitted_stays_a_delay() -> None:
    column = multisine(2000)
    run = Run("early", column, column, PERIOD).by(Convention("zero", -0.4))
    held = simulated(run, LATE)
    assert np.array_equal(simulated(run, LATE, delay=DELAY), held)


def test_a_held_input_is_simulated_as_ever() -> None:
    column = multisine(500)
    run = Run("held", column, column, PERIOD)
    assert run.by(HELD).drive is None
    wanted = Simulator(Model("stage", PERIOD, base=LATE)).run(column, past_input=column[0])
    assert np.array_equal(simulated(run.by(HELD), LATE), wanted.reading)


def test_a_part_of_a_run_keeps_the_input_of_the_whole() -> None:
    column = multisine(600)
    run = Run("bl", column, column, PERIOD).by(Convention("band_limited"))
    part = run.sliced(slice(100, 250))
    factor = 0 if run.drive is None else run.drive.factor
    assert factor > 1
    assert part.drive is not None
    assert run.drive is not None
    assert np.array_equal(part.drive.values, run.drive.values[100 * factor:250 * factor])
    assert part.output.size == 150


def test_the_neighbour_s_position_is_followed_between_samples() -> None:
    column, other = np.zeros(1500), multisine(1500, seed=8) * 1e-3
    model = Model("x", PERIOD, base=BASE).with_effect("cross_axis_coupling",
                                                      {"stiffness": 400.0, "ratio": 0.01})
    held = System(model, [Run("x", column, column, PERIOD, other=other)], [])
    fine = System(model, [Run("x", column, column, PERIOD, other=other).by(
        Convention("band_limited"))], [])
    wanted, found = (s.simulated(0, s.start[None, :])[0][0] for s in (held, fine))
    assert np.std(found - wanted) < 1e-3 * np.std(wanted)


@pytest.mark.parametrize(("slower", "steps"), [(1, 3), (8, 2)])
def test_a_slow_motion_is_followed_with_fewer_steps(slower: int, steps: int) -> None:
    """A resonance at 12 Hz, moved up to 200 Hz, or to 25 Hz."""
    column = multisine(2000)
    if slower > 1:
        column = interpolated(column, slower)[:2000]
    run = Run("slow", column, steady(column, BASE), PERIOD).by(Convention("band_limited"))
    assert run.drive is not None
    assert run.drive.factor == steps


def test_interpolation_passes_through_the_samples() -> None:
    values = np.random.default_rng(0).standard_normal(301)
    assert interpolated(values, 4)[::4] == pytest.approx(values, abs=1e-12)


def test_steps_of_a_straight_input_have_its_mean() -> None:
    ramp = np.linspace(0.0, 5.0, 51)
    drive = drive_of(ramp, Convention("first"), ramp)
    assert drive is not None
    assert drive.values[8:-8] == pytest.approx((np.arange(8, 196) + 0.5) / 40.0)


# -- finding it ----------------------------------------------------------------------------------


def recorded(hold: str, seed: int, base: dict[str, float] = BASE, noise: float = 1e-3,
             shift: float = 0.0, count: int = 8000,
             **effects: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a stage, made on steps of a twentieth of a sample, apart from what is tested."""
    rng = np.random.default_rng(seed)
    column = multisine(count, seed)
    fine = 20
    model = Model("stage", PERIOD / fine, base=base)
    for name, parameters in effects.items():
        model = model.with_effect(name, parameters)
    at = (np.arange(fine * count) + 0.5) / fine - shift
    if hold == "zero":
        acting = column[np.clip(np.floor(at).astype(int), 0, count - 1)]
    elif hold == "first":
        acting = np.interp(at, np.arange(count), column)
    else:
        spectrum = np.fft.rfft(column)
        omega = 2.0 * np.pi * np.arange(spectrum.size) / count
        acting = np.fft.irfft(spectrum * np.exp(1j * omega * (0.5 / fine - shift)),
                              fine * count) * fine
    output = Simulator(model).run(acting).reading[::fine]
    return column, output + noise * np.std(output) * rng.standard_normal(count)


@pytest.mark.parametrize("effects", [
    {}, {"cubic_stiffness": {"k3": 1e9}}, {"coulomb_friction": {"force": 0.2}},
    {"second_mode": {"share": 0.1, "frequency": 60.0, "damping_ratio": 0.02}},
    {"quadratic_damping": {"coefficient": 300.0}}])
@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_a_held_input_is_left_alone(effects: dict[str, dict[str, float]], noise: float) -> None:
    found = find_convention(*recorded("zero", 5, noise=noise, **effects))
    assert found.held


@pytest.mark.parametrize("hold", ["first", "band_limited"])
def test_an_input_that_is_not_held_is_found(hold: str) -> None:
    found = find_convention(*recorded(hold, 6, noise=1e-5))
    assert (found.hold, found.shift, found.source) == (hold, 0.0, "estimated")
    assert found.sigma is not None
    assert found.sigma < 0.03


@pytest.mark.parametrize(("hold", "shift"), [("zero", -1.0), ("band_limited", -0.7)])
def test_an_input_that_is_early_is_found(hold: str, shift: float) -> None:
    found = find_convention(*recorded(hold, 7, noise=1e-5, shift=shift))
    assert found.hold == hold
    assert found.shift == pytest.approx(shift, abs=0.03)


@pytest.mark.parametrize("base", [BASE, LATE])
def test_what_is_late_is_never_corrected(base: dict[str, float]) -> None:
    found = find_convention(*recorded("zero", 8, base, shift=1.0))
    assert found.held
    assert found.late is not None
    assert found.late > 0.9
    assert "a lag or a delay does the same" in found.words


def test_a_measured_velocity_tells_it_too() -> None:
    column, position = recorded("band_limited", 9, noise=0.0)
    between = interpolated(position, 64)
    speed = (between[65::64] - between[63::64][:7999]) * 32.0 / PERIOD
    found = find_convention(column[1:1 + speed.size], speed, derivative=1)
    assert (found.hold, found.shift) == ("band_limited", 0.0)


def test_without_motion_it_is_assumed() -> None:
    rng = np.random.default_rng(1)
    for output in (np.zeros(2000), rng.standard_normal(2000)):
        found = find_convention(rng.standard_normal(2000), output)
        assert found == HELD
        assert "assumed" in found.words


def test_what_is_given_by_hand_is_taken() -> None:
    column, output = recorded("zero", 5)
    found = find_convention(column, output, hold="band_limited", shift=-0.25)
    assert (found.hold, found.shift, found.source) == ("band_limited", -0.25, "given")
    assert find_convention(column, output, shift=-1.0).hold == "zero"




def test_identify_follows_and_tells_the_convention_of_its_records() -> None:
    little = {**BASE, "amplifier_time_constant": 1e-4}
    column, output = recorded("band_limited", 6, little, noise=1e-5, count=4000)
    model = Model("start", PERIOD, base={**little, "damping": 4.0, "stiffness": 4500.0})
    found = identify([Source("run", AxisRecord(column, output), PERIOD)], model=model)
    (told,) = found.to_dict()["conventions"]
    assert (told["record"], told["input_hold"], told["estimated"]) == ("run", "band_limited", True)
    assert told["input_shift_samples"]["value"] == 0.0
    assert found.model.base["amplifier_time_constant"] == pytest.approx(1e-4, rel=0.02)
    by_hand = Source("run", AxisRecord(column, output, input_hold="zero"), PERIOD)
    assert by_hand.run().drive is None
    assert identify([by_hand], model=model).model.base["amplifier_time_constant"] < 2e-5

def shown(hold: str, late: float, sigma: float = 0.01, shift: float = 0.0,
          **left: float) -> Convention:
    return Convention(hold, shift, sigma, "estimated", late, sigma, left)


BY_KIND = {"zero": 0.3, "first": 0.2, "band_limited": 0.1}


def test_a_record_that_does_not_show_its_convention_takes_that_of_the_others() -> None:
    both = [HELD, shown("band_limited", 0.1, 0.02, **BY_KIND),
            shown("band_limited", 0.08, **BY_KIND)]
    silent, *others = agreed(both)
    assert (silent.hold, silent.source, silent.late) == ("band_limited", "others", 0.08)
    assert "the other records show it" in silent.words
    assert others == both[1:]


def test_an_input_that_acts_more_than_a_sample_early_is_no_convention() -> None:
    column, output = recorded("band_limited", 7, noise=1e-5, shift=-1.0)
    assert find_convention(column, output).shift == pytest.approx(-1.0, abs=0.05)
    assert find_convention(*recorded("band_limited", 7, noise=1e-5, shift=-1.4)) == HELD


def test_records_share_the_kind_of_hold_that_leaves_least_over_all() -> None:
    """One says straight lines by a hair, the other band-limited by a factor of two."""
    first, second = agreed([
        shown("first", 0.1, zero=0.3, first=0.100, band_limited=0.101),
        shown("band_limited", 0.1, zero=0.3, first=0.200, band_limited=0.1)])
    assert (first.hold, second.hold) == ("band_limited", "band_limited")
    assert (first.late, first.source) == (0.1, "estimated")


def test_an_early_held_input_beside_a_band_limited_one_is_told_as_that() -> None:
    """Both act at the sample instant: the first was told as half a sample early."""
    early = shown("zero", 0.0, shift=-0.5, zero=0.10, first=0.12, band_limited=0.11)
    other = shown("band_limited", 0.0, zero=0.3, first=0.2, band_limited=0.1)
    told, _ = agreed([early, other])
    assert (told.hold, told.shift, told.late) == ("band_limited", 0.0, 0.0)


def test_what_was_given_stays_and_speaks_for_no_other() -> None:
    given = Convention("band_limited", -0.2, source="given")
    mine = shown("first", 0.0, zero=0.3, first=0.1, band_limited=0.2)
    assert agreed([mine, given]) == [mine, given]
    assert agreed([HELD, given]) == [HELD, given]


def test_records_that_contradict_each_other_are_not_corrected() -> None:
    """Friction made two of four held records of one case look as if they acted at once."""
    held, early = shown("zero", 0.2), shown("first", 0.0, zero=0.3, first=0.1, band_limited=0.2)
    first, second = agreed([held, early])
    assert first == held
    assert second.held
    assert second.source == "contradicted"
    assert "contradicts" in second.words


def test_an_input_that_acts_before_a_held_one_could_contradicts_none() -> None:
    """It acts at 0.3 samples behind a lag; another record shows its kind of hold, too."""
    told, _ = agreed([shown("zero", -0.2), shown("band_limited", 0.3, **BY_KIND)])
    assert (told.hold, told.shift, told.source) == ("band_limited", 0.0, "estimated")
    assert told.late == pytest.approx(0.3)
    early, _ = agreed([shown("zero", -0.2), shown("zero", 0.0, shift=-0.3, zero=0.1, first=0.2)])
    assert (early.hold, early.shift, early.sigma) == ("zero", pytest.approx(-0.2), 0.01)


def test_identify_and_diagnose_take_what_the_records_say_together() -> None:
    little = {**BASE, "amplifier_time_constant": 1e-4}
    column, output = recorded("band_limited", 6, little, noise=1e-5, count=4000)
    blurred = output + 0.3 * np.std(output) * np.random.default_rng(1).standard_normal(output.size)
    assert find_convention(column, blurred) == HELD
    clear, noisy = agreeing([Source("clear", AxisRecord(column, output), PERIOD),
                             Source("noisy", AxisRecord(column, blurred), PERIOD)])
    assert clear.run().convention.hold == noisy.run().convention.hold == "band_limited"
    assert noisy.run().drive is not None


SHARED = Path(os.environ.get("DFM_SHARED_DATA", Path(__file__).parents[4] / "shared" / "data"))


@pytest.mark.skipif(not (SHARED / "silverbox").is_dir(),
                    reason="the recorded data are not here (DFM_SHARED_DATA or ../shared/data)")
@pytest.mark.parametrize("name", ["train", "holdout_multisine", "holdout_arrow_full"])
def test_silverbox_was_sampled_at_the_same_instant(name: str) -> None:
    data = np.load(SHARED / "silverbox" / f"{name}.npz")
    found = find_convention(data["input_v"], data["position_v"])
    assert (found.hold, found.shift, found.source) == ("band_limited", 0.0, "estimated")
    assert "both columns were sampled at the same instant" in found.words


@pytest.mark.skipif(not (SHARED / "emps").is_dir(),
                    reason="the recorded data are not here (DFM_SHARED_DATA or ../shared/data)")
@pytest.mark.parametrize("name", ["train", "holdout"])
def test_a_servo_s_input_is_held(name: str) -> None:
    data = np.load(SHARED / "emps" / f"{name}.npz")
    assert find_convention(data["input_v"], data["position_m"]).held


def test_between_lags_values_follow_a_cubic_spline() -> None:
    lags = lags_of(1)
    values = np.random.default_rng(1).standard_normal(lags.size)
    np.testing.assert_allclose(finer_from(1) @ values, CubicSpline(lags, values)(GRID), atol=1e-12)


def test_between_few_lags_a_slow_wave_is_followed() -> None:
    wave = np.cos(0.5 * np.arange(1, 4)[:, None] * np.concatenate((lags_of(4), GRID)))
    few, fine = np.split(wave, [lags_of(4).size], axis=1)
    np.testing.assert_allclose(finer_from(4) @ few.T, fine.T, atol=1e-4)
    np.testing.assert_allclose(finer_from(4) @ few[0], fine[0], atol=1e-9)


def test_the_input_at_every_lag_is_the_whole_one_moved() -> None:
    u = np.random.default_rng(2).standard_normal(601)
    lags = lags_of(1)
    for lag, moved in zip(lags, delayed_by(lags, Waves.of(u), 4.0, 1), strict=True):
        inner = slice(50, 550)      # away from the ends, which are reflected
        early = Waves.of(interpolated(u, 1, -float(lag)))
        again = delayed_by(np.zeros(1), early, 4.0, 1)[0]
        np.testing.assert_allclose(moved[inner], again[inner], atol=1e-6)


def test_every_fourth_sample_behind_a_filter_is_the_same_as_with_all() -> None:
    u = np.random.default_rng(3).standard_normal(2001)
    lags, width = lags_of(4), 8.0
    all_ = delayed_by(lags, Waves.of(u), width, 1)[:, ::4]
    np.testing.assert_allclose(delayed_by(lags / 4, Waves.of(u).every(4), width / 4, 1, 4), all_,
                               atol=1e-8)


@pytest.mark.parametrize("derivative", [0, 1, 2])
@pytest.mark.parametrize("every", [3, 4])
def test_every_few_samples_of_a_filtered_motion_are_the_same_as_with_all(
        derivative: int, every: int) -> None:
    y = np.cumsum(np.random.default_rng(4).standard_normal(2401))
    motion = Motion.of(y, derivative)
    whole, few = motion.features(2.0 * every), motion.features(2.0 * every, every)
    for one, other in zip(whole[:, ::every], few, strict=True):
        np.testing.assert_allclose(other / np.linalg.norm(other), one / np.linalg.norm(one),
                                   atol=1e-6)    # in another unit of time


@pytest.mark.parametrize("width", [8.0, 16.0])
def test_timing_is_the_same_with_few_samples(width: float,
                                             monkeypatch: pytest.MonkeyPatch) -> None:
    column, output = recorded("band_limited", 7, noise=1e-5, shift=-0.4)
    waves, motion = Waves.of(column), Motion.of(output, 0)
    few = timing(waves, motion, width)
    monkeypatch.setattr(input_timing, "_spacing", lambda *_: 1)
    whole = timing(waves, motion, width)
    assert few is not None
    assert whole is not None
    assert few.tau == pytest.approx(whole.tau, abs=0.1 * whole.sigma + 1e-4)
    assert few.sigma == pytest.approx(whole.sigma, rel=0.05)
    assert few.left == pytest.approx(whole.left, rel=0.02)
