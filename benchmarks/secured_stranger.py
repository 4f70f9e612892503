"""Somebody beside the graph, as anybody may write him with rclpy: `python secured_stranger.py
NAME SECONDS`. He lists, listens, and gives commands of his own to the axis x.

Prints what he found as JSON.
"""

from __future__ import annotations

import json
import sys
import time

import rclpy

from dfm_stage.nodes.wiring import LINKS

SPACE, RATE_HZ, FORGED_V = "/stage/x", 50.0, 2.0


def main() -> None:
    """Forge commands for the time given; each answers the newest measurement, if one was read."""
    name, seconds = sys.argv[1], float(sys.argv[2])
    rclpy.init(args=[])
    node = rclpy.create_node(name, namespace=SPACE)
    heard: list = []
    own = {f"{SPACE}/{topic}" for topic in ("measurement", "command")}
    node.create_subscription(LINKS["measurement"].type, f"{SPACE}/measurement", heard.append, 10)
    command = LINKS["command"].type
    publisher = node.create_publisher(command, f"{SPACE}/command", 10)
    end, sent = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        due = time.monotonic() + 1.0 / RATE_HZ
        while (left := due - time.monotonic()) > 0.0:
            rclpy.spin_once(node, timeout_sec=left)
        now = node.get_clock().now().to_msg()
        sent += 1
        forged = command(seq=sent, measurement_seq=sent, measurement_stamp=now, voltage=FORGED_V)
        forged.header.stamp = now
        if heard:
            forged.measurement_seq = heard[-1].seq
            forged.measurement_stamp = heard[-1].header.stamp
        publisher.publish(forged)
    listed = [each for each, _ in node.get_node_names_and_namespaces() if each != name]
    listed += [each for each, _ in node.get_topic_names_and_types()
               if each.startswith("/stage/") and each not in own and f"/{name}/" not in each]
    print(json.dumps({"listed": len(listed), "read": len(heard), "sent": sent,
                      "matched": publisher.get_subscription_count()}), flush=True)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
