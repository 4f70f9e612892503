"""What a witness heard, held against what the recorder wrote: lost messages and their causes."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.fault_outcome import Tally
from dfm_stage.nodes.wiring import LINKS

CLOCK_AHEAD_S = 120.0
"""Of nodes whose clock is not the witness's, before and after it is set. Never behind: Fast DDS
waits until times of this clock (pthread_mutex_timedlock, sem_timedwait), which libfaketime leaves
as they are, and would take every neighbour for dead."""
AT_KILL_S = 5e-3
"""What a node published this shortly before it was killed may have reached one reader alone."""


class Ledger:
    """The messages of one bag: heard, paused, killed; counted in `tally` when the bag ends.

    `heard` lists what the witness heard by topic, `paused` when the recorder was stopped,
    `killed` names of killed nodes and between which times each died (ns), `seconds` when second
    nodes of a name came and the newest numbers of the first ones, by topic. `ends_ns` is up to
    when the recorder, which has ended, must have what was heard; None while it works. All of these
    are times of the witness, `ahead_ns` behind the clock of the nodes.
    """

    def __init__(self, tally: Tally, ahead_ns: int = 0) -> None:
        self.tally = tally
        self.ahead_ns = ahead_ns
        self.heard: dict[str, list[Any]] = {}
        self.paused: list[tuple[int, int]] = []
        self.killed: list[tuple[str, int, int]] = []
        self.seconds: list[tuple[int, dict[str, int]]] = []
        self.ends_ns: int | None = None
        self.began_ns = 0

    def begin(self) -> None:
        """Begin with a new bag."""
        for messages in self.heard.values():
            messages.clear()
        self.paused.clear()
        self.killed.clear()
        self.seconds.clear()
        self.ends_ns = None
        self.began_ns = time.time_ns()

    def ends(self, at_ns: int) -> None:
        """Expect nothing of the recorder that was heard after `at_ns`."""
        self.ends_ns = at_ns if self.ends_ns is None else min(at_ns, self.ends_ns)

    def second_comes(self) -> None:
        """Note that another node of a name comes: it numbers from zero."""
        self.seconds.append((time.time_ns(), {
            topic: messages[-1].seq for topic, messages in self.heard.items() if messages}))

    def newest_ns(self, node: str) -> int:
        """Return the stamp of the last message of a node that was heard; 0 without one."""
        return max((messages[-1].stamp_ns - self.ahead_ns for topic, messages in self.heard.items()
                    if messages and LINKS[topic].publisher == node.rpartition("/")[2]), default=0)

    def compare(self, bags: Sequence[Mapping[str, Any]], name: str, until_ns: int) -> None:
        """Count what was heard before `until_ns` and is in none of the bags of this recorder."""
        for topic, messages in self.heard.items():
            there: set[tuple[int, int]] = set()
            for bag in bags:
                if (full := f"/stage/x/{topic}") in bag:
                    there |= set(zip((bag[full]["header.stamp"] - self.ahead_ns).tolist(),
                                     bag[full]["seq"].tolist(), strict=True))
            mine = {(stamp_ns, each.seq) for each in messages
                    if self.began_ns < (stamp_ns := each.stamp_ns - self.ahead_ns) < until_ns}
            self.tally.witnessed += len(mine)
            self._count(topic, sorted(mine - there), len(mine), until_ns,
                        f"{name}, begun anew {len(bags) - 1} times")

    def _count(self, topic: str, missing: Sequence[tuple[int, int]], heard: int, until_ns: int,
               where: str) -> None:
        lost = []
        for stamp_ns, seq in missing:
            if any(start <= stamp_ns <= end for start, end in self.paused):
                self.tally.lost_while_paused += 1
            elif self._at_kill(topic, stamp_ns):
                self.tally.lost_at_kill += 1
            elif any(start <= stamp_ns and seq < newest.get(topic, 0)
                     for start, newest in self.seconds):
                self.tally.lost_of_seconds += 1
            else:
                lost.append((stamp_ns, seq))
        self.tally.lost += len(lost)
        if lost:
            at = np.array([(stamp_ns - until_ns) * 1e-9 for stamp_ns, _ in lost])
            self.tally.lost_words.append(
                f"{topic}: {len(lost)} of {heard}, {-at[0]:.3f} to {-at[-1]:.3f} s before the "
                f"end, of {(until_ns - self.began_ns) * 1e-9:.1f} s in {where}; kills "
                + ", ".join(f"{node} {(until_ns - then) * 1e-9:.3f}"
                            for node, _, then in self.killed))

    def _at_kill(self, topic: str, stamp_ns: int) -> bool:
        publisher = LINKS[topic].publisher
        return any(node.rpartition("/")[2] == publisher
                   and sent_ns - AT_KILL_S * 1e9 <= stamp_ns <= ended_ns
                   for node, sent_ns, ended_ns in self.killed)
