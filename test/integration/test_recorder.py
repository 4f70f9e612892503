"""Bags from the real recorder: accepted by others, and readable whatever happens to it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from dfm_stage.harness import StageGraph
from dfm_stage.recording import read_bag, read_record

pytestmark = pytest.mark.real_time

SCAN = {"name": "scan", "mode": "pid", "duration_s": 1.0,
        "axes": {"x": {"reference": {"kind": "raster"}}}}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("recorder") / "bag"
    with StageGraph(lockstep=True, composed=True, bag=path, seed=7) as graph:
        graph.run(SCAN)
        graph.stop_recording()
    return path


def test_rosbags_reads_every_message(bag):
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        ours = [each for each in reader.connections if each.topic == "/stage/x/measurement"]
        positions = [reader.deserialize(raw, connection.msgtype).position
                     for connection, _, raw in reader.messages(connections=ours)]
        assert {each.ext.serialization_format for each in reader.connections} == {"cdr"}
        for each in reader.connections:
            assert each.digest.startswith("RIHS01_")
            assert each.ext.offered_qos_profiles
    expected = read_bag(bag)["/stage/x/measurement"]["position"]
    assert np.array_equal(positions, expected)
    assert len(positions) == 1001


def test_parameters_model_and_versions_are_inside(bag):
    with next(bag.glob("*.mcap")).open("rb") as file:
        attached = {each.name: each.data for each in make_reader(file).iter_attachments()}
    parameters = json.loads(attached["parameters.yaml"])
    assert parameters["/stage/x/controller"]["parameters"]["mode"] == "pid"
    assert parameters["/stage/sim_plant"]["parameters"]["seed"] == 7
    run = parameters["/stage/x/trajectory_generator"]["run"]
    assert (run["experiment"], run["first_seq"]) == ("scan", 0)
    assert b"stiffness: 650" in attached["model.yaml"]
    assert "numpy" in json.loads(attached["versions.json"])


def test_the_schema_is_the_installed_definition(bag):
    with next(bag.glob("*.mcap")).open("rb") as file:
        schemas = {each.name: each for each in make_reader(file).get_summary().schemas.values()}
    schema = schemas["dfm_interfaces/msg/Command"]
    assert schema.encoding == "ros2msg"
    text = schema.data.decode()
    assert "uint32 measurement_seq" in text
    assert "=" * 80 + "\nMSG: std_msgs/Header\n" in text
    assert "MSG: builtin_interfaces/Time\n" in text


def test_killed_it_loses_at_most_the_last_second(tmp_path):
    bag = tmp_path / "bag"
    with StageGraph(bag=bag) as graph:
        recorder = next(each for each in graph.launched if each.kind == "recorder")
        plant = []
        from dfm_interfaces.msg import PlantState

        graph._client_node.create_subscription(
            PlantState, "/stage/x/plant", lambda message: plant.append(message.seq), 10)
        graph.spin_until(lambda: len(plant) > 3000, 30.0, "three seconds of samples")
        recorder.process.send_signal(signal.SIGKILL)
        recorder.process.wait()
        last = plant[-1]
        graph.launched.remove(recorder)
    read = read_bag(bag)
    recorded = read["/stage/x/plant"]["seq"]
    assert recorded[-1] >= last - 1000
    assert np.all(np.diff(recorded.astype(np.int64)) > 0)
    # the plant leaves samples out where the machine holds it up; what it published is there
    published = [seq for seq in plant if recorded[0] <= seq <= recorded[-1]]
    assert len(published) > 1000
    assert set(published) <= set(recorded.tolist())
    assert read.losses
    assert any("cut" in text or "not closed" in text or "end" in text
               for text in read_record(bag).warnings), read_record(bag).warnings


@pytest.mark.slow
def test_a_full_disk_is_said_and_stops_nothing_else(tmp_path):
    bag = tmp_path / "bag"
    with StageGraph(composed=True) as graph:
        args = [sys.executable, "-m", "dfm_stage", "recorder", "--ros-args", "-p",
                f"bag:={bag}"]
        log = tmp_path / "log"
        with log.open("wb") as out:
            recorder = subprocess.Popen(
                ["bash", "-c", 'ulimit -f 1024; exec "$@"', "bash", *args], stdout=out, stderr=out,
                env={**os.environ, "ROS_DOMAIN_ID": str(graph._domain_id)})
        try:
            graph.spin_until(lambda: "not recorded" in log.read_text()
                             or "the file would grow" in log.read_text(), 30.0,
                             "the recorder's complaint")
            assert recorder.poll() is None
            plant = next(each.node for each in graph.launched if each.kind == "sim_plant")
            seq = plant.seq
            graph.spin_until(lambda: plant.seq > seq + 100, 10.0, "further samples")
        finally:
            recorder.terminate()
            recorder.wait(10.0)
    assert "Traceback" not in log.read_text()
    assert len(read_bag(bag)["/stage/x/plant"]["seq"]) > 0
