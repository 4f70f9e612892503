"""The real-time loop in separate processes at 1 kHz, beside a bare pipeline of five processes.

The bare pipeline does nothing but pass a message on, four times, in plain rclpy with the same
executor: what the middleware alone costs on this machine in this minute.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import pipeline
from benchmarks.executors import executor
from benchmarks.figure import Figure
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.nodes.base import PRIORITY
from dfm_stage.recording import read_bag

TOPICS = ("reference", "excitation", "measurement", "command", "amplifier", "plant",
          "sim/position_counts", "sim/drive")
SETTLING_S = 1.0


def figures(quick: bool = False) -> list[Figure]:
    """Measure for 60 s (quick: 10 s); the default executor does the same work for a third."""
    duration_s = 10.0 if quick else 60.0
    spike = pipeline.ages_ms(duration_s / 3)
    urgent = pipeline.ages_ms(duration_s / 3, PRIORITY.default)
    ours = measure(duration_s, "events")
    default = _default_executor(duration_s / 3)
    seconds = f"{duration_s:g} s at 1 kHz, six processes, raster under PID"
    peer = "default executor, same nodes"
    out = [
        Figure("loop.answered_percent", ours["answered"], "%", 99.5, peer, default["answered"],
               None, f"commands within 1 ms of their measurement, of all samples; {seconds}",
               "at least"),
    ]
    for key, ages, how in (("spike", spike, "at normal priority"),
                           ("spike_realtime", urgent, "with our real-time priority")):
        out.append(Figure(f"loop.{key}_age_p99_ms", float(np.percentile(ages, 99)), "ms",
                          how=f"bare five-process pipeline {how}, median {np.median(ages):.3f}, "
                          f"p99.9 {np.percentile(ages, 99.9):.3f} ms"))
    for key, q in (("median", 50), ("p99", 99), ("p999", 99.9)):
        value, other = (float(np.percentile(each["age"], q)) for each in (ours, default))
        bar = 1.0 if key == "p99" else None
        out.append(Figure(f"loop.age_{key}_ms", value, "ms", bar, peer, other, value / other,
                          f"measurement stamp to amplifier stamp; {seconds}",
                          "at most" if bar else None))
    out += [
        Figure("loop.messages_lost", ours["lost"], "messages", 0.0, None, None, None,
               f"gaps in the sequence numbers of {len(TOPICS)} topics in the bag", "at most"),
        Figure("loop.cpu_percent", ours["cpu"], "% of a core", None, peer, default["cpu"],
               ours["cpu"] / default["cpu"], "all six processes together"),
        Figure("loop.deadlines_missed", ours["missed"], "samples", None, None, None, None,
               "sample periods that the plant's steady clock woke up too late for"),
    ]
    return out


def _default_executor(duration_s: float) -> dict:
    """What `measure` says of the default executor; nothing where its delay lets the stage leave
    its travel."""
    try:
        return measure(duration_s, "default")
    except HarnessError:
        return {"answered": np.nan, "age": np.full(1, np.nan), "cpu": np.nan}


def measure(duration_s: float, name: str, line: Mapping[str, float] | None = None,
            rate_hz: float = 1000.0, **graph_settings: Any) -> dict:
    """Scan in six processes with an executor, recorded; return what the bag says.

    `line` goes to the raster, `graph_settings` to `StageGraph`.

    Returns
    -------
    dict
        `age` (an array, ms), `answered` (%), `cpu` (% of a core), `lost` and `missed`.
    """
    experiment = {"name": "loop", "mode": "pid", "duration_s": duration_s + SETTLING_S,
                  "axes": {"x": {"reference": {"kind": "raster", **(line or {})}}}}
    with executor(name), tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with StageGraph(bag=bag, sample_period_s=1.0 / rate_hz, **graph_settings) as graph:
            busy = graph.cpu_seconds()
            result = graph.run(experiment)["x"]
            cpu = 100.0 * (graph.cpu_seconds() - busy) / (duration_s + SETTLING_S)
            graph.stop_recording()
        return {"cpu": cpu, **_evaluate(bag, result.first_seq + int(SETTLING_S * rate_hz),
                                        result.last_seq, 2e3 / rate_hz)}


def _evaluate(bag: Path, first: int, last: int, missed_ms: float) -> dict:
    topics = {name: read_bag(bag, [f"/stage/x/{name}"])[f"/stage/x/{name}"] for name in TOPICS}
    lost = sum(int(np.sum(np.diff(np.sort(columns["seq"]).astype(np.int64)) - 1))
               for columns in topics.values())
    measured = dict(zip(topics["measurement"]["seq"].tolist(),
                        topics["measurement"]["header.stamp"].tolist(), strict=True))
    command, amplifier = topics["command"], topics["amplifier"]
    late = (command["header.stamp"] - command["measurement_stamp"]) * 1e-6
    inside = (command["measurement_seq"] >= first) & (command["measurement_seq"] <= last)
    answered = 100.0 * int(np.sum(late[inside] <= 1.0)) / (last - first + 1)
    ages = np.array([(stamp - measured[seq]) * 1e-6 for seq, stamp in zip(
        amplifier["measurement_seq"].tolist(), amplifier["header.stamp"].tolist(), strict=True)
        if first <= seq <= last and seq in measured])
    plant = topics["plant"]
    gaps = np.diff(plant["header.stamp"]) * 1e-6
    return {"answered": answered, "age": ages, "lost": float(lost),
            "missed": float(np.sum(gaps > missed_ms))}


