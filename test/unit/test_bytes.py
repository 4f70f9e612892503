"""A few hundred spoilt inputs of every format, and those that once ended wrongly."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import patch

import pytest

from benchmarks import bytes as bench
from benchmarks.bytes_targets import TARGETS, Target, fault_in, input_of
from benchmarks.bytes_worker import ending_of
from dfm_stage.drivers.interlock import Interlock
from dfm_stage.errors import DfmError

SEED = 7
FAST = {"copley", "qsb", "csv", "mat", "formula"}
FEW, MANY = 15, 300
FOUND = sorted((Path(__file__).parent / "found_bytes").glob("*/*"))


@pytest.mark.parametrize("name", sorted(TARGETS))
def test_spoilt_inputs_end_in_a_value_or_one_line(name: str, tmp_path: Path) -> None:
    target = TARGETS[name]
    for number in range(MANY if name in FAST else FEW):
        _, wrong, details = ending_of(target, input_of(target, SEED, number),
                                      tmp_path / target.file)
        assert not wrong, f"input {number}: {wrong}\n{details}"


@pytest.mark.parametrize("path", FOUND, ids=lambda path: f"{path.parent.name}_{path.name}")
def test_inputs_that_once_ended_wrongly(path: Path, tmp_path: Path) -> None:
    target = TARGETS[path.parent.name]
    _, wrong, details = ending_of(target, path.read_bytes(), tmp_path / target.file)
    assert not wrong, f"{wrong}\n{details}"


def test_a_number_and_a_seed_give_the_same_bytes() -> None:
    for target in TARGETS.values():
        first = [input_of(target, SEED, number) for number in range(5)]
        assert first == [input_of(target, SEED, number) for number in range(5)]
        assert first != [input_of(target, SEED + 1, number) for number in range(5)]


def test_an_output_that_moves_after_an_error_is_found() -> None:
    """Without its interlock, the amplifier's worker goes on commanding a drive with a fault."""
    target = TARGETS["copley"]
    with patch.object(Interlock, "trip", lambda *_: None):
        ends = {ending_of(target, input_of(target, SEED, number), Path())[1]
                for number in range(MANY)}
    assert any("UnsafeError" in each for each in ends)


def test_what_is_wrong_with_an_ending() -> None:
    def raising(error: Exception) -> Target:
        def call(_data: bytes, _path: Path) -> None:
            raise error

        return Target("x", 0, lambda _: b"", call)

    assert ending_of(raising(DfmError("no such file")), b"", Path())[:2] == (True, "")
    assert ending_of(raising(ValueError("x")), b"", Path())[1].startswith("ValueError in")
    assert fault_in(DfmError("")) == "an empty message"


def test_a_process_that_dies_is_a_finding_and_the_rest_goes_on(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker is given a target that kills it at one input."""
    monkeypatch.setattr(bench, "TARGETS", {"formula": TARGETS["formula"]})
    worker = tmp_path / "benchmarks"
    worker.mkdir()
    (worker / "__init__.py").touch()
    (worker / "bytes_worker.py").write_text(
        "import os, struct, sys\n"
        "first, count, path = int(sys.argv[3]), int(sys.argv[4]), sys.argv[5]\n"
        "handle = os.open(path, os.O_RDWR)\n"
        "put = lambda at, number: os.pwrite(handle, struct.pack('d', number), at)\n"
        "begin, values = struct.unpack('dd', os.pread(handle, 16, 0))\n"
        "for k in range(max(first, int(begin)), first + count):\n"
        "    put(0, k)\n"
        "    if k == 3: os.kill(os.getpid(), 9)\n"
        "    values += 1\n"
        "    put(8, values)\n"
        "put(0, first + count)\n")
    monkeypatch.setattr(bench, "ROOT", tmp_path)
    monkeypatch.setattr(bench, "POLL_S", 0.01)
    found = {each.key: each for each in bench.figures(cases=100, keep=tmp_path / "kept", jobs=1)}
    assert found["bytes.inputs"].value == 12
    assert found["bytes.findings"].value == 1
    assert found["bytes.findings"].met is False
    assert "died with -9" in found["bytes.findings"].how
    folder = tmp_path / "kept" / f"seed_{bench.SEED}_100"
    (kept_input,) = (folder / "found" / "formula").glob("*/3.bin")
    assert kept_input.read_bytes() == input_of(TARGETS["formula"], bench.SEED, 3)
    assert json.loads((folder / "result.json").read_text())["targets"][0]["values"] == 11
