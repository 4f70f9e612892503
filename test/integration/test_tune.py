"""tune: files that the controller loads, tuning on the node graph, and its refusals."""

from __future__ import annotations

import json

import pytest

from dfm_stage.cli import tune
from dfm_stage.control import read_parameters, sample_model, ultimate
from dfm_stage.model import load_model
from dfm_stage.nodes.controller import Controller


@pytest.fixture
def load(ros):
    """Start a controller with a file as --params-file; return its settings."""
    def started(path) -> dict:
        node = Controller(context=ros(), cli_args=["--ros-args", "--params-file", str(path)])
        values = dict(node.settings.values)
        node.destroy_node()
        return values

    return started


@pytest.mark.parametrize(("method", "extra"), [
    ("pid", []), ("lqr", ["--no-integral", "--disturbance"]),
    ("ziegler_nichols", ["--way", "model"]),
])
def test_the_controller_loads_what_tune_writes(tmp_path, capfd, method, extra, load):
    out = tmp_path / "gains.yaml"
    assert tune.main(["--model", "paper_stage", "--method", method, "--margin", "0.55",
                      "--out", str(out), "--json", *extra]) == 0
    said = json.loads(capfd.readouterr().out)
    assert said["reasons"]
    assert said["predicted"]["step_1mm_after_5s"]["value"] < 5e-6
    if method == "ziegler_nichols":
        assert said["margins"]["modulus"] == pytest.approx(0.36, abs=0.01)
        assert said["predicted"]["sine_1mm_half_hz_peak"]["value"] > 1e-4
    else:
        assert said["margins"]["modulus"] >= 0.55
        assert said["predicted"]["sine_1mm_half_hz_peak"]["value"] < 5e-6
    values = load(out)
    for name, value in said["parameters"].items():
        assert values[name] == value, name
    assert sorted(tmp_path.iterdir()) == [out.with_suffix(".html"), out]


def test_both_axes_are_tuned_and_scan_as_predicted(tmp_path, capfd):
    """One file for two axes; the coupled plant runs both at once."""
    out, scan = tmp_path / "xy.yaml", tmp_path / "spiral.yaml"
    part = {"kind": "spiral", "radius_m": 3e-4, "turns": 2, "turn_s": 0.5}
    scan.write_text(json.dumps({"name": "spiral", "mode": "pid", "duration_s": 3.0, "axes": {
        "x": {"reference": part}, "y": {"reference": {**part, "phase_deg": -90.0}}}}))
    assert tune.main(["--model", "xy_stage", "--verify", str(scan), "--out", str(out),
                      "--json"]) == 0
    said = json.loads(capfd.readouterr().out)["axes"]
    assert set(said) == {"x", "y"}
    assert said["x"]["parameters"]["kp"] != said["y"]["parameters"]["kp"]
    for axis in said:
        assert read_parameters(out, axis)["kp"] == said[axis]["parameters"]["kp"]
        found = said[axis]["verified"]
        assert found["achieved"]["rms"] < 1e-6
        # the other axis moves 1/300 of its 0.3 mm here: the model of one axis lacks that
        assert found["achieved"]["rms"] == pytest.approx(found["predicted"]["rms"], abs=3e-7)


@pytest.mark.parametrize(("extra", "below"), [
    ([], 2e-6), pytest.param(["--feedforward", "inverse"], 1e-7, marks=pytest.mark.slow),
    pytest.param(["--method", "lqr"], 3e-7, marks=pytest.mark.slow)])
def test_predicted_and_achieved_error_agree_on_the_graph(tmp_path, capfd, extra, below):
    assert tune.main(["--model", "raster_bench", "--verify", "scan", "--json",
                      "--out", str(tmp_path / "p.yaml"), *extra]) == 0
    found = json.loads(capfd.readouterr().out)["verified"]
    assert found["achieved"]["rms"] < below
    assert found["achieved"]["rms"] == pytest.approx(found["predicted"]["rms"], rel=0.15)


def test_relay_tuning_runs_on_the_node_graph(tmp_path, capfd, load):
    out = tmp_path / "zn.yaml"
    assert tune.main(["--model", "paper_stage", "--method", "ziegler_nichols", "--way", "relay",
                      "--duration", "16", "--out", str(out), "--json"]) == 0
    said = json.loads(capfd.readouterr().out)
    exact = ultimate(sample_model(load_model("paper_stage")))
    assert said["ultimate"]["relay"]["gain_v_m"] == pytest.approx(exact.gain_v_m, rel=0.03)
    assert load(out)["kp"] == pytest.approx(0.6 * said["ultimate"]["relay"]["gain_v_m"])


def test_tuning_that_has_to_stop_is_one_line_and_code_1(tmp_path, capfd):
    out = tmp_path / "zn.yaml"
    assert tune.main(["--model", "paper_stage", "--method", "ziegler_nichols", "--way",
                      "raise_gain", "--travel", "1e-4", "--duration", "3",
                      "--out", str(out)]) == 1
    error = capfd.readouterr().err.strip().split("\n")[-1]
    assert error.startswith("error: raise_gain: the stage went")
    assert not out.exists()


@pytest.mark.parametrize(("arguments", "word"), [
    ([], "no model"), (["--model", "nowhere"], "nowhere"),
    (["--model", "paper_stage", "--margin", "2"], "between 0 and 1"),
    (["--model", "paper_stage", "--out", "/nowhere/x.yaml"], "cannot write there"),
    (["--model", "xy_stage", "--axis", "q"], "axis q"),
    (["--bag", "/nowhere"], "no model could be identified"),
])
def test_unusable_input_is_one_line_and_code_2(tmp_path, monkeypatch, capfd, arguments, word):
    monkeypatch.chdir(tmp_path)
    assert tune.main(arguments) == 2
    assert word in capfd.readouterr().err.strip().split("\n")[-1]
    assert not list(tmp_path.glob("*.yaml"))
