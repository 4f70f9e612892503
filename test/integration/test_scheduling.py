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
from dfm_stage.middleware.scheduling import LOOK_S, RealTime

LOOP = {"sim_plant", "encoder_driver", "controller", "amplifier_driver", "trajectory_generator"}


def allowed() -> bool:
    code = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(20))"
    return subprocess.run([sys.executable, "-c", code], stderr=subprocess.DEVNULL,
                          check=False).returncode == 0


needs_the_right = pytest.mark.skipif(not allowed(), reason="this user has no right to SCHED_RR")


def policies(pid: int) -> dict[str, set[tuple[int, int]]]:
    """Policy and priority of each thread, as the kernel tells: of Fast DDS's senders, which spin
    on locks, of its other threads, and of the node's own."""
    found: dict[str, set[tuple[int, int]]] = {}
    for thread in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            name = (thread / "comm").read_text("ascii")
            whose = ("sends" if name.startswith("dds.asyn") else
                     "dds" if name.startswith("dds.") else "own")
            number = int(thread.name)
            found.setdefault(whose, set()).add(
                (os.sched_getscheduler(number), os.sched_getparam(number).sched_priority))
    return found


@needs_the_right
@pytest.mark.real_time     # a process that waits for a processor gives its priority back
@pytest.mark.parametrize("lockstep", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_loop_runs_before_other_work_and_what_a_recorder_writes_in_between(lockstep, tmp_path):
    with StageGraph(bag=tmp_path / "bag", lockstep=lockstep) as graph:
        for each in graph.launched:
            priority = 20 if each.kind in LOOP else 10
            assert policies(each.process.pid) == {
                "own": {(os.SCHED_RR, priority)}, "dds": {(os.SCHED_RR, 20)},
                "sends": {(os.SCHED_RR, 1)}}, each.kind
        niceness = {each.kind: os.getpriority(os.PRIO_PROCESS, each.process.pid)
                    for each in graph.launched}
    assert niceness.pop("recorder") == max(5, *niceness.values())
    assert len(set(niceness.values())) == 1


@needs_the_right
@pytest.mark.slow
def test_it_is_left_out_when_asked_to():
    with StageGraph(parameters={"sim_plant": {"realtime_priority": 0}}) as graph:
        plant = next(each for each in graph.launched if each.kind == "sim_plant")
        assert set().union(*policies(plant.process.pid).values()) == {(os.SCHED_OTHER, 0)}


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


class Machine:
    """Two processors, and real-time processes that each take `needs` of one, in the order in which
    they began; this process is one of them."""

    def __init__(self, monkeypatch, waited, needs, own):
        self.waited, self.needs, self.used_s = waited, needs, [100.0] * len(needs)
        self.own, self.now_s = own, 0.0
        self.realtime = RealTime()
        monkeypatch.setattr(os, "cpu_count", lambda: 2)
        monkeypatch.setattr(scheduling, "_real_time_work", self._work)
        self.realtime.take(20, 0.0)

    def _work(self):
        # numbers of processes say nothing of their age
        return {(number, os.getpid() if number == self.own else 1000 - number): used_s
                for number, used_s in enumerate(self.used_s)
                if number != self.own or self.realtime.held}

    def runs(self, seconds, waits=0.2):
        """Return when `held` changed, and to what."""
        changes = []
        for _ in range(round(seconds / LOOK_S)):
            self.now_s = round(self.now_s + LOOK_S, 3)
            self.waited[0] += waits * LOOK_S
            self.used_s = [used_s + LOOK_S * need
                           for used_s, need in zip(self.used_s, self.needs, strict=True)]
            if self.realtime.look(self.now_s):
                changes.append((self.now_s, self.realtime.held))
        return changes


@pytest.mark.parametrize(("number", "given_back"), [(0, False), (6, False), (8, False),
                                                    (9, True), (11, True)])
def test_of_two_graphs_those_that_began_last_give_it_back(scheduler, monkeypatch, number,
                                                          given_back):
    asked, waited = scheduler
    machine = Machine(monkeypatch, waited, [0.16] * 12, number)
    changes = machine.runs(3.0)
    assert changes == ([(0.8, False)] if given_back else [])
    assert (asked[-1][1] == os.SCHED_OTHER) == given_back
    if given_back:
        assert f"it needs {0.16 * (number + 1):.1f} of 2 processors" in machine.realtime.words


@pytest.mark.parametrize(("needs", "waits"), [([0.7, 0.7], 0.2), ([0.9, 0.9], 0.04)])
def test_where_there_is_room_or_it_hardly_waits_it_is_kept(scheduler, monkeypatch, needs, waits):
    machine = Machine(monkeypatch, scheduler[1], needs, 1)
    assert machine.runs(10.0, waits) == []


def test_a_moment_of_much_work_is_no_reason(scheduler, monkeypatch):
    machine = Machine(monkeypatch, scheduler[1], [0.9, 0.9], 1)
    for _ in range(10):
        assert machine.runs(0.4, 0.5) == []
        assert machine.runs(0.4, 0.0) == []


def test_it_is_taken_again_after_a_while_which_doubles(scheduler, monkeypatch):
    machine = Machine(monkeypatch, scheduler[1], [0.9, 0.9], 1)
    assert machine.runs(70.0) == [(0.8, False), (20.8, True), (21.6, False), (61.6, True),
                                  (62.4, False)]


@needs_the_right
def test_work_of_other_processes_is_measured():
    """Against what the process itself counts."""
    code = ("import os, time\nos.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))\n"
            "while time.process_time() < 0.5: pass\n"
            "print(time.process_time(), flush=True)\ninput()")
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, text=True,
                          stdout=subprocess.PIPE) as other:
        used_s = float(other.stdout.readline())
        work = {number: (began, cpu_s) for (began, number), cpu_s in
                scheduling._real_time_work().items()}
        other.communicate("\n")
    began, cpu_s = work[other.pid]
    assert cpu_s == pytest.approx(used_s, abs=0.05)
    assert began > 0
    assert os.getpid() not in work


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
