"""How long until something happens: a node's first message, a graph, and a suite of graphs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import rclpy
from std_msgs.msg import Float64

from benchmarks.figure import Figure
from dfm_interfaces.msg import PlantState
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.domain import claim_domain
from dfm_stage.middleware.discovery import loopback_alone

FIRST_MESSAGE_S, READY_S, SUITE_S = 0.7, 1.5, 60.0
GRAPHS = 20
STEP = {"name": "step", "mode": "pid", "duration_s": 6.0,
        "axes": {"x": {"reference": {"kind": "steps", "levels_m": [0.0, 1e-3], "dwell_s": 3.0}}}}
PATIENCE_S = 30.0
NODE = [sys.executable, "-m", "dfm_stage", "sim_plant"]
BARE_NODE = [sys.executable, "-c", """\
import rclpy
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node("bare")
out = node.create_publisher(Float64, "/bare", 10)
node.create_timer(1e-3, lambda: out.publish(Float64()))
rclpy.spin(node)
"""]


def figures(quick: bool = False) -> list[Figure]:
    """Ten starts of a node and of a graph, and twenty graphs with a step (quick: three each)."""
    times, graphs = (3, 3) if quick else (10, GRAPHS)
    ours, bare = [], []
    for _ in range(times):  # in turn: the machine changes
        ours.append(first_message_s(NODE, PlantState, "/stage/x/plant"))
        bare.append(first_message_s(BARE_NODE, Float64, "/bare"))
    first = ready_s("processes")
    processes, composed = [], []
    for _ in range(times):
        processes.append(ready_s("processes"))
        composed.append(ready_s("composed"))
    return [
        _figure("start.first_message_s", ours, FIRST_MESSAGE_S, "bare rclpy node, median", bare,
                "sim_plant, from exec to the first message that a subscriber gets"),
        _figure("start.ready_s", processes, READY_S, "the same in one process, median", composed,
                "six processes with a recorder, real time, until all have met; the first of the "
                f"program, which loads what they need, {first:.2f} s"),
        Figure("start.suite_s", suite_s(graphs), "s", SUITE_S if graphs == GRAPHS else None,
               how=f"{graphs} graphs in six processes one after the other, each with a step of "
               "6 s in lockstep and a bag, start and end included",
               bar_kind="at most" if graphs == GRAPHS else None),
    ]


def _figure(key: str, seconds: Sequence[float], bar: float, peer: str, others: Sequence[float],
            how: str) -> Figure:
    value, other = median(seconds), median(others)
    return Figure(key, value, "s", bar, peer, other, value / other,
                  f"{how}; median of {len(seconds)}, longest {max(seconds):.2f} s", "at most")


def first_message_s(command: Sequence[str], kind: type[Any], topic: str) -> float:
    """Seconds from the start of a process to its first message on a topic."""
    context, heard = rclpy.Context(), []
    with claim_domain() as domain, loopback_alone():
        rclpy.init(context=context, domain_id=domain.number)
        try:
            node = rclpy.create_node("listener", context=context)
            node.create_subscription(kind, topic, lambda _: heard.append(time.monotonic()), 10,
                                     raw=True)
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            begin = time.monotonic()
            process = subprocess.Popen(
                command, env={**os.environ, "ROS_DOMAIN_ID": str(domain.number)},
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            try:
                while not heard and time.monotonic() < begin + PATIENCE_S:
                    executor.spin_once(timeout_sec=0.1)
            finally:
                process.terminate()
                process.wait()
                executor.shutdown()
                node.destroy_node()
        finally:
            context.try_shutdown()
    if not heard:
        raise HarnessError(f"nothing on {topic} within {PATIENCE_S:g} s of {' '.join(command)}")
    return heard[0] - begin


def ready_s(layout: str) -> float:
    """Seconds until a graph of one axis in real time, with a recorder, is ready."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        with StageGraph(layout=layout, bag=Path(folder) / "bag"):
            return time.monotonic() - begin


def suite_s(graphs: int) -> float:
    """Seconds that so many graphs in separate processes take, one after the other."""
    begin = time.monotonic()
    for _ in range(graphs):
        with tempfile.TemporaryDirectory() as folder, StageGraph(
                layout="processes", lockstep=True, bag=Path(folder) / "bag") as graph:
            graph.run(STEP)
    return time.monotonic() - begin
