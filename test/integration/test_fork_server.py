"""Node processes that are forked are what `python -m dfm_stage` starts, and end as those do."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dfm_stage.commands import NODES
from dfm_stage.harness import StageGraph, fork_server

PUSH = {"name": "push", "mode": "open_loop", "duration_s": 0.1, "axes": {"x": {
    "excitation": {"kind": "steps", "levels_v": [0.0, 0.1], "dwell_s": 0.05}}}}


def status(pid: int, what: str) -> str:
    lines = Path(f"/proc/{pid}/status").read_text("utf-8").splitlines()
    return next(line.split(":", 1)[1].strip() for line in lines if line.startswith(f"{what}:"))


def test_it_knows_every_node():
    assert sorted(fork_server.NODES) == sorted(NODES)


def test_nothing_runs_beside_it_when_it_forks():
    """A thread that holds a lock at that moment would hold it for ever in the child.

    The listeners of LTTng, which come with rclpy, sleep and hold none.
    """
    code = ("import os\nfrom dfm_stage.harness import fork_server\nimport rclpy\n"
            "bare = len(os.listdir('/proc/self/task'))\nfork_server._load()\n"
            "print(len(os.listdir('/proc/self/task')) - bare)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0"]


def test_each_node_is_a_process_of_its_own_in_the_world_as_it_is_now(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DFM_SEEN_BY_NODES", "late")
    with StageGraph(lockstep=True, bag="bag") as graph:
        pids = [each.process.pid for each in graph.launched]
        assert len({os.getsid(pid) for pid in pids}) == len(pids) == 6
        for each in graph.launched:
            pid = each.process.pid
            assert status(pid, "Name") == each.kind[:15]
            assert int(status(pid, "SigBlk"), 16) & (1 << signal.SIGINT - 1) == 0
            assert Path(f"/proc/{pid}/cwd").resolve() == tmp_path.resolve()
            assert os.readlink(f"/proc/{pid}/fd/1") == str(each.log)
        graph.run(PUSH)
        graph.stop_recording()
    assert (tmp_path / "bag").is_dir()


def test_ends_are_told_as_of_any_process():
    with StageGraph(lockstep=True) as graph:
        one, two = graph.launched[:2]
        assert one.process.poll() is None
        with pytest.raises(subprocess.TimeoutExpired):
            one.process.wait(0.05)
        graph.signal_node(one.full_name, signal.SIGKILL)
        assert one.process.returncode == -signal.SIGKILL
        graph.signal_node(two.full_name, signal.SIGINT)
        assert two.process.returncode == 0
        one.process.send_signal(signal.SIGINT)  # nothing, it has ended


@pytest.mark.parametrize("kind", ["encoder_driver", "trajectory_generator", "sim_plant"])
def test_an_ended_node_keeps_nothing_of_the_middleware(kind):
    """Its participant has said goodbye then, and the process may end at once. What is kept would
    have to be freed first, object by object."""
    code = ("import os, signal, sys, threading\nfrom dfm_stage.harness import fork_server\n"
            f"from dfm_stage.nodes.{kind} import main\n"
            "threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
            f"sys.argv = ['dfm_stage', '{kind}']\ncode = main([])\n"
            "print(code, fork_server._left())")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == ["0", "True"]


def test_a_node_that_its_middleware_does_not_let_go_ends_all_the_same():
    """Its harness was killed, and it kept a processor busy for ever in closing its participant."""
    code = ("import ctypes, os, signal, sys, threading\nfrom rclpy.node import Node\n"
            "stuck = ctypes.CDLL(None).pause\n"
            "Node.destroy_node = lambda _: [stuck() for _ in iter(int, 1)]\n"
            "from dfm_stage.nodes.encoder_driver import main\n"
            "threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
            "sys.argv = ['dfm_stage', 'encoder_driver']\nmain([])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60.0,
                          check=False)
    assert done.returncode == -signal.SIGALRM


def test_a_signal_before_a_node_can_answer_ends_it_quietly(tmp_path):
    for number in (signal.SIGINT, signal.SIGTERM):
        log = tmp_path / f"{number}.log"
        process = fork_server.shared_fork_server().start("controller", [], log, dict(os.environ))
        process.send_signal(number)
        assert process.wait(10.0) in (0, 128 + number)
        assert log.read_text() == ""


def test_another_one_is_made_where_it_has_ended_or_imports_would_differ(monkeypatch):
    first = fork_server.shared_fork_server()
    assert fork_server.shared_fork_server() is first
    os.kill(first._process.pid, signal.SIGKILL)
    first._process.wait()
    second = fork_server.shared_fork_server()
    assert second is not first
    monkeypatch.setenv("NUMBA_DEBUG_CACHE", "0")
    third = fork_server.shared_fork_server()
    assert third is not second
    third.loaded()


def test_an_answer_that_nobody_waited_for_is_not_taken_for_the_next():
    """A Ctrl-C leaves one behind."""
    made = fork_server.ForkServer()
    made._link.write('{"number": 0, "kind": "controller", "arguments": ["--help"], "log": '
                     '"/dev/null", "cwd": "/", "processors": [0], "environment": {}}\n')
    assert made.ask({}) is None


def test_it_ends_with_its_program():
    code = ("from dfm_stage.harness import fork_server\n"
            "made = fork_server.shared_fork_server()\nmade.loaded()\n"
            "print(made._process.pid)")
    pid = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                             check=True).stdout)
    deadline = time.monotonic() + 5.0
    while Path(f"/proc/{pid}").exists() and time.monotonic() < deadline:
        if status(pid, "State")[0] in "ZX":
            break
        time.sleep(0.02)
    else:
        assert not Path(f"/proc/{pid}").exists()
