"""Long records: which stretches are chosen of them, and that the answer is made from these."""

from __future__ import annotations

import numpy as np
import pytest
import truth

from dfm_stage.diagnosis import diagnose, stretches
from dfm_stage.recording import AxisRecord, Provenance, Record

LENGTH = 1000
DAMPING = 30.0
"""N s/m; the stage stands still soon after a burst."""
SIZES = (0.05, 0.3, 1.0)
"""Amplitudes of the bursts (V), in turn; each lasts two stretches, and two of rest follow."""


def _bursts(count: int, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    time = truth.PERIOD * np.arange(2 * LENGTH)
    parts = []
    for k in range(count):
        waves = np.sin(2 * np.pi * np.outer(rng.uniform(1.0, 40.0, 12), time)
                       + rng.uniform(0.0, 2 * np.pi, (12, 1)))
        parts += [SIZES[k % 3] * waves.sum(axis=0) / 5.0, np.zeros(2 * LENGTH)]
    return np.concatenate(parts)


@pytest.fixture(scope="module")
def long_record() -> Record:
    feed = _bursts(12)
    return truth.record(feed, truth.move(feed, lambda x, v: -4.0e6 * x**3, damping=DAMPING), 5)


@pytest.fixture
def _shorter(monkeypatch):
    monkeypatch.setattr(stretches, "STRETCH", LENGTH)
    monkeypatch.setattr(stretches, "LONG_RECORD", 20 * LENGTH)


@pytest.mark.usefixtures("_shorter")
def test_stretches_come_from_every_size_of_motion_and_part_of_the_record(long_record):
    found = stretches.choose(long_record, long_record.axis(), "run", 6, 3)
    assert len({*found.fitted, *found.held}) == 9
    for starts in (found.fitted, found.held):
        bursts = [start // (4 * LENGTH) for start in starts]
        assert all(start % (4 * LENGTH) < 2 * LENGTH for start in starts)       # none at rest
        assert sorted({burst % 3 for burst in bursts}) == [0, 1, 2]             # every size
        assert sorted({burst // 4 for burst in bursts}) == [0, 1, 2]            # every third
    assert found.still == pytest.approx(0.5)


@pytest.mark.usefixtures("_shorter")
def test_missing_samples_are_not_chosen(long_record):
    axis = long_record.axis()
    holed = axis.position.copy()
    holed[::4 * LENGTH] = np.nan                     # the first half of every burst
    found = stretches.choose(Record(long_record.time, long_record.sample_period,
                                    {"x": AxisRecord(axis.input, holed)}, Provenance("r", "csv")),
                             AxisRecord(axis.input, holed), "run", 6, 3)
    assert all(start % (4 * LENGTH) == LENGTH for start in (*found.fitted, *found.held))


@pytest.mark.usefixtures("_shorter")
def test_a_long_record_is_diagnosed_by_stretches_and_says_so(long_record):
    found = diagnose([long_record], truth.believed(damping=DAMPING), names=["hour"],
                     library=["cubic_stiffness", "coulomb_friction"])
    assert (found.verdict, found.names) == ("named", ("cubic_stiffness",))
    assert found.effects[0].parameters["k3"].covers(4.0e6)
    assert len(found.comparisons) == 9
    assert sum(each.held_out for each in found.comparisons) == 3
    told = found.to_dict()["stretches"]
    assert [each["record"] for each in told] == ["hour"]
    assert (told[0]["of_s"], told[0]["length_s"]) == (48.0, 1.0)
    fitted = [c.time[0] for c in found.comparisons if not c.held_out]
    assert sorted(begin for begin, _ in told[0]["fitted_s"]) == pytest.approx(
        sorted(fitted), abs=0.05)                    # the lead-in is not compared
    assert "hour: 9 stretches of 1 s (6 fitted, 3 held out), chosen of 48 s" in found.warnings[0]
    assert not any("last 30 %" in warning for warning in found.warnings)
    assert [c["record"] for c in found.conventions] == ["hour"]
    assert found.model.effect("cubic_stiffness").origin["diagnosed_from"] == ["hour"]


@pytest.mark.usefixtures("_shorter")
def test_a_record_that_is_held_out_is_predicted_by_its_stretches(long_record):
    train = truth.multisine(1)
    found = diagnose([truth.record(train, truth.move(train, damping=DAMPING), 11)],
                     truth.believed(damping=DAMPING),
                     holdout=[long_record], names=["short", "hour"], library=[])
    assert [(s.record, len(s.fitted), len(s.held)) for s in found.stretches] == [("hour", 0, 3)]
    assert [c.name.partition(",")[0] for c in found.comparisons] == ["short", *["hour"] * 3]


@pytest.mark.usefixtures("_shorter")
@pytest.mark.parametrize(("fall", "differs"), [(0.02, True), (0.0, False)])
def test_a_stiffness_that_falls_over_the_record_is_told(fall, differs):
    feed = _bursts(12)
    thirds = np.split(feed, 3)
    position = np.concatenate([truth.move(part, damping=DAMPING,
                                          stiffness=truth.STIFFNESS * (1.0 - fall * k / 2.0))
                               for k, part in enumerate(thirds)])     # at rest at each cut
    found = diagnose([truth.record(feed, position, 5)], truth.believed(damping=DAMPING),
                     names=["hour"], library=["cubic_stiffness"])
    told = [w for w in found.warnings if "stiffness differs between" in w]
    assert bool(told) == differs
    assert len(told) <= 1
    assert not differs or told[0].startswith("hour: stiffness differs between the first and the "
                                             "last part of the record: ")


def test_a_record_of_the_longest_usual_length_is_taken_whole():
    samples = stretches.LONG_RECORD
    usual, long = (Record(np.zeros(n), 1e-3, {}, Provenance("r", "csv"))
                   for n in (samples, samples + 1))
    assert not stretches.is_long(usual)
    assert stretches.is_long(long)
