"""diagnose --run: the next experiment on the node graph, and the diagnosis with its bag."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dfm_stage.cli import diagnose
from dfm_stage.model import Simulator, load_model, save_model

K3 = 2e5


@pytest.mark.slow
def test_what_was_ambiguous_is_named_after_the_next_experiment(tmp_path, capfd):
    """Slowly moved, a stiffening spring and a coil whose force falls off look alike."""
    believed = load_model("paper_stage")
    stage = believed.with_effect("cubic_stiffness", {"k3": K3})
    save_model(believed, tmp_path / "believed.yaml")
    save_model(stage, tmp_path / "stage.yaml")
    time = stage.sample_period * np.arange(20_000)
    voltage = 0.35 * np.sin(0.4 * np.pi * time) + 0.15 * np.sin(0.6 * np.pi * time)
    noise = 5e-8 * np.random.default_rng(3).standard_normal(time.size)
    position = Simulator(stage).run(voltage).position + noise
    np.savetxt(tmp_path / "slow.csv", np.column_stack([time, voltage, position]), delimiter=",",
               comments="", header="time_s,input_v,position_m")
    out = tmp_path / "out"
    assert diagnose.main([
        str(tmp_path / "slow.csv"), "--model", str(tmp_path / "believed.yaml"), "--out", str(out),
        "--without", "hysteresis,presliding_friction", "--no-report",
        "--run", str(tmp_path / "stage.yaml")]) == 0
    first, again = capfd.readouterr().out.split("on the node graph")
    assert first.startswith("ambiguous:")
    assert "named: The model lacks cubic stiffness" in again
    found = json.loads((out / "diagnosis.json").read_text())
    low, high = found["effects"][0]["parameters"]["k3"]["ci95"]
    assert low < K3 < high
    assert found["records"][1] == str(out / "round_1")
