"""Two coupled axes in real time: ros2 launch dfm_stage two_axes.launch.py record:=true."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

LAYOUTS = ("processes", "per_axis", "composed")
AXES = ("x", "y")
AXIS_NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator")


def nodes(context):
    """The nodes; a sampling period that was given is one value for all of them."""
    period = LaunchConfiguration("sample_period_s").perform(context)
    parameters = [LaunchConfiguration("parameters"),
                  *([{"sample_period_s": float(period)}] if period else [])]

    recording = IfCondition(LaunchConfiguration("record"))
    names = {axis: [f"/stage/{axis}/{name}" for name in AXIS_NODES] for axis in AXES}
    names[AXES[0]].insert(0, "/stage/sim_plant")

    def alone(full_name, condition=None):
        namespace, _, name = full_name.rpartition("/")
        return Node(package="dfm_stage", executable=name, namespace=namespace, name=name,
                    parameters=parameters, output="screen", condition=condition,
                    ros_arguments=["--enclave", full_name])

    def together(full_names):
        return Node(package="dfm_stage", executable="compose", arguments=full_names,
                    parameters=parameters, output="screen",
                    ros_arguments=["--enclave", full_names[0]])

    layout = LaunchConfiguration("layout").perform(context)
    if layout == "composed":
        first = ["/stage/recorder"] if recording.evaluate(context) else []
        return [together([*first, *(name for axis in AXES for name in names[axis])])]
    return [alone("/stage/recorder", recording), *(
        [together(names[axis]) for axis in AXES] if layout == "per_axis" else
        [alone(name) for axis in AXES for name in names[axis]])]


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
        DeclareLaunchArgument("layout", default_value="processes", choices=LAYOUTS,
                              description="a process for each node, one for each axis and one for "
                              "the recorder, or one for all"),
        OpaqueFunction(function=nodes),
    ])
