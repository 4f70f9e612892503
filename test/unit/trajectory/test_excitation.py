"""Excitations: spectra, periods, crest factors and seeds against closed forms."""

from __future__ import annotations

import math
import tracemalloc
from typing import Any

import numpy as np
import pytest
import scipy.signal

from dfm_stage.trajectory import EXCITATION_KINDS, Excitation, TrajectoryError, make_excitation

DT = 1e-3


def made(kind: str, duration_s: float = 16.0, seed: int = 0, **settings: Any) -> Excitation:
    return make_excitation({"kind": kind, **settings}, sample_period_s=DT, duration_s=duration_s,
                           seed=seed)


def lines_of(signal: np.ndarray) -> np.ndarray:
    spectrum = np.abs(np.fft.rfft(signal)) / signal.size
    return np.flatnonzero(spectrum > 1e-10)


@pytest.mark.parametrize("odd", [False, True])
def test_multisine_has_exactly_the_wanted_lines_with_equal_amplitude(odd: bool) -> None:
    e = made("multisine", low_hz=1.0, high_hz=70.0, period_s=8.0, odd=odd)
    wanted = np.arange(8, 561)
    wanted = wanted[wanted % 2 == 1] if odd else wanted
    assert np.array_equal(lines_of(e.voltage[:8000]), wanted)
    assert np.array_equal(e.excited_lines, wanted)
    assert np.allclose(e.excited_hz, wanted / 8.0)
    amplitude = np.abs(np.fft.rfft(e.voltage[:8000]))[wanted]
    assert np.ptp(amplitude) < 1e-9 * amplitude[0]


