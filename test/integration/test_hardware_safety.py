"""Life cycle and safety of the drivers in simulation: what cuts the output, and latches."""

from __future__ import annotations

import math

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from std_srvs.srv import Trigger

from dfm_interfaces.msg import AmplifierState, Command, Drive, PositionCounts
from dfm_stage.errors import DfmError
from dfm_stage.harness import StageGraph
from dfm_stage.middleware.wire import codec
from dfm_stage.nodes.encoder_driver import EncoderDriver
from dfm_stage.nodes.wiring import LATCHED_QOS

pytestmark = pytest.mark.real_time

AMPLIFIER, ENCODER = "/stage/x/amplifier_driver", "/stage/x/encoder_driver"


class Bench:
    """amplifier_driver alone, with a hand on the command topic and an eye on what it does."""

    def __init__(self, graph):
        self.graph = graph
        self.states, self.drives = [], []
        client = graph._client_node
        client.create_subscription(AmplifierState, "/stage/x/amplifier", self.states.append, 100)
        client.create_subscription(Drive, "/stage/x/sim/drive", self.drives.append, 100)
        self.publisher = client.create_publisher(Command, "/stage/x/command", 10)
        graph.spin_until(lambda: self.publisher.get_subscription_count() > 0
                         and client.count_publishers("/stage/x/amplifier") > 0, 10.0, "the driver")
        self.seq = 0

    def command(self, voltage, seq=None, saturated=False):
        """Send one command; return the state that answers it."""
        self.seq = self.seq + 1 if seq is None else seq
        del self.states[:]
        self.publisher.publish(codec(Command, "x").encode(0, self.seq, 0, 0, voltage, saturated))
        self.graph.spin_until(lambda: len(self.states) > 0, 10.0, "an answer")
        return self.states[-1]

    def trigger(self, service):
        return self.graph.call(Trigger, f"{AMPLIFIER}/{service}", Trigger.Request())

    def assert_latched(self, fault):
        state = self.command(1.0)
        assert (state.voltage, state.enabled, state.faults) == (0.0, False, fault)
        assert (self.drives[-1].voltage, self.drives[-1].enabled) == (0.0, False)
        refused = self.trigger("arm")
        assert not refused.success
        assert "clear first" in refused.message
        assert self.trigger("clear").success
        assert self.command(1.0).faults == AmplifierState.FAULT_DISARMED
        assert self.trigger("arm").success
        assert self.command(1.0).voltage == 1.0


@pytest.fixture
def bench():
    with StageGraph(composed=True, nodes=("sim_plant", "amplifier_driver"),
                    parameters={"amplifier_driver": {"stale_timeout_s": 10.0}}) as graph:
        yield Bench(graph)


@pytest.mark.parametrize(("voltage", "fault"), [
    (math.nan, AmplifierState.FAULT_NOT_FINITE), (-math.inf, AmplifierState.FAULT_NOT_FINITE),
    (10.5, AmplifierState.FAULT_OUT_OF_RANGE)])
def test_a_bad_command_latches(bench, voltage, fault):
    assert bench.command(1.0).voltage == 1.0
    assert bench.command(voltage).faults == fault
    bench.assert_latched(fault)


def test_commands_of_two_publishers_latch(bench):
    assert bench.command(1.0, seq=500).voltage == 1.0
    assert bench.command(1.0, seq=3).faults == AmplifierState.FAULT_OTHER_PUBLISHER
    bench.assert_latched(AmplifierState.FAULT_OTHER_PUBLISHER)


def test_a_second_publisher_latches_before_it_says_anything(bench):
    bench.command(1.0)
    intruder = rclpy.create_node("intruder", context=bench.graph._context,
                                 use_global_arguments=False)
    publisher = intruder.create_publisher(Command, "/stage/x/command", 10)
    try:
        bench.graph.spin_until(lambda: bool(bench.states[-1].faults), 10.0, "the fault")
        assert bench.states[-1].faults == AmplifierState.FAULT_OTHER_PUBLISHER
    finally:
        intruder.destroy_publisher(publisher)
        intruder.destroy_node()
    answer = bench.trigger("clear")
    assert "/intruder" in answer.message


