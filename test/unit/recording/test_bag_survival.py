"""A recorder that is killed, and one whose disk fills up."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dfm_stage.recording import BagWriteError, BagWriter, read_bag

ROOT = Path(__file__).parents[3]
DEFINITION = "uint32 seq\nfloat64 value\n"
PREAMBLE = """
import os, struct, sys, time
from pathlib import Path
from dfm_stage.recording import BagWriter, BagWriteError

def message(k):
    return b"\\0\\1\\0\\0" + struct.pack("<I4xd", k, k * 0.5)
"""
WRITER = PREAMBLE + """
bag = BagWriter(sys.argv[1])
topic = bag.add_topic("/a", "a/msg/A", [], "", "uint32 seq\\nfloat64 value\\n")
bag.attach("model.yaml", "application/yaml", b"dfm_model: 1\\n")
k, most = 0, int(sys.argv[2])
start = time.monotonic()
while True:
    while k < min(most, (time.monotonic() - start) * 4000):
        now = time.time_ns()
        bag.write(topic, message(k), now, now, k)
        k += 1
    os.write(1, b"%d\\n" % k)
    time.sleep(0.002)
"""
FULL = PREAMBLE + """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
bag = BagWriter(sys.argv[1], compression="none", chunk_bytes=20_000)
topic = bag.add_topic("/a", "a/msg/A", [], "", "uint32 seq\\nfloat64 value\\n")
refused = 0
for k in range(20_000):
    try:
        bag.write(topic, message(k), k + 1, k + 1, k)
    except BagWriteError as error:
        refused += 1
        text = str(error)
    if k % 500 == 0:
        time.sleep(0.01)
assert refused > 0 and bag.error is not None, refused
try:
    bag.close()
except BagWriteError as error:
    print(text)
    print(error)
"""


def values(folder: Path) -> tuple[np.ndarray, np.ndarray, list[str]]:
    bag = read_bag(folder)
    topic = bag["/a"]
    assert (topic["value"] == topic["seq"] * 0.5).all()
    return topic["seq"], topic.log_time_ns, [str(loss) for loss in bag.losses]


@pytest.mark.parametrize("most", [10**9, 25], ids=["busy", "idle"])
def test_sigkill_loses_at_most_the_last_second(tmp_path: Path, most: int) -> None:
    folder = tmp_path / "bag"
    process = subprocess.Popen([sys.executable, "-c", WRITER, str(folder), str(most)],
                               stdout=subprocess.PIPE, cwd=ROOT)
    assert process.stdout is not None
    try:
        os.set_blocking(process.stdout.fileno(), True)
        lines, accepted = [process.stdout.readline()], []
        until = time.monotonic() + 1.7
        while time.monotonic() < until:
            lines.append(process.stdout.readline())
            accepted.append((time.time_ns(), int(lines[-1])))
    finally:
        process.send_signal(signal.SIGKILL)
        killed = time.time_ns()
        process.wait()
        process.stdout.close()
    seq, log, losses = values(folder)
    assert (seq == np.arange(len(seq))).all()
    second_before = [count for at, count in accepted if at < killed - 10**9]
    assert len(seq) >= max(second_before)
    assert (log <= killed).all()
    assert any("stops without an index" in text for text in losses)
    assert read_bag(folder).attachments == {"model.yaml": b"dfm_model: 1\n"}


def test_a_file_that_may_not_grow_is_a_clear_error_and_stays_readable(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    done = subprocess.run([sys.executable, "-c", FULL, str(folder)], cwd=ROOT, check=True,
                          capture_output=True, text=True)
    refused, closing = done.stdout.splitlines()
    assert refused == (f"{folder}/bag_0.mcap: the file would grow beyond the allowed size; raise "
                       f"the limit (ulimit -f)")
    assert closing.startswith(refused)
    seq, _, losses = values(folder)
    assert 1000 < len(seq) < 20_000
    assert (seq == np.arange(len(seq))).all()
    assert f"({20_000 - len(seq)} of 20000 messages were not recorded)" in closing
    assert losses
    assert not list(folder.glob(".*"))


def test_a_disk_that_fills_up_in_the_middle_of_a_write(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = 100_000
    write = os.write

    def until_full(file: int, data: bytes) -> int:
        fits = min(len(data), room - os.lseek(file, 0, os.SEEK_CUR))
        if fits <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(file, data[:fits])

    monkeypatch.setattr(os, "write", until_full)
    bag = BagWriter(tmp_path / "bag", compression="none", chunk_bytes=8000)
    topic = bag.add_topic("/a", "a/msg/A", [], "", DEFINITION)
    record = b"\0\1\0\0" + bytes(16)
    accepted = 0
    while bag.error is None and accepted < 10**6:
        with contextlib.suppress(BagWriteError):  # it fills up between look and write
            bag.write(topic, record, accepted + 1, accepted + 1, accepted)
        accepted += 1
        if accepted % 100 == 0:
            time.sleep(0.001)
    with pytest.raises(BagWriteError, match=r"^[^\n]*bag_0\.mcap: the disk is full; free some"):
        bag.write(topic, record, 1, 1, 1)
    assert bag.message_count == accepted + 1
    with pytest.raises(BagWriteError, match="were not recorded"):
        bag.close()
    found = read_bag(tmp_path / "bag")["/a"].sequence
    assert (found == np.arange(len(found))).all()
    assert len(found) == bag.message_count - bag.lost > 500
    data = bag.file_path.read_bytes()
    assert len(data) <= room
    assert data.endswith(b"\x89MCAP0\r\n")     # nothing of the chunk that did not fit is left


def test_a_full_disk_at_the_start_leaves_nothing_behind(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(file: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(BagWriteError, match="the disk is full"):
        BagWriter(tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []
