"""Faster than planned, and beside other work: missed deadlines counted, published, stage safe."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.fault_scene import CONTROLLER
from benchmarks.fault_sight import TRAVEL_M
from benchmarks.figure import Figure
from dfm_stage.harness import HarnessError, StageGraph

DURATION_S, QUICK_DURATION_S = 30.0, 4.0
DIAGNOSTICS_S = 2.5
RATES_HZ = (1000, 2000, 5000)
BUSY = "while True: pass"
COUNTED = ("deadlines_missed", "late_drives", "samples")
PLANT, AMPLIFIER = "/stage/sim_plant", "/stage/x/amplifier_driver"


@dataclass
class Outcome:
    """What the plant counted and published in one run, and where the stage was."""

    published: dict[str, int] = field(default_factory=dict)
    counted: dict[str, int] = field(default_factory=dict)
    latched: str = ""
    travel_m: float = 0.0
    ended: str = ""

    def share(self, what: str) -> float:
        """Return a published count in percent of the samples."""
        return 100.0 * self.published.get(what, 0) / max(1, self.published.get("samples", 0))

    @property
    def unsafe(self) -> bool:
        """Whether the travel was passed."""
        return self.travel_m > TRAVEL_M


def figures(quick: bool = False) -> list[Figure]:
    """Measure 30 s (quick: 4 s) of each rate composed, and of processes beside busy cores."""
    duration_s = QUICK_DURATION_S if quick else DURATION_S
    out = []
    for rate in RATES_HZ:
        out += _figures(f"composed_{rate}hz", run(rate, duration_s, True),
                        f"all nodes in one process at {rate} Hz, {duration_s:g} s")
    out += _figures("processes", run(1000, duration_s, False),
                    f"five processes at 1000 Hz, {duration_s:g} s")
    with busy_cores() as cores:
        out += _figures("processes_busy", run(1000, duration_s, False),
                        f"five processes at 1000 Hz beside a busy loop on each of {cores} "
                        f"cores, {duration_s:g} s")
    return out


@contextlib.contextmanager
def busy_cores() -> Iterator[int]:
    """Keep every core busy; yields how many there are."""
    cores = len(os.sched_getaffinity(0))
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(cores)]
    try:
        yield cores
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def run(rate_hz: int, duration_s: float, composed: bool) -> Outcome:
    """Scan at a rate; a run that is cut short is an outcome, too."""
    outcome = Outcome()

    def on_diagnostics(array: DiagnosticArray) -> None:
        for status in array.status:
            values = {value.key: value.value for value in status.values}
            if status.name == PLANT:
                outcome.published = {key: int(values.get(key, 0)) for key in COUNTED}
            elif status.name == AMPLIFIER and values.get("latched", "nothing") != "nothing":
                outcome.latched = values["latched"]

    with StageGraph(composed=composed, sample_period_s=1.0 / rate_hz,
                    parameters={"controller": CONTROLLER}) as graph:
        graph.watch_diagnostics(on_diagnostics)
        plant = graph.listen("x", "plant")
        try:
            graph.run({"name": "load", "mode": "pid", "duration_s": duration_s, "axes": {
                "x": {"reference": {"kind": "raster", "line_length_m": 1e-3}}}})
        except HarnessError as error:
            outcome.ended = str(error)
        graph.spin(DIAGNOSTICS_S)
        outcome.travel_m = max((abs(each.position) for each in plant), default=0.0)
        outcome.counted = _counters(graph)
    return outcome


def _counters(graph: StageGraph) -> dict[str, int]:
    node: Any = next(each.node for each in graph.launched if each.kind == "sim_plant")
    return {} if node is None else {key: node.counters.get(key, 0) for key in COUNTED}


def _figures(name: str, outcome: Outcome, how: str) -> list[Figure]:
    said = f"; latched: {outcome.latched}" if outcome.latched else ""
    said += f"; cut short: {outcome.ended}" if outcome.ended else ""
    out = [
        Figure(f"load.{name}_missed_percent", outcome.share("deadlines_missed"), "%",
               how=f"sample periods that the plant woke up too late for, as published; {how}"),
        Figure(f"load.{name}_late_percent", outcome.share("late_drives"), "%",
               how=f"drives that came after their sample and acted one later; {how}{said}"),
        Figure(f"load.{name}_unsafe", float(outcome.unsafe), "1 = yes", 0.0, bar_kind="at most",
               how=f"travel passed; furthest {outcome.travel_m * 1e3:.2f} mm; {how}"),
    ]
    if outcome.counted:
        apart = (outcome.counted["deadlines_missed"] > 0) and (
            outcome.published.get("deadlines_missed", 0) == 0)
        out.append(Figure(f"load.{name}_unpublished", float(apart), "1 = yes", 0.0,
                          bar_kind="at most",
                          how=f"{outcome.counted['deadlines_missed']} missed deadlines counted "
                          "in the node and none in /diagnostics"))
    return out
