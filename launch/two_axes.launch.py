"""Two coupled axes in real time: ros2 launch dfm_stage two_axes.launch.py record:=true."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

AXIS_NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator")


def nodes(context):
    """The nodes; a sampling period that was given is one value for all of them."""
    period = LaunchConfiguration("sample_period_s").perform(context)
    parameters = [LaunchConfiguration("parameters"),
                  *([{"sample_period_s": float(period)}] if period else [])]

    def node(name, namespace, condition=None):
        return Node(package="dfm_stage", executable=name, namespace=namespace, name=name,
                    parameters=parameters, output="screen", condition=condition,
                    ros_arguments=["--enclave", f"{namespace}/{name}"])

    return [
        node("recorder", "/stage", IfCondition(LaunchConfiguration("record"))),
        node("sim_plant", "/stage"),
        *[node(name, f"/stage/{axis}") for axis in ("x", "y") for name in AXIS_NODES],
    ]


def generate_launch_description():
    default = PathJoinSubstitution([FindPackageShare("dfm_stage"), "config", "two_axes.yaml"])
    return LaunchDescription([
        DeclareLaunchArgument("parameters", default_value=default,
                              description="parameter YAML of all nodes"),
        DeclareLaunchArgument("sample_period_s", default_value="",
                              description="sampling period of all nodes, s; empty = what the "
                              "parameters say"),
        DeclareLaunchArgument("record", default_value="false",
                              description="record a bag into bags/<date and time>"),
        OpaqueFunction(function=nodes),
    ])
