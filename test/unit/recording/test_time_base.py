"""Jittered samples against the function they were taken from; the error is as stated."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dfm_stage.recording import Record, RecordError, read_record
from dfm_stage.recording.time_base import (
    TimeBase,
    average_held,
    find_time_base,
    read_stamps,
    resample,
)

PERIOD = 1e-3
COUNT = 4000
Signal = Callable[[np.ndarray], np.ndarray]
SIGNALS: dict[str, Signal] = {
    "sine 5 Hz": lambda t: 1e-4 * np.sin(2 * np.pi * 5 * t),
    "sine 40 Hz": lambda t: 1e-4 * np.sin(2 * np.pi * 40 * t),
    "sine 120 Hz": lambda t: 1e-4 * np.sin(2 * np.pi * 120 * t),
    "many": lambda t: sum(1e-5 * np.sin(2 * np.pi * f * t + f) for f in (3, 11, 29, 53, 71)),
    "ring-down": lambda t: 1e-3 * np.exp(-3 * t) * np.cos(2 * np.pi * 24 * t),
}


def jittered(signal: Signal, share: float, seed: int, folder: Path) -> tuple[Record, np.ndarray]:
    """Read a CSV sampled unevenly; return the record and the truth at its own time stamps."""
    rng = np.random.default_rng(seed)
    time = PERIOD * (np.arange(COUNT) + share * rng.uniform(-1, 1, COUNT))
    drive = rng.normal(size=COUNT)
    lines = ["time_s,input_v,position_m"] + [
        f"{t!r},{u!r},{x!r}" for t, u, x in zip(time.tolist(), drive.tolist(),
                                                signal(time).tolist(), strict=True)]
    path = folder / "jitter.csv"
    path.write_text("\n".join(lines))
    record = read_record(path)
    return record, signal(record.time)


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
def test_the_resampling_error_is_as_stated(name: str, share: float, tmp_path: Path) -> None:
    record, truth = jittered(SIGNALS[name], share, 4, tmp_path)
    note = next(text for text in record.warnings if "estimated error" in text)
    match = re.search(r"estimated error ([\d.e+-]+) m rms", note)
    assert match is not None
    stated = float(match[1])
    actual = float(np.sqrt(np.mean((record.axis().position - truth)**2)))
    assert actual <= 1.3 * stated + 1e-17
    assert actual >= 0.2 * stated - 1e-17
    assert actual < 0.2 * float(np.sqrt(np.mean(truth**2)))
    jitter = next(text for text in record.warnings if "jitter by" in text)
    assert f"{share * PERIOD / 3**0.5:.1g}" in f"{float(jitter.split()[4]):.1g}"
    assert record.sample_period == pytest.approx(PERIOD, rel=1e-4)


def test_even_samples_are_left_alone(tmp_path: Path) -> None:
    record, truth = jittered(SIGNALS["many"], 1e-5, 1, tmp_path)
    assert record.warnings == []
    assert np.abs(record.axis().position - truth).max() < 1e-9


@pytest.mark.parametrize(("stamps", "samples", "moved"), [
    (0.1, 0.0, False),   # a timer samples, and a computer stamps late
    (0.1, 0.1, True), (0.3, 0.3, True)])
def test_the_motion_says_whether_samples_or_only_stamps_jitter(stamps, samples, moved,
                                                               tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    late = rng.uniform(-1, 1, COUNT)
    time, taken = (PERIOD * (np.arange(COUNT) + share * late) for share in (stamps, samples))
    drive, noise = rng.normal(size=(2, COUNT))
    position = SIGNALS["sine 40 Hz"](taken) + 3e-7 * noise
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack((time, drive, position)), fmt="%.12e", delimiter=",",
               header="time_s,input_v,position_m", comments="")
    record = read_record(path)
    assert bool(np.abs(record.axis().position - position).max() > 1e-9) == moved
    assert moved or np.allclose(record.axis().input, drive, rtol=1e-11)
    assert any("the stamps tell the period only" in w for w in record.warnings) != moved


@pytest.mark.parametrize("by_timer", [True, False])
@pytest.mark.parametrize("noise", [0.0, 3e-3])
def test_the_motion_says_whether_the_input_jitters_with_the_samples(by_timer, noise) -> None:
    """A lag of 20 ms behind an input that a timer sets, or a loop that wakes late."""
    rng = np.random.default_rng(6)
    late = np.minimum(0.1 * np.abs(rng.standard_normal(COUNT)), 0.4)
    drive, tick = rng.normal(size=COUNT), PERIOD * np.arange(COUNT)
    taken = tick + PERIOD * late
    sets = tick if by_timer else taken
    states = np.zeros(COUNT + 1)     # at the times at which the input is set
    for k in range(COUNT - 1):
        states[k + 1] = drive[k] + (states[k] - drive[k]) * np.exp((sets[k] - sets[k + 1]) / 0.02)
    position = drive + (states[:-1] - drive) * np.exp((sets - taken) / 0.02)
    base = base_of(taken)
    assert base.jitter is not None
    seen = position + noise * np.std(position) * rng.normal(size=COUNT)
    found = read_stamps(base, [(drive, seen)], held=True)
    assert found.input_late != by_timer
    assert np.allclose(found.jitter, taken - tick, atol=5e-3 * PERIOD) or not by_timer
    assert read_stamps(base, [(drive, seen)], held=False) is base


def base_of(time: np.ndarray, gaps: str = "longest") -> TimeBase:
    return find_time_base(time, np.arange(len(time)), lambda row: f"row {row}", gaps)


def test_a_held_input_keeps_its_impulse() -> None:
    rng = np.random.default_rng(9)
    time = PERIOD * (np.arange(500) + 0.2 * rng.uniform(-1, 1, 500))
    drive = rng.normal(size=500)
    base = base_of(time)
    even = average_held(drive, base)
    fine = np.linspace(base.time[0], base.time[-1], 500_001)
    held = drive[np.clip(np.searchsorted(time, fine, side="right") - 1, 0, 499)]
    impulse = np.concatenate(([0], np.cumsum(held[:-1] * np.diff(fine))))
    ours = np.concatenate(([0], np.cumsum(even[:-1] * base.period)))
    assert np.abs(ours - np.interp(base.time, fine, impulse)).max() < 5e-5
    assert np.allclose(average_held(np.ones(500), base), 1.0)


def test_gaps_and_masks() -> None:
    time = PERIOD * np.delete(np.arange(1000.0), [100, 101, 700])
    longest = base_of(time)
    assert longest.length == 598
    assert longest.time[0] == pytest.approx(0.102)
    assert longest.rows[0] == 100
    masked = base_of(time, "mask")
    assert masked.length == 1000
    assert np.setdiff1d(np.arange(1000), masked.index).tolist() == [100, 101, 700]
    assert "3 samples are missing before row 100 (0.003 s at 0.099 s)" in masked.notes[0]


def test_what_is_no_time_base() -> None:
    for time, words in ((np.array([0.0, 1.0]), "only 2 usable rows"),
                        (np.array([0.0, 1.0, 0.5, 2.0]), "row 2: time goes back"),
                        (np.zeros(10), "time stands still"),
                        (np.cumsum(np.random.default_rng(0).exponential(size=99)), "no sample")):
        with pytest.raises(RecordError, match=words):
            base_of(time)


def test_resampling_exact_cubics_is_exact() -> None:
    rng = np.random.default_rng(12)
    time = PERIOD * (np.arange(200) + 0.3 * rng.uniform(-1, 1, 200))
    base = base_of(time)

    def cubic(t: np.ndarray) -> np.ndarray:
        return 3 - 20 * t + 400 * t**2 - 900 * t**3

    values, error = resample(cubic(time), base)
    assert np.abs(values - cubic(base.time)).max() < 1e-11
    assert error < 1e-11


def test_a_late_stamp_is_no_lost_sample() -> None:
    """A logger that was held up stamps some rows late, and then goes on in time."""
    rng = np.random.default_rng(6)
    index = np.setdiff1d(np.arange(2000), [500, 1300, 1301])
    time = 1e-3 * (index + 0.1 * rng.exponential(size=len(index)))
    time[[100, 700, 1600]] += 0.8e-3
    base = find_time_base(time, np.arange(len(time)), str, "mask")
    assert base.index.tolist() == index.tolist()
    assert any("3 samples are missing before 500 " in note for note in base.notes)
