"""The recorded loop for a long time: does memory grow, does latency drift, is anything lost."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.fault_campaign import CONTROLLER, GENERATOR
from benchmarks.figure import Figure
from dfm_stage.harness import StageGraph
from dfm_stage.recording import Topic, read_bag

MINUTES, QUICK_S = 10, 30.0
LOOK_S = 2.0
WARM_SHARE = 0.3
TOPICS = ("measurement", "reference", "command", "amplifier", "plant")
GROWTH_MIB = 8.0


def figures(quick: bool = False, cases: int | None = None) -> list[Figure]:
    """Measure for 10 minutes (quick: 30 s; `cases`: as many minutes)."""
    duration_s = 60.0 * cases if cases else QUICK_S if quick else 60.0 * MINUTES
    with tempfile.TemporaryDirectory(prefix="dfm_soak_") as folder:
        bag = Path(folder) / "bag"
        memory = _run(bag, duration_s)
        topics = {name: read_bag(bag, [f"/stage/x/{name}"])[f"/stage/x/{name}"]
                  for name in TOPICS}
    how = f"raster at 1 kHz in six processes, recorded, {duration_s / 60.0:g} minutes"
    return [*_memory(memory, how), *_latency(topics, how), _lost(topics, how)]


def _run(bag: Path, duration_s: float) -> dict[str, list[tuple[float, float]]]:
    """Return (time s, resident MiB) of every node, every few seconds."""
    memory: dict[str, list[tuple[float, float]]] = {}
    with StageGraph(bag=bag, parameters={
            "trajectory_generator": {**GENERATOR, "autostart": True},
            "controller": CONTROLLER}) as graph:
        begin = time.monotonic()
        while (now := time.monotonic() - begin) < duration_s:
            for each in graph.launched:
                assert each.process is not None
                memory.setdefault(each.full_name, []).append(
                    (now, _resident_mib(each.process.pid)))
            graph.spin(LOOK_S)
        graph.stop_recording()
    return memory


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


def _lost(topics: dict[str, Topic], how: str) -> Figure:
    lost = sum(int(np.sum(np.diff(np.sort(topic["seq"]).astype(np.int64)) - 1))
               for topic in topics.values())
    return Figure("soak.messages_lost", float(lost), "messages", 0.0, bar_kind="at most",
                  how=f"gaps in the numbers of {len(topics)} topics; {how}")
