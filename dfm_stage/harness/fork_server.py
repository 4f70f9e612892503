"""Node processes without their imports: a process that has loaded everything forks for each node.

Six nodes that start from scratch take five seconds of processor time, nearly all of it for
imports. Here one process does the imports, once for all graphs of a program, and never starts ROS;
what it forks is a node as `python -m dfm_stage NAME` makes it, in a session of its own, with the
environment and working folder that the program has now. It ends with the program, and the nodes
with it. The server of `multiprocessing` would run the user's main module again in every node.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from dfm_stage import interruption
from dfm_stage.errors import DfmError

NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator", "sim_plant",
         "recorder")
SEVERAL = "compose"
"""What is asked for in place of a node, to run several: their full names come first."""
_READ_ONCE = ("PYTHON", "NUMBA", "RMW_", "LD_", "OPENBLAS", "MKL")
"""What variables begin with that are read by imports: where one changes, a new process is due."""
_THREADS_OF_DDS = "dds."
_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
_POLL_S = 0.005
_lock = threading.RLock()


class ForkServerError(DfmError):
    """The process that forks the nodes has ended."""


class NodeProcess:
    """A node that was forked; as far as it goes like `subprocess.Popen`."""

    def __init__(self, server: ForkServer, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self._server = server

    def poll(self) -> int | None:
        """Return the exit code, minus the signal that ended it, or None."""
        if self.returncode is None:
            self.returncode = self._server.ask({"wait": self.pid})
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Return the exit code; subprocess.TimeoutExpired where there is none in time."""
        deadline = None if timeout is None else time.monotonic() + timeout
        while (code := self.poll()) is None:
            if deadline is not None and time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
            time.sleep(_POLL_S)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:  # nobody else waits for it: the number is still its own
            os.kill(self.pid, number)

    def kill(self) -> None:
        """Send SIGKILL, unless it has ended."""
        self.send_signal(signal.SIGKILL)


class ForkServer:
    """The process that forks, as the program sees it."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "dfm_stage.harness.fork_server", str(theirs.fileno())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, start_new_session=True,
                pass_fds=(theirs.fileno(),),
                preexec_fn=interruption.block)  # noqa: PLW1509 nothing but a system call
        with ours:
            # apart: a text stream that is written to forgets what it has read ahead
            self._answers = ours.makefile("r", encoding="utf-8")
            self._link = ours.makefile("w", encoding="utf-8")
        self._asked = 0
        self.made_for = _made_for()

    def ask(self, request: Mapping[str, Any]) -> Any:
        """Send a request and return the answer.

        Raises
        ------
        ForkServerError
            If it has ended.
        """
        with _lock:
            self._asked += 1
            try:
                self._link.write(json.dumps({"number": self._asked, **request}) + "\n")
                self._link.flush()
                while True:  # one that a Ctrl-C kept from being read may come first
                    number, answer = json.loads(self._answers.readline())
                    if number == self._asked:
                        return answer
            except (OSError, ValueError):
                raise ForkServerError("the process that starts the nodes has ended with code "
                                   f"{self._process.poll()}: begin again") from None

    def start(self, kind: str, arguments: Sequence[str], log: Path,
              environment: Mapping[str, str]) -> NodeProcess:
        """Fork a node with these ROS arguments; what it says goes into `log`."""
        return NodeProcess(self, self.ask({
            "kind": kind, "arguments": [*arguments], "log": str(log), "cwd": str(Path.cwd()),
            "environment": dict(environment), "processors": [*os.sched_getaffinity(0)]}))

    def loaded(self) -> None:
        """Return when it has loaded all."""
        self.ask({})

    def ended(self) -> bool:
        """Return whether it can fork no more."""
        return self._process.poll() is not None


_servers: dict[int, ForkServer] = {}
"""By the process whose server it is: a program may fork, too."""


def shared_fork_server() -> ForkServer:
    """Return the server of this process; one that was just started loads beside the caller."""
    with _lock:
        found = _servers.get(os.getpid())
        if found is None or found.ended() or found.made_for != _made_for():
            found = _servers[os.getpid()] = ForkServer()
        return found


def _made_for() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name.startswith(_READ_ONCE)}


# In the process that forks

def _load() -> None:
    """Import what nodes need, down to the middleware's libraries; no thread starts by that."""
    import rclpy
    import scipy.linalg  # noqa: F401 a controller with a model designs its regulator
    from rclpy.type_support import check_for_type_support

    from dfm_stage.compile_all import compile_all
    from dfm_stage.nodes.wiring import LINKS

    for kind in NODES:
        importlib.import_module(f"dfm_stage.nodes.{kind}")
    rclpy.get_rmw_implementation_identifier()
    for link in LINKS.values():
        check_for_type_support(link.type)
    compile_all()
    gc.collect()
    gc.freeze()


def _serve(descriptor: int) -> int:
    """Fork for every line until the program has gone; in a forked node, run it."""
    with socket.socket(fileno=descriptor) as connection:
        requests = connection.makefile("r", encoding="utf-8")
        link = connection.makefile("w", encoding="utf-8")
    _load()
    while line := _heard(requests):
        request, answer = json.loads(line), None
        if "wait" in request:
            pid, status = os.waitpid(request["wait"], os.WNOHANG)
            answer = os.waitstatus_to_exitcode(status) if pid else None
        elif "kind" in request:
            answer = os.fork()
            if answer == 0:
                requests.close()
                link.close()
                return _run(request)
        with contextlib.suppress(OSError):
            link.write(json.dumps([request["number"], answer]) + "\n")
            link.flush()
    return 0


def _heard(link: TextIO) -> str:
    try:
        return link.readline()
    except OSError:  # the program was killed
        return ""


def _run(request: Mapping[str, Any]) -> int:
    """Be the node that was asked for; signals are blocked until it can answer them."""
    kind, arguments = request["kind"], request["arguments"]
    os.setsid()
    system = ctypes.CDLL(None)
    system.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    system.prctl(_PR_SET_NAME, kind.encode())
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["cwd"])
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, request["processors"])
    log = os.open(request["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
    for standard in (1, 2):
        os.dup2(log, standard)
    os.close(log)
    sys.argv = ["dfm_stage", kind, *arguments]
    sys.orig_argv = [sys.executable, "-m", "dfm_stage", kind, *arguments]
    interruption.end_at_once()
    place = "harness" if kind == SEVERAL else "nodes"
    code = int(importlib.import_module(f"dfm_stage.{place}.{kind}").main(arguments))
    if _left():
        _end(code)
    return code


def _left() -> bool:
    """Leave the graph; return whether nothing of the middleware, and no other thread, is left."""
    import rclpy

    rclpy.get_default_context().destroy()
    gc.collect()  # of what was made since the interpreter was made steady: a millisecond
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):
            if task.joinpath("comm").read_text("utf-8").startswith(_THREADS_OF_DDS):
                return False
    return threading.active_count() == 1


def _end(code: int) -> None:
    """End this process as `sys.exit` does, but leave its memory to the system: to free one object
    after the other takes 0.14 s of a processor."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


if __name__ == "__main__":
    sys.exit(_serve(int(sys.argv[1])))
