"""Lockstep: reproducible to the bit, complete, and able to say what it waits for."""

from __future__ import annotations

import contextlib
import math
import os
import threading
import time

import numpy as np
import pytest
import rclpy
from mcap.reader import make_reader

from dfm_stage.harness import HarnessError, StageGraph, node_set
from dfm_stage.middleware import hand_over
from dfm_stage.middleware.discovery import loopback_alone
from dfm_stage.model import Simulator, load_model
from dfm_stage.nodes.process import make_executor
from dfm_stage.nodes.wiring import LINKS, LOCKSTEP_QOS

SIMULATED = ("sim/position_counts", "sim/drive")
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


@pytest.mark.parametrize("layout", ["composed", "per_axis", pytest.param(
    "processes", marks=pytest.mark.slow)])
def test_a_run_in_processes_is_identical_to_another(layout, tmp_path):
    run(tmp_path / "a", (SHAKE, SCAN), composed=False)
    run(tmp_path / "b", (SHAKE, SCAN), layout=layout)
    first, second = content(tmp_path / "a"), content(tmp_path / "b")
    for topic in LOOP:
        assert first[f"/stage/x/{topic}"] == second[f"/stage/x/{topic}"], topic
    assert len(first["/stage/x/command"]) == 2500


def test_handing_over_gives_the_bytes_that_dds_gives(tmp_path, monkeypatch):
    by_dds, sender = [], hand_over.Sender.to_dds
    monkeypatch.setattr(hand_over.Sender, "to_dds", lambda self, data: (
        by_dds.append(data), sender(self, data)))
    run(tmp_path / "handed", (SHAKE, SCAN), composed=True)
    assert len(by_dds) < 5  # said at the end, when the recorder has left
    with monkeypatch.context() as plain:
        plain.setattr(node_set, "handing_over", lambda *_: contextlib.nullcontext())
        run(tmp_path / "dds", (SHAKE, SCAN), composed=True)
    handed, dds = content(tmp_path / "handed"), content(tmp_path / "dds")
    # of which a short run may have none
    by_the_wall_clock = {"/diagnostics", "/stage/x/joint_states"}
    assert handed.keys() - by_the_wall_clock == dds.keys() - by_the_wall_clock
    topics = [*(f"/stage/x/{topic}" for topic in (*LOOP, *SIMULATED)), "/clock"]
    for topic in topics:
        assert handed[topic] == dds[topic], topic
        assert len(handed[topic]) >= 2500
    assert len(by_dds) >= 2500 * len(topics)


def test_a_listener_outside_hears_all_in_order_and_changes_nothing(tmp_path):
    run(tmp_path / "alone", (SHAKE,), composed=True)
    heard = {topic: [] for topic in (*LOOP, *SIMULATED)}
    with (StageGraph(lockstep=True, composed=True, bag=tmp_path / "heard") as graph,
          listening(graph, heard)):
        graph.run(SHAKE)
        graph.stop_recording()
    alone, recorded = content(tmp_path / "alone"), content(tmp_path / "heard")
    for topic, data in heard.items():
        name = f"/stage/x/{topic}"
        assert recorded[name] == alone[name], topic
        assert data == recorded[name][-len(data):], topic
        assert len(data) >= 1000, topic


@pytest.mark.parametrize(("period_s", "fast"), [(5e-4, True), (1e-3, False)])
def test_a_fast_plant_in_one_process_takes_its_samples_without_a_timer(period_s, fast):
    with StageGraph(composed=True, sample_period_s=period_s) as graph:
        plant, = (each.node for each in graph.launched if each.kind == "sim_plant")
        graph.spin_until(lambda: plant.seq > 0, 20.0, "the first sample")
        begin = plant.seq
        graph.spin_until(lambda: plant.seq > begin + 300, 20.0, "300 samples")
        assert plant._timer.is_canceled() is fast


def test_nothing_of_a_composed_graph_outlives_it():
    threads = []
    for _ in range(3):  # the first leaves what numba and DDS keep for the process
        with StageGraph(lockstep=True, composed=True) as graph:
            graph.run({**SHAKE, "duration_s": 0.1})
        threads.append(len(os.listdir("/proc/self/task")))
    assert threads[1] == threads[2] == threads[0]


@contextlib.contextmanager
def listening(graph, heard):
    """Listen from a context of one's own, as another process does, in a thread."""
    context, over = rclpy.Context(), threading.Event()
    with loopback_alone():
        rclpy.init(context=context, domain_id=graph.domain_id, args=[])
    node, executor = rclpy.create_node("outside", context=context), make_executor(context)
    executor.add_node(node)
    writers = [(each, each.get_subscription_count()) for launched in graph.launched
               for each in launched.node.publishers if each.topic_name.rpartition("/")[2] in heard]
    ears = [node.create_subscription(LINKS[topic].type, f"/stage/x/{topic}", data.append,
                                     LOCKSTEP_QOS, raw=True) for topic, data in heard.items()]

    def spin():
        while not over.is_set():
            executor.spin_once(0.01)

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        graph.spin_until(lambda: all(each.get_publisher_count() for each in ears) and all(
            each.get_subscription_count() > before for each, before in writers), 10.0, "all")
        yield
        time.sleep(0.5)
    finally:
        over.set()
        thread.join()
        executor.remove_node(node)
        node.destroy_node()
        context.try_shutdown()


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
