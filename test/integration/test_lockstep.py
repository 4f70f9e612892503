"""Lockstep: reproducible to the bit, complete, and able to say what it waits for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mcap.reader import make_reader

from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.model import Simulator, load_model

LOOP = ("reference", "excitation", "measurement", "command", "amplifier", "plant")
SHAKE = {"name": "shake", "mode": "open_loop", "duration_s": 1.0, "axes": {"x": {
    "excitation": {"kind": "multisine", "amplitude_v": 0.5, "period_s": 0.5}}}}
SCAN = {"name": "scan", "mode": "pid", "duration_s": 1.5, "axes": {"x": {
    "reference": {"kind": "raster"}}}}


def content(bag):
    out = {}
    with next(bag.glob("*.mcap")).open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            out.setdefault(channel.topic, []).append(message.data)
    return out


def run(bag, experiments=(SCAN,), **options):
    with StageGraph(lockstep=True, bag=bag, **options) as graph:
        results = [graph.run(experiment) for experiment in experiments]
        graph.stop_recording()
    return results


@pytest.mark.parametrize("composed", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_run_in_processes_is_identical_to_another(composed, tmp_path):
    run(tmp_path / "a", (SHAKE, SCAN), composed=False)
    run(tmp_path / "b", (SHAKE, SCAN), composed=composed)
    first, second = content(tmp_path / "a"), content(tmp_path / "b")
    for topic in LOOP:
        assert first[f"/stage/x/{topic}"] == second[f"/stage/x/{topic}"], topic
    assert len(first["/stage/x/command"]) == 2500


def test_seed_changes_the_noise(tmp_path):
    run(tmp_path / "a", (SHAKE,), composed=True, seed=1)
    run(tmp_path / "b", (SHAKE,), composed=True, seed=2)
    a, b = content(tmp_path / "a"), content(tmp_path / "b")
    assert a["/stage/x/plant"] == b["/stage/x/plant"]
    assert a["/stage/x/measurement"] != b["/stage/x/measurement"]


def test_the_record_is_what_the_simulator_says(tmp_path):
    bag = tmp_path / "bag"
    result = run(bag, (SHAKE,), composed=True)[0]["x"]
    assert (result.first_seq, result.last_seq) == (0, 999)
    from dfm_stage.recording import read_record

    axis = read_record(bag).axes["x"]
    position = Simulator(load_model("paper_stage")).run(axis.input).position
    assert np.max(np.abs(axis.position - position[:axis.position.size])) < 6 * 5e-8
    assert np.ptp(axis.position) > 1e-5


def test_two_axes_on_one_plant(tmp_path):
    both = {"name": "both", "mode": "pid", "duration_s": 1.0, "axes": {
        "x": {"reference": {"kind": "sine", "amplitude_m": 1e-3, "frequency_hz": 1.0}},
        "y": {"reference": {"kind": "hold", "position_m": 0.0}}}}
    run(tmp_path / "bag", (both,), axes=("x", "y"), model="xy_stage", composed=True)
    bag = content(tmp_path / "bag")
    for axis in "xy":
        for topic in LOOP:
            assert len(bag[f"/stage/{axis}/{topic}"]) in (1000, 1001), (axis, topic)


@pytest.mark.slow
def test_what_a_stuck_loop_waits_for_is_named(tmp_path):
    kinds = ("sim_plant", "encoder_driver", "controller", "trajectory_generator")
    with (StageGraph(lockstep=True, composed=True, nodes=kinds) as graph,
          pytest.raises(HarnessError, match="sim_plant says: waiting for x/sim/drive")):
        graph.run(SHAKE, timeout_s=8.0)


def test_between_experiments_the_loop_waits_for_a_reference(lockstep_graph):
    graph = lockstep_graph()
    controller = next(each.node for each in graph.launched if each.kind == "controller")
    graph.spin_until(lambda: controller._measurement is not None, 5.0, "a measurement")
    assert "reference" in controller.waiting_for()[0]


def test_pid_follows_and_settles(tmp_path):
    step = {"name": "step", "mode": "pid", "duration_s": 3.0, "axes": {"x": {
        "reference": {"kind": "steps", "levels_m": [0.0, 1e-3], "dwell_s": 0.5}}}}
    run(tmp_path / "bag", (step,), composed=True)
    from dfm_stage.recording import read_record

    axis = read_record(tmp_path / "bag").axes["x"]
    assert axis.reference is not None
    assert np.max(np.abs(axis.position[-500:] - 1e-3)) < 1e-6
    assert math.isclose(float(axis.reference[-2]), 1e-3)
