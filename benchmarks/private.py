"""A program with a /dev/shm and a folder of its own, which end with it and are nobody else's."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from dfm_stage.errors import DfmError

PRIVATE = "DFM_BENCH_PRIVATE"
"""In the environment where /dev/shm and the folder are this program's alone."""
ROOT = Path(__file__).resolve().parents[1]
ROOM = "256m"
"""Of /dev/shm, and of the folder, each."""
MOUNT = (f"mount -t tmpfs -o size={ROOM} none /dev/shm && "
         f'mount -t tmpfs -o size={ROOM} none "$0" && exec "$@"')


@cache
def private_mounts() -> tuple[str, ...]:
    """Return the command that gives a program mounts of its own; empty where not permitted."""
    for flags in ("-m", "-Urm"):
        command = ("unshare", flags)
        if shutil.which("unshare") and subprocess.run(
                [*command, "mount", "-t", "tmpfs", "none", "/dev/shm"],  # noqa: S108
                check=False, capture_output=True).returncode == 0:
            return command
    return ()


def run_module(name: str, arguments: Sequence[str], folder: Path) -> None:
    """Run `python -m name arguments`, where permitted with /dev/shm and `folder` to itself.

    Raises
    ------
    DfmError
        If it fails.
    """
    private = private_mounts()
    environment = {**os.environ, PRIVATE: "1"} if private else dict(os.environ)
    with subprocess.Popen([*private, *(["sh", "-c", MOUNT, str(folder)] if private else []),
                           sys.executable, "-m", name, *arguments],
                          cwd=ROOT, env=environment) as process:
        try:
            code = process.wait()
        except BaseException:
            process.send_signal(signal.SIGINT)
            process.wait()
            raise
    if code != 0:
        raise DfmError(f"{name} ended with code {code}: its message is above")
