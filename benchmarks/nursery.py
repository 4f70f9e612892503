"""Starts the real controller node in a process of its own, again and again, without its imports.

A process that has loaded everything but runs nothing forks for every line it reads; the child is
an ordinary controller that can be killed. Starting from scratch takes seconds, and a hundred
kills minutes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

_LOOK_S = 0.001


class Nursery:
    """Gives birth to controllers with the same arguments.

    Parameters
    ----------
    arguments : sequence of str
        Of the node, as on its command line.
    domain_id : int
        Its ROS domain.
    """

    def __init__(self, arguments: list[str], domain_id: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.nursery", *arguments], stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True, bufsize=1,
            env={**os.environ, "ROS_DOMAIN_ID": str(domain_id)})
        self.child = 0

    def start(self) -> int:
        """Start one in place of the last; return its process id."""
        self.kill()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("go\n")
        self.child = int(self._process.stdout.readline())
        return self.child

    def kill(self) -> None:
        """SIGKILL the one that was started last, and wait until it is gone."""
        while self.child:
            try:
                os.kill(self.child, signal.SIGKILL)
                time.sleep(_LOOK_S)
            except ProcessLookupError:
                self.child = 0

    def close(self) -> None:
        """End all of it."""
        self.kill()
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def _main(arguments: list[str]) -> None:
    from dfm_stage.nodes.controller import main

    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the killed ones are not waited for
    for _ in sys.stdin:
        child = os.fork()
        if child == 0:
            sys.stdin.close()
            os.dup2(2, 1)  # what it says is no process id
            sys.orig_argv = [sys.executable, "-m", "dfm_stage", "controller", *arguments]
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            os._exit(main(arguments))
        print(child, flush=True)


if __name__ == "__main__":
    _main(sys.argv[1:])
