"""Bags that were cut off or damaged: what is there is read, and only that."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dfm_stage.recording import Bag, BagReadError, BagWriter, read_bag

KIND = "dfm_interfaces/msg/Measurement"
PERIOD_NS = 10**6
COUNT = 3000
TOPICS = ("/stage/x/measurement", "/stage/y/measurement")


def payload(k: int) -> bytes:
    """A Measurement whose every field says k."""
    return (b"\0\1\0\0" + struct.pack("<iI", k // 1000, k % 1000 * PERIOD_NS)
            + struct.pack("<I", 2) + b"x\0\0\0" + struct.pack("<I4xdqI", k, k * 1e-6, -k, k % 7)
            )


def write(folder: Path, schema: Callable[[str], str], compression: str, count: int = COUNT,
          close: bool = True) -> Path:
    bag = BagWriter(folder, compression=compression, chunk_bytes=30_000)
    topics = [bag.add_topic(name, KIND, [], "", schema(KIND)) for name in TOPICS]
    for k in range(count):
        for topic in topics:
            bag.write(topic, payload(k), 10**18 + k * PERIOD_NS, 10**18 + k * PERIOD_NS, k)
    if close:
        bag.close()
    else:
        bag.flush()
    return bag.file_path


def check_rows(bag: Bag) -> dict[str, np.ndarray[Any, Any]]:
    """Every row that was read says what was written; return the numbers that are there."""
    found = {}
    for name in TOPICS:
        if name not in bag or not bag[name].message_count:
            found[name] = np.zeros(0, np.int64)
            continue
        topic = bag[name]
        k = topic["seq"].astype(np.int64)
        assert (topic["position"] == k * 1e-6).all()
        assert (topic["counts"] == -k).all()
        assert (topic["flags"] == k % 7).all()
        assert (topic["header.stamp"] == k // 1000 * 10**9 + k % 1000 * PERIOD_NS).all()
        assert (topic["header.frame_id"] == "x").all()
        assert (topic.log_time_ns == 10**18 + k * PERIOD_NS).all()
        assert (topic.sequence == k).all()
        assert (np.diff(k) > 0).all()
        found[name] = k
    return found


def chunk_ends(path: Path) -> list[tuple[int, int]]:
    """(end of the chunk record, messages up to there on each topic), walked independently."""
    data = path.read_bytes()
    at, messages, ends = 8, 0, []
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        at += 9 + length
        if opcode == 6:
            ends.append((at, 0))
        elif opcode == 7:
            messages += struct.unpack_from("<I", data, at - length + 2)[0] // 16
            ends[-1] = (ends[-1][0], messages // len(TOPICS))
        elif opcode == 15:
            break
    return ends


@pytest.fixture(scope="module", params=["zstd", "lz4", "none"])
def whole(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory,
          schema: Callable[[str], str]) -> tuple[str, Path]:
    folder = tmp_path_factory.mktemp(request.param) / "bag"
    return request.param, write(folder, schema, request.param)


def test_the_whole_file_reads_whole(whole: tuple[str, Path]) -> None:
    bag = read_bag(whole[1].parent)
    assert bag.losses == []
    assert all(len(k) == COUNT for k in check_rows(bag).values())


def test_cut_anywhere(whole: tuple[str, Path], tmp_path: Path) -> None:
    compression, path = whole
    data, ends = path.read_bytes(), chunk_ends(path)
    size = 22 + len(payload(0))
    starts = np.array([match.start() for match in re.finditer(
        re.escape(struct.pack("<BQ", 5, size)), data)])
    rng = np.random.default_rng(7)
    cuts = [*rng.integers(1, len(data), 60), *(end for end, _ in ends[::6]),
            *(end + 1 for end, _ in ends[1::6]), *range(1, 9), len(data) - 1, len(data) - 9]
    for cut in map(int, cuts):
        copy = tmp_path / "cut.mcap"
        copy.write_bytes(data[:cut])
        bag = read_bag(copy)
        assert bag.losses, cut
        whole_chunks = max((count for end, count in ends if end <= cut), default=0)
        whole_records = int(np.sum(starts + 9 + size <= cut))
        for k in check_rows(bag).values():
            assert (k == np.arange(len(k))).all(), cut
            assert len(k) >= whole_chunks, cut
            if compression == "none":
                assert len(k) in (whole_records // 2, (whole_records + 1) // 2), cut
            assert len(k) <= COUNT


def test_a_cut_bag_says_what_is_missing(whole: tuple[str, Path], tmp_path: Path) -> None:
    _, path = whole
    data = path.read_bytes()
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_bytes((path.parent / "metadata.yaml").read_bytes())
    (folder / path.name).write_bytes(data[:len(data) // 2])
    bag = read_bag(folder)
    texts = [str(loss) for loss in bag.losses]
    assert any("stops without an index" in text for text in texts)
    for name, k in check_rows(bag).items():
        missing = COUNT - len(k)
        assert f"{name}: {missing} of {COUNT} messages are not readable" in texts
    seconds = [loss.seconds for loss in bag.losses if "the last" in str(loss)
               and "s are missing" in str(loss) and "chunk" not in str(loss)]
    last = max(int(bag[name].log_time_ns.max()) for name in TOPICS)
    assert seconds == [(10**18 + (COUNT - 1) * PERIOD_NS - last) / 1e9]
    assert all("\n" not in text for text in texts)


def test_flipped_bits(whole: tuple[str, Path], tmp_path: Path) -> None:
    """A message that is read is right; one that is missing is mentioned."""
    _, path = whole
    data = path.read_bytes()
    rng = np.random.default_rng(3)
    ends = [end for end, _ in chunk_ends(path)]
    places = [*rng.integers(0, len(data), 90), *range(0, 60, 3),
              *(end + offset for end in ends[::20] for offset in (0, 1, 9, 11)),
              *range(len(data) - 40, len(data), 3)]
    silent = 0
    for place in map(int, places):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        copy = tmp_path / "flipped.mcap"
        copy.write_bytes(damaged)
        bag = read_bag(copy)
        found = check_rows(bag)
        missing = sum(COUNT - len(k) for k in found.values())
        assert missing <= 2 * 800, (place, bag.losses)
        if missing:
            assert bag.losses, place
            assert sum(loss.messages for loss in bag.losses) >= missing, place
        silent += not bag.losses
    assert silent < len(places)


def test_an_unfinished_bag_is_read_to_its_end(tmp_path: Path,
                                              schema: Callable[[str], str]) -> None:
    path = write(tmp_path / "bag", schema, "zstd", close=False)
    copy = tmp_path / "copy" / path.name
    copy.parent.mkdir()
    copy.write_bytes(path.read_bytes())
    (copy.parent / "metadata.yaml").write_bytes((path.parent / "metadata.yaml").read_bytes())
    bag = read_bag(copy.parent)
    assert all(len(k) == COUNT for k in check_rows(bag).values())
    cut_off = (f"{path.name}: the file stops without an index: the recording was cut off, and "
               f"what came after the last message here is missing")
    assert [str(loss) for loss in bag.losses] == [cut_off]


def test_a_message_index_that_lies_is_not_believed(whole: tuple[str, Path],
                                                   tmp_path: Path) -> None:
    """One entry less in an index, the record's lengths made to agree."""
    _, path = whole
    data = bytearray(path.read_bytes())
    at = chunk_ends(path)[2][0]
    opcode, length = struct.unpack_from("<BQ", data, at)
    assert opcode == 7
    struct.pack_into("<H", data, at + 9, 2)  # the entries of topic 1 said to be of topic 2
    copy = tmp_path / "lying.mcap"
    copy.write_bytes(data)
    bag = read_bag(copy)
    assert all(len(k) == COUNT for k in check_rows(bag).values())
    assert length % 16 == 6


def test_random_bytes_are_no_bag(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for size in (1, 7, 8, 9, 100, 5000):
        path = tmp_path / "noise.mcap"
        path.write_bytes(rng.bytes(size))
        with pytest.raises(BagReadError):
            read_bag(path)
        path.write_bytes(b"\x89MCAP0\r\n" + rng.bytes(size))
        bag = read_bag(path)
        assert bag.losses
        assert not bag.message_count
