"""The analysis half where POSIX is missing, as on Windows, and what a first answer loads."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dfm_stage.commands import TOOLS

ROOT = Path(__file__).parents[2]
GRAPH = {"demo", "characterize", "view", "compose", "emulate", "learn", "bench"}
"""Tools that start nodes, serial devices or processes, on Linux alone."""
WITHOUT_POSIX = """
import os, select, signal, sys
import control, matplotlib.figure, numba, scipy.signal      # have branches of their own
for name in ("crypt", "curses", "fcntl", "grp", "nis", "pty", "pwd", "readline", "resource",
             "spwd", "syslog", "termios", "tty", "_posixshmem", "rclpy"):
    sys.modules[name] = None
for module, names in (
        (os, "chown fchmod fchown fork forkpty getegid geteuid getgid getloadavg getpgid getuid "
             "killpg mkfifo nice posix_fallocate posix_spawn pread preadv pwrite pwritev "
             "sched_getaffinity sched_setaffinity setpgid setsid statvfs sysconf uname"),
        (signal, "SIGALRM SIGHUP SIGKILL SIGUSR1 SIGUSR2 pthread_sigmask setitimer"),
        (select, "epoll poll")):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""
RECORD_A_BAG = """
import struct
from dfm_stage.recording import BagWriter, read_bag
writer = BagWriter("bag")
topic = writer.add_topic("/t", "std_msgs/msg/Float64", (), "", "float64 data\\n")
for k in range(1000):
    writer.write(topic, struct.pack("<id", 256, 0.1 * k), 1000 * k, 1000 * k)
writer.close()
assert read_bag("bag").topics["/t"]["data"].tolist() == [0.1 * k for k in range(1000)]
"""
RUN = "from dfm_stage.__main__ import entry\nsys.argv[1:] = {}\ncode = entry()\n"
HELP = """
from dfm_stage.__main__ import entry
for name in {}:
    sys.argv = ["dfm-stage", name, "--help"]
    try:
        entry()
    except SystemExit as end:
        assert end.code == 0
"""
RECORDS = ["example/multisine.csv", "--holdout", "example/sweep.csv"]
MODEL = ["--model", "example/model.yaml"]


def run(folder: Path, code: str) -> str:
    """What a process prints to a pipe of Windows, in `folder`."""
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252",
                   "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT),
                                                               os.environ.get("PYTHONPATH"))))}
    done = subprocess.run([sys.executable, "-c", f"import sys\n{code}"], cwd=folder,
                          env=environment, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout.decode("cp1252")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example in it."""
    found = tmp_path_factory.mktemp("elsewhere")
    run(found, WITHOUT_POSIX + RUN.format(["example"]) + "sys.exit(code)")
    return found


@pytest.mark.parametrize("arguments", [
    ["diagnose", *RECORDS, *MODEL],
    ["identify", "example/sweep.csv"],
    ["simulate", "example/model.yaml", "example/sweep.csv"],
    ["compare", "example/model.yaml", "paper_stage", "--record", "example/sweep.csv"],
    ["tune", "--model", "example/model.yaml"],
], ids=lambda arguments: str(arguments[0]))
def test_a_tool_runs_without_posix(folder: Path, arguments: list[str]) -> None:
    assert run(folder, WITHOUT_POSIX + RUN.format(arguments) + "sys.exit(code)")


def test_the_help_of_the_tools_is_there_without_posix(folder: Path) -> None:
    names = sorted(TOOLS.keys() - GRAPH)
    said = run(folder, WITHOUT_POSIX + HELP.format(names))
    for name in names:
        assert f"usage: {name} " in said


def test_bags_are_written_and_read_without_posix(folder: Path) -> None:
    run(folder, WITHOUT_POSIX + RECORD_A_BAG)


def test_the_first_answer_waits_for_no_library_that_it_does_not_need(folder: Path) -> None:
    said = run(folder, RUN.format(["diagnose", *RECORDS, *MODEL, "--no-report"])
               + "print(*sys.modules)")
    assert said.startswith("named: ")
    loaded = set(said.split())
    assert "numba" in loaded
    assert not loaded & {"matplotlib", "mcap", "pandas", "rclpy", "scipy.fft", "scipy.linalg",
                         "scipy.sparse", "scipy.special", "scipy.stats"}
