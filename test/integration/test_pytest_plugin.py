"""The pytest plugin, as the test suite of another lab meets it: in sessions of its own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
STRANGER = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "192.0.2.1",
            "ROS_DOMAIN_ID": "0"}
LAB = """
import os, subprocess, sys
import rclpy
SEEN = {}

def test_a_step_in_lockstep(lockstep_graph, tmp_path):
    graph = lockstep_graph(bag=tmp_path / "bag")
    SEEN.update({name: os.environ.get(name) for name in (
        "ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS")})
    assert SEEN["ROS_DOMAIN_ID"] == str(graph.domain_id)
    graph.run("step")
    graph.close()
    axis = graph.record().axis()
    assert abs(axis.position[-1] - axis.reference[-1]) < 1e-5

def test_a_node_of_the_lab_meets_the_nodes_that_run(stage_graph):
    graph = stage_graph()
    assert len([each for each in graph.launched if each.process]) == 5
    rclpy.init()
    node = rclpy.create_node("of_the_lab")
    for _ in range(200):
        rclpy.spin_once(node, timeout_sec=0.05)
        names = node.get_node_names_and_namespaces()
        if ("controller", "/stage/x") in names:
            break
    assert ("controller", "/stage/x") in names
    node.destroy_node()
    rclpy.shutdown()

def test_two_graphs_in_one_test(lockstep_graph):
    assert lockstep_graph().domain_id != lockstep_graph().domain_id

def test_afterwards():
    assert SEEN["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert SEEN["ROS_STATIC_PEERS"] is None
    assert os.environ["ROS_DOMAIN_ID"] == "0"
    assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    children = open(f"/proc/self/task/{os.getpid()}/children").read().split()
    names = [open(f"/proc/{child}/cmdline").read() for child in children]
    assert not [name for name in names if "dfm_stage.harness.fork_server" not in name]
"""
UNRELATED = """
import os, sys

def test_of_something_else():
    assert "pytest_dfm_stage" in sys.modules
    assert not {"dfm_stage", "numpy", "rclpy"} & set(sys.modules)
    assert "OPENBLAS_NUM_THREADS" not in os.environ
"""
WITHOUT_ROS = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("rclpy", "dfm_interfaces", "lifecycle_msgs"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())

def test_of_the_lab(lockstep_graph):
    lockstep_graph()
"""
CLOCK = """
import pathlib, time
import pytest

FLAG = pathlib.Path(__file__).with_name("alone")

@pytest.mark.real_time
@pytest.mark.parametrize("number", range(3))
def test_against_the_clock(number):
    FLAG.touch()
    time.sleep(0.3)
    FLAG.unlink()
"""
BESIDE = """
import pathlib, time
import pytest

FLAG = pathlib.Path(__file__).with_name("alone")

@pytest.mark.parametrize("number", range(40))
def test_beside(number):
    before = FLAG.exists()
    time.sleep(0.03)
    assert not before and not FLAG.exists()
"""


def session(folder: Path, *options: str, **files: str) -> str:
    """Run the test files of a lab, which knows the plugin and nothing else of ours."""
    for name, text in files.items():
        (folder / f"test_{name}.py").write_text(text)
    environment = {**os.environ, **STRANGER,
                   "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), *sys.path]))}
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "PYTEST_XDIST_WORKER"):
        environment.pop(name, None)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "pytest_dfm_stage", "-p", "no:cacheprovider",
         "-p", "no:launch_testing", "-p", "no:launch_ros", "--strict-markers", "-rs", *options,
         str(folder)], cwd=folder, env=environment, capture_output=True, text=True,
        check=False).stdout


def test_a_lab_brings_a_stage_up_in_one_line(tmp_path: Path) -> None:
    said = session(tmp_path, lab=LAB)
    assert " 4 passed" in said, said


def test_a_session_that_does_not_use_it_pays_nothing(tmp_path: Path) -> None:
    said = session(tmp_path, unrelated=UNRELATED)
    assert " 1 passed" in said, said


def test_without_ros_the_test_is_skipped_in_one_line(tmp_path: Path) -> None:
    said = session(tmp_path, lab=WITHOUT_ROS)
    assert " 1 skipped" in said, said
    reason = next(line for line in said.splitlines() if line.startswith("SKIPPED"))
    assert re.search(r"needs ROS 2 Jazzy and dfm_interfaces: no module \w+;", reason)


def test_a_real_time_test_has_the_machine_to_itself(tmp_path: Path) -> None:
    pytest.importorskip("xdist")
    said = session(tmp_path, "-n", "2", "--dist", "loadfile", clock=CLOCK, beside=BESIDE)
    assert " 43 passed" in said, said
