"""A graph of this machine alone shares no lock with anybody: no tool can hold it up with one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dfm_stage.harness import StageGraph
from dfm_stage.harness.domain import claim_domain
from dfm_stage.middleware import shared_memory
from dfm_stage.middleware.discovery import PROFILES, RANGE
from dfm_stage.middleware.shared_memory import PORT_BASE, killed_neighbours

HEARS = """
import rclpy, sys
from dfm_interfaces.msg import Measurement
rclpy.init()
node = rclpy.create_node("tool")
heard = []
node.create_subscription(Measurement, "/stage/x/measurement", heard.append, 10)
while not heard:
    rclpy.spin_once(node)
"""


def shared(pid: int) -> set[str]:
    """What a process has of Fast DDS in shared memory."""
    maps = Path(f"/proc/{pid}/maps").read_text("utf-8")
    return {line.split()[-1] for line in maps.splitlines() if "/dev/shm/fastrtps" in line}


@pytest.mark.parametrize("layout", ["processes", "composed"])
def test_nothing_of_the_graph_is_in_shared_memory(layout):
    before = shared(os.getpid())
    with StageGraph(layout=layout) as graph:
        graph.spin(0.2)
        assert shared(os.getpid()) == before
        for each in graph.launched:
            assert each.process is None or not shared(each.process.pid), each.kind


@pytest.mark.parametrize("asked", ["", "LOCALHOST", "SUBNET"])
def test_a_plain_tool_hears_the_graph_all_the_same(asked):
    with StageGraph() as graph:
        plain = {name: value for name, value in os.environ.items()
                 if name not in {PROFILES, RANGE}}
        plain |= {"ROS_DOMAIN_ID": str(graph.domain_id), **({RANGE: asked} if asked else {})}
        with subprocess.Popen([sys.executable, "-c", HEARS], env=plain) as tool:
            try:
                graph.spin_until(lambda: tool.poll() is not None, 20.0, "a tool that heard")
            finally:
                tool.kill()
        assert tool.returncode == 0


def test_the_port_of_a_killed_node_is_left_alone_on_loopback_too(monkeypatch):
    with claim_domain() as claimed:
        first = notes_of_a_killed_node(claimed.number)
        monkeypatch.setattr(shared_memory, "_own", {str(max(first) + 2): 0})
        assert killed_neighbours()
        assert not first & notes_of_a_killed_node(claimed.number)


def notes_of_a_killed_node(domain: int) -> set[int]:
    """Start a node, kill it, and return the numbers of the ports of its domain that it noted."""
    node = subprocess.Popen([sys.executable, "-m", "dfm_stage", "controller", "--ros-args", "-r",
                             "__ns:=/stage/x"], env={**os.environ, "ROS_DOMAIN_ID": str(domain)})
    deadline, found = time.monotonic() + 20.0, set[int]()
    try:
        while len(found) < 2 and time.monotonic() < deadline:
            time.sleep(0.05)
            links = [os.readlink(each) for each in Path(f"/proc/{node.pid}/fd").iterdir()
                     if each.is_symlink()]
            found = {number for link in links if "dfm_stage_port" in link
                     and (number := int(link.rpartition("dfm_stage_port")[2])) > PORT_BASE}
    finally:
        node.send_signal(signal.SIGKILL)
        node.wait()
    return found
