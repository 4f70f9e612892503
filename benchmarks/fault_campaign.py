"""Faults in a running graph, one after the other: what each did, and whether all is well again.

A scan runs in real time, one process per node, and is recorded. A witness in this process hears
the loop's topics as well, best effort, since a starved reliable reader would load the writers with
sending again; what it heard is held against the bag. After each fault the output must be at
zero or the loop at work, diagnostics must say what happened, and an operator's `clear`, `arm` and
`start` must bring the scan back.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fault_kinds import KINDS
from benchmarks.fault_ledger import Ledger
from benchmarks.fault_outcome import Fault, Outcome, Tally
from benchmarks.fault_scene import RECORDER, Scene
from benchmarks.fault_sight import RECENT_S, TRAVEL_M, recorded
from dfm_stage.harness import HarnessError
from dfm_stage.recording import read_bag

LOOKED_AT_S = 1.0
SAFE_WITHIN_S = 3.0
EXPLAINED_WITHIN_S = 8.0
DEAF_S, DEAF_AT_MOST = 5.0, 10
SETTLES_S = 2.0
PRIORITY_NOTE = "no real-time priority"


@dataclass
class _Struck:
    """When a fault began, was looked at and was repaired, and when the witness saw no safety."""

    outcome: Outcome
    begin_ns: int
    looked_ns: int = 0
    end_ns: int = 0
    doubts_ns: list[int] = field(default_factory=list)


class Campaign:
    """A graph that suffers faults; bags go into `folder`, one for every start of the recorder.

    The clock of the nodes is `ahead_s` before that of this process.
    """

    def __init__(self, folder: Path, ahead_s: float = 0.0) -> None:
        self.tally = Tally()
        self._folder = folder
        self._ledger = Ledger(self.tally, int(ahead_s * 1e9))
        self._scene: Scene
        self._struck: list[_Struck] = []
        self._plant_ended_ns = 0

    def run(self, faults: Sequence[Fault]) -> Tally:
        """Suffer all of them; a graph that does not come back is replaced and counted."""
        left = list(faults)
        while left:
            with Scene(self._folder, self._ledger, self._bag_ends) as self._scene:
                self._scene.recover()
                while left:
                    outcome = Outcome(left.pop(0))
                    self.tally.outcomes.append(outcome)
                    try:
                        self._suffer(outcome)
                    except HarnessError as error:
                        outcome.words += f"; {error}"
                    print(_line(outcome), file=sys.stderr, flush=True)
                    if not outcome.recovered:
                        break
                ended_ns = self._ledger.ends_ns or time.time_ns()
                self._scene.spin(SETTLES_S)
            self._bag_ends(ended_ns)
            if (outcome.safe and not outcome.recovered and self._was_deaf()
                    and self.tally.deaf < DEAF_AT_MOST):
                self.tally.deaf += 1
                self.tally.outcomes.remove(outcome)
                left.insert(0, outcome.fault)
        return self.tally

    def _bag_ends(self, until_ns: int) -> None:
        """Judge by the bag of a recorder that has ended.

        A recorder that began anew went on in a folder beside.
        """
        path = self._scene.graph.bag
        assert path is not None
        bags = [read_bag(each) for each in (path, *sorted(path.parent.glob(f"{path.name}_*")))]
        for bag in bags:
            self._judge_again(bag)
            if "/stage/x/plant" in bag:
                self.tally.travelled = max(self.tally.travelled, float(np.max(
                    np.abs(bag["/stage/x/plant"]["position"]), initial=0.0)))
        stamps = bags[-1].get("/stage/x/plant", {"header.stamp": np.empty(0)})["header.stamp"]
        self._plant_ended_ns = int(stamps[-1]) if len(stamps) else 0
        self._ledger.compare(bags, path.name, until_ns)
        self._struck.clear()

    def _was_deaf(self) -> bool:
        """Whether the bag has much of what the witness, and so the operator, did not hear."""
        last = max((each[-1].stamp_ns for each in self._ledger.heard.values() if each), default=0)
        return self._plant_ended_ns - last > DEAF_S * 1e9

    def _judge_again(self, bag: Any) -> None:
        """Judge by the bag: whether the travel was passed, and what a witness behind did not see.

        It is believed where it has the plant at the very time of the witness's doubt. Witness and
        operator have no real-time priority, and are starved where the nodes need most of the
        machine.
        """
        for struck in self._struck:
            outcome, node = struck.outcome, struck.outcome.fault.node
            ahead_ns = self._ledger.ahead_ns
            begin_ns = struck.begin_ns + ahead_ns
            at_last = recorded(bag, begin_ns, struck.end_ns + ahead_ns)
            doubts = [recorded(bag, begin_ns, at + ahead_ns) for at in struck.doubts_ns]
            if at_last.travelled > TRAVEL_M:
                outcome.safe = False
                outcome.words = f"in the bag {at_last}; {outcome.words}"
            elif not outcome.safe and all(each.ages["plant"] < RECENT_S and each.safe_after(node)
                                          for each in doubts):
                outcome.safe = outcome.by_bag = True
            elif not outcome.safe:
                doubted = "; ".join(f"in the bag, at the doubt, {each}" for each in doubts)
                outcome.words = f"{doubted}; {outcome.words}"
            if not outcome.recovered and at_last.works:
                outcome.recovered = outcome.recovered_by_bag = True
            if outcome.explained is False and outcome.fault.kind != "kill" and not (
                    KINDS[outcome.fault.kind].words) and (
                    recorded(bag, begin_ns, struck.looked_ns + ahead_ns).works):
                outcome.explained, outcome.cut, outcome.by_bag = None, False, True

    # One fault

    def _suffer(self, outcome: Outcome) -> None:
        fault, scene = outcome.fault, self._scene
        scene.said.clear()
        scene.answers_s.clear()
        begin = time.monotonic()
        since = len(self._ledger.heard["plant"])
        struck = _Struck(outcome, time.time_ns())
        scene.judging_s, repaired = 0.0, begin
        try:
            KINDS[fault.kind].strike(scene, fault)
            self._look(struck, begin, 0 if fault.node == RECORDER else since)
            scene.undo.close()
            scene.judging_s, repaired = 0.0, time.monotonic()
            for node in scene.gone():
                scene.start(node)
            outcome.recovered = scene.recover()
        finally:
            scene.undo.close()
            outcome.took_s = time.monotonic() - repaired - scene.judging_s
            outcome.answered_s = max(scene.answers_s, default=0.0)
            struck.end_ns = time.time_ns()
            self._struck.append(struck)

    def _look(self, struck: _Struck, begin: float, since: int) -> None:
        """See whether the graph is safe, whether the loop goes on, and what it says of it."""
        outcome, scene = struck.outcome, self._scene
        fault = outcome.fault
        outcome.safe = self._becomes_safe(struck, since)
        outcome.safe_s = time.monotonic() - begin
        scene.spin(max(0.0, begin + LOOKED_AT_S - time.monotonic()))
        outcome.cut = self._is_cut(struck)
        if not outcome.cut and fault.kind not in {"kill", "restart"}:
            scene.spin(RECENT_S)  # looked at just as it went on
            outcome.cut = self._is_cut(struck)
        if (gone := scene.gone()) or outcome.cut or KINDS[fault.kind].words:
            scene.wait(lambda: self._explained(fault, gone), EXPLAINED_WITHIN_S)
            outcome.explained = self._explained(fault, gone)
        outcome.safe &= self._becomes_safe(struck, since)
        outcome.words = self._words(begin)
        if not outcome.safe or outcome.explained is False:
            outcome.words = f"{scene.sight(since)}; {outcome.words}"

    def _is_cut(self, struck: _Struck) -> bool:
        struck.looked_ns = time.time_ns()
        return not self._scene.sight().works

    def _becomes_safe(self, struck: _Struck, since: int) -> bool:
        def safe() -> bool:
            sight = self._scene.sight(since)
            return any(sight.safe_after(node) for node in silent)

        silent = ([node for node in self._scene.gone() if node != RECORDER]
                  or [struck.outcome.fault.node])
        found = self._scene.wait(safe, SAFE_WITHIN_S) and safe()
        if not found:
            struck.doubts_ns.append(time.time_ns())
        return found

    def _words(self, begin: float) -> str:
        """What diagnostics said, each with the seconds after the fault it was first and last."""
        when: dict[str, list[float]] = {}
        for at, text in self._scene.said:
            when.setdefault(text, []).append(at - begin)
        return "; ".join(f"{text} ({at[0]:.1f} to {at[-1]:.1f} s, {len(at)} times)"
                         for text, at in when.items())

    def _explained(self, fault: Fault, gone: Sequence[str]) -> bool:
        """Whether a node has said what it misses, or why the output is at zero.

        That a killed node costs the others their priority is true, but explains neither.
        """
        said = [each for _, text in self._scene.said for each in _notes(text)
                if PRIORITY_NOTE not in each]
        if words := KINDS[fault.kind].words:
            return any(each in text for each in words for text in said)
        kinds = [node.rpartition("/")[2] for node in (fault.node, *gone)]
        return any("output at zero" in text or text.startswith(f"{fault.node}:")
                   or any(kind in text.partition(": ")[2] for kind in kinds) for text in said)


def _notes(text: str) -> list[str]:
    """What a node said, note by note, each with the node's name before it."""
    name, _, words = text.partition(": ")
    return [f"{name}: {each}" for each in words.split("; ")]


def _line(outcome: Outcome) -> str:
    fault = outcome.fault
    return (f"{fault.kind} {fault.node}: {'safe' if outcome.safe else 'UNSAFE'}, "
            f"{'loop cut' if outcome.cut else 'loop at work'}, "
            f"{'UNEXPLAINED, ' if outcome.explained is False else ''}"
            f"{'recovered' if outcome.recovered else 'NOT RECOVERED'} in {outcome.took_s:.1f} s, "
            f"operator answered in {outcome.answered_s:.2f} s")
