"""A run says what came of it: in the action's result, the bag, the exception and the exit code."""

from __future__ import annotations

import json

import pytest
from action_msgs.msg import GoalStatus

from dfm_interfaces.action import RunExperiment
from dfm_interfaces.srv import Ready
from dfm_stage.cli.command import run_command
from dfm_stage.harness import HarnessError, RunFailedError, StageGraph
from dfm_stage.recording import read_bag, read_record

MOVE = {"name": "move", "mode": "pid", "duration_s": 0.6, "axes": {"x": {
    "reference": {"kind": "steps", "levels_m": [0.0, 1e-4], "dwell_s": 0.1}}}}
PUSH = {"name": "push", "mode": "open_loop", "duration_s": 0.3, "axes": {"x": {
    "excitation": {"kind": "steps", "levels_v": [0.0, 0.1], "dwell_s": 0.1}}}}
LAME = {"kp": 1.0, "ki": 0.0, "kd": 0.0}


def lockstep(tmp_path, **parameters):
    return StageGraph(composed=True, lockstep=True, bag=tmp_path / "bag", parameters=parameters)


@pytest.mark.parametrize(("parameters", "experiment", "why"), [
    ({"amplifier_driver": {"autoarm": False}}, PUSH, "the output is disarmed"),
    ({"amplifier_driver": {"voltage_limit_v": 0.05}}, PUSH, "out of range: a command of 0.1"),
    ({}, {**MOVE, "controller": LAME}, "the reference was not followed: RMS error"),
    ({}, {**MOVE, "bounds": {"error_rms_m": 1e-9}}, "allowed 1 nm"),
    ({}, {**MOVE, "bounds": {"error_peak_m": 1e-9}}, "largest error"),
])
def test_what_was_not_done_is_no_success_and_the_reason_is_kept(parameters, experiment, why,
                                                                tmp_path, capfd):
    def work() -> int:
        with lockstep(tmp_path, **parameters) as graph:
            graph.run(experiment)
        return 0

    assert run_command(work) == 1
    said = capfd.readouterr().err
    assert why in said.splitlines()[-1]
    record = read_record(tmp_path / "bag")
    ran = record.provenance.parameters["/stage/x/trajectory_generator"]["run"]
    assert ran["success"] is False
    assert why in ran["message"]
    assert any(f"{experiment['name']} ended without success: " in note and why in note
               for note in record.warnings)


@pytest.mark.parametrize(("parameters", "experiment"), [
    ({}, MOVE), ({}, PUSH),
    ({}, {**MOVE, "controller": LAME, "bounds": {"error_rms_m": 1.0}}),
    ({"amplifier_driver": {"autoarm": False}}, {**PUSH, "bounds": {"output_on": False}}),
])
def test_what_was_done_is_a_success(parameters, experiment, tmp_path):
    with lockstep(tmp_path, **parameters) as graph:
        result = graph.run(experiment)["x"]
    assert result.last_seq - result.first_seq + 1 == round(1000 * experiment["duration_s"])
    record = read_record(tmp_path / "bag")
    ran = record.provenance.parameters["/stage/x/trajectory_generator"]["run"]
    assert (ran["success"], ran["message"]) == (True, "")
    assert not any("without success" in note for note in record.warnings)


def test_what_is_refused_before_it_starts_is_unusable_input(tmp_path):
    far = {**MOVE, "axes": {"x": {"reference": {"kind": "steps", "levels_m": [0.0, 0.5],
                                                         "dwell_s": 0.1}}}}
    with lockstep(tmp_path) as graph, pytest.raises(HarnessError) as refused:
        graph.run(far)
    assert not isinstance(refused.value, RunFailedError)


def test_the_action_says_so_to_whoever_asks(tmp_path):
    file = tmp_path / "push.yaml"
    file.write_text(json.dumps(PUSH))
    with lockstep(tmp_path, amplifier_driver={"autoarm": False}) as graph:
        goal = graph._goals["x"].send_goal_async(RunExperiment.Goal(experiment=str(file)))
        graph.spin_until(goal.done, 10.0, "acceptance")
        asked = goal.result().get_result_async()
        graph.spin_until(asked.done, 10.0, "a result")
        result = asked.result().result
    assert not result.success
    assert result.message == "the output is disarmed"
    assert result.last_seq - result.first_seq == 299


def test_a_run_that_is_cancelled_ends_with_its_next_sample(tmp_path):
    file = tmp_path / "long.yaml"
    file.write_text(json.dumps({**MOVE, "duration_s": 1000.0}))
    with lockstep(tmp_path) as graph:
        goal = graph._goals["x"].send_goal_async(RunExperiment.Goal(experiment=str(file)))
        graph.spin_until(goal.done, 10.0, "acceptance")
        asked = goal.result().get_result_async()
        graph.spin(0.1)
        assert not asked.done()
        goal.result().cancel_goal_async()
        graph.spin_until(asked.done, 10.0, "a result")
        answer = asked.result()
        pushed = graph.run(PUSH)["x"]
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.message == "cancelled"
    assert 0 < answer.result.last_seq - answer.result.first_seq < 999_999
    assert pushed.first_seq == answer.result.last_seq + 1
    bag = read_bag(tmp_path / "bag")
    for topic in ("reference", "excitation", "command"):  # each sample once
        seq = bag[f"/stage/x/{topic}"]["measurement_seq" if topic == "command" else "seq"]
        assert seq.tolist() == list(range(pushed.last_seq + 1)), topic


def test_ready_knows_which_nodes_there_are():
    with StageGraph(composed=True, lockstep=True) as graph:
        def ask(*names):
            return graph.call(Ready, "/stage/x/controller/ready", Ready.Request(nodes=names))

        assert ask("/stage/x/amplifier_driver", "/stage/sim_plant", "/stage/x/controller").ready
        assert ask("amplifier_driver").ready
        answer = ask("/stage/x/amplifier_driver", "/stage/nothing", "/other/amplifier_driver")
        assert not answer.ready
        assert answer.message == "there is no /stage/nothing, /other/amplifier_driver"
