"""The recorded loop for a long time: does memory grow, does latency drift, is anything lost."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray

from benchmarks.fault_scene import CONTROLLER, GENERATOR
from benchmarks.fault_sight import WITNESSED
from benchmarks.figure import Figure
from benchmarks.load import PLANT
from dfm_stage.harness import StageGraph
from dfm_stage.recording import Topic, read_bag

MINUTES, QUICK_S = 10, 30.0
LOOK_S = 2.0
WARM_SHARE = 0.3
GROWTH_MIB = 8.0


def figures(quick: bool = False, cases: int | None = None) -> list[Figure]:
    """Measure for 10 minutes (quick: 30 s; `cases`: as many minutes)."""
    duration_s = 60.0 * cases if cases else QUICK_S if quick else 60.0 * MINUTES
    with tempfile.TemporaryDirectory(prefix="dfm_soak_") as folder:
        bag = Path(folder) / "bag"
        memory, said = _run(bag, duration_s)
        topics = {name: read_bag(bag, [f"/stage/x/{name}"])[f"/stage/x/{name}"]
                  for name in WITNESSED}
    how = f"raster at 1 kHz in six processes, recorded, {duration_s / 60.0:g} minutes"
    return [*_memory(memory, how), *_latency(topics, how), *_lost(topics, said, how)]


def _run(bag: Path, duration_s: float) -> tuple[dict[str, list[tuple[float, float]]], int]:
    """Return (time s, resident MiB) of every node, and how many deadlines the plant missed."""
    memory: dict[str, list[tuple[float, float]]] = {}
    said = [0]

    def on_diagnostics(array: DiagnosticArray) -> None:
        said.extend(int(value.value) for status in array.status if status.name == PLANT
                    for value in status.values if value.key == "deadlines_missed")

    with StageGraph(bag=bag, parameters={
            "trajectory_generator": {**GENERATOR, "autostart": True},
            "controller": CONTROLLER}) as graph:
        graph.watch_diagnostics(on_diagnostics)
        begin = time.monotonic()
        while (now := time.monotonic() - begin) < duration_s:
            for each in graph.launched:
                assert each.process is not None
                memory.setdefault(each.full_name, []).append(
                    (now, _resident_mib(each.process.pid)))
            graph.spin(LOOK_S)
        graph.stop_recording()
    return memory, said[-1]


def _resident_mib(pid: int) -> float:
    text = Path(f"/proc/{pid}/status").read_text("utf-8")
    return next(int(line.split()[1]) for line in text.splitlines()
                if line.startswith("VmRSS")) / 1024


def _memory(memory: dict[str, list[tuple[float, float]]], how: str) -> list[Figure]:
    growth, slope = {}, {}
    for name, looks in memory.items():
        at, mib = np.array(looks[int(WARM_SHARE * len(looks)):]).T
        growth[name] = float(mib[-1] - mib[0])
        slope[name] = float(np.polyfit(at, mib, 1)[0]) * 3600.0
    worst = max(growth, key=lambda name: growth[name])
    each = ", ".join(f"{name.rpartition('/')[2]} {growth[name]:+.1f}" for name in growth)
    return [
        Figure("soak.memory_growth_mib", growth[worst], "MiB", GROWTH_MIB, bar_kind="at most",
               how=f"of the node that grew most, over the last {1 - WARM_SHARE:.0%} of the time; "
               f"{each}; {how}"),
        Figure("soak.memory_slope_mib_per_hour", max(slope.values()), "MiB/h",
               how=f"steepest straight line through the same; {how}"),
    ]


def _latency(topics: dict[str, Topic], how: str) -> list[Figure]:
    measured = dict(zip(topics["measurement"]["seq"].tolist(),
                        topics["measurement"]["header.stamp"].tolist(), strict=True))
    amplifier = topics["amplifier"]
    ages: NDArray[np.float64] = np.array(
        [(at - measured[seq]) * 1e-6 for at, seq in zip(
            amplifier["header.stamp"].tolist(), amplifier["measurement_seq"].tolist(),
            strict=True) if seq in measured])
    tenths = np.array_split(ages, 10)
    out = []
    for name, share in (("median", 50), ("p99", 99)):
        values = [float(np.percentile(each, share)) for each in tenths]
        early, late = float(np.mean(values[1:4])), float(np.mean(values[-3:]))
        out.append(Figure(f"soak.age_{name}_drift", late / early, "x", None, "early, ms", early,
                          late / early, f"{name} of measurement to output in the last three "
                          f"tenths, {late:.3f} ms, over that in the second to fourth; {how}"))
    return out


def _lost(topics: dict[str, Topic], said: int, how: str) -> list[Figure]:
    """Tell samples that the plant left out, as it woke up too late, from lost messages."""
    missing = {}
    for name, topic in topics.items():
        numbers = topic["seq"].astype(np.int64)
        missing[name] = set(range(numbers.min(), numbers.max() + 1)) - set(numbers.tolist())
    never = set.intersection(*missing.values())
    left_out = len(never) if len(never) <= said else 0
    lost = sum(map(len, missing.values())) - left_out * len(missing)
    return [
        Figure("soak.messages_lost", float(lost), "messages", 0.0, bar_kind="at most",
               how=f"numbers that only some of {len(topics)} topics lack; {how}"),
        Figure("soak.samples_left_out", float(left_out), "samples",
               how="numbers that no topic has: the plant woke up too late for them; it says that "
               f"it missed {said}"),
    ]
