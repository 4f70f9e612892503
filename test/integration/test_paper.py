"""The paper command: quick, whole or not at all, and one run of its stage on the graph."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dfm_stage.cli import paper
from dfm_stage.cli.paper import GraphStage
from dfm_stage.control import PidGains
from dfm_stage.model import load_model
from dfm_stage.paper.lqr import LAWS
from dfm_stage.paper.pid import closed_loop
from dfm_stage.paper.stage import DirectStage
from dfm_stage.trajectory import load_experiment


@pytest.mark.slow
def test_quick(tmp_path, capsys):
    out = tmp_path / "out"
    assert paper.main(["--quick", "--out", str(out)]) == 0
    said = capsys.readouterr()
    rows = json.loads((out / "paper.json").read_text())["rows"]
    assert len(rows) > 100
    assert all(row["id"] in said.out for row in rows)
    assert "[17/17" in said.err
    assert (out / "report.html").read_text().endswith("</html>\n")
    assert paper.main(["--quick", "--out", str(out)]) == 2
    assert "not empty" in capsys.readouterr().err


def test_a_model_that_is_no_such_stage(tmp_path, capsys):
    assert paper.main(["--quick", "--model", "xy_stage", "--out", str(tmp_path / "x")]) == 2
    assert capsys.readouterr().err.startswith("error: model xy_stage has several axes")


def test_both_laws_on_the_graph_as_simulated_directly(tmp_path):
    model = load_model("paper_two_mode")
    step = {"kind": "steps", "levels_m": [0.0, 0.001], "dwell_s": 0.3}
    regulator = load_experiment({
        "name": "lqr", "mode": "lqr", "duration_s": 1.0, "axes": {"x": {"reference": step}},
        "controller": LAWS["u = L (x_ref - x)"].to_dict()})
    stiffer = model.with_parameters({"stiffness": 1.05 * model.base["stiffness"]})
    for experiment, plant in ((closed_loop("pid", step, 1.0, PidGains()), model),
                              (regulator, stiffer)):
        graph = GraphStage(tmp_path).run(experiment, plant, model).axis(None)
        direct = DirectStage().run(experiment, plant, model).axis(None)
        assert np.allclose(graph.position, direct.position, rtol=0.0, atol=2e-9)
        assert np.max(np.abs(graph.position)) > 1e-4
