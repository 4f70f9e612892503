"""The sampling period of the loop is that of the measurements, or nothing is armed."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from dfm_stage.drivers.errors import DriverError
from dfm_stage.errors import DfmError
from dfm_stage.harness import HarnessError
from dfm_stage.nodes.amplifier_driver import AmplifierDriver
from dfm_stage.nodes.controller import Controller
from dfm_stage.nodes.sample_period import PeriodCheck
from dfm_stage.nodes.trajectory_generator import TrajectoryGenerator

HOLD = {"name": "hold", "mode": "pid", "duration_s": 0.2,
        "axes": {"x": {"reference": {"kind": "hold"}}}}


def compared(period_s: float, stamps_s: np.ndarray, first: int = 0) -> PeriodCheck:
    check = PeriodCheck(period_s)
    for seq, stamp_s in enumerate(stamps_s, first):
        check.heard(seq & 0xFFFFFFFF, round(1e9 * stamp_s))
    return check


@pytest.mark.parametrize(("measured_s", "agrees"), [
    (1e-3, True), (1.05e-3, True), (0.95e-3, True), (1.2e-3, False), (1 / 512, False),
    (0.5e-3, False)])
def test_another_period_is_named_with_both_values(measured_s: float, agrees: bool) -> None:
    check = compared(1e-3, measured_s * np.arange(3000), first=2**32 - 500)
    assert check.agrees is agrees
    assert check.measured_s == pytest.approx(measured_s)
    if agrees:
        assert check.complaint == ""
    else:
        assert "sample_period_s is 0.001 s" in check.complaint
        assert f"every {measured_s:.3g} s" in check.complaint


@pytest.mark.parametrize(("held_up_s", "every_s"), [(0.02, 0.02), (0.1, 0.4)])
def test_a_plant_that_makes_up_for_its_samples_in_bursts_is_no_other_period(
        held_up_s: float, every_s: float) -> None:
    grid = 1e-3 * np.arange(3000)
    into = grid % every_s
    late = grid + np.where(into < held_up_s, held_up_s - into, 0.0)  # nothing, then all at once
    assert compared(1e-3, late).agrees
    assert not compared(2e-3, late).agrees


def test_a_standstill_alone_is_not_believed() -> None:
    late = 1e-3 * np.arange(3000)
    late[100:300] = late[300]
    check = PeriodCheck(1e-3)
    for seq in range(500):
        check.heard(seq, round(1e9 * late[seq]))
    assert not check.complaint
    for seq in range(500, 1000):
        check.heard(seq, round(1e9 * late[seq]))
    assert check.agrees


def test_measurements_that_begin_anew_are_compared_anew() -> None:
    check = compared(1e-3, 1e-3 * np.arange(3000))
    assert check.agrees
    assert check.heard(0, 0)
    assert check.measured_s is None
    for seq in range(1, 3000):
        check.heard(seq, seq * 2_000_000)
    assert "every 0.002 s" in check.complaint


def test_too_few_measurements_say_nothing() -> None:
    assert compared(1e-3, 2e-3 * np.arange(100)).measured_s is None


def health(level: bytes, message: str) -> DiagnosticStatus:
    return DiagnosticStatus(level=level, name="/stage/x/controller", message=message)


def test_the_amplifier_refuses_to_arm_until_the_loop_agrees(make) -> None:
    node = make(AmplifierDriver, autoarm=False)
    node._on_loop_health(health(DiagnosticStatus.ERROR, "0.001 s, but every 0.002 s"))
    with pytest.raises(DriverError, match=r"refused: 0\.001 s, but every 0\.002 s"):
        node._arm()
    assert not node._interlock.armed
    node._on_loop_health(health(DiagnosticStatus.OK, "running"))
    assert node._arm() == "armed"
    node._on_loop_health(health(DiagnosticStatus.ERROR, "0.001 s, but every 0.002 s"))
    assert not node._interlock.armed


def test_hardware_waits_for_the_comparison_and_simulation_does_not(make) -> None:
    node = make(AmplifierDriver, autoarm=False)
    node._on_loop_health(health(DiagnosticStatus.WARN, "still compares"))
    node._encoder = DiagnosticStatus(level=DiagnosticStatus.OK)
    assert node._trouble() == ""
    node.simulated = False
    assert node._trouble() == "still compares"
    node.simulated = True


@pytest.mark.parametrize("kind", [Controller, TrajectoryGenerator])
def test_in_lockstep_a_node_ends_at_the_second_measurement(make, kind) -> None:
    heard = []
    hears = make(kind, lockstep=True)._comparing_period(heard.append)
    hears(SimpleNamespace(seq=0, stamp_ns=0))
    with pytest.raises(DfmError, match=r"is 0\.001 s, but .* every 0\.002 s"):
        hears(SimpleNamespace(seq=1, stamp_ns=2_000_000))
    assert len(heard) == 1


def test_a_graph_has_one_period_and_all_nodes_get_it(lockstep_graph) -> None:
    graph = lockstep_graph(sample_period_s=0.002)
    heard = graph.listen("x", "measurement")
    ran = graph.run(HOLD)["x"]
    assert ran.last_seq - ran.first_seq == 99  # 0.2 s
    assert np.unique(np.diff([each.stamp_ns for each in heard])).tolist() == [2_000_000]


def test_a_node_with_a_period_of_its_own_ends_a_lockstep_graph(lockstep_graph) -> None:
    graph = lockstep_graph(parameters={"controller": {"sample_period_s": 0.002}})
    with pytest.raises(DfmError, match=r"controller: .*0\.002 s, .*every 0\.001 s"):
        graph.run(HOLD)


@pytest.mark.real_time
def test_a_node_with_a_period_of_its_own_keeps_a_graph_from_being_armed(stage_graph) -> None:
    graph = stage_graph(composed=True,
                        parameters={"trajectory_generator": {"sample_period_s": 0.002}})
    driver = next(each.node for each in graph.launched if each.kind == "amplifier_driver")
    graph.spin_until(lambda: bool(driver._trouble()), 10.0, "the end of the comparison")
    graph.call(Trigger, "/stage/x/amplifier_driver/clear", Trigger.Request())
    answer = graph.call(Trigger, "/stage/x/amplifier_driver/arm", Trigger.Request())
    assert not answer.success
    assert "trajectory_generator: sample_period_s is 0.002 s" in answer.message
    measured = re.search(r"every (\S+) s", answer.message)
    assert measured is not None
    assert float(measured[1]) == pytest.approx(0.001, rel=0.1)
    with pytest.raises(HarnessError, match="cannot be armed"):
        graph.run(HOLD)
