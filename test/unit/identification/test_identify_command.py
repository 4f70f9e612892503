"""The identify command: files it writes, lines it prints, codes it ends with."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from dfm_stage.cli import identify
from dfm_stage.model import load_model

LINES = np.arange(1, 141, 2)


@pytest.fixture
def record(tmp_path, reference_stage, multisine):
    def write(name="shake.csv", seed=0, header="time_s,input_v,position_m", periods=4):
        rng = np.random.default_rng(seed)
        u = 0.08 * multisine(LINES, 2000, periods, seed)
        u, y = reference_stage().simulate(u, noise=5e-8 * rng.standard_normal(u.size))
        path = tmp_path / name
        np.savetxt(path, np.column_stack((np.arange(u.size) * 1e-3, u, y)), delimiter=",",
                   header=header, comments="")
        return str(path)
    return write


def run(capsys, *arguments):
    code = identify.main([str(a) for a in arguments])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_writes_figures_model_and_page(record, tmp_path, capsys):
    out = tmp_path / "found"
    code, printed, _ = run(capsys, record(), "--out", out)
    assert code == 0
    found = json.loads((out / "identify.json").read_text())
    assert found["natural_frequency_hz"]["value"] == pytest.approx(3.9009, rel=1e-3)
    assert found["records"] == [str(tmp_path / "shake.csv")]
    model = load_model(out / "model.yaml")
    assert model.base["stiffness"] == found["parameters"]["stiffness"]["value"]
    assert model.origin["identified_from"] == ["shake.csv"]
    assert model.origin["input_unit"] == "V"
    page = (out / "report.html").read_text()
    assert page.startswith("<!DOCTYPE html>")
    assert page.count("<figure") >= 3
    assert "3.90" in page
    digits = hashlib.sha256((tmp_path / "shake.csv").read_bytes()).hexdigest()[:12]
    assert f"shake.csv (sha256 {digits})" in page
    assert "natural frequency" in printed
    assert "paper" in printed
    assert max(len(line) for line in printed.splitlines()) < 140
    assert sorted(p.name for p in out.iterdir()) == ["identify.json", "model.yaml", "report.html"]


def test_the_model_it_writes_can_be_its_start(record, tmp_path, capsys):
    first = tmp_path / "first"
    train, unseen = record(), record("other.csv", seed=1)
    run(capsys, train, "--out", first, "--no-report")
    code, printed, _ = run(capsys, train, "--model", first / "model.yaml", "--holdout", unseen,
                           "--out", tmp_path / "second", "--no-report", "--json")
    assert code == 0
    assert json.loads(printed)["held_out"]["source"] == "other.csv"


def test_free_only_and_fix(record, tmp_path, capsys):
    path = record()
    code, printed, _ = run(capsys, path, "--fix", "mass=2.164", "--fix", "delay=0.001", "--json",
                           "--out", tmp_path / "a", "--no-report")
    found = json.loads(printed)["parameters"]
    assert code == 0
    assert found["delay"] == {"value": 0.001, "unit": "s", "ci95": None, "held": True}
    assert found["stiffness"]["value"] == pytest.approx(1300.0, rel=1e-2)
    code, printed, _ = run(capsys, path, "--free", "mass", "--json", "--out", tmp_path / "b",
                           "--no-report")
    found = json.loads(printed)
    assert code == 0
    assert found["status"] == "not_identifiable"
    assert "ratios" in found["identifiability"]["text"]
    assert found["parameters"]["mass"]["ci95"] == [None, None]
    code, printed, _ = run(capsys, path, "--model", "paper_stage", "--only", "stiffness,damping",
                           "--json", "--out", tmp_path / "c", "--no-report")
    estimated = {n for n, v in json.loads(printed)["parameters"].items() if "held" not in v}
    assert estimated == {"stiffness", "damping"}


def test_other_columns_and_units(record, tmp_path, capsys):
    path = record("log.csv", header="t,iq,theta")
    code, printed, _ = run(capsys, path, "--time", "t", "--time-unit", "s", "--input", "iq",
                           "--input-unit", "A", "--output", "theta", "--output-unit", "rad",
                           "--json", "--out", tmp_path / "o", "--no-report")
    assert code == 0
    assert json.loads(printed)["gain"]["unit"] == "rad/A"


@pytest.mark.parametrize("arguments", [
    [], ["missing.csv"], ["{}", "--fix", "mass=heavy"], ["{}", "--only", "nonsense"],
    ["{}", "--model", "no_such_model"], ["{}", "--skip", "99"], ["{}", "--axis", "z"],
    ["{}", "--free", "cubic_stiffness.k3"],
])
def test_unusable_input_is_one_line_and_code_two(record, tmp_path, capsys, arguments):
    path = record(periods=2)
    code, printed, said = run(capsys, *(a.format(path) for a in arguments), "--out",
                              tmp_path / "o")
    assert code == 2
    assert printed == ""
    assert said.startswith("error: ")
    assert len(said.strip().splitlines()) == 1


def test_an_input_that_never_moves_is_told(tmp_path, capsys):
    path = tmp_path / "rest.csv"
    t = np.arange(5000) * 1e-3
    noise = 1e-7 * np.random.default_rng(0).standard_normal(t.size)
    np.savetxt(path, np.column_stack((t, 0 * t, noise)), delimiter=",",
               header="time_s,input_v,position_m", comments="")
    code, _, said = run(capsys, path, "--out", tmp_path / "o")
    assert code == 2
    assert "excite" in said or "constant" in said


def test_a_position_that_never_moves_is_told(tmp_path, capsys):
    path = tmp_path / "stuck.csv"
    t = np.arange(5000) * 1e-3
    np.savetxt(path, np.column_stack((t, np.sin(t), 0 * t + 1e-3)), delimiter=",",
               header="time_s,input_v,position_m", comments="")
    code, _, said = run(capsys, path, "--out", tmp_path / "o")
    assert code == 2
    assert "never changes" in said
    np.savetxt(path, np.column_stack((t, np.sin(t), np.sin(t)))[:50], delimiter=",",
               header="time_s,input_v,position_m", comments="")
    code, _, said = run(capsys, path, "--out", tmp_path / "o")
    assert code == 2
    assert "50 samples are too few" in said


def test_an_unwritable_folder_is_told(record, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    code, _, said = run(capsys, record(periods=2), "--out", tmp_path / "file")
    assert code == 2
    assert "--out" in said
