"""Lockstep at 1 kHz with recording: how much faster than real time, and twice the same."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median

from mcap.reader import make_reader

from benchmarks.executors import executor
from benchmarks.figure import Figure
from dfm_stage.harness import StageGraph

TOPICS = ("reference", "excitation", "measurement", "command", "amplifier", "plant")


def figures(quick: bool = False) -> list[Figure]:
    """Run a raster under PID, composed and in processes, three times each (quick: once)."""
    duration_s, repeats = (4.0, 1) if quick else (15.0, 3)
    with tempfile.TemporaryDirectory() as folder:
        bags = Path(folder)
        speed = {}
        for composed in (True, False):
            for which in ("events", "default"):
                rounds = repeats if which == "events" else 1
                speed[composed, which] = median(
                    _run(duration_s if which == "events" else duration_s / 3, composed,
                         which, bags / f"{composed}_{which}_{index}")
                    for index in range(rounds))
        twice = [bags / f"again_{index}" for index in range(2)]
        for bag in twice:
            _run(duration_s / 3, composed=False, name="events", bag=bag)
        composed_twice = bags / "again_composed"
        _run(duration_s / 3, composed=True, name="events", bag=composed_twice)
        first = _content(twice[0])
        identical = all(_content(bag) == first for bag in (twice[1], composed_twice))
    out = []
    for composed, name, bar in ((True, "composed", 12.0), (False, "processes", 2.0)):
        value, other = speed[composed, "events"], speed[composed, "default"]
        out.append(Figure(f"lockstep.{name}_x_real_time", value, "x", bar, "default executor",
                          other, value / other, f"{duration_s:g} s at 1 kHz, PID raster, "
                          f"recording all topics; median of {repeats}", "at least"))
    out.append(Figure("lockstep.identical", float(identical), "1 = yes", 1.0, None, None, None,
                      f"two runs in processes and one composed: same bytes, topic by topic and in "
                      f"order, on {', '.join(TOPICS)}", "at least"))
    return out


def _run(duration_s: float, composed: bool, name: str, bag: Path) -> float:
    experiment = {"name": "lockstep", "mode": "pid", "duration_s": duration_s,
                  "axes": {"x": {"reference": {"kind": "raster"}}}}
    with executor(name), StageGraph(lockstep=True, composed=composed, bag=bag) as graph:
        start = time.perf_counter()
        graph.run(experiment)
        elapsed = time.perf_counter() - start
        graph.stop_recording()
    return duration_s / elapsed


def _content(bag: Path) -> dict[str, list[bytes]]:
    out: dict[str, list[bytes]] = {}
    with next(bag.glob("*.mcap")).open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            if channel.topic.removeprefix("/stage/x/") in TOPICS:
                out.setdefault(channel.topic, []).append(message.data)
    return out