def test_a_loop_that_diverges_latches(bench):
    for index in range(7):
        state = bench.command(9.0 * (-1) ** index, saturated=True)
    assert state.faults == AmplifierState.FAULT_DIVERGING
    bench.assert_latched(AmplifierState.FAULT_DIVERGING)


@pytest.mark.parametrize(("cause", "fault"), [
    ("travel", AmplifierState.FAULT_TRAVEL), ("encoder", AmplifierState.FAULT_ENCODER)])
def test_what_the_encoder_says_latches(bench, cause, fault):
    health = bench.graph._client_node.create_publisher(DiagnosticStatus,
                                                       "/stage/x/encoder_health", LATCHED_QOS)
    bench.command(1.0)
    health.publish(DiagnosticStatus(level=DiagnosticStatus.ERROR, message="bad",
                                    values=[KeyValue(key="cause", value=cause)]))
    bench.graph.spin_until(lambda: bool(bench.states[-1].faults), 10.0, "the fault")
    assert bench.states[-1].faults == fault
    assert bench.trigger("clear").success
    assert bench.trigger("arm").message == "refused: bad"
    health.publish(DiagnosticStatus(level=DiagnosticStatus.OK))
    bench.graph.spin_until(lambda: bench.trigger("arm").success, 10.0, "armed again")


def test_a_latched_cause_is_named_in_diagnostics(bench):
    heard = []
    bench.graph._client_node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 10)
    bench.command(math.nan)
    bench.graph.spin_until(lambda: any(
        status.name == AMPLIFIER and status.level == DiagnosticStatus.ERROR
        for array in heard for status in array.status), 10.0, "an error in diagnostics")
    status = next(status for array in reversed(heard) for status in array.status
                  if status.name == AMPLIFIER)
    assert "not finite: a command is nan" in status.message
    values = {value.key: value.value for value in status.values}
    assert values["armed"] == "False"
    assert values["latched"].startswith("not finite")
    assert values["trips_not_finite"] == "1"
    assert {"command rate", "command limit", "stale after", "state"} <= values.keys()


def test_before_the_first_command_nothing_is_stale():
    with StageGraph(composed=True, nodes=("sim_plant", "amplifier_driver"),
                    parameters={"amplifier_driver": {"stale_timeout_s": 0.001}}) as graph:
        hand = Bench(graph)
        graph.spin(0.3)
        assert hand.trigger("arm").message == "armed"
        hand.command(1.0)
        graph.spin_until(lambda: bool(hand.states[-1].faults), 10.0, "stale")
        assert hand.states[-1].faults == AmplifierState.FAULT_STALE_COMMAND


def state_of(graph, node):
    return graph.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label


def transition(graph, node, name):
    number = getattr(Transition, f"TRANSITION_{name.upper()}")
    return graph.call(ChangeState, f"{node}/change_state", ChangeState.Request(
        transition=Transition(id=number))).success


def test_in_simulation_the_drivers_start_themselves_and_stop_when_deactivated():
    with StageGraph(composed=True) as graph:
        assert state_of(graph, AMPLIFIER) == state_of(graph, ENCODER) == "active"
        assert not transition(graph, AMPLIFIER, "configure"), "there is no such transition now"
        assert state_of(graph, AMPLIFIER) == "active"
        drives = []
        graph._client_node.create_subscription(Drive, "/stage/x/sim/drive", drives.append, 100)
        graph.spin_until(lambda: len(drives) > 10, 10.0, "drives")
        assert transition(graph, AMPLIFIER, "deactivate")
        graph.spin_until(lambda: not drives[-1].enabled, 10.0, "off")
        assert drives[-1].voltage == 0.0
        del drives[:]
        graph.spin(0.1)
        assert not drives
        refused = graph.call(Trigger, f"{AMPLIFIER}/arm", Trigger.Request())
        assert "activate it first" in refused.message
        assert transition(graph, AMPLIFIER, "activate")
        graph.spin_until(lambda: bool(drives) and drives[-1].enabled, 10.0, "on again")
        assert transition(graph, ENCODER, "deactivate")
        assert transition(graph, ENCODER, "cleanup")
        assert state_of(graph, ENCODER) == "unconfigured"


