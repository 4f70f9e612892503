"""The bench `real` on a simulated record of its own, and the page made from its results."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import real
from benchmarks.measured import page, trial
from benchmarks.measured.records import Expected, MeasuredRecord, load_records
from dfm_stage.model import Model, Simulator

T = 2e-3
LINEAR = {"mass": 1.0, "damping": 4.0, "stiffness": 600.0, "force_constant": 1.0}
RECORD = MeasuredRecord(
    name="bench_spring", what="a simulated spring", source="this test", licence="ours",
    files=("drive.npy",), rate="500 Hz", fit={"a": "first drive"}, hold={"b": "second drive"},
    expected=Expected(("named",), "it was put in", first=("cubic_stiffness",),
                      required=(("cubic_stiffness",),)),
    published=("k3 of 4e7",), model={"sample_period": T, "base": LINEAR},
    options=("--library", "cubic_stiffness,coulomb_friction"),
    parameters={"cubic_stiffness.k3": {"value": 4e7, "unit": "N/m^3", "bar": 5.0}},
    rmse={"after": 50, "scale": 1e6, "unit": "um",
          "figures": {"b": {"hold": "b", "peer": "its noise", "peer_value": 1.0, "bar": 1.2}}})


def spring(folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Two records of a hardening spring, the drive read from the folder."""
    drive = np.load(folder / "drive.npy")
    model = Model("truth", T, base=LINEAR).with_effect("cubic_stiffness", {"k3": 4e7})
    noise = np.random.default_rng(3)
    return {part: {"time_s": T * np.arange(each.size), "input_v": each,
                   "position_m": Simulator(model).run(each).position
                   + 1e-6 * noise.standard_normal(each.size)}
            for part, each in zip("ab", drive, strict=True)}


@pytest.fixture
def data(tmp_path: Path, monkeypatch) -> Path:
    folder = tmp_path / "data" / RECORD.name
    folder.mkdir(parents=True)
    random = np.random.default_rng(1)
    np.save(folder / "drive.npy", np.repeat(random.uniform(-4, 4, (2, 100)), 20, axis=1))
    monkeypatch.setitem(trial.READERS, RECORD.name, spring)
    monkeypatch.setattr(real, "load_records", lambda: {RECORD.name: RECORD})
    return tmp_path / "data"


@pytest.mark.slow
def test_right_and_wrong_answers_are_told_apart(data: Path, tmp_path: Path):
    """One diagnosis; the same answer is right by one expectation and wrong by another."""
    keep = tmp_path / "kept"
    found = {figure.key: figure for figure in real.figures(data=data, keep=keep)}
    right = found["real.bench_spring.right"]
    assert right.value == 1.0, right.how
    assert found["real.bench_spring.cubic_stiffness_k3"].met
    assert found["real.bench_spring.rmse_b"].met
    assert 0.0 < found["real.bench_spring.seconds"].value < 600.0
    assert found["real.bench_spring.held_out_left_percent"].value < 5.0
    kept = json.loads((keep / "results.json").read_text())
    assert kept["bench_spring"]["names"] == ["cubic_stiffness"]
    answer = json.loads((keep / "bench_spring" / "diagnosed" / "diagnosis.json").read_text())
    other = replace(RECORD, expected=Expected(("named",), "", first=("coulomb_friction",)))
    again = trial.Trial(other, keep / "bench_spring", {}, answer, "", 1.0)
    assert real.verdict_of(again).judged == "wrong"


def test_a_command_that_fails_is_no_answer(data: Path, monkeypatch):
    broken = replace(RECORD, model={"sample_period": 3 * T, "base": {"mass": -1.0}})
    monkeypatch.setattr(real, "load_records", lambda: {RECORD.name: broken})
    found = {figure.key: figure for figure in real.figures(data=data)}
    assert found["real.bench_spring.right"].value == 0.0
    assert "mass" in found["real.bench_spring.right"].how


def test_a_record_that_is_not_there_is_left_out_and_said_where_to_get(tmp_path: Path):
    found = real.figures(data=tmp_path, only="pendulum")
    assert [figure.key for figure in found] == ["real.pendulum.right"]
    assert math.isnan(found[0].value)
    assert "github.com/dynamicslab/MultiArm-Pendulum" in found[0].how


def test_what_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(real.RealError, match="no such record"):
        real.figures(only="pendulums")
    with pytest.raises(real.RealError, match="no such folder"):
        real.figures(data=tmp_path / "nowhere")


def test_the_page_holds_the_tables_of_what_is_kept():
    text = page.PAGE.read_text("utf-8")
    assert page.with_tables(text, page.read_results()) == text
    for name in load_records():
        assert f"### {name}\n" in text


def test_results_fill_their_rows_and_leave_the_others(tmp_path: Path):
    one = page.Result("partial", ("second_mode",), "wrong", "`partial` was not expected", 12.3,
                      {"held_out_left_percent": {"value": 7.0},
                       "mass": {"value": 94.0, "unit": "kg", "peer_value": 95.1, "bar": 93.2,
                                "bar_to": 97.0, "bar_kind": "between", "met": True,
                                "how": "inside"}})
    path = tmp_path / "results.json"
    page.write_results(path, {"emps": one})
    page.write_results(path, {"beam": replace(one, judged="right")})
    results = page.read_results(path)
    totals, _, _, _, *lines = page.answers(results).splitlines()
    assert totals.startswith("All 2 records: 1 right, 0 silent, 1 wrong.")
    rows = {row[row.index("[") + 1:row.index("]")]: row for row in lines}
    assert "`force_offset` | partial: `second_mode` | **wrong** | 7 | 12 |" in rows["emps"]
    assert "| right |" in rows["beam"]
    assert page.NOT_RUN in rows["silverbox"]
    assert "| `emps` | mass | 94 kg | 95.1 kg | 93.2 to 97 | inside |" in \
        page.figures_beside_published(results)


def test_results_that_are_not_there_leave_the_page_as_it_is(tmp_path, capsys):
    before = page.PAGE.read_text("utf-8")
    assert page.main([str(tmp_path / "results.json")]) == 2
    assert "no such file" in capsys.readouterr().err
    assert page.PAGE.read_text("utf-8") == before
