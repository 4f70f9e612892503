"""The six executables as `ros2 run` finds and starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix

from dfm_stage.compile_all import compile_all

pytestmark = pytest.mark.real_time

NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator", "sim_plant",
         "recorder")
PARAMETERS = {"sim_plant": ["seed:=3"], "controller": ["kp:=100.0"],
              "encoder_driver": ["travel_limit_m:=0.005"]}


@pytest.fixture(scope="module")
def folder():
    compile_all()
    try:
        return Path(get_package_prefix("dfm_stage")) / "lib" / "dfm_stage"
    except LookupError:
        pytest.skip("dfm_stage is not installed by colcon in this environment")


def _start(folder, name, tmp_path, *extra):
    args = ["--ros-args", "-r", "__ns:=/stage/x"]
    for parameter in (*PARAMETERS.get(name, ()), *extra):
        args += ["-p", parameter]
    log = (tmp_path / f"{name}.log").open("wb")
    return subprocess.Popen([folder / name, *args], cwd=tmp_path, stdout=log, stderr=log,
                            start_new_session=True)


def test_all_six_start_work_together_and_end_on_a_signal(folder, tmp_path, ros):
    processes = {name: _start(folder, name, tmp_path) for name in NODES}
    context = ros()
    node = rclpy.create_node("observer", context=context)
    try:
        from rclpy.executors import SingleThreadedExecutor

        from dfm_interfaces.msg import AmplifierState

        answers = []
        node.create_subscription(AmplifierState, "/stage/x/amplifier", answers.append, 10)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        missing = {f"/stage/x/{name}" for name in NODES}
        deadline = time.monotonic() + 60.0
        while (len(answers) < 100 or missing) and time.monotonic() < deadline:
            executor.spin_once(timeout_sec=0.1)
            missing -= {f"{space}/{name}" for name, space in node.get_node_names_and_namespaces()}
            for name, process in processes.items():
                assert process.poll() is None, (tmp_path / f"{name}.log").read_text()
        assert not missing
        assert len(answers) >= 100
    finally:
        node.destroy_node()
        context.try_shutdown()
        for process in processes.values():
            os.killpg(process.pid, signal.SIGINT)
        codes = {}
        for name, process in processes.items():
            try:
                codes[name] = process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                codes[name] = "had to be killed"
    assert codes == dict.fromkeys(NODES, 0)
    for name in NODES:
        text = (tmp_path / f"{name}.log").read_text()
        assert "Traceback" not in text, text


def test_a_bad_parameter_is_one_line_and_exit_code_2(folder, tmp_path):
    process = _start(folder, "controller", tmp_path, "ki:=fast")
    assert process.wait(20.0) == 2
    lines = (tmp_path / "controller.log").read_text().splitlines()
    assert len(lines) == 1
    assert "ki" in lines[0]
    assert "real number" in lines[0]
