"""Characterisation through the node graph: bars of the paper's tests, from the bags."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dfm_stage.cli import characterize
from dfm_stage.cli.graph_run import run_on_graph
from dfm_stage.identification.characterisation import characterise
from dfm_stage.model import load_model
from dfm_stage.paper.stage import DirectStage
from dfm_stage.trajectory import load_experiment

UP = [0.0, 1.8, 3.6, 1.8, 0.0, -1.8, -3.6, -1.8, 0.0, 1.8, 3.6, 1.8, 0.0]
ALL = {
    # One run for three tests: a staircase, a stepped sine and a decay would take three graphs.
    "static": {"name": "short_static", "mode": "open_loop", "duration_s": 13.0, "axes": {"x": {
        "excitation": {"kind": "steps", "levels_v": UP, "dwell_s": 1.0, "rise_s": 0.6}}}},
    "decay": {"name": "short_decay", "mode": "open_loop", "duration_s": 6.5, "axes": {"x": {
        "excitation": {"kind": "steps", "levels_v": [1.5, 0.0], "dwell_s": 1.5}}}},
    "stepped_sine": {"name": "short_sine", "mode": "open_loop", "duration_s": 13.2, "axes": {
        "x": {"excitation": {"kind": "stepped_sine", "settle_s": 0.4, "measure_s": 0.8,
                             "frequencies_hz": [60.0, 30.0, 15.0, 8.0, 5.5, 4.4, 4.0, 3.8, 3.4,
                                                2.5, 1.2]}}}},
}


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    return {kind: run_on_graph(content, folder / kind, model="paper_stage")
            for kind, content in ALL.items()}


def test_bars(records):
    base = load_model("paper_stage").base
    held = characterise("static", records["static"], force_constant=base["force_constant"])
    assert held.stiffness.value == pytest.approx(base["stiffness"], rel=0.005)
    decay = characterise("decay", records["decay"])
    ratio = base["damping"] / (2 * math.sqrt(base["stiffness"] * base["mass"]))
    assert decay.decrement.value == pytest.approx(
        2 * math.pi * ratio / math.sqrt(1 - ratio**2), rel=0.02)
    fit = characterise("stepped_sine", records["stepped_sine"]).constrained
    for found, truth in ((fit.numerator, base["force_constant"]), (fit.damping, base["damping"]),
                         (fit.stiffness, base["stiffness"])):
        assert found.value == pytest.approx(truth / base["mass"], rel=0.01)


def test_the_direct_simulation_is_the_graph_to_the_bit(records):
    model = load_model("paper_stage")
    for kind, content in ALL.items():
        direct = DirectStage().run(load_experiment(content), model).axis(None)
        graph = records[kind].axis(None)
        assert np.array_equal(direct.input, graph.input)
        # A count times its size, or the same through the encoder driver: equal to rounding.
        assert np.allclose(direct.position, graph.position, rtol=0.0, atol=1e-15)


def test_the_command_on_a_bag(records, tmp_path, capsys, opens_well):
    bag = records["decay"].provenance.source
    assert characterize.main(["decay", "--bag", bag, "--out", str(tmp_path)]) == 0
    assert "logarithmic decrement" in capsys.readouterr().out
    found = json.loads((tmp_path / "characterize.json").read_text())
    assert found["results"]["decay"]["decrement"]["value"] == pytest.approx(0.2187, rel=1e-3)
    opens_well(tmp_path / "report.html")


def test_what_cannot_be_done_takes_one_line(records, tmp_path, capsys):
    bag = records["decay"].provenance.source
    assert characterize.main(["stepped_sine", "--bag", bag, "--out", str(tmp_path)]) == 2
    assert "stepped sine" in capsys.readouterr().err
    assert characterize.main(["all", "--bag", bag]) == 2
    assert characterize.main(["static", "--bag", str(tmp_path / "none")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 2
    assert error.count("error: ") == 2
