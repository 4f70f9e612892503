"""The real-time priority of a node's process: taken where it may be, and told either way."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from dfm_stage.harness import StageGraph
from dfm_stage.middleware import scheduling
from dfm_stage.middleware.scheduling import RealTime

LOOP = {"sim_plant", "encoder_driver", "controller", "amplifier_driver", "trajectory_generator"}


def allowed() -> bool:
    code = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(20))"
    return subprocess.run([sys.executable, "-c", code], stderr=subprocess.DEVNULL,
                          check=False).returncode == 0


needs_the_right = pytest.mark.skipif(not allowed(), reason="this user has no right to SCHED_RR")


def policies(pid: int, senders: bool = False) -> set[tuple[int, int]]:
    """Policy and priority of every thread, as the kernel tells: those of Fast DDS's senders, which
    spin on locks, or of all others."""
    found = set()
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            if (thread / "comm").read_text("ascii").startswith("dds.asyn") != senders:
                continue
            number = int(thread.name)
            found.add((os.sched_getscheduler(number), os.sched_getparam(number).sched_priority))
    return found


@needs_the_right
@pytest.mark.real_time     # a process that waits for a processor gives its priority back
@pytest.mark.parametrize("lockstep", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_loop_runs_before_other_work_and_the_recorder_in_between(lockstep, tmp_path):
    with StageGraph(bag=tmp_path / "bag", lockstep=lockstep) as graph:
        for each in graph.launched:
            priority = 20 if each.kind in LOOP else 10
            assert policies(each.process.pid) == {(os.SCHED_RR, priority)}, each.kind
            assert policies(each.process.pid, senders=True) == {(os.SCHED_RR, 1)}, each.kind
        niceness = {each.kind: os.getpriority(os.PRIO_PROCESS, each.process.pid)
                    for each in graph.launched}
    assert niceness.pop("recorder") == max(5, *niceness.values())
    assert len(set(niceness.values())) == 1


@needs_the_right
@pytest.mark.slow
def test_it_is_left_out_when_asked_to():
    with StageGraph(parameters={"sim_plant": {"realtime_priority": 0}}) as graph:
        plant = next(each for each in graph.launched if each.kind == "sim_plant")
        assert policies(plant.process.pid) == {(os.SCHED_OTHER, 0)}


def test_a_process_that_the_nodes_share_keeps_its_own():
    before = os.sched_getscheduler(0)
    with StageGraph(composed=True):
        assert os.sched_getscheduler(0) == before


@pytest.fixture
def scheduler(monkeypatch):
    """A scheduler that grants everything, and a clock of how long the process waited."""
    asked: list[tuple[int, int, int]] = []
    waited = [0.0]
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_OTHER)
    monkeypatch.setattr(os, "sched_setscheduler", lambda thread, policy, parameter: asked.append(
        (thread, policy, parameter.sched_priority)))
    monkeypatch.setattr(scheduling, "_waited_s", lambda: waited[0])
    return asked, waited


def test_a_refusal_changes_nothing_and_says_what_is_missing(monkeypatch, scheduler):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    realtime = RealTime()
    realtime.take(20, 0.0)
    assert realtime.words == ("normal (SCHED_RR 20: Operation not permitted; see rtprio in "
                              "limits.conf)")
    assert not realtime.look(1.0)


def test_a_policy_from_outside_is_kept(monkeypatch, scheduler):
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_IDLE)
    realtime = RealTime()
    realtime.take(20, 0.0)
    assert realtime.words == "as set from outside"
    assert scheduler[0] == []


def test_threads_that_run_already_get_it_too(scheduler):
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    RealTime().take(20, 0.0)
    done.set()
    thread.join()
    assert (thread.native_id, os.SCHED_RR, 20) in scheduler[0]


@pytest.mark.parametrize(("waits", "given_back"), [
    ([0.01] * 9, False), ([0.3, 0.3, 0.0] * 3, False), ([0.0] + [0.1] * 5, True)])
def test_it_is_given_back_where_the_processors_are_too_few(scheduler, waits, given_back):
    asked, waited = scheduler
    realtime = RealTime()
    realtime.take(20, 0.0)
    looks = []
    for second, wait in enumerate(waits, start=1):
        waited[0] += wait
        looks.append(realtime.look(float(second)))
    assert any(looks) == given_back
    assert realtime.held != given_back
    assert (asked[-1][1] == os.SCHED_OTHER) == given_back
    if given_back:
        assert "waited 10% of the time" in realtime.words


def test_where_it_waits_much_it_is_given_back_sooner(scheduler):
    _, waited = scheduler
    realtime = RealTime()
    realtime.take(20, 0.0)
    looks = []
    for second in range(1, 4):
        waited[0] += 0.35
        looks.append(realtime.look(float(second)))
    assert looks == [False, False, True]
    assert "waited 35% of the time" in realtime.words


def test_it_is_taken_again_after_a_while_which_doubles(scheduler):
    _, waited = scheduler
    realtime = RealTime()
    realtime.take(20, 0.0)
    changes = []
    for second in range(1, 100):
        waited[0] += 0.1
        if realtime.look(float(second)):
            changes.append((second, realtime.held))
    assert changes == [(5, False), (25, True), (30, False), (70, True), (75, False)]


def test_it_is_given_back_while_the_loop_is_broken(scheduler):
    asked, _ = scheduler
    realtime = RealTime()
    realtime.take(20, 0.0)
    seen = [(realtime.look(float(second), broken), realtime.held) for second, broken in
            enumerate(["", "killed", "killed", "", ""], start=1)]
    assert seen == [(False, True), (True, False), (False, False), (True, True), (False, True)]
    assert asked[-1][1:] == (os.SCHED_RR, 20)


def test_one_that_never_was_real_time_stays_so(scheduler):
    realtime = RealTime()
    realtime.take(0, 0.0)
    assert [realtime.look(1.0, "killed"), realtime.look(2.0)] == [False, False]
    assert scheduler[0] == []
