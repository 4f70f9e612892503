"""The harness: isolation, clean ends, and clear words when something is wrong."""

from __future__ import annotations

import os
import signal
import time

import pytest

from dfm_stage.errors import DfmError
from dfm_stage.harness import HarnessError, StageGraph

SHORT = {"name": "short", "mode": "pid", "duration_s": 0.5,
         "axes": {"x": {"reference": {"kind": "hold"}}}}


def processes_of(graph):
    return [each.process for each in graph.launched if each.process is not None]


def test_two_graphs_do_not_see_each_other(lockstep_graph):
    one, two = lockstep_graph(), lockstep_graph()
    one.run(SHORT)
    nodes = two._client_node.get_node_names()
    assert sorted(nodes).count("controller") == 1
    two.run(SHORT)


def test_no_process_is_left_when_the_test_fails():
    graph = StageGraph(lockstep=True)
    with pytest.raises(ZeroDivisionError), graph:  # noqa: PT012
        processes = processes_of(graph)
        assert len(processes) == 5
        _ = 1 / 0
    assert all(process.poll() is not None for process in processes)


def test_a_node_that_dies_is_named_with_its_last_words():
    with pytest.raises(HarnessError, match="controller ended"), StageGraph() as graph:  # noqa: PT012
        for each in graph.launched:
            if each.kind == "controller":
                each.process.send_signal(signal.SIGKILL)
        graph.spin(10.0)


def test_a_bad_parameter_reaches_the_caller():
    with pytest.raises(DfmError, match="kp"), StageGraph(
            composed=True, parameters={"controller": {"kp": "high"}}):
        pass
    with pytest.raises(DfmError, match="ki"), StageGraph(
            parameters={"controller": {"ki": -1.0}}):
        pass


def test_the_client_of_a_service_is_kept(lockstep_graph):
    graph = lockstep_graph()
    graph.set_parameters("/stage/x/controller", {"kp": 1000.0})
    clients = list(graph._client_node.clients)
    graph.set_parameters("/stage/x/controller", {"kp": 2000.0})
    assert list(graph._client_node.clients) == clients


def test_unknown_experiment_and_axis(lockstep_graph):
    graph = lockstep_graph()
    with pytest.raises(DfmError, match="multisine"):
        graph.run("no_such_experiment")
    with pytest.raises(HarnessError, match="axis z"):
        graph.run({**SHORT, "axes": {"z": {"reference": {"kind": "hold"}}}})
    with pytest.raises(DfmError, match="kq"):
        graph.run({**SHORT, "controller": {"kq": 1.0}})
    graph.run({**SHORT, "controller": {"kp": 2000.0}})


def test_progress_reaches_one(lockstep_graph):
    seen = []
    graph = lockstep_graph()
    graph.run(SHORT, progress=seen.append)
    assert seen[-1] == 1.0


def test_children_end_when_the_harness_is_killed(tmp_path):
    script = tmp_path / "user.py"
    script.write_text(
        "import time\nfrom dfm_stage.harness import StageGraph\n"
        "with StageGraph(lockstep=True) as graph:\n"
        "    print(*[e.process.pid for e in graph.launched], flush=True)\n    time.sleep(60)\n")
    import subprocess
    import sys

    user = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True)
    pids = [int(word) for word in user.stdout.readline().split()]
    user.kill()
    user.wait()
    user.stdout.close()
    deadline = time.monotonic() + 5.0
    while any(_runs(pid) for pid in pids) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert len(pids) == 5
    assert not any(_runs(pid) for pid in pids)


def _runs(pid):
    try:
        os.kill(pid, 0)
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except (ProcessLookupError, FileNotFoundError):
        return False
