"""Any damage hypothesis can think of, two recorders in one folder, and a clock that steps back."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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


damages = st.lists(st.one_of(
    st.tuples(st.just("cut"), st.floats(0, 1), st.just(0)),
    st.tuples(st.just("flip"), st.floats(0, 1), st.integers(0, 7)),
    st.tuples(st.just("zero"), st.floats(0, 1), st.integers(1, 600)),
    st.tuples(st.just("drop"), st.floats(0, 1), st.integers(1, 600)),
    st.tuples(st.just("repeat"), st.floats(0, 1), st.integers(1, 600)),
), min_size=1, max_size=4)


@settings(max_examples=60)
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
    except BagReadError as error:
        assert "\n" not in str(error)
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
    for attempt in range(3):
        folder, go = tmp_path / f"bag{attempt}", tmp_path / f"go{attempt}"
        ready = [tmp_path / f"ready{attempt}{k}" for k in range(2)]
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


def test_a_clock_that_steps_back_loses_and_reorders_nothing(
        tmp_path: Path, schema: Callable[[str], str]) -> None:
    import struct

    period, hour = 10**6, 3600 * 10**9
    kind = "dfm_interfaces/msg/Measurement"
    with BagWriter(tmp_path / "bag", chunk_bytes=20_000) as bag:
        topic = bag.add_topic("/stage/x/measurement", kind, [], "", schema(kind))
        for k in range(2000):
            now = 10**18 + k * period - (hour if k >= 1200 else 0)
            data = (b"\0\1\0\0" + struct.pack("<iI", *divmod(now, 10**9)) + struct.pack("<I", 2)
                    + b"x\0\0\0" + struct.pack("<I4xdqI", k, k * 1e-6, k, 0))
            bag.write(topic, data, now, now, k)
    read = read_bag(tmp_path / "bag")
    assert not read.losses
    assert read["/stage/x/measurement"]["seq"].tolist() == list(range(2000))
    text = (tmp_path / "bag" / "metadata.yaml").read_text(encoding="utf-8")
    assert f"nanoseconds_since_epoch: {10**18 + 1200 * period - hour}" in text
    record = read_record(tmp_path / "bag")
    assert any("clock" in each or "back" in each for each in record.warnings), record.warnings
