"""From a failure to zero current in the emulated drive, in separate processes.

The loop swings the stage; at a moment with current in the coil something is broken. Both the
failure and the drive's output are dated on the steady clock, which all processes share: the
emulator writes every change of its output to a file.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dfm_interfaces.msg import Command
from dfm_stage.drivers.qsb_protocol import TICKS_PER_SECOND
from dfm_stage.harness import HarnessError
from dfm_stage.harness.emulated import EmulatedGraph, hardware_parameters
from dfm_stage.harness.fork_server import NodeProcess, shared_fork_server
from dfm_stage.middleware.wire import codec
from dfm_stage.nodes.process import helper_node

NODES = ("sim_plant", "encoder_driver", "amplifier_driver", "trajectory_generator")
MOVING = {
    "trajectory_generator": {
        "autostart": True, "repeat": True, "duration_s": 600.0, "reference.kind": "sine",
        "reference.amplitude_m": 5e-4, "reference.frequency_hz": 2.0}}
LEAST_CURRENT_A = 0.05
PATIENCE_S = 60.0
GUARD_S = 4.0
DEAF_S = 15.0
NAN_TIMES, NAN_PERIOD_S = 5, 0.001


class StandsStillError(HarnessError):
    """The stage could not be brought to swing again after a failure."""


class OutputFile:
    """The emulator's log of its output."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        self.changes: list[tuple[int, float]] = []
        self.off = True

    def read(self) -> None:
        """Take over what was written since."""
        with self._path.open("rb") as file:
            file.seek(self._offset)
            data = file.read()
        whole = data[:data.rfind(b"\n") + 1]
        self._offset += len(whole)
        for line in whole.decode().splitlines():
            when, current, state = line.split()
            self.changes.append((int(when), float(current)))
            self.off = state == "off"

    @property
    def current_a(self) -> float:
        """The output now."""
        self.read()
        return self.changes[-1][1] if self.changes else 0.0

    def zero_since(self, after_ns: int) -> int | None:
        """Return when the output became zero, if it then went off, after `after_ns`."""
        self.read()
        if not self.off or not self.changes or self.changes[-1][0] < after_ns:
            return None
        index = len(self.changes) - 1
        while index and self.changes[index - 1][1] == 0.0:
            index -= 1
        return self.changes[index][0]


@dataclass
class Trial:
    """A way to fail: `strike` returns the steady clock in ns, `mend` undoes it."""

    strike: Callable[[], int]
    mend: Callable[[], None]
    latched: tuple[str, ...]


class Controller:
    """The real controller node, forked without its imports: it can be killed a hundred times."""

    def __init__(self, parameters: Path, domain_id: int) -> None:
        self._parameters = parameters
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain_id)}
        self.process = self._forked()

    def _forked(self) -> NodeProcess:
        return shared_fork_server().start(
            "controller",
            ["--ros-args", "-r", "__ns:=/stage/x", "--params-file", str(self._parameters)],
            self._parameters.with_suffix(".log"), self._environment)

    def start(self) -> None:
        """Start one in place of the last."""
        self.kill()
        self.process = self._forked()

    def kill(self) -> None:
        """SIGKILL the last one, and wait until it is gone."""
        self.process.kill()
        self.process.wait()


