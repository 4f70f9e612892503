"""The graph that suffers faults, with the witness beside it and the operator who repairs it."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

from benchmarks.fault_ledger import Ledger
from benchmarks.fault_sight import RECENT_S, WITNESSED, Sight, heard
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.fork_server import shared_fork_server
from dfm_stage.harness.node_set import NotInTimeError
from dfm_stage.harness.stage_graph import AXIS_NODES
from dfm_stage.share import config_folder

NODES = ("/stage/sim_plant", "/stage/recorder", *(f"/stage/x/{name}" for name in AXIS_NODES))
RECORDER = "/stage/recorder"
TOOLS = Path(__file__).with_name("fault_tools.py")
DIES_LATE_S = 0.5
RECORDER_MAY_LOSE_S = 1.0
RECOVERED_WITHIN_S = 30.0
ENDS_WITHIN_S = 10.0
GENERATOR = {"reference.kind": "raster", "reference.line_length_m": 1e-3, "duration_s": 4.0,
             "repeat": True}
# Soft enough for what a busy machine adds to the loop's delay, and with little output; the
# feedforward is that of paper_stage.
CONTROLLER = {"kp": 600.0, "ki": 4000.0, "kd": 30.0, "output_limit_v": 2.0,
              "feedforward_position": 600.7, "feedforward_velocity": 1.705,
              "feedforward_acceleration": 1.0}


class Scene:
    """A running graph with what faults need to be done to it; a context manager.

    `undo` takes what ends a fault: it is closed before the operator repairs the graph.
    `clock_ahead_ns` is by how much the clock of the nodes is ahead of that of the witness.
    `bag_ends(until_ns)` is called when a recorder has ended, before the next one starts.
    """

    def __init__(self, folder: Path, ledger: Ledger, bag_ends: Callable[[int], None]) -> None:
        self.folder = folder
        self.ledger = ledger
        self.undo = contextlib.ExitStack()
        self.said: list[tuple[float, str]] = []
        self.answers_s: list[float] = []
        self.clock_ahead_ns = ledger.ahead_ns
        self.model = folder / "model.yaml"
        self.model.write_bytes(packaged_model("paper_stage"))
        self.parameters: dict[str, dict[str, Any]] = {
            "trajectory_generator": GENERATOR,
            "controller": {**CONTROLLER, "model": str(self.model)}}
        self.graph = StageGraph(model=str(self.model), bag=self._new_bag(),
                                start_timeout_s=60.0, parameters=self.parameters)
        self._bag_ends = bag_ends
        self.judging_s = 0.0
        """What the bench itself took to judge bags before a recorder was started again."""

    def __enter__(self) -> Scene:
        self.graph.__enter__()
        try:
            self.ledger.heard = {topic: self.graph.listen("x", topic, lossy=True)
                                 for topic in WITNESSED}
            self.graph.watch_diagnostics(self._on_diagnostics)
            self.ledger.begin()
        except BaseException:
            self.graph.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.undo.close()
        self.graph.close()

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level != DiagnosticStatus.OK:
                self.said.append((time.monotonic(), f"{status.name}: {status.message}"))

    def _new_bag(self) -> Path:
        return self.folder / f"bag_{len([*self.folder.glob('bag_*')]):03d}"

    # Time

    def wait(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Spin until `condition` holds or the time is over, whatever node dies meanwhile."""
        deadline = time.monotonic() + within_s
        while True:
            try:
                self.graph.spin_until(condition, max(0.0, deadline - time.monotonic()), "it")
            except NotInTimeError:
                return condition()
            except HarnessError:
                if not self._find_dead():
                    raise
            else:
                return True

    def spin(self, duration_s: float) -> None:
        """Let the graph run, whatever node dies meanwhile."""
        end = time.monotonic() + duration_s
        self.wait(lambda: time.monotonic() >= end, duration_s + 60.0)

    def sight(self, since: int | None = None) -> Sight:
        """What the witness has; the travel only `since` a message of plant, as this is polled."""
        messages = self.ledger.heard
        plant = len(messages["plant"]) if since is None else since
        return heard(messages, plant, time.time_ns() + self.clock_ahead_ns)

    # Nodes

    def gone(self) -> list[str]:
        """Return the full names of the nodes that have ended."""
        self._find_dead()
        return [each.full_name for each in self.graph.launched if each.ended]

    def _find_dead(self) -> bool:
        """Note which nodes died of a fault; return whether any did."""
        dead = [each.full_name for each in self.graph.launched
                if each.process is not None and not each.ended and each.process.poll() is not None]
        for name in dead:
            last_ns = self.ledger.newest_ns(name) or time.time_ns()
            self._killed(name, last_ns, last_ns)
            self.graph.signal_node(name, signal.SIGKILL)
        return bool(dead)

    def _killed(self, node: str, sent_ns: int, ended_ns: int) -> None:
        self.ledger.killed.append((node, sent_ns, ended_ns))
        if node == RECORDER:
            self.ledger.ends(sent_ns - int(RECORDER_MAY_LOSE_S * 1e9))

    def pid(self, node: str) -> int:
        """Return the number of a node's process."""
        return next(each.process.pid for each in self.graph.launched
                    if each.full_name == node and each.process is not None)

    def end(self, node: str, number: int) -> None:
        """End a node with a signal."""
        sent_ns = time.time_ns()
        self.graph.signal_node(node, number)
        if number == signal.SIGKILL:
            self._killed(node, sent_ns, time.time_ns())
        elif node == RECORDER:
            self.ledger.ends(sent_ns)

    def start(self, node: str) -> None:
        """Start a node that has ended again; a recorder with a new bag."""
        bag = None
        if node == RECORDER:
            begin = time.monotonic()
            self.graph.spin(DIES_LATE_S)
            self._bag_ends(self.ledger.ends_ns or time.time_ns())
            self.judging_s += time.monotonic() - begin
            bag = {"bag": str(self._new_bag())}
        self.graph.restart_node(node, bag)
        if bag is not None:
            self.ledger.begin()

    def change_bag(self, until_ns: int) -> None:
        """Have the recorder begin another bag; of this one nothing is expected after a time."""
        self.ledger.ends(until_ns)
        if RECORDER not in self.gone():
            self.end(RECORDER, signal.SIGINT)
        self.start(RECORDER)

    # Strangers

    @contextlib.contextmanager
    def second(self, nodes: Sequence[str]) -> Iterator[None]:
        """Run nodes of these full names beside the graph, with the parameters of its own."""
        own = {each.kind: each.parameters for each in self.graph.launched}
        started = []
        self.ledger.second_comes()
        try:
            for name in nodes:
                space, _, kind = name.rpartition("/")
                place = self.folder / f"second_{kind}"
                values = {**own[kind], **({"bag": str(self.folder / f"second{time.time_ns()}")}
                                          if kind == "recorder" else {})}
                place.with_suffix(".yaml").write_text(
                    json.dumps({name: {"ros__parameters": values}}), "utf-8")
                started.append(shared_fork_server().start(
                    kind, ["--ros-args", "--params-file", str(place.with_suffix(".yaml")), "-r",
                           f"__ns:={space}"], place.with_suffix(".log"),
                    {**os.environ, "ROS_DOMAIN_ID": str(self.graph.domain_id)}))
            yield
        finally:
            for process in started:
                process.send_signal(signal.SIGINT)
            for process in started:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(ENDS_WITHIN_S)
                process.kill()
                process.wait()

    @contextlib.contextmanager
    def tool(self, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
        """Run fault_tools.py with arguments in the graph's domain; at the end kill it."""
        with subprocess.Popen(
                [sys.executable, str(TOOLS), *arguments],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                env={**os.environ, "ROS_DOMAIN_ID": str(self.graph.domain_id)}) as process:
            try:
                assert process.stdout is not None
                said = process.stdout.fileno()
                self.wait(lambda: bool(select.select([said], [], [], 0.0)[0]), ENDS_WITHIN_S)
                yield process
            finally:
                process.kill()

    # The operator

    def recover(self) -> bool:
        """Do what an operator would do; return whether the scan runs again."""
        deadline = time.monotonic() + RECOVERED_WITHIN_S
        while time.monotonic() < deadline and not self.gone():
            with contextlib.suppress(HarnessError):
                self.operate()
            self.spin(RECENT_S)
            if self.sight().works:
                return True
        return False

    def operate(self) -> None:
        """Clear, arm and start, as far as needed, and set the mode; HarnessError if refused."""
        for service in self._services():
            with self._asking():
                self.graph.call(Trigger, f"/stage/x/{service}", Trigger.Request())
        with self._asking():
            self.graph.set_parameters("/stage/x/controller", {"mode": "pid"})

    @contextlib.contextmanager
    def _asking(self) -> Iterator[None]:
        begin = time.monotonic()
        try:
            yield
        finally:
            self.answers_s.append(time.monotonic() - begin)

    def _services(self) -> Iterator[str]:
        amplifier = self.ledger.heard["amplifier"]
        if not amplifier or not amplifier[-1].enabled:
            yield "amplifier_driver/clear"
            yield "amplifier_driver/arm"
        yield "trajectory_generator/start"


def packaged_model(name: str) -> bytes:
    """Return the file of a model that comes with the package."""
    return (config_folder() / "models" / f"{name}.yaml").read_bytes()
