"""What noise is, and what stands out of it: signals whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import median_filter
from scipy.signal import cont2discrete, lfilter, ss2tf, welch

from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.remainder import describe, findings, rounding_rms
from dfm_stage.diagnosis.spectra import (
    denoised,
    density,
    frequency_peaks,
    lattice,
    position_peaks,
    read_off,
)
from dfm_stage.identification.periods import Periodicity
from dfm_stage.identification.weights import (
    high_band_rms,
    weights_of,
    white_weights,
)
from dfm_stage.model import Model

SIZE, DT = 8000, 1e-3
TIME = DT * np.arange(SIZE)


def noise(seed: int = 0, size: int = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(size)


def run(output, *, period: int = 0, current=None) -> Observation:
    repeats = Periodicity(period, 0, output.size // period) if period else None
    return Observation("run", np.sin(7.0 * TIME[:output.size]), output, 1e-3, current=current,
                       periodicity=repeats, skip=0)


# -- weighting --------------------------------------------------------------------------------


def test_white_noise_is_told_from_slow_motion_by_its_high_frequencies():
    slow = 100.0 * np.sin(2 * np.pi * 3.0 * TIME)
    assert high_band_rms(noise() + slow) == pytest.approx(1.0, rel=0.05)
    assert white_weights([[noise()]])[0][0].rms == pytest.approx(1.0, rel=0.05)


def test_the_weight_of_coloured_noise_makes_it_white_and_knows_its_rms():
    coloured = lfilter([1.0], [1.0, -0.8], noise())
    weight = weights_of([[coloured]])[0][0]
    white = weight.apply(coloured)
    assert weight.rms == pytest.approx(1.0 / math.sqrt(1.0 - 0.64), rel=0.05)
    assert np.std(white) == pytest.approx(1.0, rel=0.02)
    assert abs(float(white[1:] @ white[:-1]) / white.size) < 0.03


def test_weights_of_the_change_hold_a_drift_to_be_next_to_nothing():
    drift = np.linspace(0.0, 100.0, SIZE)
    weight = white_weights([[noise()]])[0][0].of_change()
    assert np.std(weight.apply(noise())) == pytest.approx(1.0, rel=0.1)
    assert np.std(weight.apply(drift)) < 0.03 * np.std(drift)


# -- spectra ----------------------------------------------------------------------------------


def test_a_line_in_time_and_a_pattern_over_position_are_found():
    assert frequency_peaks([noise() + np.sin(2 * np.pi * 36.9 * TIME)], 1e-3)[0] \
        == pytest.approx(36.9, abs=0.02)
    position = 1e-4 * np.sin(2 * np.pi * 0.3 * TIME)
    error = np.sin(2 * np.pi * position / 4e-6)
    assert position_peaks([position], [error])[0] == pytest.approx(4e-6, rel=1e-3)
    assert position_peaks([np.zeros(100)], [noise(size=100)]) == []


def test_noise_is_filtered_where_nothing_moves():
    slow = 10.0 * np.sin(2 * np.pi * 2.0 * TIME)
    assert np.std(denoised(slow + noise()) - slow) < 0.3
    busy = noise()
    assert denoised(busy) is not None


def test_the_step_of_a_reading_is_read_off_only_where_it_is_coarse():
    steps = 5e-8 * np.rint(20.0 * np.sin(TIME))
    assert lattice(steps) == pytest.approx(5e-8)
    assert read_off(steps, 5e-8) is None
    assert read_off(steps, 1e-8) == pytest.approx(5e-8)
    digits = np.random.default_rng(4).choice([0.0, 1e-15], SIZE)  # of the file it was kept in
    assert lattice(steps + digits) == pytest.approx(5e-8, rel=1e-6)
    assert lattice(noise()) is None
    assert lattice(np.repeat([0.0, 1.0], 100)) is None


# -- what is left over -------------------------------------------------------------------------


def real(left, position=None, known=None, **more) -> set[str]:
    """Names of what is more than noise in `left` (N,), on a motion of its own."""
    motion = 1e3 * np.sin(2 * np.pi * 0.31 * TIME) if position is None else position
    return {f.name for f in findings(run(motion + left, **more), left, known) if f.real}


@pytest.mark.parametrize("seed", range(5))
def test_white_and_coloured_noise_are_noise(seed):
    assert real(noise(seed), period=2000) == set()
    assert real(lfilter([1.0], [1.0, -0.3], noise(seed)), period=2000) == set()


@pytest.mark.parametrize(("extra", "name"), [
    (0.5 * np.sin(2 * np.pi * 36.9 * TIME), "line"),
    (np.linspace(-2.0, 2.0, SIZE), "drift"),
    (10.0 * np.sin(2 * np.pi * 0.9 * TIME), "excess"),
    (np.resize(0.7 * lfilter([1.0], [1.0, -0.9], noise(9, 2000)), SIZE), "repeating")])
def test_what_is_more_than_noise_has_its_name(extra, name):
    assert name in real(noise() + extra, period=2000)


STAGE = Model("stage", DT, {"mass": 1.0, "damping": 6.0, "stiffness": 4000.0,
                            "force_constant": 1.0})


SLOW = 40.0 * np.sin(2 * np.pi * 0.31 * TIME)


def found_in(left, resolution):
    """What is real of `left` (SIZE,), beside SLOW, to a user who gives this resolution."""
    model = replace(STAGE, base={**STAGE.base, "encoder_resolution": resolution})
    return {f.name for f in findings(run(SLOW + left), left, None, model) if f.real}


def test_what_rounding_leaves_of_slow_motion_is_no_gap():
    left = np.rint(SLOW) - SLOW      # counts of 1
    assert rounding_rms(run(SLOW + left), STAGE) == 0.0
    told = replace(STAGE, base={**STAGE.base, "encoder_resolution": 1.0})
    assert rounding_rms(run(SLOW + left), told) == pytest.approx(np.std(left), rel=0.02)
    assert found_in(left, 1.0) == set()
    assert "pattern" in found_in(left, 1e-3), "nobody knew of these counts"
    moved = np.rint(SLOW + 0.4 * np.sin(2 * np.pi * 0.9 * TIME)) - SLOW
    assert found_in(moved, 1.0), "more than rounding leaves"


def shaped(colour, seed):
    """Noise of unit RMS (SIZE,): 1/f, low-passed, or a random walk."""
    white = np.random.default_rng(seed).standard_normal(SIZE)
    if colour == "walk":
        made = np.cumsum(white)
    elif colour == "slow":
        made = lfilter([1.0], [1.0, -0.9], white)
    else:
        line = np.maximum(np.arange(SIZE // 2 + 1), 1)
        made = np.fft.irfft(np.fft.rfft(white) / np.sqrt(line))
    return (made - made.mean()) / np.std(made)


def driven(left):
    """What is real of `left` (SIZE,), beside the response of STAGE to a random input."""
    feed = lfilter([1.0], [1.0, -0.8], noise(8))
    a, b = np.array([[0.0, 1.0], [-4000.0, -6.0]]), np.array([[0.0], [1.0]])
    held = cont2discrete((a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1))), DT)
    above, below = ss2tf(*held[:4])
    x = lfilter(above[0], below, feed)
    observed = Observation("made", feed, x + left(x), DT, skip=0)
    return {f.name for f in findings(observed, left(x), None, STAGE) if f.real}


@pytest.mark.parametrize("colour", ["flicker", "slow", "walk"])
@pytest.mark.parametrize("seed", range(3))
def test_the_colour_of_noise_is_no_gap(colour, seed):
    assert driven(lambda x: noise(seed) + 5.0 * shaped(colour, 20 + seed)) == set()


@pytest.mark.parametrize("gap", [
    lambda x: (x / np.std(x)) ** 3, lambda x: np.abs(x / np.std(x)),
    lambda x: np.roll(x, 30) / np.std(x)])
def test_what_input_and_motion_foretell_is_a_gap_even_under_noise_with_a_colour(gap):
    assert "excess" in driven(lambda x: noise(3) + 3.0 * shaped("flicker", 5) + 3.0 * gap(x))


def test_noise_above_what_the_model_gives_is_told():
    assert "known_noise" in real(noise(), known=0.45)
    assert real(noise(), known=0.6) == set()


@pytest.mark.parametrize("seed", range(5))
def test_few_samples_of_noise_are_not_flat(seed):
    """The kurtosis of 80 normal numbers has a standard deviation of 0.5."""
    samples = np.random.default_rng(seed).standard_normal((40, 80))
    observed = Observation("run", np.ones(80), np.zeros(80), 1e-3, skip=0)
    found = [f for each in samples for f in findings(observed, each, None)]
    assert not any(f.real for f in found if f.name == "flatness")


def test_rounding_is_flat():
    assert "flatness" in real(np.random.default_rng(3).uniform(-1.0, 1.0, SIZE))


def test_an_error_of_the_scale_is_a_pattern_over_position():
    position = 1e3 * np.sin(2 * np.pi * 0.31 * TIME)
    assert "pattern" in real(noise() + np.sin(2 * np.pi * position / 40.0), position)


# -- what it looks like ------------------------------------------------------------------------

X = np.sin(2 * np.pi * 1.3 * TIME) + 0.5 * np.sin(2 * np.pi * 3.1 * TIME)


@pytest.mark.parametrize(("left", "parity"), [
    (X**3, "odd"), (X * X, "even"), (X**3 + X * X, "both")])
def test_the_parity_of_a_remainder(left, parity):
    assert describe([run(X + 1e-3 * left)], [[1e-3 * left]]).parity == parity


def test_memory_is_what_the_present_does_not_explain():
    assert not describe([run(X)], [[1e-3 * X**3]]).memory
    late = 1e-3 * np.sin(2 * np.pi * 17.0 * TIME)
    assert describe([run(X)], [[late]]).memory
    assert describe([run(X)], [[late]]).frequency_hz == pytest.approx(17.0, abs=0.2)


def test_a_constant_input_says_nothing_of_memory():
    steady = replace(run(X), input=np.full(X.size, 90.0))
    assert not describe([steady], [[1e-3 * X**3]]).memory


def test_the_exponent_of_amplitude_needs_two_sizes():
    sizes = (1.0, 4.0)
    runs = [run(a * X) for a in sizes]
    left = [[1e-3 * a**3 * X**3] for a in sizes]
    assert describe(runs, left).amplitude_exponent == pytest.approx(3.0, abs=1e-6)
    assert describe(runs[:1], left[:1]).amplitude_exponent is None


@pytest.mark.parametrize(("current", "side"), [
    ((), "unclear"), ((noise(),), "mechanical"),
    ((noise() + 9.0 * np.sin(9.0 * TIME),), "actuator")])
def test_the_side_is_told_by_the_current(current, side):
    assert describe([run(X)], [[1e-3 * X, *current]]).side == side


@pytest.mark.parametrize("length", [256, 255])
def test_a_density_is_that_of_scipy(length: int) -> None:
    hertz, power = density(3.0 + noise(), length, DT)
    expected = welch(3.0 + noise(), 1.0 / DT, nperseg=length)
    np.testing.assert_allclose(hertz, expected[0])
    np.testing.assert_allclose(power[1:], expected[1][1:], rtol=1e-9)


@pytest.mark.parametrize("colour", [0.0, 0.99])
@pytest.mark.parametrize("line", [0.0, 0.5])
def test_the_highest_line_is_that_over_a_running_median(colour: float, line: float) -> None:
    residual = lfilter([1.0], [1.0, -colour], noise(5)) + line * np.sin(2.0 * TIME / DT)
    found = next(f for f in findings(run(residual), residual, None) if f.name == "line")
    power = (np.abs(np.fft.rfft(residual - residual.mean())) ** 2)[3:]
    ratio = power / median_filter(power, size=101, mode="mirror") * math.log(2.0)
    assert found.value <= np.max(ratio) * (1.0 + 1e-12)
    if line:
        assert found.value == pytest.approx(np.max(ratio))
        assert f"at {1.0 / math.pi:.3f}" in found.text
