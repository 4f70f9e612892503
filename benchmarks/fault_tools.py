"""Programs beside the graph, as anybody may write them with rclpy: `python fault_tools.py NAME`.

They print a line when they work, and go on until they are killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from dfm_stage.nodes.wiring import LINKS

LONG_NS = 2_000_000
KEPT = 5000
"""Answers that may be on their way at once; the rest is not waited for."""


def storm(target: str, rate_hz: str, name: str, value: str) -> None:
    """Set a parameter of a node again and again, at a rate."""
    node = rclpy.create_node("storm")
    client = node.create_client(SetParameters, f"{target}/set_parameters")
    client.wait_for_service(10.0)
    executor = EventsExecutor()
    executor.add_node(node)
    given = float(value) if "." in value else int(value)
    request = SetParameters.Request(parameters=[Parameter(name, value=given).to_parameter_msg()])
    print("storm", flush=True)
    begin, done, waiting = time.monotonic(), 0, []
    while rclpy.ok():
        while done < (time.monotonic() - begin) * float(rate_hz):
            waiting.append(client.call_async(request))
            done += 1
        if len(waiting) > KEPT:
            for future in waiting[:-KEPT]:
                client.remove_pending_request(future)
            del waiting[:-KEPT]
        executor.spin_once(1e-3)


def deaf(space: str) -> None:
    """Subscribe to the topics of the loop, reliable and keeping all, and never read."""
    node = rclpy.create_node("deaf")
    qos = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
    kept = [node.create_subscription(link.type, f"{space}/{link.topic}", print, qos)
            for link in LINKS.values()]
    print(f"deaf to {len(kept)} topics", flush=True)
    while True:
        time.sleep(1.0)


def crowd() -> None:
    """For each line of stdin fork a tool, and print its number; it ends on a signal."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    tools = []
    for _ in sys.stdin:
        tools.append(os.fork())
        if not tools[-1]:
            _be_tool(f"tool_{len(tools)}")
        print(tools[-1], flush=True)
    for pid in tools:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _be_tool(name: str) -> None:
    """As `ros2 topic echo` and `ros2 service call` do: listen, and look for a service."""
    # RuntimeError: of rclpy, which a signal shuts down while the node is made
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException, RuntimeError):
        rclpy.init(args=[])
        node = rclpy.create_node(name)
        heard = LINKS["measurement"]
        kept = [node.create_subscription(heard.type, "/stage/x/measurement", lambda _: None, 10),
                node.create_client(Trigger, "/stage/x/trajectory_generator/start")]
        rclpy.spin(node)
        del kept
        node.destroy_node()
        rclpy.try_shutdown()
    os._exit(0)


def sleeper(priority: str) -> None:
    """Sleep for a millisecond at a time, at a priority of SCHED_RR or without one (0), and say
    when that took long.

    When stdin ends, prints pairs of time since the epoch and gap, ns, one for each gap above 2 ms.
    """
    with contextlib.suppress(OSError):
        if int(priority):
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(int(priority)))
    gaps, before = [(time.time_ns(), 0)], time.monotonic_ns()
    while not select.select([sys.stdin], [], [], 1e-3)[0]:
        now = time.monotonic_ns()
        if now - before > LONG_NS:
            gaps.append((time.time_ns(), now - before))
        before = now
    print(json.dumps(gaps), flush=True)


if __name__ == "__main__":
    name, *given = sys.argv[1:]
    if name in {"storm", "deaf"}:
        rclpy.init(args=[])
    programs: dict[str, Callable[..., None]] = {
        "storm": storm, "deaf": deaf, "crowd": crowd, "sleeper": sleeper}
    programs[name](*given)
