"""read_bag against the rosbags decoder, on files of several writers."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.interfaces import Qos
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys.store import Typestore

from dfm_stage.recording import BagReadError, BagWriter, QosProfile, Ragged, read_bag

Messages = dict[str, tuple[str, list[bytes]]]
STANDARD = (
    "std_msgs/msg/Empty", "std_msgs/msg/Bool", "std_msgs/msg/Int8", "std_msgs/msg/UInt16",
    "std_msgs/msg/String", "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/TwistStamped", "diagnostic_msgs/msg/DiagnosticArray",
    "sensor_msgs/msg/CameraInfo", "visualization_msgs/msg/Marker", "rcl_interfaces/msg/Log",
    "trajectory_msgs/msg/JointTrajectory", "rosgraph_msgs/msg/Clock")


@pytest.fixture
def all_messages(our_messages: Messages, typestore: Typestore,
                 random_message: Callable[[str, np.random.Generator], Any]) -> Messages:
    rng = np.random.default_rng(23)
    result = dict(our_messages)
    for kind in STANDARD:
        result["/t/" + kind.rpartition("/")[2].lower()] = (kind, [
            bytes(typestore.serialize_cdr(random_message(kind, rng), kind)) for _ in range(60)])
    return result


def check(path: Path, messages: Messages, typestore: Typestore,
          flatten: Callable[[Any], dict[str, Any]], same: Callable[[Any, Any], bool]) -> None:
    bag = read_bag(path)
    assert bag.losses == []
    assert bag.left_out == {}
    assert set(bag) == set(messages)
    for name, (kind, data) in messages.items():
        topic = bag[name]
        assert topic.type_name == kind
        assert topic.message_count == len(data)
        truth = [flatten(typestore.deserialize_cdr(raw, kind)) for raw in data]
        compared = 0
        for column in topic:
            values = topic[column]
            if column in truth[0]:
                compared += 1
                for k, row in enumerate(truth):
                    assert same(values[k], row[column]), (name, column, k)
        loops = {column.partition(".")[0] for column in topic if column not in truth[0]}
        left = {text.partition(":")[0].partition(".")[0] for text in topic.left_out}
        fields = {column.partition(".")[0] for column in truth[0]} - {
            "structure_needs_at_least_one_member"}
        assert {column.partition(".")[0] for column in topic} | left >= {
            field for field in fields if not field.isupper()}
        assert compared or loops or kind == "std_msgs/msg/Empty"


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_our_bags(tmp_path: Path, all_messages: Messages, make_bag: Callable[..., None],
                  typestore: Typestore, flatten: Any, same: Any, compression: str) -> None:
    make_bag(tmp_path / "bag", all_messages, compression=compression, chunk_bytes=20_000)
    check(tmp_path / "bag", all_messages, typestore, flatten, same)
    check(tmp_path / "bag" / "bag_0.mcap", all_messages, typestore, flatten, same)
    bag = read_bag(tmp_path / "bag")
    assert bag.attachments["model.yaml"].startswith(b"dfm_model")
    topic = bag["/stage/x/command"]
    k = np.arange(50)
    assert (topic.log_time_ns == 10**18 + k * 10**6 + 5).all()
    assert (topic.publish_time_ns == 10**18 + k * 10**6).all()
    assert (topic.sequence == k).all()


@pytest.mark.parametrize("options", [
    {"compression": CompressionType.ZSTD, "chunk_size": 10_000},
    {"compression": CompressionType.LZ4, "chunk_size": 10_000},
    {"compression": CompressionType.NONE, "repeat_schemas": False, "repeat_channels": False},
    {"use_chunking": False},
    {"use_chunking": False, "use_statistics": False, "repeat_schemas": False,
     "repeat_channels": False, "use_summary_offsets": False},
], ids=str)
def test_bags_of_the_mcap_library(
        tmp_path: Path, all_messages: Messages, schema: Callable[[str], str],
        typestore: Typestore, flatten: Any, same: Any, options: dict[str, Any]) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2")
        channels = {name: writer.register_channel(name, "cdr", writer.register_schema(
            kind, "ros2msg", schema(kind).encode())) for name, (kind, _) in all_messages.items()}
        for k in range(60):
            for name, (_, data) in all_messages.items():
                if k < len(data):
                    writer.add_message(channels[name], k + 1, data[k], k, k)
        writer.finish()
    check(path, all_messages, typestore, flatten, same)


def test_bags_of_the_rosbags_library(tmp_path: Path, our_messages: Messages, typestore: Typestore,
                                     flatten: Any, same: Any) -> None:
    assert Qos is not None
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {name: writer.add_connection(name, kind, typestore=typestore)
                       for name, (kind, _) in our_messages.items()}
        for k in range(50):
            for name, (_, data) in our_messages.items():
                writer.write(connections[name], k + 1, data[k])
    check(tmp_path / "bag", our_messages, typestore, flatten, same)


def test_several_files_are_one_bag(tmp_path: Path, our_messages: Messages,
                                   make_bag: Callable[..., None], typestore: Typestore,
                                   flatten: Any, same: Any) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    for part in range(12):
        make_bag(tmp_path / f"part{part}", {
            name: (kind, data[4 * part:4 * part + 4])
            for name, (kind, data) in our_messages.items()})
        (tmp_path / f"part{part}" / f"part{part}_0.mcap").rename(folder / f"bag_{part}.mcap")
    files = "".join(f"\n    - bag_{part}.mcap" for part in range(12))
    (folder / "metadata.yaml").write_text(f"""rosbag2_bagfile_information:
  version: 9
  storage_identifier: mcap
  message_count: 384
  starting_time: {{nanoseconds_since_epoch: 1000000000000000005}}
  duration: {{nanoseconds: 3000000}}
  topics_with_message_count: []
  compression_mode: ""
  relative_file_paths:{files}
