"""What the launch files of this package describe; it imports launch, which a full ROS 2 has."""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from dfm_stage.harness.stage_graph import AXIS_NODES, LAYOUTS
from dfm_stage.middleware.security import enclave_for
from launch import LaunchDescription


def nodes(context: Any, axes: tuple[str, ...]) -> list[Any]:
    """The nodes; a sampling period that was given is one value for all of them."""
    period = LaunchConfiguration("sample_period_s").perform(context)
    parameters = [LaunchConfiguration("parameters"),
                  *([{"sample_period_s": float(period)}] if period else [])]
    recording = IfCondition(LaunchConfiguration("record"))
    names = {axis: [f"/stage/{axis}/{name}" for name in AXIS_NODES] for axis in axes}
    names[axes[0]].insert(0, "/stage/sim_plant")

    def alone(full_name: str, condition: Any = None) -> Any:
        namespace, _, name = full_name.rpartition("/")
        return Node(package="dfm_stage", executable=name, namespace=namespace, name=name,
                    parameters=parameters, output="screen", condition=condition,
                    ros_arguments=["--enclave", full_name])

    def together(full_names: list[str]) -> Any:
        return Node(package="dfm_stage", executable="compose", arguments=full_names,
                    parameters=parameters, output="screen",
                    ros_arguments=["--enclave", enclave_for(full_names)])

    layout = LaunchConfiguration("layout").perform(context)
    if layout == "composed":
        first = ["/stage/recorder"] if recording.evaluate(context) else []
        return [together([*first, *(name for axis in axes for name in names[axis])])]
    return [alone("/stage/recorder", recording), *(
        [together(names[axis]) for axis in axes] if layout == "per_axis" else
        [alone(name) for axis in axes for name in names[axis]])]


def described(axes: tuple[str, ...], config: str) -> Any:
    """The launch description of a stage with these axes, and the parameters of `config`."""
    default = PathJoinSubstitution([FindPackageShare("dfm_stage"), "config", config])
    return LaunchDescription([
        DeclareLaunchArgument("parameters", default_value=default,
                              description="parameter YAML of all nodes"),
        DeclareLaunchArgument("sample_period_s", default_value="",
                              description="sampling period of all nodes, s; empty = what the "
                              "parameters say"),
        DeclareLaunchArgument("record", default_value="false",
                              description="record a bag into bags/<date and time>"),
        DeclareLaunchArgument("layout", default_value="processes", choices=LAYOUTS,
                              description="a process for each node, one for each axis and one for "
                              "the recorder, or one for all"),
        OpaqueFunction(function=nodes, args=[axes]),
    ])
