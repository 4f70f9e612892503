"""One axis in real time: ros2 launch dfm_stage one_axis.launch.py record:=true."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

LOOP = ("sim_plant", "encoder_driver", "amplifier_driver", "controller", "trajectory_generator")


def generate_launch_description():
    parameters = LaunchConfiguration("parameters")
    default = PathJoinSubstitution([FindPackageShare("dfm_stage"), "config", "one_axis.yaml"])

    def node(name, condition=None):
        return Node(package="dfm_stage", executable=name, namespace="/stage/x", name=name,
                    parameters=[parameters], output="screen", condition=condition)

    return LaunchDescription([
        DeclareLaunchArgument("parameters", default_value=default,
                              description="parameter YAML of all nodes"),
        DeclareLaunchArgument("record", default_value="false",
                              description="record a bag into bags/<date and time>"),
        node("recorder", IfCondition(LaunchConfiguration("record"))),
        *[node(name) for name in LOOP],
    ])
