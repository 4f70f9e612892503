"""Several hosts on one machine: network namespaces on a switch; slow, lossy or pulled cables.

Linux only, without root: everything lives in a user namespace of its own. Each host has its own
addresses and its own /dev/shm, so the middleware takes it for another machine.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from dfm_stage.errors import DfmError
from dfm_stage.middleware.discovery import PROFILES

TOOLS = ("unshare", "nsenter", "ip")
DOMAIN = 5
SWITCH = Path(__file__).with_name("switch.py")
_READY_S = 10.0


class NoHostsError(DfmError):
    """This machine does not let its user make network namespaces."""


class Hosts:
    """A switch and hosts `10.77.0.1`, `10.77.0.2`, ...; a context manager.

    Parameters
    ----------
    names : sequence of str
        Up to 200 short names.

    Raises
    ------
    NoHostsError
        On entering, with the reason.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._holders: dict[str, subprocess.Popen[bytes]] = {}
        self._started: list[subprocess.Popen[bytes]] = []
        self._switch: subprocess.Popen[bytes]

    def __enter__(self) -> Hosts:
        missing = [tool for tool in TOOLS if shutil.which(tool) is None]
        if missing:
            raise NoHostsError(f"{', '.join(missing)} not found: install util-linux and iproute2")
        try:
            self._hold("switch", ["unshare", "-Urnm"])
            for number, name in enumerate(self.names, 1):
                self._add(number, name)
            self._switch = subprocess.Popen(
                [*self._enter("switch"), sys.executable, str(SWITCH), "1",
                 *(self._port(name) for name in self.names)], stdin=subprocess.PIPE)
            self._started.append(self._switch)
        except BaseException:
            self.close()
            raise
        return self

    def _hold(self, name: str, start: Sequence[str]) -> None:
        script = "mount -t tmpfs none /dev/shm && echo ready && exec sleep 100000"
        holder = subprocess.Popen([*start, "sh", "-c", script], stdin=subprocess.DEVNULL,
                                  stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self._holders[name] = holder
        assert holder.stdout is not None
        assert holder.stderr is not None
        if holder.stdout.readline() != b"ready\n":
            words = holder.stderr.read().decode(errors="replace").split("\n")[0]
            raise NoHostsError(f"network namespaces are not permitted here ({words})")

    def _enter(self, name: str) -> list[str]:
        return ["nsenter", "-t", str(self._holders[name].pid), "-U", "-n", "-m",
                "--preserve-credentials"]

    def _add(self, number: int, name: str) -> None:
        self._hold(name, [*self._enter("switch"), "unshare", "-nm"])
        port, pid = self._port(name), self._holders[name].pid
        self._in("switch", f"ip link add {port} type veth peer name eth0 netns {pid} "
                 f"&& ip link set {port} up")
        self._in(name, f"ip link set lo up && ip addr add 10.77.0.{number}/24 dev eth0 && "
                 "ip link set eth0 up && ip route add 224.0.0.0/4 dev eth0")

    def _port(self, name: str) -> str:
        return f"port{self.names.index(name) + 1}"

    def _in(self, name: str, script: str) -> None:
        done = subprocess.run([*self._enter(name), "sh", "-c", script], capture_output=True,
                              text=True, check=False)
        if done.returncode:
            raise NoHostsError(f"{script}: {done.stderr.strip().splitlines()[:1]}")

    # What can be done to the cables

    def shape(self, name: str, delay_ms: float = 0.0, loss_percent: float = 0.0) -> None:
        """Delay and lose what a host sends."""
        assert self._switch.stdin is not None
        self._switch.stdin.write(f"{self._port(name)} {delay_ms:g} {loss_percent:g}\n".encode())
        self._switch.stdin.flush()

    def pull(self, name: str) -> None:
        """Pull the cable of a host."""
        self._in("switch", f"ip link set {self._port(name)} down")

    def plug(self, name: str) -> None:
        """Put it back."""
        self._in("switch", f"ip link set {self._port(name)} up")

    # What runs on the hosts

    def start(self, name: str, arguments: Sequence[str], log: Path,
              **environment: str) -> subprocess.Popen[bytes]:
        """Start this Python with `arguments` on a host, output into `log`.

        A profile that this process has for itself stays here: with loopback alone, a program on
        one host would not reach another.
        """
        own = {key: value for key, value in os.environ.items() if key != PROFILES}
        with log.open("wb") as file:
            process = subprocess.Popen(
                [*self._enter(name), sys.executable, *arguments], stdin=subprocess.DEVNULL,
                stdout=file, stderr=file, env={**own, "ROS_DOMAIN_ID": str(DOMAIN),
                                               "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
                                               **environment})
        self._started.append(process)
        return process

    def close(self) -> None:
        """End everything on the hosts, then the hosts."""
        for process in self._started:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
        deadline = time.monotonic() + _READY_S
        for process in self._started:
            try:
                process.wait(max(0.1, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdin is not None:
                process.stdin.close()
        for holder in self._holders.values():
            holder.kill()
            holder.wait()
            for pipe in (holder.stdout, holder.stderr):
                if pipe is not None:
                    pipe.close()

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()
