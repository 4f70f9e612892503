"""What BagWriter writes, read by others."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys.store import Typestore
from ruamel.yaml import YAML

from dfm_stage.recording import BagWriteError, BagWriter, DefinitionError, QosProfile
from dfm_stage.recording.message_definitions import SEPARATOR, definition_text, parse_schema

Messages = dict[str, tuple[str, list[bytes]]]
STRING = "string data\n"


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_rosbags_reads_the_same_bytes_and_values(
        tmp_path: Path, our_messages: Messages, make_bag: Callable[..., None],
        typestore: Typestore, compression: str) -> None:
    make_bag(tmp_path / "bag", our_messages, compression=compression, chunk_bytes=5000)
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == sum(len(data) for _, data in our_messages.values())
        assert reader.ros_distro == "jazzy"
        found: dict[str, list[bytes]] = {}
        for connection, stamp, raw in reader.messages():
            found.setdefault(connection.topic, []).append(bytes(raw))
            assert stamp == 10**18 + (len(found[connection.topic]) - 1) * 10**6 + 5
            typestore.deserialize_cdr(raw, connection.msgtype)
        for connection in reader.connections:
            assert connection.msgtype == our_messages[connection.topic][0]
            assert connection.digest == "RIHS01_" + "ab" * 32
            assert connection.ext.offered_qos_profiles[0].depth == 10
    assert found == {topic: data for topic, (_, data) in our_messages.items()}


def test_mcap_ros2_decodes_with_the_schema_in_the_bag(
        tmp_path: Path, our_messages: Messages, make_bag: Callable[..., None],
        typestore: Typestore) -> None:
    make_bag(tmp_path / "bag", our_messages)
    counts = dict.fromkeys(our_messages, 0)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert schema is not None
            assert schema.encoding == "ros2msg"
            assert channel.metadata["topic_type_hash"].startswith("RIHS01_")
            truth = typestore.deserialize_cdr(message.data, schema.name)
            for name in truth.__dataclass_fields__:
                if name.islower() and name not in ("header", "measurement_stamp", "__msgtype__"):
                    assert getattr(decoded, name) == getattr(truth, name)
            counts[channel.topic] += 1
    assert set(counts.values()) == {50}


def test_metadata_yaml_is_there_from_the_start_and_complete_at_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "run_001"
    bag = BagWriter(folder, custom_data={"no": "1: 'x' \"y\""})
    first = YAML(typ="safe").load((folder / "metadata.yaml").read_text())
    assert first["rosbag2_bagfile_information"]["relative_file_paths"] == ["run_001_0.mcap"]
    topic = bag.add_topic("/a", "std_msgs/msg/String", [QosProfile(depth=3), QosProfile()], "",
                          STRING)
    bag.add_topic("/empty", "std_msgs/msg/String", [], "", STRING)
    bag.write(topic, b"\0\1\0\0\1\0\0\0\0", 2_000, 1_000)
    bag.write(topic, b"\0\1\0\0\1\0\0\0\0", 1_500, 1_000)
    bag.close()
    info = YAML(typ="safe").load((folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"]
    assert list(info) == [
        "version", "storage_identifier", "duration", "starting_time", "message_count",
        "topics_with_message_count", "compression_format", "compression_mode",
        "relative_file_paths", "files", "custom_data", "ros_distro"]
    assert (info["version"], info["storage_identifier"], info["message_count"]) == (9, "mcap", 2)
    assert info["starting_time"] == {"nanoseconds_since_epoch": 1_500}
    assert info["duration"] == {"nanoseconds": 500}
    assert info["compression_format"] == info["compression_mode"] == ""
    assert info["custom_data"] == {"no": "1: 'x' \"y\""}
    assert info["files"] == [{"path": "run_001_0.mcap", "message_count": 2,
                              "starting_time": {"nanoseconds_since_epoch": 1_500},
                              "duration": {"nanoseconds": 500}}]
    used, empty = info["topics_with_message_count"]
    assert (used["message_count"], empty["message_count"]) == (2, 0)
    profile = used["topic_metadata"].pop("offered_qos_profiles")[0]
    assert used["topic_metadata"] == {
        "name": "/a", "type": "std_msgs/msg/String", "serialization_format": "cdr",
        "type_description_hash": ""}
    forever = {"sec": 9223372036, "nsec": 854775807}
    assert profile == {
        "history": "keep_last", "depth": 3, "reliability": "reliable", "durability": "volatile",
        "deadline": forever, "lifespan": forever, "liveliness": "automatic",
        "liveliness_lease_duration": forever, "avoid_ros_namespace_conventions": False}


def test_what_is_attached_stands_before_later_messages(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", compression="none") as bag:
        topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
        bag.write(topic, b"before", 1, 1)
        bag.attach("model.yaml", "application/yaml", b"the model")
        bag.write(topic, b"after", 2, 2)
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    assert data.index(b"before") < data.index(b"the model") < data.index(b"after")
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as file:
        attachments = list(make_reader(file).iter_attachments())
    assert [(item.name, item.media_type, item.data) for item in attachments] == [
        ("model.yaml", "application/yaml", b"the model")]


def test_messages_reach_the_file_without_another_call(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag", compression="none")
    topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
    bag.write(topic, b"only one", 1, 1)
    deadline = time.monotonic() + 30
    while b"only one" not in bag.file_path.read_bytes() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert b"only one" in bag.file_path.read_bytes()
    bag.write(topic, b"and another", 2, 2)
    bag.flush()
    assert b"and another" in bag.file_path.read_bytes()
    bag.close()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    with BagWriter(folder):
        pass
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(BagWriteError, match=r"exists already.*another name$"):
        BagWriter(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    (tmp_path / "file").write_text("a file")
    for place in (tmp_path / "file", tmp_path / "file" / "bag"):
        with pytest.raises(BagWriteError) as caught:
            BagWriter(place)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "file").read_text() == "a file"


def test_a_folder_that_cannot_be_written_is_named() -> None:
    place = Path("/proc/dfm_bag")
    if not Path("/proc").is_dir():
        pytest.skip("no /proc here")
    with pytest.raises(BagWriteError, match=r"^/proc/dfm_bag: "):
        BagWriter(place)


def test_wrong_calls_are_refused_and_leave_the_bag_whole(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
        bag.write(topic, b"\0\1\0\0", 1, 1)
        with pytest.raises(BagWriteError, match="refused"):
            bag.write(9, b"", 1, 1)
        with pytest.raises(BagWriteError, match="refused"):
            bag.write(topic, b"", -1, 1)
        with pytest.raises(BagWriteError, match="added before"):
            bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
        with pytest.raises(BagWriteError, match="two definitions"):
            bag.add_topic("/b", "std_msgs/msg/String", [], "", "string other\n")
        with pytest.raises(DefinitionError):
            bag.add_topic("/c", "String", [], "", STRING)
        with pytest.raises(BagWriteError, match="compression"):
            BagWriter(tmp_path / "other", compression="gzip")
        assert not (tmp_path / "other").exists()
        bag.write(topic, b"\0\1\0\0", 2, 2)
    with pytest.raises(BagWriteError, match="closed"):
        bag.write(topic, b"", 1, 1)
    bag.close()
    with Reader(tmp_path / "bag") as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == [1, 2]


def test_many_threads_may_write(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", chunk_bytes=4096) as bag:
        def work(name: str) -> None:
            topic = bag.add_topic(name, "std_msgs/msg/String", [], "", STRING)
            for k in range(2000):
                bag.write(topic, name.encode() + b"%d" % k, k + 1, k, k)

        threads = [threading.Thread(target=work, args=(f"/t{k}",)) for k in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found: dict[str, list[bytes]] = {}
    with Reader(tmp_path / "bag") as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(bytes(raw))
    assert found == {f"/t{t}": [b"/t%d%d" % (t, k) for k in range(2000)] for t in range(4)}


def test_a_slow_disk_drops_and_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = BagWriter(tmp_path / "bag", chunk_bytes=1000, backlog_bytes=5000)
    topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
    bag.flush()
    release = threading.Event()
    write_chunk = bag._sink.write_chunk

    def slow(chunk: Any) -> None:
        release.wait(30)
        write_chunk(chunk)

    monkeypatch.setattr(bag._sink, "write_chunk", slow)
    for k in range(200):
        bag.write(topic, bytes(100), k + 1, k)
    release.set()
    with pytest.raises(BagWriteError, match=rf"too slow \({bag.lost} of 200 messages"):
        bag.close()
    assert 0 < bag.lost < 200
    with Reader(tmp_path / "bag") as reader:
        assert reader.message_count == 200 - bag.lost
        assert sum(1 for _ in reader.messages()) == 200 - bag.lost


def test_definitions_come_from_installed_packages(tmp_path: Path) -> None:
    for name, text in {"a_msgs/msg/Outer": "a_msgs/Inner[<=3] inner\nb_msgs/msg/Stamp stamp\n"
                       "string NAME = \"x # y\"\nInner one  # comment\n",
                       "a_msgs/msg/Inner": "float64[4] values\nstring<=10 text\nint32 n 5\n",
                       "b_msgs/msg/Stamp": "int32 sec\n"}.items():
        path = tmp_path / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    text = definition_text("a_msgs/msg/Outer", [tmp_path / "nothing", tmp_path])
    assert text.count(SEPARATOR + "\nMSG: a_msgs/Inner\n") == 1
    assert text.count(SEPARATOR + "\nMSG: b_msgs/Stamp\n") == 1
    fields = parse_schema(text, "a_msgs/msg/Outer")
    assert [(f.name, f.base, f.count) for f in fields["a_msgs/msg/Outer"]] == [
        ("inner", "a_msgs/msg/Inner", 0), ("stamp", "b_msgs/msg/Stamp", None),
        ("one", "a_msgs/msg/Inner", None)]
    assert [(f.name, f.base, f.count) for f in fields["a_msgs/msg/Inner"]] == [
        ("values", "float64", 4), ("text", "string", None), ("n", "int32", None)]
    with pytest.raises(DefinitionError, match=r"no c_msgs/msg/None\.msg in"):
        definition_text("c_msgs/msg/None", [tmp_path])


def test_random_schemas_of_rosbags_are_understood(
        schema: Callable[[str], str], typestore: Typestore) -> None:
    rng = np.random.default_rng(5)
    names = sorted(name for name in typestore.fielddefs if "/msg/" in name)
    for name in rng.choice(names, 60, replace=False):
        fields = parse_schema(schema(str(name)), str(name))[str(name)]
        assert [field.name for field in fields] == [
            field for field, _ in typestore.fielddefs[str(name)][1]
            if field != "structure_needs_at_least_one_member"]


def test_one_message_that_is_refused_keeps_no_other_out(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", chunk_bytes=40) as bag:
        topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
        with pytest.raises(BagWriteError, match=r"topic 9.*refused"):
            bag.write_all([(topic, b"one", 1, 1, 1), (9, b"", 2, 2, 1), (topic, b"two", 3, 3, 2)])
        assert (bag.message_count, bag.lost) == (2, 0)
    with bag.file_path.open("rb") as file:
        assert [(m.log_time, m.data) for _, _, m in make_reader(file).iter_messages()] == [
            (1, b"one"), (3, b"two")]


def header(sec: int, nanosec: int) -> bytes:
    """A serialised std_msgs/Header without a frame."""
    return b"\0\1\0\0" + struct.pack("<iII", sec, nanosec, 1) + b"\0"


@pytest.mark.parametrize("log_stamps", [False, True], ids=["real time", "lockstep"])
def test_what_arrives_is_numbered_by_topic_and_dated_by_its_stamp(
        tmp_path: Path, log_stamps: bool) -> None:
    bag = BagWriter(tmp_path / "bag", chunk_bytes=200, log_stamps=log_stamps)
    kind = "std_msgs/msg/String"
    plain = bag.add_topic("/plain", kind, [], "", STRING)
    arrivals, expected = [], []
    for k in range(100):
        if k == 50:  # known after others have come
            late = bag.add_topic("/late", kind, [], "", STRING, stamped=True)
        topic = late if k >= 50 and k % 3 else plain
        data, came = header(k // 60, k) if k % 7 else header(-1, 5)[:11 + k % 2], 10**15 + k
        arrivals.append((topic, data, came))
        if k % 10 == 9:
            bag.write_arrived(arrivals)
            arrivals.clear()
        stamp = 10**9 * (k // 60) + k if topic != plain and k % 7 else came
        number = sum(each[1] == topic for each in expected) + 1
        expected.append((data, topic, number, stamp if log_stamps else came, stamp))
    assert bag.message_count == 100
    bag.close()
    found = []
    with bag.file_path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.append((message.data, channel.id, message.sequence, message.log_time,
                          message.publish_time))
    assert found == expected
    with pytest.raises(BagWriteError, match="closed"):
        bag.write_arrived([(plain, b"", 1)])


def test_a_stamp_of_zero_is_when_lockstep_begins(tmp_path: Path) -> None:
    for log_stamps, log_time in ((True, 0), (False, 7)):
        with BagWriter(tmp_path / f"{log_stamps}", log_stamps=log_stamps) as bag:
            topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING, stamped=True)
            bag.write_arrived([(topic, header(0, 0), 7)])
        with bag.file_path.open("rb") as file:
            _, _, message = next(iter(make_reader(file).iter_messages()))
        assert (message.log_time, message.publish_time) == (log_time, 7)


def test_what_waited_for_a_slow_disk_is_split_into_chunks(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = BagWriter(tmp_path / "bag", compression="none", chunk_bytes=10_000)
    topic = bag.add_topic("/a", "std_msgs/msg/String", [], "", STRING)
    release, write_chunk = threading.Event(), bag._sink.write_chunk
    monkeypatch.setattr(bag._sink, "write_chunk",
                        lambda chunk: (release.wait(30), write_chunk(chunk)))
    for k in range(1000):
        bag.write(topic, bytes(100), k, k)
    release.set()
    bag.close()
    with bag.file_path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) >= 10
    assert max(chunk.uncompressed_size for chunk in summary.chunk_indexes) < 2 * 10_000


@pytest.mark.parametrize("topic", [0, 2])
def test_a_topic_that_was_not_announced_is_refused_as_it_arrives(tmp_path: Path,
                                                                 topic: int) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        known = bag.add_topic("/a", "std_msgs/msg/Empty", [], "", "")
        bag.write_arrived([])
        with pytest.raises(BagWriteError, match="not announced"):
            bag.write_arrived([(known, b"x", 1), (topic, b"x", 2)])
        bag.write_arrived([(known, b"x", 3)])
    assert bag.message_count == 1


def test_any_error_of_the_writing_thread_is_told(tmp_path: Path,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    def no_memory(*_: object) -> None:
        raise MemoryError("no memory")

    bag = BagWriter(tmp_path / "bag")
    topic = bag.add_topic("/a", "std_msgs/msg/Empty", [], "", "")
    monkeypatch.setattr("dfm_stage.recording.chunk.lay_out", no_memory)
    bag.write(topic, b"x", 1, 1, 1)
    with pytest.raises(BagWriteError, match="MemoryError: no memory"):
        bag.flush()
    with pytest.raises(BagWriteError, match="1 of 1 messages"):
        bag.close()


def test_messages_that_wait_count_with_all_the_memory_they_take(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty ones written one by one, while the disk stands still."""
    go_on = threading.Event()
    monkeypatch.setattr(BagWriter, "_write_messages", lambda *_: go_on.wait(20.0))
    bag = BagWriter(tmp_path / "bag", backlog_bytes=1 << 20)
    topic = bag.add_topic("/a", "std_msgs/msg/Empty", [], "", "")
    for k in range(30_000):
        bag.write(topic, b"", k, k, k)
    assert 30_000 - bag.lost == pytest.approx((1 << 20) / 40, rel=0.01)  # five columns of 8 bytes
    monkeypatch.undo()
    go_on.set()
    with pytest.raises(BagWriteError):
        bag.close()
