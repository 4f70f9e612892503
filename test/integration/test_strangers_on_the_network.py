"""A graph and another machine, by network namespaces: strangers see nothing."""

from __future__ import annotations

import pytest

from benchmarks.hosts import Hosts
from dfm_stage.share import config_folder

LOOK = """
import sys, time
import rclpy

rclpy.init()
node = rclpy.create_node("stranger")
until = time.monotonic() + float(sys.argv[1])
while time.monotonic() < until and "sim_plant" not in node.get_node_names():
    rclpy.spin_once(node, timeout_sec=0.1)
print("seen:", "sim_plant" in node.get_node_names())
"""

pytestmark = pytest.mark.usefixtures("hosts_permitted")
STRANGER = {"ROS_STATIC_PEERS": "10.77.0.1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(config_folder() / "fastdds.xml")}
"""What was set here for this machine only does not reach another one."""


@pytest.mark.slow
@pytest.mark.parametrize(("plant_range", "seen"), [("", False), ("SUBNET", True)])
def test_a_stranger_on_the_network_sees_a_graph_only_where_it_was_opened(
        plant_range, seen, tmp_path):
    with Hosts(("plant", "stranger")) as hosts:
        hosts.start("plant", ["-m", "dfm_stage", "sim_plant"], tmp_path / "plant.log",
                    ROS_AUTOMATIC_DISCOVERY_RANGE=plant_range or "LOCALHOST")
        friend = hosts.start("plant", ["-c", LOOK, "60"], tmp_path / "friend.log",
                             ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
        friend.wait(90.0)
        assert "seen: True" in (tmp_path / "friend.log").read_text()
        stranger = hosts.start("stranger", ["-c", LOOK, "60" if seen else "4"],
                               tmp_path / "stranger.log", **STRANGER)
        stranger.wait(90.0)
        assert f"seen: {seen}" in (tmp_path / "stranger.log").read_text()
