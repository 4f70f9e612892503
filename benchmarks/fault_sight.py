"""What is seen of a running graph at one time, by a live witness or in its bag, and if it is safe.

A witness that is behind sees a loop at rest that works; the bag, complete, tells the two apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

WITNESSED = ("measurement", "reference", "command", "amplifier", "plant")
RECENT_S = 0.3
TRAVEL_M = 7.7e-3
NO_CURRENT = 1e-6
"""A current (A) or, without a coil, a voltage (V) that counts as none: it moves the stage by
2 nm. The lag of the amplifier is 1 ms, so that the current is exactly zero only 0.7 s after the
output was put to zero."""


@dataclass(frozen=True)
class Sight:
    """Ages of the newest messages, s (inf: none), and what the newest of them say, in SI units."""

    ages: Mapping[str, float]
    enabled: bool
    voltage: float
    current: float
    travelled: float

    @property
    def works(self) -> bool:
        """Whether commands are given and obeyed, and references come."""
        return max(self.ages.values()) < RECENT_S and self.enabled

    def safe_after(self, node: str) -> bool:
        """Whether the loop works or the output is at zero, a fault in `node` or none.

        Without references the loop holds the stage where it is.
        """
        if self.travelled > TRAVEL_M:
            return False
        if node.endswith("recorder") or self.works:
            return True
        if node.endswith("trajectory_generator"):
            return self.ages["command"] < RECENT_S
        if self.ages["plant"] < RECENT_S:
            return abs(self.current) < NO_CURRENT
        return self.voltage == 0.0

    def __str__(self) -> str:
        ages = ", ".join(f"{topic} {age:.2f}" for topic, age in self.ages.items())
        return f"travelled {self.travelled * 1e3:.2f} mm, last heard (s ago) {ages}"


def heard(messages: Mapping[str, Sequence[Any]], since: int, now_ns: int) -> Sight:
    """Return what a witness has heard; `since` is the first message of plant to look at."""
    last = {topic: each[-1] if each else None for topic, each in messages.items()}
    amplifier, plant = last["amplifier"], last["plant"]
    return Sight(
        {topic: (now_ns - each.stamp_ns) * 1e-9 if each else float("inf")
         for topic, each in last.items()},
        bool(amplifier and amplifier.enabled), amplifier.voltage if amplifier else 0.0,
        plant.current if plant else 0.0,
        max((abs(each.position) for each in messages["plant"][since:]), default=0.0))


def recorded(bag: Mapping[str, Any], since_ns: int, now_ns: int) -> Sight:
    """Return what a bag shows at `now_ns`, with the travel since `since_ns`.

    Its stamps need not rise: a clock may have been set.
    """
    ages, last = {}, {}
    for topic in WITNESSED:
        stamps = (np.asarray(bag[f"/stage/x/{topic}"]["header.stamp"])
                  if f"/stage/x/{topic}" in bag else np.empty(0, np.int64))
        there = stamps <= now_ns
        last[topic] = int(np.argmax(np.where(there, stamps, 0))) if there.any() else -1
        ages[topic] = ((now_ns - int(stamps[last[topic]])) * 1e-9 if last[topic] >= 0
                       else float("inf"))

    def newest(topic: str, column: str) -> float:
        return float(bag[f"/stage/x/{topic}"][column][last[topic]]) if last[topic] >= 0 else 0.0

    travelled = 0.0
    if "/stage/x/plant" in bag:
        plant = bag["/stage/x/plant"]
        then = (plant["header.stamp"] >= since_ns) & (plant["header.stamp"] <= now_ns)
        travelled = float(np.max(np.abs(plant["position"][then]), initial=0.0))
    return Sight(ages, bool(newest("amplifier", "enabled")), newest("amplifier", "voltage"),
                 newest("plant", "current"), travelled)
