"""Two coupled axes in real time: ros2 launch dfm_stage two_axes.launch.py record:=true."""

from dfm_stage.harness.launch_files import described


def generate_launch_description():
    return described(("x", "y"), "two_axes.yaml")
