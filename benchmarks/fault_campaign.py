"""Faults in a running graph, one after the other: what each did, and whether all is well again.

A scan runs in real time, one process per node, and is recorded. A witness in this process hears
the loop's topics as well, best effort, since a starved reliable reader would load the writers with
sending again; what it heard is held against the bag. Faults are SIGKILL, SIGSTOP with
SIGCONT some time later, and SIGINT with an immediate new start. After each the output must be at
zero or the loop at work, diagnostics must say what happened, and an operator's `clear`, `arm` and
`start` must bring the scan back.
"""

from __future__ import annotations

import contextlib
import random
import signal
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from std_srvs.srv import Trigger

from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.stage_graph import AXIS_NODES
from dfm_stage.recording import read_bag

KINDS = ("kill", "pause", "restart")
NODES = ("/stage/sim_plant", "/stage/recorder", *(f"/stage/x/{name}" for name in AXIS_NODES))
RECORDER = "/stage/recorder"
WITNESSED = ("measurement", "reference", "command", "amplifier", "plant")
PAUSES_S = (0.05, 2.0)
LOOKED_AT_S = 1.0
SETTLING_S = 2.0
SAFE_WITHIN_S = 3.0
EXPLAINED_WITHIN_S = 8.0
RECOVERED_WITHIN_S = 30.0
RECENT_S = 0.3
RECORDER_MAY_LOSE_S = 1.0
DIES_LATE_S = 0.5
TRAVEL_M = 7.7e-3
GENERATOR = {"reference.kind": "raster", "reference.line_length_m": 1e-3, "duration_s": 4.0,
             "repeat": True}
# Soft enough for what a busy machine adds to the loop's delay, and with little output; the
# feedforward is that of paper_stage.
CONTROLLER = {"kp": 600.0, "ki": 4000.0, "kd": 30.0, "output_limit_v": 2.0,
              "feedforward_position": 600.7, "feedforward_velocity": 1.705,
              "feedforward_acceleration": 1.0}


@dataclass(frozen=True)
class Fault:
    """What is done to which node; `pause_s` is how long a pause lasts."""

    node: str
    kind: str
    pause_s: float = 0.0


@dataclass
class Outcome:
    """How one fault ended; `explained` is None where there was nothing to explain."""

    fault: Fault
    safe: bool = False
    cut: bool = False
    explained: bool | None = None
    recovered: bool = False
    safe_s: float = 0.0
    took_s: float = 0.0
    words: str = ""


@dataclass
class Tally:
    """What became of all faults, and of the messages."""

    outcomes: list[Outcome] = field(default_factory=list)
    witnessed: int = 0
    lost: int = 0
    lost_while_paused: int = 0
    lost_words: list[str] = field(default_factory=list)


def draw(count: int, seed: int) -> list[Fault]:
    """Return `count` faults, each kind on each node as often as any other, in random order."""
    rng = random.Random(seed)
    every = [(node, kind) for node in NODES for kind in KINDS]
    out: list[Fault] = []
    while len(out) < count:
        rng.shuffle(every)
        out += [Fault(node, kind, rng.uniform(*PAUSES_S) if kind == "pause" else 0.0)
                for node, kind in every]
    return out[:count]


