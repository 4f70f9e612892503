"""A launch test of one axis, for a full ROS 2: launch_test examples/one_axis_launch_test.py.

It starts the package's own launch file, waits for measurements that the controller answers, and
looks at how the nodes ended. A copy with your launch file and your topics is a start.
"""

import time
import unittest

import launch_testing
import launch_testing.actions
import launch_testing.asserts
import launch_testing.markers
import pytest
import rclpy
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare
from rclpy.qos import qos_profile_sensor_data

from dfm_interfaces.msg import Command
from launch import LaunchDescription

ANSWERED = 100
LIMIT_S = 30.0


@pytest.mark.launch_test
@launch_testing.markers.keep_alive
def generate_test_description():
    """The graph, and the sign that the test may begin."""
    file = PathJoinSubstitution([FindPackageShare("dfm_stage"), "launch", "one_axis.launch.py"])
    return LaunchDescription([
        IncludeLaunchDescription(PythonLaunchDescriptionSource(file)),
        launch_testing.actions.ReadyToTest(),
    ])


class TestTheLoop(unittest.TestCase):
    """While the nodes run."""

    def test_measurements_are_answered(self):
        rclpy.init()
        node = rclpy.create_node("one_axis_launch_test")
        answered = []
        node.create_subscription(
            Command, "/stage/x/command", lambda each: answered.append(each.measurement_seq),
            qos_profile_sensor_data)
        deadline = time.monotonic() + LIMIT_S
        while len(answered) < ANSWERED and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        node.destroy_node()
        rclpy.shutdown()
        self.assertGreaterEqual(len(answered), ANSWERED)
        self.assertEqual(answered, sorted(answered))


@launch_testing.post_shutdown_test()
class TestTheEnd(unittest.TestCase):
    """After the nodes were asked to end."""

    def test_every_node_ended_without_an_error(self, proc_info):
        launch_testing.asserts.assertExitCodes(proc_info, allowable_exit_codes=[0, 130])
