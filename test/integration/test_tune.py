"""tune: files that the controller loads, tuning on the node graph, and its refusals."""

from __future__ import annotations

import json

import pytest
import rclpy

from dfm_stage.cli import tune
from dfm_stage.control import sample_model, ultimate
from dfm_stage.model import load_model
from dfm_stage.nodes.controller import Controller


def load(path) -> dict:
    """Start a controller with the file as --params-file; return its settings."""
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    try:
        node = Controller(context=context, cli_args=["--ros-args", "--params-file", str(path)])
        values = dict(node.settings.values)
        node.destroy_node()
        return values
    finally:
        context.try_shutdown()


@pytest.mark.parametrize(("method", "extra"), [
    ("pid", []), ("lqr", ["--no-integral", "--disturbance"]),
    ("ziegler_nichols", ["--way", "model"]),
])
def test_the_controller_loads_what_tune_writes(tmp_path, capfd, method, extra):
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
    assert list(tmp_path.iterdir()) == [out]


def test_relay_tuning_runs_on_the_node_graph(tmp_path, capfd):
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
