"""Bags to records: samples by number, inputs by the measurement they answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys.store import Typestore

from dfm_stage.recording import BagWriter, RecordError, read_record

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 1_000_000
COUNT = 400


@dataclass
class Story:
    """What happened on one axis; the numbers of samples that are missing, by topic."""

    count: int = COUNT
    first_seq: int = 0
    stamp_ns: int = START_NS
    jitter_ns: float = 0.0
    step: tuple[int, int] = (0, 0)      # from that sample on, stamps are this many ns later
    lost: dict[str, set[int]] = field(default_factory=dict)
    unanswered: set[int] = field(default_factory=set)
    late: set[int] = field(default_factory=set)
    current: bool = True
    topics: tuple[str, ...] = ("reference", "excitation", "measurement", "command", "amplifier",
                               "plant")
    extra: list[tuple[str, Any, int]] = field(default_factory=list)


NAMES = {"reference": "Reference", "excitation": "Excitation", "measurement": "Measurement",
         "command": "Command", "amplifier": "AmplifierState", "plant": "PlantState"}
REAL = ("position", "velocity", "acceleration", "voltage", "current", "force")
Entry = tuple[int, str, bytes, int]     # log time, topic, message, sample


class Teller:
    """Writes bags in which input[k] = k + 1, position[k] = 1e-3 k, and so on."""

    def __init__(self, folder: Path, typestore: Typestore, schema: Callable[[str], str]) -> None:
        self.folder = folder
        self.typestore = typestore
        self.schema = schema

    def message(self, topic: str, stamp: int, fields: dict[str, Any]) -> bytes:
        kind = f"dfm_interfaces/msg/{NAMES[topic]}"
        types = self.typestore.types
        time = types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        values = {name: fields.get(name, 0) for name, _ in self.typestore.fielddefs[kind][1]}
        values |= {name: float(value) for name, value in values.items() if name in REAL}
        values["header"] = types["std_msgs/msg/Header"](time, "x")
        if topic == "command":
            values["measurement_stamp"] = time
        return bytes(self.typestore.serialize_cdr(types[kind](**values), kind))

    def rows(self, story: Story, k: int) -> dict[str, tuple[int, dict[str, Any]]]:
        """What is said about sample k: by topic, how much later, and the fields."""
        seq = (story.first_seq + k) % 2**32
        rows: dict[str, tuple[int, dict[str, Any]]] = {
            "plant": (0, {"seq": seq, "position": k * 1e-3 + 1e-7, "velocity": 1.0}),
            "measurement": (0, {"seq": seq, "position": k * 1e-3, "counts": k}),
            "reference": (0, {"seq": seq, "position": k * 2e-3}),
            "excitation": (0, {"seq": seq, "voltage": 0.25})}
        if k not in story.unanswered:
            lag = 2_500_000 if k in story.late else 300_000
            rows["command"] = (lag, {"measurement_seq": seq, "voltage": k + 1.5})
            rows["amplifier"] = (lag + 100_000, {
                "measurement_seq": seq, "voltage": k + 1, "enabled": True,
                "current": 0.1 * k if story.current else np.nan})
        return rows

    def entries(self, story: Story, seed: int) -> list[Entry]:
        """All messages of an axis, each topic in order, the topics late by different amounts."""
        rng = np.random.default_rng(seed)
        said: list[tuple[int, int, str, dict[str, Any], int]] = []
        for k in range(story.count):
            stamp = story.stamp_ns + k * PERIOD_NS + round(story.jitter_ns * rng.normal())
            stamp += story.step[1] if k >= story.step[0] else 0
            said += [(stamp + lag, int(rng.integers(3_000_000)), topic, fields, k)
                     for topic, (lag, fields) in self.rows(story, k).items()]
            said += [(story.stamp_ns + fields["stamp_ns"], 0, topic, fields, k)
                     for topic, fields, at in story.extra if at == k]
        order = dict.fromkeys(NAMES, 0)
        latest = dict.fromkeys(NAMES, 0)
        entries = []
        for stamp, delay, topic, fields, k in said:
            if "measurement_seq" in fields:
                fields = {**fields, "seq": order[topic]}  # noqa: PLW2901
                order[topic] += 1
            if topic in story.topics and k not in story.lost.get(topic, ()):
                latest[topic] = max(latest[topic] + 1, stamp + delay)
                entries.append((latest[topic], topic, self.message(topic, stamp, fields), k))
        return entries

    def __call__(self, **axes: Story) -> Path:
        path = self.folder / "bag"
        entries = [(log, f"/stage/{axis}/{topic}", topic, data, k)
                   for seed, (axis, story) in enumerate(axes.items())
                   for log, topic, data, k in self.entries(story, seed)]
        with BagWriter(path) as bag:
            bag.attach("model.yaml", "application/yaml",
                       b"dfm_model: 1\nname: test\nsample_period: 0.001\n")
            bag.attach("versions.json", "application/json", b'{"dfm_stage": "0.1.0"}')
            bag.attach("parameters.yaml", "application/yaml", b'{"/x": {"parameters": {}}}')
            numbers: dict[str, int] = {}
            for log, name, topic, data, k in sorted(entries, key=lambda entry: entry[0]):
                if name not in numbers:
                    kind = f"dfm_interfaces/msg/{NAMES[topic]}"
                    numbers[name] = bag.add_topic(name, kind, [], "", self.schema(kind))
                bag.write(numbers[name], data, log, log, k)
        return path


@pytest.fixture
def tell(tmp_path: Path, typestore: Typestore, schema: Callable[[str], str]) -> Teller:
    return Teller(tmp_path, typestore, schema)


def test_samples_belong_together_by_number_not_by_arrival(tell: Teller) -> None:
    record = read_record(tell(x=Story()))
    axis, k = record.axis(), np.arange(COUNT)
    assert record.warnings == []
    assert record.sample_period == 0.001
    assert (record.time == k * 0.001).all()
    assert (axis.input == k + 1).all()
    assert (axis.position == k * 1e-3).all()
    assert axis.current is not None
    assert axis.reference is not None
    assert np.allclose(axis.current, 0.1 * k, atol=0)
    assert (axis.reference == k * 2e-3).all()
    assert (axis.extra["command"] == k + 1.5).all()
    assert (axis.extra["excitation"] == 0.25).all()
    assert (axis.extra["plant_position"] == k * 1e-3 + 1e-7).all()
    assert (axis.input_unit, axis.position_unit) == ("V", "m")
    provenance = record.provenance
    assert provenance.kind == "bag"
    assert provenance.start_ns == START_NS
    assert provenance.model is not None
    assert provenance.model.startswith("dfm_model")
    assert provenance.versions == {"dfm_stage": "0.1.0"}
    assert provenance.parameters == {"/x": {"parameters": {}}}
    assert provenance.fingerprint.startswith("sha256:")


def test_numbers_may_wrap(tell: Teller) -> None:
    record = read_record(tell(x=Story(first_seq=2**32 - 150)))
    assert (record.axis().input == np.arange(COUNT) + 1).all()
    assert record.warnings == []


def test_a_current_that_was_not_measured_is_none(tell: Teller) -> None:
    assert read_record(tell(x=Story(current=False))).axis().current is None


def test_the_command_stands_in_for_an_amplifier_that_was_not_recorded(
        tell: Teller) -> None:
    record = read_record(tell(x=Story(topics=("measurement", "command"))))
    assert (record.axis().input == np.arange(COUNT) + 1.5).all()
    assert record.axis().reference is None
    assert record.warnings == [
        "/stage/x/amplifier was not recorded; the command is taken as the input"]


def test_lost_measurements_leave_a_gap(tell: Teller) -> None:
    path = tell(x=Story(lost={"measurement": {130, 131, 300}}))
    record = read_record(path)
    assert (record.axis().position == np.arange(132, 300) * 1e-3).all()
    assert (record.axis().input == np.arange(132, 300) + 1).all()
    assert record.provenance.start_ns == START_NS + 132 * PERIOD_NS
    assert record.warnings == [
        "3 samples are missing in 2 gaps, at 0.13 s (2), 0.3 s (1)",
        "the longest stretch without a gap was kept: 168 of 400 samples"]
    masked = read_record(path, gaps="mask")
    assert len(masked) == COUNT
    assert np.flatnonzero(np.isnan(masked.axis().position)).tolist() == [130, 131, 300]
    assert masked.warnings == ["3 samples are missing in 2 gaps, at 0.13 s (2), 0.3 s (1)"]


def test_a_lost_amplifier_message_is_unknown_input(tell: Teller) -> None:
    record = read_record(tell(x=Story(lost={"amplifier": {20, 21}})), gaps="mask")
    assert np.flatnonzero(np.isnan(record.axis().input)).tolist() == [20, 21]
    assert ("/stage/x/amplifier: messages are missing; the input of 2 samples is not known"
            in record.warnings)


def test_an_unanswered_sample_keeps_the_output_before_it(tell: Teller) -> None:
    record = read_record(tell(x=Story(unanswered={20, 21, 50})))
    expected = np.arange(COUNT) + 1.0
    expected[[20, 21, 50]] = [20, 20, 50]
    assert (record.axis().input == expected).all()
    assert ("/stage/x/amplifier: 3 samples had no answer; the output before them stood"
            in record.warnings)


def test_an_output_switched_off_in_between_counts_from_then(tell: Teller) -> None:
    off = ("amplifier", {"measurement_seq": 99, "voltage": 0.0, "enabled": True, "faults": 1,
                         "stamp_ns": 104 * PERIOD_NS + 400_000}, 99)
    record = read_record(tell(x=Story(unanswered=set(range(100, 110)), extra=[off])))
    expected = np.arange(COUNT) + 1.0
    expected[100:104] = 100.0
    expected[104:110] = 0.0
    assert (record.axis().input == expected).all()
    assert "/stage/x/amplifier: 1 messages report faults" in record.warnings


def test_late_answers_act_when_they_come(tell: Teller) -> None:
    record = read_record(tell(x=Story(late={200})))
    expected = np.arange(COUNT) + 1.0
    expected[200] = 200.0     # the output of sample 199 still stands
    assert record.axis().input[:202].tolist() == expected[:202].tolist()
    assert any("1 answers came more than a period late" in text for text in record.warnings)


def test_what_comes_before_the_first_input_is_left_out(tell: Teller) -> None:
    record = read_record(tell(x=Story(unanswered=set(range(30)))))
    assert len(record) == COUNT - 30
    assert record.axis().position[0] == 0.03
    assert record.warnings == [
        "the first 30 samples (0.03 s) have no input yet and were left out"]


def test_two_axes_share_a_time_base(tell: Teller) -> None:
    path = tell(x=Story(), y=Story(first_seq=7000, stamp_ns=START_NS + 25 * PERIOD_NS))
    record = read_record(path)
    assert list(record.axes) == ["x", "y"]
    assert len(record) == COUNT - 25
    assert (record.axis("x").input == np.arange(25, COUNT) + 1).all()
    assert (record.axis("y").input == np.arange(COUNT - 25) + 1).all()
    assert list(read_record(path, axis="y").axes) == ["y"]
    with pytest.raises(RecordError, match=r"several axes; choose one of x, y$"):
        record.axis()
    with pytest.raises(RecordError, match=r"no axis z; there are none$"):
        read_record(path, axis="z")


def test_uneven_stamps_are_reported_with_what_they_are_worth(tell: Teller) -> None:
    record = read_record(tell(x=Story(jitter_ns=100_000)))
    assert (record.axis().input == np.arange(COUNT) + 1).all()
    note = next(text for text in record.warnings if "wander" in text)
    assert "0.001 s" in note
    assert "m rms" in note


def test_a_clock_that_steps_does_not_change_the_period(tell: Teller) -> None:
    path = tell(x=Story(step=(150, -3 * 10**9)))
    record = read_record(path)
    assert record.sample_period == 0.001
    assert (record.axis().input == np.arange(COUNT) + 1).all()
    note = ("/stage/x/measurement: the clock was set 1 times while recording, first by -3 s; "
            "samples were taken by their numbers")
    assert record.warnings == [note]
    assert read_record(path, sample_period=0.002).sample_period == 0.002


def test_bags_without_a_record(tell: Teller, tmp_path: Path) -> None:
    with pytest.raises(RecordError, match=r"bag: holds no measurement topic of an axis, only"):
        read_record(tell(x=Story(topics=("command",))))
    for name, topics, words in (("b", ("measurement",), "record those topics too"),
                                ("c", ("measurement", "amplifier"), "at least 3")):
        folder = tmp_path / name
        folder.mkdir()
        (tmp_path / "bag").rename(folder / "old")
        path = tell(x=Story(topics=topics, count=2 if name == "c" else 50))
        with pytest.raises(RecordError, match=words) as caught:
            read_record(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    with pytest.raises(RecordError, match="bag: 'u' names no field of a topic"):
        read_record(path, input="u", output="y")
    with pytest.raises(RecordError, match="bag: is a bag: name the fields"):
        read_record(path, time="t")


def test_damage_in_the_bag_shows_in_the_warnings(tell: Teller) -> None:
    path = tell(x=Story())
    file = next(path.glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(data[:-50])
    record = read_record(path)
    assert len(record) == COUNT
    assert any("index at the end is damaged" in text for text in record.warnings)