def test_detection_lines_are_one_odd_line_of_every_group() -> None:
    e = made("multisine", period_s=8.0, odd=True, detection_lines=True, group=4)
    odd = np.arange(9, 561, 2)
    assert np.array_equal(np.union1d(e.excited_lines, e.detection_lines), odd)
    assert np.array_equal(lines_of(e.voltage[:8000]), e.excited_lines)
    assert e.detection_lines.size == odd.size // 4
    for i in range(odd.size // 4):
        assert np.intersect1d(odd[4 * i:4 * i + 4], e.detection_lines).size == 1
    assert np.unique((e.detection_lines - 9) // 2 % 4).size > 1   # not always the same place


def test_multisine_repeats_to_the_last_bit_and_peaks_at_the_amplitude() -> None:
    e = made("multisine", amplitude_v=0.08, period_s=8.0)
    assert np.array_equal(e.voltage[:8000], e.voltage[8000:])
    assert np.max(np.abs(e.voltage)) == pytest.approx(0.08, rel=1e-12)
    rms = math.sqrt(np.mean(e.voltage**2))
    assert e.crest_factor == pytest.approx(0.08 / rms, rel=1e-9)
    assert (e.period_samples, e.periods) == (8000, 2)


@pytest.mark.parametrize("kind", ["multisine", "sine"])
def test_an_rms_replaces_the_amplitude(kind: str) -> None:
    e = made(kind, rms_v=0.03)
    assert math.sqrt(np.mean(e.voltage**2)) == pytest.approx(0.03, rel=1e-9)


def test_the_seed_fixes_phases_and_detection_lines() -> None:
    spec = {"odd": True, "detection_lines": True}
    first, again, other = (made("multisine", seed=s, **spec) for s in (3, 3, 4))
    assert np.array_equal(first.voltage, again.voltage)
    assert not np.array_equal(first.voltage, other.voltage)
    assert not np.array_equal(first.detection_lines, other.detection_lines)


def test_phases_are_random_over_the_circle() -> None:
    e = made("multisine", low_hz=0.5, high_hz=400.0, period_s=8.0)
    phase = np.angle(np.fft.rfft(e.voltage[:8000])[e.excited_lines])
    assert abs(np.mean(np.exp(1j * phase))) < 4.0 / math.sqrt(phase.size)


def test_ramp_and_number_of_periods() -> None:
    plain, ramped = made("multisine"), made("multisine", ramp_s=1.0, periods=1)
    assert ramped.voltage[0] == 0.0
    assert ramped.voltage[500] == pytest.approx(0.5 * plain.voltage[500], rel=1e-12)
    assert np.array_equal(ramped.voltage[1000:8000], plain.voltage[1000:8000])
    assert not ramped.voltage[8000:].any()
    assert (ramped.ramp_samples, ramped.periods) == (1000, 1)


@pytest.mark.parametrize(("sweep", "method"), [("linear", "linear"),
                                               ("logarithmic", "logarithmic")])
def test_chirp_is_scipys(sweep: str, method: str) -> None:
    e = made("chirp", amplitude_v=0.1, low_hz=1.0, high_hz=70.0, period_s=10.0, sweep=sweep)
    t = np.arange(10000) * DT
    peer = scipy.signal.chirp(t, 1.0, 10.0, 70.0, method=method, phi=-90.0)
    assert np.allclose(e.voltage[:10000], 0.1 * peer, atol=1e-9)
    assert not e.voltage[10000:].any()


def test_sweeps_repeat_when_asked() -> None:
    e = made("chirp", period_s=4.0, periods=0, ramp_s=0.1)
    assert np.array_equal(e.voltage[:4000], e.voltage[12000:])
    assert e.period_samples == 4000
    assert e.crest_factor == pytest.approx(np.max(np.abs(e.voltage))
                                           / math.sqrt(np.mean(e.voltage**2)), rel=1e-9)


@pytest.mark.parametrize("sweep", ["linear", "logarithmic"])
def test_a_sweep_longer_than_the_run_takes_memory_for_the_run_only(sweep: str) -> None:
    tracemalloc.start()
    try:
        e = made("chirp", duration_s=1.0, low_hz=1.0, high_hz=70.0, amplitude_v=0.1,
                 period_s=19_000.0, sweep=sweep)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    peer = scipy.signal.chirp(np.arange(1000) * DT, 1.0, 19_000.0, 70.0, method=sweep, phi=-90.0)
    assert np.allclose(e.voltage, 0.1 * peer, atol=1e-9)
    assert e.period_samples == 19_000_000
    assert peak < 5e6      # 19 million samples take 150 MB


def test_sine_period_is_known_only_if_whole() -> None:
    assert made("sine", frequency_hz=5.0).period_samples == 200
    assert np.array_equal(made("sine", frequency_hz=5.0).excited_hz, [5.0])
    assert made("sine", frequency_hz=7.0).period_samples == 0
    five = made("sine", frequency_hz=7.0, periods=5)
    assert np.flatnonzero(five.voltage)[-1] == round(5 / 7.0 / DT) - 1


def test_steps_of_voltage_up_and_down() -> None:
    e = made("steps", levels_v=[0.0, 0.5, 1.0], dwell_s=2.0, down_again=True)
    assert np.allclose(e.voltage[::2000], [0.0, 0.5, 1.0, 0.5, 0.0, 0.0, 0.0, 0.0])


def test_metadata_is_plain() -> None:
    import json
    e = made("multisine", odd=True, detection_lines=True)
    again = json.loads(json.dumps(e.metadata()))
    assert again["excited_lines"] == list(e.excited_lines)
    assert json.loads(json.dumps(made("hold").metadata()))["crest_factor"] is None


@pytest.mark.parametrize(("settings", "part"), [
    ({"period_s": 8.0003}, "8000.3 samples of 0.001 s"),
    ({"high_hz": 500.0}, "not below half the sample rate"),
    ({"low_hz": 80.0}, "low_hz = 80 Hz is above high_hz"),
    ({"low_hz": 1.01, "high_hz": 1.02}, "no line of 0.125 Hz lies in"),
    ({"detection_lines": True}, "needs odd: true"),
    ({"odd": True, "detection_lines": True, "group": 1000}, "do not fill one group"),
    ({"odd": True, "detection_lines": True, "group": 3.5}, "must be a whole number"),
])
def test_a_multisine_that_cannot_be_is_refused(settings: dict[str, Any], part: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        made("multisine", **settings)
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", sorted({*EXCITATION_KINDS} - {"csv"}))
def test_defaults_make_a_signal(kind: str) -> None:
    e = made(kind)
    assert e.voltage.shape == (16000,)
    assert np.isfinite(e.voltage).all()
