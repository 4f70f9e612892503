"""One axis in real time: ros2 launch dfm_stage one_axis.launch.py record:=true."""

from dfm_stage.harness.launch_files import described


def generate_launch_description():
    return described(("x",), "one_axis.yaml")
