"""Real time: what is counted, what is never lost, and when the output is zero."""

from __future__ import annotations

import math

import numpy as np
import pytest
from std_srvs.srv import Trigger

from dfm_interfaces.msg import AmplifierState, Command, Measurement
from dfm_stage.harness import StageGraph
from dfm_stage.middleware.wire import codec
from dfm_stage.recording import read_bag

pytestmark = pytest.mark.real_time

SHAKE = {"name": "shake", "mode": "open_loop", "duration_s": 1.0, "axes": {"x": {
    "excitation": {"kind": "sine", "amplitude_v": 0.1, "frequency_hz": 5.0}}}}


def node(graph, kind):
    return next(each.node for each in graph.launched if each.kind == kind)


def listen(graph, message_type, topic):
    received = []
    graph._client_node.create_subscription(message_type, topic, received.append, 100)
    return received


def assert_gaps_are_flagged(seq, flags):
    """A machine that stands still for a tenth of a second leaves samples out, but says so."""
    gap = np.diff(np.asarray(seq, dtype=np.int64)) != 1
    lost = (np.asarray(flags) & Measurement.FLAG_SAMPLES_LOST) != 0
    assert np.array_equal(gap, lost[1:])


def test_measurements_have_no_gap_and_are_numbered_and_dated(tmp_path):
    bag = tmp_path / "bag"
    with StageGraph(composed=True, bag=bag) as graph:
        result = graph.run(SHAKE)["x"]
        graph.stop_recording()
    topics = read_bag(bag)
    measurement = topics["/stage/x/measurement"]
    assert_gaps_are_flagged(measurement["seq"], measurement["flags"])
    assert np.all(np.diff(measurement["header.stamp"]) >= 0)
    command = topics["/stage/x/command"]
    assert np.all(np.diff(command["seq"].astype(np.int64)) == 1)
    stamps = dict(zip(measurement["seq"], measurement["header.stamp"], strict=True))
    for seq, stamp in zip(command["measurement_seq"], command["measurement_stamp"], strict=True):
        assert stamps.get(seq, stamp) == stamp
    inside = (command["measurement_seq"] >= result.first_seq + 100) & (
        command["measurement_seq"] <= result.last_seq)
    assert np.max(np.abs(command["voltage"][inside])) == pytest.approx(0.1, rel=1e-2)


def test_the_output_is_zero_when_commands_stop_and_says_so():
    with StageGraph(composed=True) as graph:
        states = listen(graph, AmplifierState, "/stage/x/amplifier")
        graph.spin_until(lambda: len(states) > 50, 10.0, "amplifier states")
        controller = node(graph, "controller")
        graph._executor.remove_node(controller)
        graph.spin_until(lambda: bool(states[-1].faults), 5.0, "a fault")
        assert states[-1].faults == AmplifierState.FAULT_STALE_COMMAND
        assert states[-1].voltage == 0.0
        graph._executor.add_node(controller)
        del states[:]
        graph.spin_until(lambda: len(states) > 20, 5.0, "commands again")
        assert all(state.faults and state.voltage == 0.0 for state in states)
        for service in ("clear", "arm"):
            assert graph.call(Trigger, f"/stage/x/amplifier_driver/{service}",
                              Trigger.Request()).success
        graph.spin_until(lambda: states[-1].faults == 0, 5.0, "output again")


@pytest.mark.parametrize(("voltage", "fault"), [
    (math.nan, AmplifierState.FAULT_NOT_FINITE),
    (math.inf, AmplifierState.FAULT_NOT_FINITE),
    (10.1, AmplifierState.FAULT_OUT_OF_RANGE),
])
def test_a_command_that_is_wrong_gives_zero(voltage, fault):
    with StageGraph(composed=True, nodes=("sim_plant", "amplifier_driver")) as graph:
        states = listen(graph, AmplifierState, "/stage/x/amplifier")
        commands = graph._client_node.create_publisher(Command, "/stage/x/command", 10)
        graph.spin_until(lambda: commands.get_subscription_count() >= 1, 10.0, "amplifier_driver")
        encode = codec(Command, "x").encode
        commands.publish(encode(0, 1, 0, 0, 1.0, False))
        graph.spin_until(lambda: len(states) > 0, 5.0, "an answer")
        assert (states[-1].voltage, states[-1].faults) == (1.0, 0)
        del states[:]
        commands.publish(encode(0, 2, 1, 0, voltage, False))
        graph.spin_until(lambda: len(states) > 0, 5.0, "an answer")
        assert states[0].voltage == 0.0
        assert states[0].faults & fault


def test_disarmed_there_is_no_output():
    with StageGraph(composed=True) as graph:
        states = listen(graph, AmplifierState, "/stage/x/amplifier")
        answer = graph.call(Trigger, "/stage/x/amplifier_driver/disarm", Trigger.Request())
        assert answer.success
        graph.spin_until(lambda: bool(states) and not states[-1].enabled, 5.0, "disarmed")
        graph.spin_until(lambda: len(states) > 50, 5.0, "states")
        assert states[-1].voltage == 0.0
        assert states[-1].faults & AmplifierState.FAULT_DISARMED


def test_a_plant_held_up_makes_up_for_its_samples_and_counts_them():
    with StageGraph(composed=True) as graph:
        seen = listen(graph, Measurement, "/stage/x/measurement")
        graph.spin_until(lambda: len(seen) > 50, 10.0, "measurements")
        import time

        time.sleep(0.02)
        graph.spin_until(lambda: len(seen) > 200, 10.0, "measurements")
        plant = node(graph, "sim_plant")
        assert plant.counters["deadlines_missed"] >= 15
        assert_gaps_are_flagged([each.seq for each in seen], [each.flags for each in seen])
