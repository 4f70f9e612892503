"""Programs beside the graph, as anybody may write them with rclpy: `python fault_tools.py NAME`.

They print a line when they work, and go on until they are killed.
"""

from __future__ import annotations

import sys
import time

import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy

from dfm_stage.nodes.wiring import LINKS

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


if __name__ == "__main__":
    rclpy.init(args=[])
    if sys.argv[1] == "storm":
        storm(*sys.argv[2:])
    else:
        deaf(*sys.argv[2:])
