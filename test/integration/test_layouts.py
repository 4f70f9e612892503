"""Which nodes share a process, from Python and from the command line."""

from __future__ import annotations

import signal

import pytest

from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.compose import main

STEP = {"name": "step", "mode": "pid", "duration_s": 1.0, "axes": {axis: {
    "reference": {"kind": "steps", "levels_m": [0.0, 1e-4], "dwell_s": 0.2}} for axis in "xy"}}
AXIS = {"encoder_driver", "amplifier_driver", "controller", "trajectory_generator"}


def processes(graph):
    out = {}
    for each in graph.launched:
        out.setdefault(each.process.pid, set()).add(each.full_name)
    return sorted(out.values(), key=sorted)


def nodes_of(axis, *more):
    return {*(f"/stage/{axis}/{kind}" for kind in AXIS), *more}


@pytest.mark.real_time
def test_axes_without_coupling_have_a_plant_each(tmp_path):
    with StageGraph(axes=("x", "y"), layout="per_axis", bag=tmp_path / "bag") as graph:
        assert processes(graph) == [
            {"/stage/recorder"}, nodes_of("x", "/stage/x/sim_plant"),
            nodes_of("y", "/stage/y/sim_plant")]
        graph.run(STEP)
        graph.stop_recording()
    record = graph.record()
    for axis in "xy":
        assert abs(record.axes[axis].position[-1] - 1e-4) < 2e-5
    assert (record.axes["x"].position[:900] != record.axes["y"].position[:900]).any()  # the seed


@pytest.mark.real_time
def test_coupled_axes_have_one_plant_in_the_process_of_the_first():
    with StageGraph(axes=("x", "y"), model="xy_stage", layout="per_axis") as graph:
        assert processes(graph) == [nodes_of("x", "/stage/sim_plant"), nodes_of("y")]
        graph.run(STEP)


@pytest.mark.real_time
def test_nodes_that_share_a_process_end_and_start_together():
    with StageGraph(layout="per_axis") as graph:
        graph.signal_node("/stage/x/controller", signal.SIGINT)
        assert all(each.ended for each in graph.launched)
        graph.restart_node("/stage/x/encoder_driver")
        assert processes(graph) == [nodes_of("x", "/stage/sim_plant")]
        graph.run({**STEP, "axes": {"x": STEP["axes"]["x"]}})


def test_an_unknown_layout_is_refused():
    with pytest.raises(HarnessError, match="choose one of processes, per_axis, composed"):
        StageGraph(layout="per_axes")


@pytest.mark.parametrize("name", ["controller", "/stage/x/controler", "x/controller"])
def test_a_name_that_is_no_node_is_one_line(name, capsys):
    assert main([name]) == 2
    assert "is no full name of a node" in capsys.readouterr().err
