"""One axis in real time: ros2 launch dfm_stage one_axis.launch.py record:=true."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

AXIS_NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator")


def generate_launch_description():
    parameters = LaunchConfiguration("parameters")
    default = PathJoinSubstitution([FindPackageShare("dfm_stage"), "config", "one_axis.yaml"])

    def node(name, namespace, condition=None):
        return Node(package="dfm_stage", executable=name, namespace=namespace, name=name,
                    parameters=[parameters], output="screen", condition=condition,
                    ros_arguments=["--enclave", f"{namespace}/{name}"])

    return LaunchDescription([
        DeclareLaunchArgument("parameters", default_value=default,
                              description="parameter YAML of all nodes"),
        DeclareLaunchArgument("record", default_value="false",
                              description="record a bag into bags/<date and time>"),
        node("recorder", "/stage", IfCondition(LaunchConfiguration("record"))),
        node("sim_plant", "/stage"),
        *[node(name, "/stage/x") for name in AXIS_NODES],
    ])
