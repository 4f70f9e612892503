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

from benchmarks.fault_sight import RECENT_S, TRAVEL_M, WITNESSED, Sight, heard, recorded
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.harness.stage_graph import AXIS_NODES
from dfm_stage.recording import read_bag

KINDS = ("kill", "pause", "restart")
NODES = ("/stage/sim_plant", "/stage/recorder", *(f"/stage/x/{name}" for name in AXIS_NODES))
RECORDER = "/stage/recorder"
PAUSES_S = (0.05, 2.0)
LOOKED_AT_S = 1.0
SAFE_WITHIN_S = 3.0
EXPLAINED_WITHIN_S = 8.0
RECOVERED_WITHIN_S = 30.0
RECORDER_MAY_LOSE_S = 1.0
DIES_LATE_S = 0.5
DEAF_S, DEAF_AT_MOST = 5.0, 10
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
    """How one fault ended; `explained` is None where there was nothing to explain.

    `by_bag`: the witness was behind and had not seen that all was safe, or at work; the bag shows
    it, at that very time. `recovered_by_bag`: the same of the scan at work after the repair.
    """

    fault: Fault
    safe: bool = False
    cut: bool = False
    explained: bool | None = None
    recovered: bool = False
    safe_s: float = 0.0
    took_s: float = 0.0
    words: str = ""
    by_bag: bool = False
    recovered_by_bag: bool = False


@dataclass
class _Struck:
    """When a fault began, was looked at and was repaired, and when the witness saw no safety."""

    outcome: Outcome
    begin_ns: int
    looked_ns: int = 0
    end_ns: int = 0
    doubts_ns: list[int] = field(default_factory=list)


