"""Bags of nodes that know nothing of us, as another library writes them: MCAP and SQLite."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys.store import Typestore

from dfm_stage.recording import (
    NotInBagError,
    RecordError,
    RecordingError,
    read_bag,
    read_record,
    sqlite_bag,
)
from dfm_stage.recording.arrivals import counted
from dfm_stage.recording.bag_fields import FieldPath, numeric_fields

START_NS = 1_700_000_000_000_000_000
STORAGES = (StoragePlugin.MCAP, StoragePlugin.SQLITE3)
Message = tuple[str, str, float, Any]   # topic, type, arrival in s, message
JOINTS, FLOAT, WRENCH = ("sensor_msgs/msg/JointState", "std_msgs/msg/Float64",
                         "geometry_msgs/msg/WrenchStamped")


class Maker:
    """Makes messages and bags."""

    def __init__(self, folder: Path, store: Typestore) -> None:
        self.folder, self.store, self.made = folder, store, 0

    def header(self, seconds: float) -> Any:
        stamp = START_NS + round(seconds * 1e9)
        return self.store.types["std_msgs/msg/Header"](
            self.store.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9), "base")

    def joints(self, stamp: float, position: Iterable[float], effort: Iterable[float] = (),
               names: Iterable[str] = ("joint_a", "joint_b")) -> Any:
        return self.store.types[JOINTS](
            self.header(stamp), list(names), np.array([*position], float), np.zeros(0),
            np.array([*effort], float))

    def number(self, value: float) -> Any:
        return self.store.types[FLOAT](value)

    def wrench(self, stamp: float, x: float) -> Any:
        vector = self.store.types["geometry_msgs/msg/Vector3"]
        return self.store.types[WRENCH](self.header(stamp), self.store.types[
            "geometry_msgs/msg/Wrench"](vector(x, 0.0, -1.0), vector(0.0, 2 * x, 0.0)))

    def bag(self, messages: Iterable[Message], storage: StoragePlugin = STORAGES[0]) -> Path:
        self.made += 1
        path = self.folder / f"bag_{self.made}"
        with Writer(path, version=9, storage_plugin=storage) as writer:
            links: dict[str, Any] = {}
            for topic, kind, arrival, message in sorted(messages, key=lambda each: each[2]):
                if topic not in links:
                    links[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(links[topic], START_NS + round(arrival * 1e9),
                             self.store.serialize_cdr(message, kind))
        return path


@pytest.fixture
def make(tmp_path: Path, typestore: Typestore) -> Maker:
    return Maker(tmp_path, typestore)


def sine(t: Any) -> Any:
    return np.sin(60.0 * np.asarray(t))


def states(make: Maker, stamps: Iterable[float], late: Callable[[int], float] = lambda _: 2e-4
           ) -> Iterator[Message]:
    """Joint states: effort 2 sine, position sine of joint_b; joint_a stands still."""
    for k, t in enumerate(stamps):
        yield ("/joint_states", JOINTS, t + late(k), make.joints(t, [0.5, sine(t)],
                                                                 [0.0, 2.0 * sine(t)]))


EVEN = [1e-3 * k for k in range(500)]


@pytest.mark.parametrize("storage", STORAGES)
def test_fields_of_joint_states_by_index_and_by_name(make: Maker, storage: StoragePlugin) -> None:
    path = make.bag(states(make, EVEN), storage)
    for index in ("[1]", "[joint_b]"):
        record = read_record(path, input=f"/joint_states.effort{index}",
                             output=f"/joint_states.position{index}")
        axis = record.axis()
        assert record.sample_period == pytest.approx(1e-3, rel=1e-9)
        assert axis.position == pytest.approx(sine(EVEN))
        assert axis.input == pytest.approx(2.0 * sine(EVEN))
        assert (axis.input_unit, axis.position_unit, axis.measures) == ("N m", "rad", "position")
        assert record.provenance.start_ns == START_NS
        assert record.provenance.fingerprint
        assert any("1000 Hz by header times" in text for text in record.warnings)


def test_a_joint_by_name_wherever_it_stands(make: Maker) -> None:
    def messages() -> Iterator[Message]:
        for k, t in enumerate(EVEN):
            swap = k % 2
            names, values = ["joint_a", "joint_b"], [7.0, float(sine(t))]
            yield "/joint_states", JOINTS, t, make.joints(
                t, values[::-1] if swap else values, values, names[::-1] if swap else names)
    record = read_record(make.bag(messages()), input="/joint_states.effort[0]",
                         output="/joint_states.position[joint_b]")
    assert record.axis().position == pytest.approx(sine(EVEN))


def test_jittered_stamps_are_resampled_with_the_stated_error(make: Maker) -> None:
    rng = np.random.default_rng(1)
    stamps = [t + 5e-5 * rng.uniform(-1, 1) for t in EVEN]
    record = read_record(make.bag(states(make, stamps)), input="/joint_states.effort[1]",
                         output="/joint_states.position[1]", input_hold="band_limited")
    axis = record.axis()
    start = (record.provenance.start_ns - START_NS) * 1e-9
    assert axis.position[3:-3] == pytest.approx(sine(start + record.time)[3:-3], abs=1e-6)
    assert axis.input[3:-3] == pytest.approx(2 * sine(start + record.time)[3:-3], abs=1e-6)
    assert any("by header times, which wander by" in text for text in record.warnings)
    assert any("estimated error" in text for text in record.warnings)


@pytest.mark.parametrize(("rate", "hold"), [(250, None), (250, "band_limited"), (4000, None),
                                            (1000, "zero")])
def test_rates_are_joined_with_the_stated_distance(
        make: Maker, rate: int, hold: str | None) -> None:
    """A held input is the mean over each period, another one what it is at the sample."""
    sent = [k / rate + 3e-4 for k in range(-10, rate // 2 + 10)]
    path = make.bag([*states(make, EVEN),
                     *(("/force", WRENCH, t, make.wrench(t, sine(t))) for t in sent)])
    record = read_record(path, input="/force.wrench.force.x", output="/joint_states.position[1]",
                         input_hold=hold)
    axis = record.axis()
    assert len(record) == 500
    assert axis.input_unit == "N"
    fine = np.arange(0.0, 0.5, 1e-5)
    held = sine(np.array(sent)[np.searchsorted(sent, fine + 1e-9) - 1]).reshape(-1, 100).mean(1)
    wanted = sine(record.time) if hold == "band_limited" else held
    assert axis.input == pytest.approx(wanted, abs=2e-4 if hold == "band_limited" else 0.002)
    text = next(each for each in record.warnings if "nearest message" in each)
    away = np.abs(np.subtract.outer(record.time, sent)).min(axis=1)
    assert f"{np.sqrt(np.mean(away**2)):.3g} s away rms, {away.max():.3g} s at most" in text


def test_without_a_header_the_arrival_counts(make: Maker) -> None:
    rng = np.random.default_rng(4)
    late = 1e-3 * rng.exponential(0.3, 2000)
    late[700:705] = [6e-3, 5e-3, 4e-3, 3e-3, 2e-3]     # a stall, and then a burst
    path = make.bag([("/y", FLOAT, 1e-3 * k + late[k], make.number(float(sine(1e-3 * k))))
                     for k in range(2000) if k not in (300, *range(1200, 1210))]
                    + [("/u", FLOAT, 1e-3 * k, make.number(float(k // 100 % 2)))
                       for k in range(2000)])
    record = read_record(path, input="/u.data", output="/y.data", gaps="mask", input_unit="A",
                         output_unit="mm")
    axis = record.axis()
    assert record.sample_period == pytest.approx(1e-3, rel=1e-3)
    holes = np.flatnonzero(np.isnan(axis.position))
    assert len(holes) == 10         # one is filled in, ten are not
    assert np.abs(holes - np.arange(1200, 1210)).max() <= 2
    known = np.isfinite(axis.position)
    assert axis.position[known] == pytest.approx(1e-3 * sine(1e-3 * np.arange(len(record)))[known],
                                                 abs=1.5e-4)
    said = " ".join(record.warnings)
    assert "11 messages seem to be missing in 2 places" in said
    assert "1 samples lie in gaps of up to 3.5 periods and were filled in" in said
    assert "by publish times, which wander by" in said


def test_late_messages_are_not_lost_ones() -> None:
    rng = np.random.default_rng(3)
    for seed in range(5):
        late = np.random.default_rng(seed).exponential(0.5, 3000)
        late[1000:1040] += np.arange(40, 0, -1)
        time = np.maximum.accumulate(np.arange(3000) + late)
        assert counted(time).tolist() == list(range(3000))
        keep = np.sort(rng.choice(3000, 2990, replace=False))
        found = counted(time[keep])
        assert found[-1] - found[0] == pytest.approx(keep[-1] - keep[0], abs=2)


def test_header_and_arrival_may_be_chosen(make: Maker) -> None:
    path = make.bag(states(make, EVEN, late=lambda k: 0.25 + 1e-4 * (k % 2)))
    fields = {"input": "/joint_states.effort[1]", "output": "/joint_states.position[1]"}
    for time, start in (("header", 0.0), ("arrival", 0.25), ("publish", 0.25)):
        record = read_record(path, time=time, **fields)
        assert record.provenance.start_ns is not None
        assert (record.provenance.start_ns - START_NS) * 1e-9 == pytest.approx(start, abs=2e-4)
        assert any(f"{time} times" in text for text in record.warnings)
    stamp = read_record(path, time="/joint_states.header.stamp", **fields)
    assert stamp.provenance.start_ns == START_NS
    with pytest.raises(RecordError, match="not in the topic of both"):
        read_record(path, time="/other.t", **fields)


def test_a_header_on_another_clock_is_not_mixed_with_arrival(make: Maker) -> None:
    path = make.bag([*states(make, EVEN, late=lambda _: 1000.0),
                     *(("/u", FLOAT, 1000.0 + t, make.number(float(sine(t)))) for t in EVEN)])
    record = read_record(path, input="/u.data", output="/joint_states.position[1]")
    assert len(record) == 500
    assert any("arrival was used for both" in text for text in record.warnings)
    near = make.bag([*states(make, EVEN), *(("/u", FLOAT, t, make.number(float(sine(t))))
                                            for t in EVEN)])
    record = read_record(near, input="/u.data", output="/joint_states.position[1]")
    assert any("counts as delay" in text for text in record.warnings)


def test_messages_lost_on_the_input_are_a_gap_and_a_change_is_none(make: Maker) -> None:
    even = [("/u", FLOAT, t, make.number(3.0)) for k, t in enumerate(EVEN)
            if k not in (100, *range(200, 220))]
    record = read_record(make.bag([*states(make, EVEN), *even]), input="/u.data", gaps="mask",
                         output="/joint_states.position[1]", time="arrival")
    assert int(np.isnan(record.axis().input).sum()) in (20, 21)
    changes = [("/u", FLOAT, t, make.number(v)) for t, v in
               ((0.0, 1.0), (0.1004, 2.0), (0.11, 3.0), (0.4, 4.0), (0.41, 5.0), (0.9, 0.0))]
    record = read_record(make.bag([*states(make, EVEN), *changes]), input="/u.data",
                         output="/joint_states.position[1]")
    axis = record.axis()
    assert len(record) == 500
    assert axis.input[[50, 105, 200, 405, 450]].tolist() == pytest.approx([1, 2, 3, 4, 5])
    assert axis.input[100] == pytest.approx(1.6)
    assert any("comes unevenly" in text for text in record.warnings)


@pytest.mark.parametrize(("input_", "output", "words"), [
    ("/joint_states.effort[2]", "/joint_states.position[1]", "no message has this element"),
    ("/joint_states.effort[joint_c]", "/joint_states.position[1]", "only joint_a, joint_b"),
    ("/joint_states.effort", "/joint_states.position[1]", r"say which element"),
    ("/joint_states.velocity[0]", "/joint_states.position[1]", "no elements at most"),
    ("/joint_states.name[0]", "/joint_states.position[1]", "holds text"),
    ("/joint_states.torque[0]", "/joint_states.position[1]", "there are .*effort"),
    ("/joint_state.effort[0]", "/joint_states.position[1]", "no topic /joint_state"),
    ("joint_states.effort[0]", "/joint_states.position[1]", "write it as /joint_states"),
    ("/joint_states", "/joint_states.position[1]", "write it as /joint_states"),
    ("/joint_states.effort[1]", None, "name both"),
])
def test_what_is_not_there_is_one_line(make: Maker, input_: str, output: str | None,
                                       words: str) -> None:
    path = make.bag(states(make, EVEN[:20]))
    with pytest.raises((RecordError, NotInBagError), match=words) as caught:
        read_record(path, input=input_, output=output)
    assert isinstance(caught.value, RecordingError)
    assert "\n" not in str(caught.value)


def test_not_recorded_at_the_same_time_is_one_line(make: Maker) -> None:
    path = make.bag([*states(make, EVEN),
                     *(("/force", WRENCH, t, make.wrench(5.0 + t, 0.0)) for t in EVEN)])
    with pytest.raises(RecordError, match="not recorded at the same time"):
        read_record(path, input="/force.wrench.force.x", output="/joint_states.position[1]")


@pytest.mark.parametrize(("text", "column", "indices"), [
    ("/a.b", "b", ()), ("/ns/a.b.c[3]", "b.c", (3,)), ("/a.b[2].c.d[1]", "b.c.d", (2, 1)),
    ("/a.effort[arm.joint/1]", "effort", ("arm.joint/1",))])
def test_paths(text: str, column: str, indices: tuple[int | str, ...]) -> None:
    path = FieldPath.parse(text)
    assert (path.column, path.indices) == (column, indices)


def test_elements_of_sequences_of_messages(make: Maker) -> None:
    types = make.store.types
    kind = "geometry_msgs/msg/PoseArray"

    def poses(t: float) -> Any:
        return types[kind](make.header(t), [
            types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](k + t, 0.0, 0.0),
                                            types["geometry_msgs/msg/Quaternion"](0, 0, 0, 1))
            for k in range(3)])

    path = make.bag([("/p", kind, t, poses(t)) for t in EVEN[:50]])
    axis = read_record(path, input="/p.poses[0].position.x", output="/p.poses[2].position.x",
                       input_unit="V").axis()
    assert axis.position - axis.input == pytest.approx(2.0)
    assert axis.position_unit == "m"


@pytest.mark.parametrize("storage", STORAGES)
def test_what_could_be_input_and_output_is_listed(make: Maker, storage: StoragePlugin) -> None:
    path = make.bag([*states(make, EVEN), ("/u", FLOAT, 0.1, make.number(-4.0))], storage)
    found = {each.path: each for topic in numeric_fields(read_bag(path)).values()
             for each in topic}
    assert list(found) == ["/joint_states.position[joint_a]", "/joint_states.position[joint_b]",
                           "/joint_states.effort[joint_a]", "/joint_states.effort[joint_b]",
                           "/u.data"]
    effort = found["/joint_states.effort[joint_b]"]
    assert (effort.type_name, effort.count) == ("float64", 500)
    assert effort.greatest == pytest.approx(2.0, abs=1e-3)
    assert found["/u.data"].least == found["/u.data"].greatest == -4.0


def test_a_single_file_of_either_kind_is_a_bag(make: Maker) -> None:
    for storage in STORAGES:
        folder = make.bag(states(make, EVEN[:30]), storage)
        file = next(each for each in folder.iterdir() if each.suffix in (".db3", ".mcap"))
        assert read_bag(file)["/joint_states"].message_count == 30
        assert read_record(file, input="/joint_states.effort[1]",
                           output="/joint_states.position[1]").axis().input[1] > 0


def test_a_sqlite_bag_says_what_it_lacks(make: Maker, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make.bag([*states(make, EVEN[:30]), ("/u", FLOAT, 0.1, make.number(1.0))],
                      StoragePlugin.SQLITE3)
    file = next(folder.glob("*.db3"))
    with sqlite3.connect(file) as database:
        database.execute("DELETE FROM messages WHERE id = 5")
        database.execute("DELETE FROM message_definitions WHERE topic_type LIKE '%JointState'")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    bag = read_bag(folder)
    assert [loss.messages for loss in bag.losses] == [1]
    assert "sensor_msgs/msg/JointState" in bag.left_out["/joint_states"]
    with pytest.raises(RecordError, match="sensor_msgs/msg/JointState"):
        read_record(folder, input="/joint_states.effort[1]", output="/joint_states.position[1]")


@pytest.mark.parametrize(("encoding", "text"), [("ros2idl", b"module std_msgs {"), ("", b""),
                                                ("ros2msg", b"")])
def test_definitions_that_a_bag_lacks_are_those_of_installed_messages(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, encoding: str, text: bytes) -> None:
    from mcap.writer import Writer as McapWriter

    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("made_msgs/msg/Pair", encoding, text)
        channel = writer.register_channel("/pair", "cdr", schema)
        for k in range(5):
            writer.add_message(channel, 10**18 + k, b"\0\1\0\0" + np.array(
                [k, -k], np.float64).tobytes(), 10**18 + k)
        writer.finish()
    share = tmp_path / "prefix" / "share" / "made_msgs" / "msg"
    share.mkdir(parents=True)
    (share / "Pair.msg").write_text("float64 a\nfloat64 b\n")
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    absent = read_bag(path)
    assert "/pair" in absent.left_out or absent["/pair"].message_count == 0
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert read_bag(path)["/pair"]["b"].tolist() == [0, -1, -2, -3, -4]


def test_rows_of_a_batch_that_the_index_hid_are_no_message() -> None:
    """SQLite chooses by an index; of a damaged file the rows themselves may be something else."""
    rows = [[(-1, b"late"), (3, "text")], [(5, b"sound")], []]
    connection = SimpleNamespace(execute=lambda *_: SimpleNamespace(
        fetchmany=lambda _: rows.pop(0)))
    (records, offsets), = sqlite_bag._batches(connection, 1, 0, 3)  # type: ignore[arg-type]
    assert bytes(records).endswith(b"sound")
    assert offsets.tolist() == [0]
