"""Tools of others that join and leave during a scan at 1 kHz: do they hold up the loop?

The tools are plain rclpy without our profile, as in a shell of their own. A sleeper at the
priority of the nodes tells what the machine itself held up in the same run.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from benchmarks.fault_scene import CONTROLLER, ENDS_WITHIN_S, GENERATOR, TOOLS
from benchmarks.figure import Figure
from benchmarks.private import run_module
from dfm_stage.harness import StageGraph
from dfm_stage.middleware.discovery import PROFILES, RANGE
from dfm_stage.middleware.scheduling import RealTime
from dfm_stage.nodes.base import PRIORITY
from dfm_stage.recording import Topic, read_bag

FULL, QUICK, SEED = 200, 20, 1
LAYOUTS = {"processes": "", "per_axis": "per_axis.", "composed": "composed."}
"""What stands in the keys of the figures of each layout."""
LOOP = ("measurement", "command", "amplifier")
ENDS = (signal.SIGINT, signal.SIGKILL, signal.SIGTERM)
EVERY_S, LIVES_S = 0.4, (0.3, 2.0)
SETTLES_S = 3.0
BAR_MS = 20.0


def figures(quick: bool = False, cases: int | None = None, seed: int = SEED) -> list[Figure]:
    """Measure 200 tools (quick: 20, or `cases`) beside each layout; `seed` draws their lives and
    ends."""
    tools = cases or (QUICK if quick else FULL)
    found = [figure for layout in LAYOUTS for figure in _of_layout(layout, tools, seed)]
    return [*found, Figure("joins.tools", float(tools), "tools", how=(
        f"beside each layout; plain rclpy, one each {EVERY_S:g} s, ended by SIGINT, SIGTERM or "
        f"SIGKILL after {LIVES_S[0]:g} to {LIVES_S[1]:g} s"))]


def _of_layout(layout: str, tools: int, seed: int) -> list[Figure]:
    with tempfile.TemporaryDirectory(prefix="dfm_joins_") as folder:
        answer = Path(folder) / "gaps.json"
        (bags := Path(folder) / "bags").mkdir()
        run_module("benchmarks.joins", [str(bags), str(answer), str(tools), str(seed), layout],
                   bags)
        found = json.loads(answer.read_text("utf-8"))
    stall_ms = max(0.0, found["loop_ms"] - found["sleeper_ms"])
    key, how = f"joins.{LAYOUTS[layout]}", f"{tools} tools, during a raster, layout {layout}"
    return [
        Figure(f"{key}longest_stall_ms", stall_ms, "ms", BAR_MS, bar_kind="at most",
               how="largest gap of measurement, command or amplifier, less that of a bare sleeper "
               f"at the same priority; {how}"),
        Figure(f"{key}loop_gap_ms", found["loop_ms"], "ms", None, "sleeper", found["sleeper_ms"],
               how="the two largest gaps; of the loop before tools came: "
               f"{found['before_ms']:.1f} ms"),
        Figure(f"{key}latched_off", found["off"], "messages", 0.0, bar_kind="at most",
               how="of amplifier, from the first tool to the last, with the output off"),
    ]


def main() -> None:
    """Run the graph with tools; write the gaps, ms."""
    folder, answer, tools, seed, layout = sys.argv[1:]
    bag = Path(folder) / "bag"
    with StageGraph(bag=bag, layout=layout, parameters={
            "trajectory_generator": {**GENERATOR, "autostart": True},
            "controller": CONTROLLER}) as graph, _tool(
            {}, "sleeper", str(PRIORITY.default)) as sleeper, _tool(
            _of_a_stranger(graph), "crowd") as crowd:
        realtime = RealTime()
        if layout == "composed":  # in this process: as the command `compose` does in its own
            realtime.take(PRIORITY.default, time.monotonic())
        graph.spin(SETTLES_S)
        begin_ns = time.time_ns()
        _come_and_go(graph, crowd, int(tools), random.Random(int(seed)))
        end_ns = time.time_ns()
        realtime.give_back()
        assert sleeper.stdin is not None
        assert sleeper.stdout is not None
        sleeper.stdin.close()
        asleep = np.array(json.loads(sleeper.stdout.readline()))
        graph.stop_recording()
    topics = {name: read_bag(bag)[f"/stage/x/{name}"] for name in LOOP}
    amplifier = topics["amplifier"]
    then = (amplifier["header.stamp"] > begin_ns) & (amplifier["header.stamp"] < end_ns)
    here = asleep[(asleep[:, 0] > begin_ns) & (asleep[:, 0] < end_ns), 1]
    Path(answer).write_text(json.dumps({
        "loop_ms": _gap_ms(topics, begin_ns, end_ns), "before_ms": _gap_ms(topics, 0, begin_ns),
        "sleeper_ms": 1e-6 * float(np.max(here, initial=0.0)),
        "off": float(np.sum(~amplifier["enabled"][then]))}), "utf-8")


def _gap_ms(topics: Mapping[str, Topic], begin_ns: int, end_ns: int) -> float:
    """Return the largest gap of any topic between two times."""
    gaps = []
    for topic in topics.values():
        stamps = topic["header.stamp"]
        inside = stamps[(stamps > begin_ns) & (stamps < end_ns)]
        gaps.append(1e-6 * float(np.max(np.diff(inside), initial=0)))
    return max(gaps)


def _of_a_stranger(graph: StageGraph) -> dict[str, str]:
    plain = {name: value for name, value in os.environ.items() if name not in {PROFILES, RANGE}}
    return {**plain, "ROS_DOMAIN_ID": str(graph.domain_id)}


def _come_and_go(graph: StageGraph, crowd: subprocess.Popen[bytes], count: int,
                 rng: random.Random) -> None:
    assert crowd.stdin is not None
    assert crowd.stdout is not None
    due: list[tuple[float, int, int]] = []
    for _ in range(count):
        crowd.stdin.write(b"\n")
        crowd.stdin.flush()
        pid = int(crowd.stdout.readline())
        due.append((time.monotonic() + rng.uniform(*LIVES_S), pid, rng.choice(ENDS)))
        graph.spin(EVERY_S)
        due = _end_due(due, time.monotonic())
    graph.spin(LIVES_S[1])
    _end_due(due, time.monotonic())


def _end_due(due: list[tuple[float, int, int]], now: float) -> list[tuple[float, int, int]]:
    for at, pid, number in due:
        if at <= now:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)
    return [each for each in due if each[0] > now]


@contextlib.contextmanager
def _tool(environment: Mapping[str, str], *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen([sys.executable, str(TOOLS), *arguments], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE, env=environment or None) as process:
        try:
            yield process
        finally:
            assert process.stdin is not None
            process.stdin.close()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(ENDS_WITHIN_S)
            process.kill()


if __name__ == "__main__":
    main()