@dataclass
class Tally:
    """What became of all faults, and of the messages.

    `deaf`: how often a fault cut off the witness itself, in whose process the operator sits. The
    bag shows that the graph went on, the fault is repeated on another. `travelled` is the furthest
    in all bags, m.
    """

    outcomes: list[Outcome] = field(default_factory=list)
    witnessed: int = 0
    lost: int = 0
    lost_while_paused: int = 0
    deaf: int = 0
    travelled: float = 0.0
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
        self._killed: list[tuple[str, int]] = []
        self._struck: list[_Struck] = []
        self._began_ns = 0
        self._plant_ended_ns = 0

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
                    if not outcome.recovered:
                        break
                ended_ns = time.time_ns()
                with contextlib.suppress(HarnessError):
                    self._graph.spin(2.0)
            self._check_segment(ended_ns)
            if (outcome.safe and not outcome.recovered and self._was_deaf()
                    and self.tally.deaf < DEAF_AT_MOST):
                self.tally.deaf += 1
                self.tally.outcomes.remove(outcome)
                left.insert(0, outcome.fault)
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
        for messages in self._heard.values():
            messages.clear()
        self._paused.clear()
        self._killed.clear()
        self._struck.clear()
        self._began_ns = time.time_ns()

    def _check_segment(self, until_ns: int, why: str = "the end") -> None:
        """Hold what the witness heard against the bag of this start of the recorder.

        A recorder that began anew went on in a folder beside.
        """
        path = self._graph.bag
        assert path is not None
        bags = [read_bag(each) for each in (path, *sorted(path.parent.glob(f"{path.name}_*")))]
        for bag in bags:
            self._judge_again(bag)
            if "/stage/x/plant" in bag:
                self.tally.travelled = max(self.tally.travelled, float(np.max(
                    np.abs(bag["/stage/x/plant"]["position"]), initial=0.0)))
        self._plant_ended_ns = int(bags[-1]["/stage/x/plant"]["header.stamp"][-1]) if (
            "/stage/x/plant" in bags[-1]) else 0
        for topic, messages in self._heard.items():
            name = f"/stage/x/{topic}"
            there: set[tuple[int, int]] = set()
            for bag in bags:
                if name in bag:
                    there |= set(zip(bag[name]["header.stamp"].tolist(),
                                     bag[name]["seq"].tolist(), strict=True))
            mine = {(each.stamp_ns, each.seq) for each in messages
                    if self._began_ns < each.stamp_ns < until_ns}
            lost = sorted(mine - there)
            paused = [each for each in lost
                      if any(start <= each[0] <= end for start, end in self._paused)]
            lost = [each for each in lost if each not in paused]
            self.tally.witnessed += len(mine)
            self.tally.lost_while_paused += len(paused)
            self.tally.lost += len(lost)
            if lost:
                at = np.array([(stamp - until_ns) * 1e-9 for stamp, _ in lost])
                bag_s = (until_ns - self._began_ns) * 1e-9
                self.tally.lost_words.append(
                    f"{topic}: {len(lost)} of {len(mine)}, {-at[0]:.3f} to "
                    f"{-at[-1]:.3f} s before {why}, of {bag_s:.1f} s in {path.name}"
                    + (f", begun anew {len(bags) - 1} times" if bags[1:] else "") + "; kills "
                    + ", ".join(f"{node} {(until_ns - then) * 1e-9:.3f}"
                                for node, then in self._killed))

    def _was_deaf(self) -> bool:
        """Whether the bag has much of what the witness, and so the operator, did not hear."""
        last = max((each[-1].stamp_ns for each in self._heard.values() if each), default=0)
        return self._plant_ended_ns - last > DEAF_S * 1e9

    def _judge_again(self, bag: Any) -> None:
        """Judge by the bag: whether the travel was passed, and what a witness behind did not see.

        It is believed where it has the plant at the very time of the witness's doubt. Witness and
        operator have no real-time priority, and are starved where the nodes need most of the
        machine.
        """
        for struck in self._struck:
            outcome, node = struck.outcome, struck.outcome.fault.node
            at_last = recorded(bag, struck.begin_ns, struck.end_ns)
            doubts = [recorded(bag, struck.begin_ns, at) for at in struck.doubts_ns]
            if at_last.travelled > TRAVEL_M:
                outcome.safe = False
                outcome.words = f"in the bag {at_last}; {outcome.words}"
            elif not outcome.safe and all(each.ages["plant"] < RECENT_S and each.safe_after(node)
                                          for each in doubts):
                outcome.safe = outcome.by_bag = True
            if not outcome.recovered and at_last.works:
                outcome.recovered = outcome.recovered_by_bag = True
            if outcome.explained is False and outcome.fault.kind != "kill" and (
                    recorded(bag, struck.begin_ns, struck.looked_ns).works):
                outcome.explained, outcome.cut, outcome.by_bag = None, False, True

    # One fault

    def _suffer(self, outcome: Outcome) -> None:
        fault, graph = outcome.fault, self._graph
        self._said.clear()
        begin_ns, begin = time.time_ns(), time.monotonic()
        since = len(self._heard["plant"])
        struck = _Struck(outcome, begin_ns)
        self._strike(fault)
        if fault.kind != "pause" and fault.node == RECORDER:
            lost_s = RECORDER_MAY_LOSE_S if fault.kind == "kill" else 0.0
            graph.spin(DIES_LATE_S)
            self._check_segment(begin_ns - int(lost_s * 1e9), f"{fault.kind} - {lost_s:g} s")
        if fault.kind == "restart":
            self._start_again(fault)
        outcome.safe = self._becomes_safe(struck, since)
        outcome.safe_s = time.monotonic() - begin
        graph.spin(max(0.0, begin + LOOKED_AT_S - time.monotonic()))
        outcome.cut = self._is_cut(struck)
        if fault.kind == "pause" and not outcome.cut:  # looked at just as it went on
            graph.spin(RECENT_S)
            outcome.cut = self._is_cut(struck)
        if fault.kind == "kill" or outcome.cut:
            with contextlib.suppress(HarnessError):
                graph.spin_until(lambda: self._explained(fault), EXPLAINED_WITHIN_S, "words")
            outcome.explained = self._explained(fault)
        outcome.safe &= self._becomes_safe(struck, since)
        outcome.words = self._words(begin)
        if not outcome.safe or outcome.explained is False:
            outcome.words = f"{self._sight(since)}; {outcome.words}"
        repaired = time.monotonic()
        try:
            if fault.kind == "kill":
                self._start_again(fault)
            outcome.recovered = self._recover()
        finally:
            outcome.took_s = time.monotonic() - repaired
            struck.end_ns = time.time_ns()
            self._struck.append(struck)

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
        if fault.kind == "kill":
            self._killed.append((node, time.time_ns()))
        graph.signal_node(node, signal.SIGKILL if fault.kind == "kill" else signal.SIGINT)

    def _start_again(self, fault: Fault) -> None:
        bag = {"bag": str(self._new_bag())} if fault.node == RECORDER else None
        self._graph.restart_node(fault.node, bag)
        if bag is not None:
            self._begin_segment()

    # How it is

    def _sight(self, since: int | None = None) -> Sight:
        """What the witness has; the travel only `since` a message of plant, as this is polled."""
        plant = len(self._heard["plant"]) if since is None else since
        return heard(self._heard, plant, time.time_ns())

    def _is_cut(self, struck: _Struck) -> bool:
        struck.looked_ns = time.time_ns()
        return not self._sight().works

    def _becomes_safe(self, struck: _Struck, since: int) -> bool:
        node = struck.outcome.fault.node
        with contextlib.suppress(HarnessError):
            self._graph.spin_until(lambda: self._sight(since).safe_after(node), SAFE_WITHIN_S,
                                   "safety")
        safe = self._sight(since).safe_after(node)
        if not safe:
            struck.doubts_ns.append(time.time_ns())
        return safe

    def _words(self, begin: float) -> str:
        """What diagnostics said, each with the seconds after the fault it was first and last."""
        when: dict[str, list[float]] = {}
        for at, text in self._said:
            when.setdefault(text, []).append(at - begin)
        return "; ".join(f"{text} ({at[0]:.1f} to {at[-1]:.1f} s, {len(at)} times)"
                         for text, at in when.items())

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
            if self._sight().works:
                return True
        return False

    def _services(self) -> Iterator[str]:
        if not self._heard["amplifier"] or not self._heard["amplifier"][-1].enabled:
            yield "amplifier_driver/clear"
            yield "amplifier_driver/arm"
        yield "trajectory_generator/start"