def test_without_autostart_they_wait():
    quiet = {"autostart": False}
    with StageGraph(composed=True, nodes=("sim_plant", "encoder_driver", "amplifier_driver"),
                    parameters={"encoder_driver": quiet, "amplifier_driver": quiet}) as graph:
        assert state_of(graph, ENCODER) == state_of(graph, AMPLIFIER) == "unconfigured"
        assert not transition(graph, ENCODER, "activate")
        assert transition(graph, ENCODER, "configure")
        assert transition(graph, ENCODER, "activate")
        assert state_of(graph, ENCODER) == "active"


@pytest.mark.parametrize(("elapsed_ns", "count", "fault"), [
    (1_000_000, 40_000, AmplifierState.FAULT_ENCODER),
    (1_000_000_000, 160_000, AmplifierState.FAULT_TRAVEL)])
def test_a_scale_that_jumps_or_leaves_its_travel_cuts_the_output(bench, elapsed_ns, count, fault):
    graph = bench.graph
    encoder = EncoderDriver(context=graph._context,
                            cli_args=["--ros-args", "-r", "__ns:=/stage/z"])
    graph._executor.add_node(encoder)
    client = graph._client_node
    counts = client.create_publisher(PositionCounts, "/stage/z/sim/position_counts", 10)
    relay = client.create_publisher(DiagnosticStatus, "/stage/x/encoder_health", LATCHED_QOS)
    client.create_subscription(DiagnosticStatus, "/stage/z/encoder_health", relay.publish,
                               LATCHED_QOS)
    try:
        graph.spin_until(lambda: counts.get_subscription_count() > 0
                         and relay.get_subscription_count() > 0
                         and client.count_publishers("/stage/z/encoder_health") > 0, 10.0, "both")
        bench.command(1.0)
        for seq, value in enumerate((0, count)):
            counts.publish(codec(PositionCounts).encode(seq * elapsed_ns, seq, value, 5e-8))
        graph.spin_until(lambda: bool(bench.states[-1].faults), 10.0, "the fault")
        assert bench.states[-1].faults == fault
    finally:
        graph._executor.remove_node(encoder)
        encoder.destroy_node()


@pytest.mark.parametrize(("parameters", "words"), [
    ({"device": "qsb_d", "lockstep": True}, "lockstep"),
    ({"device": "abacus"}, "sim, qsb_d")])
def test_hardware_that_cannot_be_is_refused_in_one_line(parameters, words):
    with pytest.raises(DfmError, match=words), StageGraph(
            composed=True, nodes=("encoder_driver",),
            parameters={"encoder_driver": parameters}):
        pass


def test_configuring_without_what_hardware_needs_fails_and_says_why():
    with StageGraph(composed=True, nodes=("encoder_driver", "amplifier_driver"), parameters={
            "encoder_driver": {"device": "qsb_d", "port": "/dev/nowhere"},
            "amplifier_driver": {"device": "copley_ascii", "port": "/dev/nowhere"}}) as graph:
        assert not transition(graph, ENCODER, "configure")
        assert not transition(graph, AMPLIFIER, "configure")
        nodes = {each.kind: each.node for each in graph.launched}
        assert "resolution_m" in nodes["encoder_driver"].errors_active["life cycle"]
        assert "current_limit_a" in nodes["amplifier_driver"].errors_active["life cycle"]
        assert state_of(graph, ENCODER) == state_of(graph, AMPLIFIER) == "unconfigured"
