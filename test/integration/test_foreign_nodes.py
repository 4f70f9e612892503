"""A bag of plain rclpy nodes that know nothing of us, from the recorder to a model."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dfm_stage import __main__
from dfm_stage.recording import read_bag, read_record

pytestmark = pytest.mark.real_time
NODES = Path(__file__).with_name("plain_nodes.py")
SECONDS = 12
FREQUENCY_HZ, DAMPING_RATIO, GAIN = 3.0, 0.05, 0.02     # as in plain_nodes.py
STATE = ["--output", "/joint_states.position[arm]"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foreign") / "bag"
    recorder = subprocess.Popen([sys.executable, "-m", "dfm_stage", "recorder", "--ros-args", "-p",
                                 f"bag:={path}"])
    try:
        subprocess.run([sys.executable, str(NODES), str(SECONDS + 3)], check=True, timeout=90)
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.wait(20.0)
    return path


def test_the_nodes_know_nothing_of_us(bag: Path) -> None:
    assert "dfm" not in NODES.read_text()
    assert {"/joint_states", "/arm/command"} <= set(read_bag(bag))
    assert not [name for name in read_bag(bag) if name.endswith("/measurement")]


def test_bags_says_what_could_be_input_and_output(
        bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["bags", str(bag), "--json"]) == 0
    topics = {each["name"]: each for each in json.loads(capsys.readouterr().out)["topics"]}
    fields = {each["path"]: each for each in topics["/joint_states"]["fields"]}
    assert topics["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    assert topics["/joint_states"]["rate_hz"] == pytest.approx(100.0, rel=0.1)
    assert fields["/joint_states.effort[arm]"]["greatest"] == 1.0
    assert topics["/arm/command"]["fields"][0]["path"] == "/arm/command.data"


@pytest.mark.parametrize("drive", ["/joint_states.effort[arm]", "/arm/command.data"])
def test_a_model_comes_out_of_two_fields(bag: Path, tmp_path: Path, drive: str) -> None:
    """The same topic's effort, and the command of another topic without header at 50 Hz."""
    out = tmp_path / "found"
    assert __main__.main(["identify", str(bag), "--input", drive, *STATE, "--input-unit", "V",
                          "--from", "0.5", "--split", "0.8", "--no-report",
                          "--out", str(out)]) == 0
    found = json.loads((out / "identify.json").read_text())
    assert found["natural_frequency_hz"]["value"] == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert found["damping_ratio"]["value"] == pytest.approx(DAMPING_RATIO, rel=0.15)
    assert found["gain"]["value"] == pytest.approx(GAIN, rel=0.03)
    assert found["held_out"]["fit_percent"] > 95.0
    assert any("by header times" in text for text in found["warnings"])
    if drive == "/arm/command.data":
        assert any("nearest message is" in text for text in found["warnings"])


def test_the_export_is_the_record(bag: Path, tmp_path: Path) -> None:
    words = ["--input", "/arm/command.data", *STATE]
    assert __main__.main(["bags", str(bag), *words, "--export", str(tmp_path / "run.csv")]) == 0
    exported = read_record(tmp_path / "run.csv").axis()
    record = read_record(bag, input=words[1], output=words[3])
    assert exported.position.tolist() == record.axis().position.tolist()
    assert np.abs(record.axis().input).max() == pytest.approx(1.0)
