"""The trajectory generator refuses what would leave a limit, before it starts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

from dfm_stage.errors import DfmError
from dfm_stage.nodes import trajectory_generator
from dfm_stage.nodes.trajectory_generator import TrajectoryGenerator
from dfm_stage.nodes.wiring import TOPICS

SINE = {"reference__kind": "sine", "reference__frequency_hz": 0.5}


def refused(node, **values) -> str:
    result = node.set_parameters_atomically(
        [Parameter(name.replace("__", "."), value=value) for name, value in values.items()])
    assert not result.successful
    return result.reason


def test_a_movement_beyond_the_travel_is_refused_at_start_and_at_run_time(make):
    with pytest.raises(DfmError, match=r"position of .* at t = .* exceeds the limit of 0\.0077 m; "
                                       r"make the movement smaller.*not started"):
        make(TrajectoryGenerator, **SINE, reference__amplitude_m=8e-3)
    node = make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3)
    assert "position of" in refused(node, reference__amplitude_m=8e-3)
    assert "velocity of" in refused(node, limits__velocity_m_s=0.01)
    assert "voltage of 11 V" in refused(node, excitation__kind="hold", excitation__voltage_v=11.0)
    assert "needs a model" in refused(node, limits__force_n=1.0)
    assert "force of" in refused(node, limits__force_n=1.0, limits__model="paper_stage")
    assert "coil_resistance" in refused(node, limits__current_a=1.0, limits__model="paper_stage")


def test_a_signal_found_sound_is_not_made_again(make, monkeypatch):
    node = make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3)
    made = []
    monkeypatch.setattr(node, "_signals", lambda *_: made.append(1))
    for duration_s, times in ((4.0, 1), (4.0, 1), (5.0, 2), (5.0, 2), (4.0, 3)):
        node.set_parameters([Parameter("duration_s", value=duration_s)])
        assert node.settings["duration_s"] == duration_s
        assert len(made) == times
    monkeypatch.undo()
    assert "position of" in refused(node, reference__amplitude_m=8e-3)
    assert "position of" in refused(node, reference__amplitude_m=8e-3)


def test_a_run_in_lockstep_begins_once_the_amplifier_was_heard(make):
    node = make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3, lockstep=True)
    amplifier = TOPICS["amplifier_health"]
    node.create_publisher(DiagnosticStatus, "amplifier_health", amplifier.qos)
    node._begin_run()
    node._on_measurement(SimpleNamespace(seq=7, stamp_ns=0, position=0.0))
    assert node._run.first_seq is None, "it is not known yet whether the output is on"
    node._on_output(serialize_message(
        DiagnosticStatus(level=DiagnosticStatus.WARN, message="the output is off")))
    assert node._run.first_seq == 7
    assert "the output is off" in node._run.outcome.complaint()


def test_a_run_in_lockstep_begins_with_the_sample_that_waits_and_is_one_ahead_from_there(make):
    node = make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3, duration_s=5e-3,
                lockstep=True)
    sent = []
    node._reference.send = lambda stamp_ns, seq, *_: sent.append((seq, stamp_ns))
    steps = []
    for seq in range(7, 13):
        if seq == 8:
            node._begin_run()
        node._on_measurement(SimpleNamespace(seq=seq, stamp_ns=seq * 10**6, position=0.0))
        assert all(stamp_ns == each * 10**6 for each, stamp_ns in sent)
        steps.append([each for each, _ in sent])
        sent.clear()
    assert steps == [[], [7, 8, 9], [10], [11], [], []]
    assert node._run is None
    assert node._pending.seq == 12


def test_a_run_in_lockstep_waits_for_no_amplifier_that_says_nothing(make):
    node = make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3, lockstep=True)
    node._begin_run()
    node._on_measurement(SimpleNamespace(seq=7, stamp_ns=0, position=0.0))
    assert node._run.first_seq == 7


def test_an_experiment_that_leaves_a_limit_is_refused_before_its_first_sample(make, tmp_path):
    file = tmp_path / "e.yaml"
    file.write_text("name: swing\nmode: open_loop\nduration_s: 4\naxes:\n  x:\n    excitation: "
                    "{kind: sine, amplitude_v: 0.5, frequency_hz: 3.9}\n", encoding="utf-8")
    node = make(TrajectoryGenerator, limits__model="paper_stage")
    with pytest.raises(DfmError, match=r"^swing: position of .*it was not started"):
        node._make_run(str(file))
    node.set_parameters([Parameter("limits.travel_m", value=13e-3)])
    assert node._make_run(str(file)).count == 4000


def test_the_inverse_of_a_model_is_added_ahead(make):
    node = make(TrajectoryGenerator, reference__kind="raster", inverse_model="raster_bench",
                duration_s=3.0)
    run = node._make_run()
    assert np.max(np.abs(run.voltage)) > 1.0
    from dfm_stage.model import Simulator, load_model

    moved = Simulator(load_model("raster_bench")).run(run.voltage).position
    assert np.max(np.abs(moved - run.position)) < 1e-7


def test_what_the_amplifier_says_again_is_heard_and_not_read_again(make, monkeypatch):
    node, read = make(TrajectoryGenerator, **SINE, autostart=False), []
    real = trajectory_generator.deserialize_message
    monkeypatch.setattr(trajectory_generator, "deserialize_message",
                        lambda *what: (read.append(1), real(*what))[1])
    heard = []
    for words, times in (("off", 1), ("off", 1), ("", 2), ("", 2), ("off", 3)):
        level = DiagnosticStatus.WARN if words else DiagnosticStatus.OK
        node._on_output(serialize_message(DiagnosticStatus(level=level, message=words)))
        assert (node._output_off, len(read)) == (words, times)
        heard.append(node._output_heard_s)
    assert heard == sorted(set(heard))


class Goal:
    """What the generator uses of a goal handle."""

    def __init__(self) -> None:
        self.request = SimpleNamespace(experiment="")
        self.is_cancel_requested, self.ended, self.said = False, "", ""

    def execute(self, callback) -> None:
        self.said = callback(self).message

    def __getattr__(self, how: str):
        return lambda: setattr(self, "ended", how)


@pytest.fixture
def aside(make, monkeypatch):
    """A generator in real time, and what makes the runs that it was asked for."""
    jobs, node = [], make(TrajectoryGenerator, **SINE, reference__amplitude_m=5e-3)
    monkeypatch.setattr(trajectory_generator.threading, "Thread",
                        lambda target, args, daemon: SimpleNamespace(
                            start=lambda: jobs.append(lambda: node._begin_made(
                                *args, node._made(*args)))))
    return node, jobs


def test_in_real_time_a_run_is_made_beside_the_loop_and_then_begins(aside):
    node, jobs = aside
    node._on_goal(first := Goal())
    assert node._run is None
    node._on_measurement(SimpleNamespace(seq=7, stamp_ns=0, position=0.0))
    node._on_goal(second := Goal())
    assert second.ended == "abort"
    assert second.said == "an experiment is about to begin; cancel it first"
    jobs.pop()()
    assert node._run.goal is first
    node._on_measurement(SimpleNamespace(seq=8, stamp_ns=0, position=0.0))
    assert node._run.first_seq == 9


@pytest.mark.parametrize(("by", "ended"), [("cancel", "canceled"), ("stop", "abort")])
def test_a_run_that_is_given_up_while_it_is_made_does_not_begin(aside, by, ended):
    node, jobs = aside
    node._on_goal(goal := Goal())
    if by == "cancel":
        node._on_cancel(goal)
        goal.is_cancel_requested = True
    else:
        assert node._stop() == "stopped"
    node._on_goal(later := Goal())
    jobs.pop(0)()
    assert (node._run, goal.ended, goal.said) == (None, ended, "stopped before it began")
    jobs.pop()()
    assert node._run.goal is later


def test_a_run_that_cannot_be_made_is_refused_and_an_error_of_ours_is_raised(aside, monkeypatch):
    node, jobs = aside
    node._on_goal(goal := Goal())
    goal.request.experiment = "no_such_experiment"
    jobs.pop()()
    assert (node._run, goal.ended) == (None, "abort")
    assert "no_such_experiment" in goal.said
    monkeypatch.setattr(node, "_make_run", lambda *_: 1 / 0)
    node._on_goal(Goal())
    with pytest.raises(ZeroDivisionError):
        jobs.pop()()
    assert node._asked_for is None
