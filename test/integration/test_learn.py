"""learn: passes on the node graph, the condition checked first, the signal kept and replayed."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dfm_stage.cli import learn
from dfm_stage.model import load_model, save_model
from dfm_stage.recording import read_bag


@pytest.fixture
def files(tmp_path):
    stage = load_model("raster_bench")
    save_model(stage.with_parameters({"stiffness": 540.0, "damping": 1.9}), tmp_path / "m.yaml")
    scan = {"name": "short", "mode": "pid", "duration_s": 1.6, "axes": {"x": {"reference": {
        "kind": "raster", "line_length_m": 2e-3, "line_time_s": 0.2, "turnaround_s": 0.1,
        "lead_in_s": 0.4, "lead_out_s": 0.4, "rest_s": 0.3}}}}
    (tmp_path / "short.yaml").write_text(json.dumps(scan), encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_the_error_of_a_wrong_model_is_learnt_away_and_replayed(files, capfd, opens_well):
    out = files / "learned"
    assert learn.main([str(files / "short.yaml"), "--model", str(files / "m.yaml"), "--plant",
                       "raster_bench", "--passes", "8", "--out", str(out), "--json"]) == 0
    captured = capfd.readouterr()
    said = json.loads(captured.out)["axes"]["x"]
    assert "convergence holds" in captured.err
    assert said["contraction"] < 1.0
    assert said["line_rms_m"]["learned"] < 0.3 * said["line_rms_m"]["first"]
    assert said["line_rms_m"]["learned"] < 200e-9
    assert json.loads((out / "learning.json").read_text()) == {
        "schema": 1, "experiment": str(files / "short.yaml"), "axes": {"x": said}}
    signal = np.loadtxt(out / "x_learned.csv", delimiter=",", skiprows=1)
    bag = read_bag(out / "bag")
    attached = bag.attachments["x_excitation.csv"].decode().splitlines()
    assert len(attached) == len(signal) + 1
    assert float(attached[100].split(",")[1]) == signal[99, 1]
    assert learn.main(["--replay", str(out), "--out", str(files / "again"), "--json"]) == 0
    again = json.loads(capfd.readouterr().out)["axes"]["x"]["line_rms_m"]["learned"]
    assert again == pytest.approx(said["line_rms_m"]["learned"], rel=0.25)
    opens_well(out / "report.html")


def test_what_would_not_converge_is_refused_before_any_pass(files, capfd):
    out = files / "learned"
    assert learn.main([str(files / "short.yaml"), "--model", str(files / "m.yaml"),
                       "--uncertainty", "0.7", "--out", str(out)]) == 1
    error = capfd.readouterr().err.strip().split("\n")[-1]
    assert error.startswith("error: axis x: ")
    assert math.isfinite(float(error.split("Hz the error would change by ")[1].split()[0])
                         if "would change" in error else 0.0)
    assert not out.exists()


@pytest.mark.parametrize(("arguments", "word"), [
    (["scan", "--model", "paper_stage"], "at rest in the same place"),
    (["multisine", "--model", "paper_stage"], "excitation"),
    (["scan_repeat"], "no model"), (["nothing", "--model", "paper_stage"], "nothing"),
    (["scan_repeat", "--model", "paper_stage", "--passes", "0"], "--passes"),
    (["scan_repeat", "--model", "nowhere"], "nowhere"), (["--replay", "/nowhere"], "/nowhere"),
])
def test_unusable_input_is_one_line_and_code_2(files, monkeypatch, capfd, arguments, word):
    monkeypatch.chdir(files)
    assert learn.main(arguments) == 2
    assert word in capfd.readouterr().err.strip().split("\n")[-1]
    assert not (files / "learned").exists()
