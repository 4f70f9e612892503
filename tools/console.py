"""What the front door says and runs: steps with their time, logs, stamps, the lock."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

NETWORK_SIGNS = (
    "Temporary failure in name resolution",
    "Failed to establish a new connection",
    "NewConnectionError",
    "NameResolutionError",
    "Network is unreachable",
    "Connection refused",
    "Read timed out",
    "ProxyError",
)


class SetupError(Exception):
    """Set-up cannot go on; the message is one line: what, where, remedy."""

    def __init__(self, message: str, exit_code: int = 2) -> None:
        super().__init__(message)
        self.exit_code = exit_code


class Steps:
    """Prints one line per step on stderr, and runs commands with their output in a log file."""

    def __init__(self, lock_fd: int) -> None:
        self._lock_fd = lock_fd
        self._began = time.monotonic()
        self.log = Path(os.devnull)

    def log_to(self, path: Path) -> None:
        """Start a new log file; the steps that follow write there."""
        write_whole(path, "")
        self.log = path

    @contextlib.contextmanager
    def step(self, title: str) -> Iterator[None]:
        """Time the body: `[  1.2 s] title ... 3.4 s`."""
        begin = time.monotonic()
        say(f"[{begin - self._began:5.1f} s] {title} ...", end="")
        try:
            yield
        except BaseException:
            say(" failed")
            raise
        say(f" {time.monotonic() - begin:.1f} s")

    def call(
        self,
        *commands: Sequence[str | os.PathLike[str]],
        env: Mapping[str, str],
        what: str,
        cwd: Path | None = None,
    ) -> None:
        """Run commands beside each other to their end; SetupError names the log if one fails.

        Their output goes into the log. A child keeps the set-up lock open, so a second set-up
        waits for it even when this process was killed. It gets a session of its own: all of it is
        ended when we are.
        """
        started = [self._start(command, env, cwd) for command in commands]
        try:
            codes = [child.wait() for child, _ in started]
        except BaseException:
            for child, _ in started:
                _end_session(child)
            raise
        if any(codes):
            raise SetupError(self._reason(what, started[0][1]), exit_code=1)

    @contextlib.contextmanager
    def beside(
        self, command: Sequence[str | os.PathLike[str]], env: Mapping[str, str], title: str,
        cwd: Path,
    ) -> Iterator[None]:
        """Run a command that may fail beside the body, and wait for it at the end."""
        child, _ = self._start(command, env, cwd)
        try:
            yield
            with self.step(title):
                child.wait()
        except BaseException:
            _end_session(child)
            raise

    def _start(
        self, command: Sequence[str | os.PathLike[str]], env: Mapping[str, str], cwd: Path | None
    ) -> tuple[subprocess.Popen[bytes], int]:
        """Start a command; the process, and where in the log its output begins."""
        with self.log.open("ab") as log:
            log.write(f"\n$ {' '.join(map(str, command))}\n".encode())
            log.flush()
            before = log.tell()
            child = subprocess.Popen(
                [str(word) for word in command],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=dict(env),
                cwd=cwd,
                pass_fds=(self._lock_fd,),
                start_new_session=True,
            )
        return child, before

    def _reason(self, what: str, since: int) -> str:
        with self.log.open("rb") as log:
            log.seek(since)
            text = log.read().decode(errors="replace")
        if any(sign in text for sign in NETWORK_SIGNS):
            return (
                f"{what} failed: the package registry is out of reach (network?); log: {self.log}"
            )
        errors = [line.strip() for line in text.splitlines() if "error" in line.lower()]
        return f"{what} failed{f': {errors[0][:160]}' if errors else ''}; log: {self.log}"


def say(text: str, end: str = "\n") -> None:
    """Write to stderr at once; stdout belongs to the program."""
    sys.stderr.write(text + end)
    sys.stderr.flush()


def _end_session(child: subprocess.Popen[bytes]) -> None:
    """End the child and all that it started: politely, then surely."""
    for number, wait_s in ((signal.SIGTERM, 3.0), (signal.SIGKILL, None)):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(wait_s)


@contextlib.contextmanager
def locked(path: Path) -> Iterator[int]:
    """Hold the file lock `path`, waiting for another holder with a word; gives its descriptor."""
    import fcntl

    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("run: another set-up is under way in this checkout; waiting for it")
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def read_stamp(path: Path) -> dict[str, Any]:
    """The stamp's content; empty when there is none or it is not whole."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it appears whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, encoding="utf-8")
    os.replace(temporary, path)


def write_stamp(path: Path, content: Mapping[str, Any]) -> None:
    """Write a stamp whole; always the last thing of what it vouches for."""
    write_whole(path, json.dumps(content, indent=1, sort_keys=True) + "\n")


def remove_tree(path: Path) -> None:
    """Remove a folder; its name is free at once even if removal is interrupted."""
    if not os.path.lexists(path):
        return
    doomed = path.with_name(f".trash-{path.name}-{os.getpid()}-{time.monotonic_ns()}")
    os.rename(path, doomed)
    shutil.rmtree(doomed, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Remove what an interrupted remove_tree left."""
    for doomed in folder.glob(".trash-*"):
        shutil.rmtree(doomed, ignore_errors=True)