""")
    first = {name: (kind, data[:48]) for name, (kind, data) in our_messages.items()}
    check(folder, first, typestore, flatten, same)
    (folder / "metadata.yaml").unlink()
    bag = read_bag(folder)
    assert [str(loss) for loss in bag.losses] == [
        f"{folder}: has no metadata.yaml; the .mcap files were read in the order of their names"]
    assert (bag["/stage/x/drive"]["seq"] == read_bag(folder)["/stage/x/drive"]["seq"]).all()
    truth = [typestore.deserialize_cdr(raw, first["/stage/x/drive"][0]).seq
             for raw in first["/stage/x/drive"][1]]
    assert bag["/stage/x/drive"]["seq"].tolist() == truth


def test_topics_are_chosen_by_name_or_pattern(tmp_path: Path, our_messages: Messages,
                                              make_bag: Callable[..., None]) -> None:
    make_bag(tmp_path / "bag", our_messages)
    assert set(read_bag(tmp_path / "bag", ["*/command", "/stage/x/drive", "*/nothing"])) == {
        "/stage/x/command", "/stage/x/drive"}
    with pytest.raises(BagReadError, match=r"no topic /stage/y/command; there are /stage/x/"):
        read_bag(tmp_path / "bag", ["/stage/y/command"])
    with pytest.raises(BagReadError, match=r"has no field 'volt'; there are header\.stamp"):
        read_bag(tmp_path / "bag")["/stage/x/command"]["volt"]


def test_text_and_sequences(tmp_path: Path, typestore: Typestore, schema: Callable[[str], str],
                            make_bag: Callable[..., None]) -> None:
    kind = "sensor_msgs/msg/JointState"
    JointState, Header, Time = (typestore.types[name] for name in (
        kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    rows = [(["a", "b"], [1.0, 2.0]), ([], []), (["b"], [3.0])] * 100
    data = [bytes(typestore.serialize_cdr(JointState(
        Header(Time(k, 5), "frame" if k % 7 else ""), names, np.array(values), np.array([]),
        np.array([])), kind)) for k, (names, values) in enumerate(rows)]
    make_bag(tmp_path / "bag", {"/j": (kind, data)}, chunk_bytes=3000)
    topic = read_bag(tmp_path / "bag")["/j"]
    names, position = topic["name"], topic["position"]
    assert isinstance(names, Ragged)
    assert [list(names[k]) for k in range(300)] == [row[0] for row in rows]
    assert [list(position[k]) for k in range(300)] == [row[1] for row in rows]
    assert position.lengths.tolist() == [len(row[1]) for row in rows]
    assert topic["header.frame_id"].tolist() == ["frame" if k % 7 else "" for k in range(300)]
    assert topic["header.stamp"].tolist() == [k * 10**9 + 5 for k in range(300)]


def test_what_does_not_fit_into_arrays_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        wide = bag.add_topic("/wide", "a/msg/Wide", [], "", "int32 n\nwstring w\nint32 after\n")
        deep = bag.add_topic("/deep", "a/msg/Deep", [], "",
                             "b/Inner[] parts\nint32 n\n" + "=" * 80 + "\nMSG: b/Inner\n"
                             "float64[] values\nuint8 one\n")
        broken = bag.add_topic("/broken", "a/msg/Broken", [], "", "float64[ x\n")
        bag.write(wide, bytes.fromhex("00010000 07000000 00000000 09000000"), 1, 1)
        bag.write(deep, bytes.fromhex("00010000 01000000 01000000 000000000000f03f 2a000000"
                                      "09000000"), 1, 1)
        bag.write(broken, b"\0\1\0\0", 1, 1)
    bag = read_bag(tmp_path / "bag")
    assert bag["/wide"]["n"].tolist() == [7]
    assert bag["/wide"].left_out == ["w and what follows: wide strings are not supported"]
    assert bag["/deep"]["n"].tolist() == [9]
    assert bag["/deep"]["parts.one"].values.tolist() == [42]
    assert bag["/deep"].left_out == ["parts.values: a sequence inside a sequence"]
    assert "cannot be parsed" in bag.left_out["/broken"]
    assert bag.losses == []


def test_messages_that_do_not_fit_their_definition_are_counted(tmp_path: Path) -> None:
    def text(value: bytes) -> bytes:
        return b"\0\1\0\0" + len(value).to_bytes(4, "little") + value

    with BagWriter(tmp_path / "bag", compression="none") as bag:
        topic = bag.add_topic("/a", "a/msg/A", [], "", "string s\nuint8[] data\n")
        good = text(b"ok\0") + b"\0" + b"\2\0\0\0\7\7"
        for k, data in enumerate([good, b"", b"\0\1\0\0", b"\0\0\0\0" + good[4:],
                                  b"\0\1\0\0\xff\xff\xff\x7fx", good, good[:-1], good]):
            bag.write(topic, data, k + 1, k, k)
    bag = read_bag(tmp_path / "bag")
    assert bag["/a"].sequence.tolist() == [0, 5, 7]
    assert bag["/a"]["s"].tolist() == ["ok"] * 3
    assert [list(bag["/a"]["data"][k]) for k in range(3)] == [[7, 7]] * 3
    assert [loss.messages for loss in bag.losses] == [5]
    assert "5 messages do not fit the definition of a/msg/A" in str(bag.losses[0])


def test_a_text_may_not_reach_beyond_its_message(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", "string data\n")
        for k, size in enumerate([3, 4, 5, 8, 2**31, 2**32 - 1]):
            bag.write(topic, b"\0\1\0\0" + size.to_bytes(4, "little") + b"ab\0", k + 1, k, k)
    found = read_bag(tmp_path / "bag")
    assert found["/a"]["data"].tolist() == ["ab"]
    assert [loss.messages for loss in found.losses] == [5]


def test_things_that_are_no_bag(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("hello, this is not a bag\n")
    (tmp_path / "folder").mkdir()
    (tmp_path / "sql").mkdir()
    (tmp_path / "sql" / "sql_0.db3").write_bytes(b"SQLite format 3\0")
    for name, words in {"empty.mcap": "is empty", "text.mcap": "not an MCAP file",
                        "folder": "holds no .mcap or .db3 file", "sql": "no readable SQLite bag",
                        "none": "no such file"}.items():
        with pytest.raises(BagReadError, match=words) as caught:
            read_bag(tmp_path / name)
        assert str(tmp_path / name) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_importing_the_package_does_not_import_numba() -> None:
    code = "import sys, dfm_stage.recording; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_bag_without_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic("/a", "std_msgs/msg/String", [QosProfile()], "", "string data\n")
    topic = read_bag(tmp_path / "bag")["/a"]
    assert topic.message_count == 0
    assert len(topic["data"]) == 0