class Campaign:
    """A graph that suffers faults; bags go into `folder`, one for every start of the recorder."""

    def __init__(self, folder: Path) -> None:
        self.tally = Tally()
        self._folder = folder
        self._bags = 0
        self._graph: StageGraph
        self._heard: dict[str, list[Any]] = {}
        self._said: list[tuple[float, str]] = []
        self._paused: list[tuple[int, int]] = []
        self._began_ns = 0

    def run(self, faults: Sequence[Fault]) -> Tally:
        """Suffer all of them; a graph that does not come back is replaced and counted."""
        left = list(faults)
        while left:
            with StageGraph(bag=self._new_bag(), start_timeout_s=60.0,
                            parameters={"trajectory_generator": GENERATOR,
                                        "controller": CONTROLLER}) as self._graph:
                self._listen()
                self._begin_segment()
                self._recover()
                while left:
                    outcome = Outcome(left.pop(0))
                    self.tally.outcomes.append(outcome)
                    try:
                        self._suffer(outcome)
                    except HarnessError as error:
                        outcome.words += f"; {error}"
                        break
                ended_ns = time.time_ns()
                with contextlib.suppress(HarnessError):
                    self._graph.spin(2.0)
            self._check_segment(ended_ns)
        return self.tally

    # The graph and its witness

    def _new_bag(self) -> Path:
        self._bags += 1
        return self._folder / f"bag_{self._bags:03d}"

    def _listen(self) -> None:
        self._heard = {topic: self._graph.listen("x", topic, lossy=True) for topic in WITNESSED}
        self._graph.watch_diagnostics(self._on_diagnostics)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.level != DiagnosticStatus.OK:
                self._said.append((time.monotonic(), f"{status.name}: {status.message}"))

    def _begin_segment(self) -> None:
        for heard in self._heard.values():
            heard.clear()
        self._paused.clear()
        self._began_ns = time.time_ns()

    def _check_segment(self, until_ns: int, why: str = "the end") -> None:
        """Hold what the witness heard against the bag of this start of the recorder."""
        bag = read_bag(self._graph.bag)  # type: ignore[arg-type]
        for topic, heard in self._heard.items():
            name = f"/stage/x/{topic}"
            there: set[tuple[int, int]] = set()
            if name in bag:
                there = set(zip(bag[name]["header.stamp"].tolist(), bag[name]["seq"].tolist(),
                                strict=True))
            mine = {(each.stamp_ns, each.seq) for each in heard
                    if self._began_ns < each.stamp_ns < until_ns}
            missing = sorted(mine - there)
            held_up = sum(any(start <= stamp <= end for start, end in self._paused)
                          for stamp, _ in missing)
            self.tally.witnessed += len(mine)
            self.tally.lost_while_paused += held_up
            self.tally.lost += len(missing) - held_up
            if len(missing) > held_up:
                at = np.array([(stamp - until_ns) * 1e-9 for stamp, _ in missing])
                bag_s = (until_ns - self._began_ns) * 1e-9
                self.tally.lost_words.append(
                    f"{topic}: {len(missing) - held_up} of {len(mine)}, {-at[0]:.3f} to "
                    f"{-at[-1]:.3f} s before {why}, of {bag_s:.1f} s in {bag.path.name}")

    # One fault

    def _suffer(self, outcome: Outcome) -> None:
        fault, graph = outcome.fault, self._graph
        self._said.clear()
        begin_ns, begin = time.time_ns(), time.monotonic()
        start = {topic: len(heard) for topic, heard in self._heard.items()}
        self._strike(fault)
        if fault.kind != "pause" and fault.node == RECORDER:
            lost_s = RECORDER_MAY_LOSE_S if fault.kind == "kill" else 0.0
            graph.spin(DIES_LATE_S)
            self._check_segment(begin_ns - int(lost_s * 1e9), f"{fault.kind} - {lost_s:g} s")
        if fault.kind == "restart":
            self._start_again(fault)
        outcome.safe = self._becomes_safe(fault, start)
        outcome.safe_s = time.monotonic() - begin
        graph.spin(max(0.0, begin + LOOKED_AT_S - time.monotonic()))
        outcome.cut = not self._works()
        if fault.kind == "kill" or outcome.cut:
            with contextlib.suppress(HarnessError):
                graph.spin_until(lambda: self._explained(fault), EXPLAINED_WITHIN_S, "words")
            outcome.explained = self._explained(fault)
        outcome.safe &= self._becomes_safe(fault, start)
        outcome.words = "; ".join(dict.fromkeys(text for _, text in self._said))
        if not outcome.safe:
            outcome.words = f"{self._seen(start)}; {outcome.words}"
        repaired = time.monotonic()
        if fault.kind == "kill":
            self._start_again(fault)
        outcome.recovered = self._recover()
        outcome.took_s = time.monotonic() - repaired

    def _strike(self, fault: Fault) -> None:
        graph, node = self._graph, fault.node
        if fault.kind == "pause":
            begin_ns = time.time_ns()
            graph.signal_node(node, signal.SIGSTOP)
            try:
                graph.spin(fault.pause_s)
            finally:
                graph.signal_node(node, signal.SIGCONT)
            if node == RECORDER:
                self._paused.append((begin_ns, time.time_ns()))
            return
        graph.signal_node(node, signal.SIGKILL if fault.kind == "kill" else signal.SIGINT)

    def _start_again(self, fault: Fault) -> None:
        bag = {"bag": str(self._new_bag())} if fault.node == RECORDER else None
        self._graph.restart_node(fault.node, bag)
        if bag is not None:
            self._graph.spin(SETTLING_S)  # a killed recorder still looks matched for a while
            self._begin_segment()

    # How it is

    def _age_s(self, topic: str) -> float:
        heard = self._heard[topic]
        return (time.time_ns() - heard[-1].stamp_ns) * 1e-9 if heard else float("inf")

    def _works(self) -> bool:
        """Return whether commands are given and obeyed, and references come."""
        return (all(self._age_s(topic) < RECENT_S for topic in WITNESSED)
                and self._heard["amplifier"][-1].enabled)

    def _becomes_safe(self, fault: Fault, start: dict[str, int]) -> bool:
        with contextlib.suppress(HarnessError):
            self._graph.spin_until(lambda: self._is_safe(fault, start), SAFE_WITHIN_S, "safety")
        return self._is_safe(fault, start)

    def _is_safe(self, fault: Fault, start: dict[str, int]) -> bool:
        """Whether the loop works, or the output is at zero; and the travel was never passed."""
        travelled = [abs(each.position) for each in self._heard["plant"][start["plant"]:]]
        if max(travelled, default=0.0) > TRAVEL_M:
            return False
        if fault.node == RECORDER or self._works():
            return True
        if fault.node.endswith("trajectory_generator"):
            return self._age_s("command") < RECENT_S
        if self._age_s("plant") < RECENT_S:
            return bool(self._heard["plant"][-1].current == 0.0)
        return not self._heard["amplifier"] or self._heard["amplifier"][-1].voltage == 0.0

    def _seen(self, start: dict[str, int]) -> str:
        """What the witness has of the stage."""
        travelled = [abs(each.position) for each in self._heard["plant"][start["plant"]:]]
        ages = ", ".join(f"{topic} {self._age_s(topic):.2f}" for topic in WITNESSED)
        return f"travelled {max(travelled, default=0.0) * 1e3:.2f} mm, last heard (s ago) {ages}"

    def _explained(self, fault: Fault) -> bool:
        """Whether a node has said what it misses, or why the output is at zero."""
        kind = fault.node.rpartition("/")[2]
        return any(kind in text.partition(": ")[2] or "output at zero" in text
                   or text.startswith(f"{fault.node}:") for _, text in self._said)

    def _recover(self) -> bool:
        """Do what an operator would do; return whether the scan runs again."""
        graph, deadline = self._graph, time.monotonic() + RECOVERED_WITHIN_S
        while time.monotonic() < deadline:
            with contextlib.suppress(HarnessError):
                for service in self._services():
                    graph.call(Trigger, f"/stage/x/{service}", Trigger.Request())
                graph.set_parameters("/stage/x/controller", {"mode": "pid"})
            graph.spin(RECENT_S)
            if self._works():
                return True
        return False

    def _services(self) -> Iterator[str]:
        if not self._heard["amplifier"] or not self._heard["amplifier"][-1].enabled:
            yield "amplifier_driver/clear"
            yield "amplifier_driver/arm"
        yield "trajectory_generator/start"
