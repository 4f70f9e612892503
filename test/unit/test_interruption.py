"""A process that begins or ends when a signal comes, and one whose reader leaves: no traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WAITS = "any(time.sleep(0.05) for _ in range(1200))"
"""A minute in steps: Python looks for a signal between them. One that comes just before a single
long sleep is seen after it."""
TELLS = f"import os, time\nos.mkdir({{begun!r}})\n{WAITS}\n"
"""A module whose import takes long, and tells when it has begun."""


def start(words: list[str], folder: Path, **more) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "dfm_stage", *words], cwd=ROOT, text=True, stderr=subprocess.PIPE,
        stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": os.pathsep.join(
            [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])}, **more)


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=30.0)
    return process.returncode, out, err


def wait_for(path: Path, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 30.0
    while not path.exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize(("name", "slow"), [("controller", "rclpy"), ("recorder", "numpy"),
                                            ("identify", "numpy"), ("identify", "argparse")])
def test_a_signal_while_modules_are_imported_ends_it_quietly(name, slow, number, code, tmp_path):
    begun = tmp_path / "begun"
    (tmp_path / f"{slow}.py").write_text(TELLS.format(begun=str(begun)))
    process = start([name, "a.csv"], tmp_path)
    wait_for(begun, process)
    process.send_signal(number)
    assert ended(process) == (code, "", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_before_the_first_line_waits_until_it_can_be_answered(number, tmp_path):
    process = start(["controller"], tmp_path, preexec_fn=lambda: signal.pthread_sigmask(
        signal.SIG_BLOCK, [signal.SIGINT, signal.SIGTERM]))
    process.send_signal(number)
    assert ended(process) == (128 + number, "", "")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_when_the_work_is_over_ends_it_quietly(number, code, tmp_path):
    begun = tmp_path / "begun"
    (tmp_path / "sitecustomize.py").write_text(
        "import atexit, os, time\natexit.register(lambda: (os.mkdir(" + repr(str(begun))
        + f"), {WAITS}))\n")
    process = start(["example", str(tmp_path / "out")], tmp_path)
    wait_for(begun, process)
    process.send_signal(number)
    assert ended(process)[::2] == (code, "")


def test_an_interrupt_that_a_library_turned_into_another_error_stays_one(tmp_path):
    begun = tmp_path / "begun"
    (tmp_path / "zstandard.py").write_text(
        "try:\n" + "".join(f"    {line}\n" for line in TELLS.format(
            begun=str(begun)).splitlines())
        + "except KeyboardInterrupt:\n    raise SystemError('half imported') from None\n")
    process = start(["bags", str(tmp_path)], tmp_path)
    wait_for(begun, process)
    process.send_signal(signal.SIGINT)
    assert ended(process) == (130, "", "")


@pytest.mark.parametrize("words", [["--help"], ["controller", "--help"], ["completion", "bash"]])
def test_a_reader_that_leaves_is_no_error(words):
    reading, writing = os.pipe()
    os.close(reading)
    process = subprocess.Popen([sys.executable, "-m", "dfm_stage", *words], cwd=ROOT, text=True,
                               stdout=writing, stderr=subprocess.PIPE)
    os.close(writing)
    _, err = process.communicate(timeout=60.0)
    assert (process.returncode, err) == (141, "")


def test_a_pipe_that_breaks_elsewhere_is_still_an_error(tmp_path):
    (tmp_path / "zstandard.py").write_text("raise BrokenPipeError('another pipe')\n")
    process = start(["bags", str(tmp_path)], tmp_path)
    code, _, err = ended(process)
    assert code == 1
    assert "another pipe" in err
