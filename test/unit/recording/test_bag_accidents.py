"""Any damage hypothesis can think of, two recorders in one folder, and a clock that steps back."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.synthetic_bag import START_NS, schema_text, topic_messages
from dfm_stage.recording import BagReadError, BagWriter, read_bag, read_record

ROOT = Path(__file__).parents[3]
DEFINITION = "uint32 seq\nfloat64 value\n"
COUNT = 400
TWO = """
import struct, sys, time
from pathlib import Path
from dfm_stage.recording import BagWriteError, BagWriter

Path(sys.argv[2]).touch()
while not Path(sys.argv[3]).exists():
    time.sleep(0.001)
try:
    bag = BagWriter(sys.argv[1])
except BagWriteError as error:
    sys.exit(f"refused: {error}")
topic = bag.add_topic("/a", "a/msg/A", [], "", "uint32 seq\\nfloat64 value\\n")
for k in range(300):
    bag.write(topic, b"\\0\\1\\0\\0" + struct.pack("<I4xd", k, k * 0.5), k + 1, k + 1, k)
bag.close()
"""


def message(k: int) -> bytes:
    return b"\0\1\0\0" + np.uint32(k).tobytes() + bytes(4) + np.float64(k * 0.5).tobytes()


@pytest.fixture(scope="module", params=["zstd", "none"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("accidents") / "bag"
    with BagWriter(folder, compression=request.param, chunk_bytes=2000) as bag:
        topic = bag.add_topic("/a", "a/msg/A", [], "", DEFINITION)
        for k in range(COUNT):
            bag.write(topic, message(k), 1000 + k, 1000 + k, k)
    return bag.file_path


# of a chunk that is cut off no checksum is left, so a cut comes alone
damages = st.lists(st.tuples(st.just("cut"), st.floats(0, 1), st.just(0)), min_size=1,
                   max_size=1) | st.lists(st.one_of(
    st.tuples(st.just("flip"), st.floats(0, 1), st.integers(0, 7)),
    st.tuples(st.just("zero"), st.floats(0, 1), st.integers(1, 600)),
    st.tuples(st.just("drop"), st.floats(0, 1), st.integers(1, 600)),
    st.tuples(st.just("repeat"), st.floats(0, 1), st.integers(1, 600)),
), min_size=1, max_size=4)


@settings(max_examples=40)
@given(some=damages)
def test_whatever_happens_to_the_file_nothing_wrong_is_read(whole: Path, some: list) -> None:
    data = bytearray(whole.read_bytes())
    for kind, where, size in some:
        at = int(where * max(0, len(data) - 1))
        if kind == "cut":
            del data[at:]
        elif kind == "flip" and data:
            data[at] ^= 1 << size
        elif kind == "zero":
            data[at:at + size] = bytes(len(data[at:at + size]))
        elif kind == "drop":
            del data[at:at + size]
        elif kind == "repeat":
            data[at:at] = data[at:at + size]
    copy = whole.parent / f"copy_{os.getpid()}.mcap"
    copy.write_bytes(data)
    try:
        bag = read_bag(copy)
    except BagReadError:
        return
    finally:
        copy.unlink()
    found = bag["/a"]["seq"] if "/a" in bag else np.zeros(0, np.uint32)
    if len(found):
        assert np.array_equal(bag["/a"]["value"], found * 0.5)
        assert np.array_equal(bag["/a"].log_time_ns, found.astype(np.int64) + 1000)
        assert found.max() < COUNT
    if len(set(found.tolist())) < COUNT:
        assert bag.losses
    assert all("\n" not in str(loss) for loss in bag.losses)


def test_of_two_recorders_in_one_folder_one_is_refused_and_the_other_undisturbed(
        tmp_path: Path) -> None:
    folder, go = tmp_path / "bag", tmp_path / "go"
    ready = [tmp_path / f"ready{k}" for k in range(2)]
    both = [subprocess.Popen([sys.executable, "-c", TWO, str(folder), str(each), str(go)],
                             cwd=ROOT, stderr=subprocess.PIPE, text=True) for each in ready]
    try:
        while not all(each.exists() for each in ready):
            assert all(each.poll() is None for each in both)
        go.touch()
    finally:
        words = [each.communicate(timeout=60)[1] for each in both]
    assert sorted(each.returncode for each in both) == [0, 1]
    refused = next(text for text in words if text)
    assert refused == (f"refused: {folder}: exists already and nothing is overwritten; "
                       "choose another name\n")
    bag = read_bag(folder)
    assert not bag.losses
    assert bag["/a"]["seq"].tolist() == list(range(300))


def test_a_clock_that_steps_back_loses_and_reorders_nothing(tmp_path: Path) -> None:
    hour, step_at = 3600 * 10**9, 1200
    times = START_NS + np.arange(2000) * 10**6 - np.where(np.arange(2000) >= step_at, hour, 0)
    with BagWriter(tmp_path / "bag", chunk_bytes=20_000) as bag:
        for short in ("Measurement", "Command"):
            rows = topic_messages(short, "x", 2000, 1e-3, np.random.default_rng(1))
            for name in ("header.stamp", "measurement_stamp"):
                if f"{name}.sec" in rows.dtype.names:
                    rows[f"{name}.sec"], rows[f"{name}.nanosec"] = times // 10**9, times % 10**9
            topic = bag.add_topic(f"/stage/x/{short.lower()}", f"dfm_interfaces/msg/{short}", [],
                                  "", schema_text(short))
            for k, row in enumerate(rows):
                bag.write(topic, row.tobytes(), int(times[k]), int(times[k]), k)
    read = read_bag(tmp_path / "bag")
    assert not read.losses
    for name in ("measurement", "command"):
        assert read[f"/stage/x/{name}"]["seq"].tolist() == list(range(2000))
    text = (tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8")
    assert f"nanoseconds_since_epoch: {times.min()}" in text
    record = read_record(tmp_path / "bag")
    assert any("the clock was set 1 times while recording, first by -3.6e+03 s" in each
               for each in record.warnings), record.warnings
    axis = record.axes["x"]
    assert len(axis.input) == len(axis.position) == 2000
    assert np.array_equal(axis.input, read["/stage/x/command"]["voltage"])