@dataclass
class ZeroCurrentRig:
    """The emulated stage in motion, to be struck again and again."""

    graph: EmulatedGraph
    output: OutputFile
    controller: Controller
    _publisher: Any = None
    _sender: Any = None
    reasons: list[str] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    deaf: int = 0

    def trial(self, kind: str) -> Trial:
        """Return the way to fail of this name."""
        return {
            "killed_controller": Trial(self._kill, self._restart, ("stale command",)),
            "stalled_controller": Trial(self._stall, self._resume, ("stale command",)),
            "nan_command": Trial(self._nan, lambda: None, ("not finite",)),
            "pulled_encoder": Trial(self._pull, lambda: None, ("encoder", "stale command")),
        }[kind]

    def measure(self, kind: str) -> float:
        """Fail once; return the time to zero current, ms; then mend, clear and arm."""
        graph, trial = self.graph, self.trial(kind)
        self._wait_for_current()
        struck_ns = trial.strike()
        graph.spin_until(lambda: self.output.zero_since(struck_ns) is not None, PATIENCE_S,
                         "zero current")
        graph.spin(0.05)
        zero_ns = self.output.zero_since(struck_ns)
        if zero_ns is None:
            raise HarnessError("the output came back by itself")
        trial.mend()
        _, words = graph.trigger("amplifier_driver", "clear")
        if not any(f"{cause}:" in words for cause in trial.latched):
            # a busy machine held up an emulator, and the driver noticed before it was struck
            self.others.append(words)
            return math.nan
        self.reasons.append(words)
        return max(0.0, (zero_ns - struck_ns) * 1e-6)

    def _wait_for_current(self) -> None:
        """Arm, and wait for current; a machine that held the emulators up asks for it again."""
        begin = time.monotonic()
        let_go_s, deaf_s = begin + GUARD_S, begin + DEAF_S
        while abs(self.output.current_a) <= LEAST_CURRENT_A or self.output.off:
            now = time.monotonic()
            if self.output.off:
                for kind, service in (("amplifier_driver", "clear"), ("encoder_driver", "home"),
                                      ("amplifier_driver", "arm")):
                    self.graph.trigger(kind, service)
                self.graph.spin(0.1)
            elif now > let_go_s:
                # armed, and no current: the controller's guard has let go, or the run is over
                # because measurements paused
                let_go_s = now + GUARD_S
                with contextlib.suppress(HarnessError):
                    self.graph.set_parameters("/stage/x/controller", {"mode": "pid"})
                    self.graph.trigger("trajectory_generator", "start")
            if now > deaf_s:
                # a started controller that hears nobody: see dfm_stage/middleware/shared_memory.py
                self.deaf += 1
                deaf_s = now + DEAF_S
                self.controller.start()
            self.graph.spin(0.005)
            if now > begin + PATIENCE_S:
                raise StandsStillError("no current in the coil")

    def _signal(self, number: int) -> int:
        now = time.monotonic_ns()
        os.kill(self.controller.process.pid, number)
        return now

    def _kill(self) -> int:
        return self._signal(signal.SIGKILL)

    def _restart(self) -> None:
        self.controller.start()

    def _stall(self) -> int:
        return self._signal(signal.SIGSTOP)

    def _resume(self) -> None:
        self._signal(signal.SIGCONT)

    def _nan(self) -> int:
        """As a controller gone bad, more than once: a good command may overwrite a single one."""
        now = time.monotonic_ns()
        for _ in range(NAN_TIMES):
            self._publisher.publish(codec(Command, "x").encode(
                time.time_ns(), 0, 0, time.time_ns(), math.nan, False))
            time.sleep(NAN_PERIOD_S)
        return now

    def _pull(self) -> int:
        return self.graph.devices["encoder"].inject("disconnect 0.2")

    def open_publisher(self) -> None:
        """Be able to send a NaN; named like the controller, or it would be a second sender."""
        self._sender = helper_node("controller", "/stage/x", self.graph._context)
        self._publisher = self._sender.create_publisher(Command, "command", 10)
        self.graph.spin_until(lambda: self._publisher.get_subscription_count() > 0, PATIENCE_S,
                              "amplifier_driver")


@contextlib.contextmanager
def moving_stage() -> Iterator[ZeroCurrentRig]:
    """Yield a ZeroCurrentRig on a stage that swings under control."""
    with EmulatedGraph(nodes=NODES, parameters=MOVING) as graph:
        parameters = graph.output_log.with_name("controller.yaml")
        values = {**hardware_parameters(Path(), Path())["controller"],
                  "sample_period_s": 1.0 / TICKS_PER_SECOND}
        parameters.write_text(json.dumps(
            {"/stage/x/controller": {"ros__parameters": values}}), "utf-8")
        controller = Controller(parameters, graph.domain_id)
        try:
            graph.bring_to_life()
            yield ZeroCurrentRig(graph, OutputFile(graph.output_log), controller)
        finally:
            controller.kill()
