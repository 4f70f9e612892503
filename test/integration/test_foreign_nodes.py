"""A bag of plain rclpy nodes that know nothing of us, from the recorder to a model."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from dfm_stage import __main__
from dfm_stage.recording import read_bag, read_record

pytestmark = pytest.mark.real_time
NODES = Path(__file__).with_name("plain_nodes.py")
SECONDS = 12
FREQUENCY_HZ, DAMPING_RATIO, GAIN = 3.0, 0.05, 0.02     # as in plain_nodes.py


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
    assert {"/joint_states", "/elbow/command"} <= set(read_bag(bag))
    assert not [name for name in read_bag(bag) if name.endswith("/measurement")]


def test_bags_says_what_could_be_input_and_output(
        bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert __main__.main(["bags", str(bag), "--json"]) == 0
    topics = {each["name"]: each for each in json.loads(capsys.readouterr().out)["topics"]}
    fields = {each["path"]: each for each in topics["/joint_states"]["fields"]}
    assert topics["/joint_states"]["type"] == "sensor_msgs/msg/JointState"
    arrivals = []
    for file in bag.glob("*.mcap"):
        with file.open("rb") as stream:
            arrivals += [message.log_time for _, _, message in
                         make_reader(stream).iter_messages(topics=["/joint_states"])]
    assert topics["/joint_states"]["messages"] == len(arrivals)
    assert topics["/joint_states"]["rate_hz"] == pytest.approx(
        (len(arrivals) - 1) / (1e-9 * (max(arrivals) - min(arrivals))))
    assert fields["/joint_states.effort[arm]"]["greatest"] == 1.0
    assert topics["/elbow/command"]["fields"][0]["path"] == "/elbow/command.data"


TRUTH = {"natural_frequency_hz": FREQUENCY_HZ, "damping_ratio": DAMPING_RATIO, "gain": GAIN}


@pytest.mark.parametrize(("drive", "joint"), [
    ("/joint_states.effort[arm]", "arm"), ("/elbow/command.data", "elbow")])
def test_a_model_comes_out_of_two_fields(bag: Path, tmp_path: Path, drive: str,
                                         joint: str) -> None:
    """The effort of the same topic, and a command without header at another rate."""
    out = tmp_path / "found"
    assert __main__.main(["identify", str(bag), "--input", drive, "--input-unit", "V", "--output",
                          f"/joint_states.position[{joint}]", "--from", "0.5", "--split", "0.8",
                          "--no-report", "--out", str(out)]) == 0
    found = json.loads((out / "identify.json").read_text())
    for name, true in TRUTH.items():
        low, high = found[name]["ci95"]
        within = 0.03 if "damping" in name else 0.01
        if joint == "elbow":  # without a stamp it hangs on when each command is delivered
            within = max(5.0 * within, (high - low) / true)
        assert found[name]["value"] == pytest.approx(true, rel=within)
    if joint == "arm":
        assert found["held_out"]["fit_percent"] > 98.0
    assert any("by header times" in text for text in found["warnings"])
    assert any("nearest message is" in text for text in found["warnings"])


def test_the_export_is_the_record(bag: Path, tmp_path: Path) -> None:
    words = ["--input", "/elbow/command.data", "--output", "/joint_states.position[elbow]"]
    assert __main__.main(["bags", str(bag), *words, "--export", str(tmp_path / "run.csv")]) == 0
    exported = read_record(tmp_path / "run.csv").axis()
    record = read_record(bag, input=words[1], output=words[3])
    assert exported.position.tolist() == record.axis().position.tolist()
    assert np.abs(record.axis().input).max() == pytest.approx(1.0)
