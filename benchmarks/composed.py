"""Nodes that share a process, in real time: one process at 5 kHz, and a process for each axis.

A machine that cannot wake a bare sleeper in time tells nothing of the program. So a process that
only sleeps runs beside every run, at the same rate and priority. A run counts only where the
sleeper met the bar; three of five runs must count.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from benchmarks.fault_scene import CONTROLLER
from benchmarks.figure import BarKind, Figure
from dfm_stage.harness import HarnessError, StageGraph
from dfm_stage.middleware.scheduling import RealTime
from dfm_stage.nodes.base import PRIORITY
from dfm_stage.recording import read_bag

RATES_HZ = (1000, 2000, 3000, 4000, 5000, 6000, 8000)
KEPT_PERCENT = 99.0
MISSED_PERCENT = 0.5
ANSWERED_PERCENT, AGE_MS = 99.9, 0.5
RUNS, ENOUGH = 5, 3
AXES = ("x", "y")
PLANT = "/stage/x/plant"
SLEEPER = """
import json, os, signal, sys, time
rate, priority, late, asked = float(sys.argv[1]), int(sys.argv[2]), [], []
signal.signal(signal.SIGTERM, lambda *_: asked.append(True))
try:
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))
except OSError:
    pass
period, due = 1.0 / rate, time.monotonic()
print(flush=True)
while not asked:
    due += period
    if (rest := due - time.monotonic()) > 0.0:
        time.sleep(rest)
    late.append(time.monotonic() - due)
    if late[-1] > period:
        due += period * (late[-1] // period)
print(json.dumps(late))
"""


@dataclass(frozen=True)
class Sleep:
    """How late a bare sleep at a rate woke up: share above a period (%), p99 and p99.9 (ms); and
    the processor's time that the host gave to others meanwhile (%)."""

    missed: float
    p99: float
    p999: float
    stolen: float

    def __str__(self) -> str:
        return (f"{self.missed:.2f} % late, p99 {self.p99:.2f}, p99.9 {self.p999:.2f} ms, "
                f"{self.stolen:.1f} % stolen")


class BareSleep:
    """A process of its own that sleeps from period to period at our real-time priority, as long as
    the context lasts; then `seen` is how late it woke."""

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self.seen = Sleep(math.nan, math.nan, math.nan, math.nan)

    def __enter__(self) -> BareSleep:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SLEEPER, str(self._rate_hz), str(PRIORITY.default)],
            stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self._process.stdout.readline()
        self._before = _processor()
        return self

    def __exit__(self, *error: object) -> None:
        stolen, spent = np.subtract(_processor(), self._before)
        self._process.terminate()
        said, _ = self._process.communicate()
        late = 1e3 * np.array(json.loads(said))
        self.seen = Sleep(100.0 * float(np.mean(late > 1e3 / self._rate_hz)),
                          float(np.percentile(late, 99)), float(np.percentile(late, 99.9)),
                          100.0 * stolen / max(spent, 1))


def bare_sleep(rate_hz: int, seconds: float = 3.0) -> Sleep:
    """How late a bare sleep wakes beside nothing of ours."""
    with BareSleep(rate_hz) as sleep:
        time.sleep(seconds)
    return sleep.seen


def figures(quick: bool = False) -> list[Figure]:
    """Five runs of 10 s each (quick: one of 4 s); the highest rate is looked for once."""
    runs, seconds = (1, 4.0) if quick else (RUNS, 10.0)
    fast = [missed_percent(5000, seconds) for _ in range(runs)]
    axes = [two_axes(seconds) for _ in range(runs)]
    return [
        _figure("composed.missed_percent_5khz", "%", MISSED_PERCENT, "at most", fast,
                lambda sleep: sleep.missed <= MISSED_PERCENT,
                "samples of a run a period late or more, one process at 5 kHz with the "
                f"recorder, {seconds:g} s"),
        _highest(seconds),
        _figure("two_axes.answered_percent", "%", ANSWERED_PERCENT, "at least",
                [(sleep, answered) for sleep, answered, _ in axes],
                lambda sleep: sleep.missed <= 100.0 - ANSWERED_PERCENT,
                f"commands within 1 ms, the worse axis; a process an axis, 1 kHz, {seconds:g} s"),
        _figure("two_axes.age_p99_ms", "ms", AGE_MS, "at most",
                [(sleep, age) for sleep, _, age in axes],
                lambda sleep: sleep.p99 <= AGE_MS, "measurement to amplifier, the worse axis"),
    ]


def _figure(key: str, unit: str, bar: float, kind: BarKind, runs: Sequence[tuple[Sleep, float]],
            decides: Callable[[Sleep], bool], how: str) -> Figure:
    """The median of the runs that decide; not judged where too few of them do."""
    deciding = [value for sleep, value in runs if decides(sleep)]
    enough = len(deciding) >= min(ENOUGH, len(runs))
    value = median(deciding if enough else [value for _, value in runs])
    told = "; ".join(f"{value:.3g} beside a sleep {sleep}" for sleep, value in runs)
    return Figure(key, value, unit, bar, how=(
        f"{how}; {len(deciding)} of {len(runs)} runs decide: {told}; load "
        f"{os.getloadavg()[0]:.1f}"), bar_kind=kind if enough else None)


def _highest(seconds: float) -> Figure:
    """The highest rate at which 99 % of the deadlines are kept."""
    kept, told = 0, []
    for rate in RATES_HZ:
        sleep, missed = missed_percent(rate, seconds)
        told.append(f"{rate} Hz {missed:.2f} %")
        if not missed <= 100.0 - KEPT_PERCENT:
            break
        kept = rate
    return Figure("composed.highest_hz", float(kept), "Hz", how=(
        f"with 99 % of the deadlines kept, one process with the recorder; missed: "
        f"{', '.join(told)}; a bare sleep at the last rate: {sleep}"))


def missed_percent(rate_hz: int, seconds: float) -> tuple[Sleep, float]:
    """Share (%) of a run's samples that all nodes in one process, recorder included, published
    more than a period late at the nodes' real-time priority, by the stamps in the bag; and a bare
    sleep beside it."""
    urgent, sleep = RealTime(), BareSleep(rate_hz)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with StageGraph(layout="composed", sample_period_s=1.0 / rate_hz, bag=bag,
                        parameters={"controller": CONTROLLER}) as graph:
            urgent.take(PRIORITY.default, time.monotonic())
            try:
                with sleep:
                    run, = graph.run({
                        "name": "composed", "mode": "pid", "duration_s": seconds,
                        "axes": {"x": {"reference": {"kind": "raster", "line_length_m": 1e-3}}},
                    }).values()
            except HarnessError:
                return sleep.seen, math.nan
            finally:
                urgent.give_back()
            graph.stop_recording()
        samples = read_bag(bag, [PLANT])[PLANT]
    inside = (samples["seq"] >= run.first_seq) & (samples["seq"] <= run.last_seq)
    return sleep.seen, late_percent(
        samples["seq"][inside], samples["header.stamp"][inside], rate_hz,
        run.last_seq - run.first_seq + 1)


def late_percent(numbers: Any, stamps_ns: Any, rate_hz: float, count: int) -> float:
    """Share (%) of `count` samples with these numbers (n,) and stamps (n,) that are missing, or
    more than a period later than the one that was most in time."""
    after_ns = stamps_ns - numbers * (1e9 / rate_hz)
    in_time = int(np.sum(after_ns - np.min(after_ns, initial=math.inf) <= 1e9 / rate_hz))
    return 100.0 * (count - in_time) / count


def two_axes(seconds: float) -> tuple[Sleep, float, float]:
    """The share (%) answered within 1 ms and the age's p99 (ms) of the worse of two axes, and a
    bare sleep beside them."""
    sleep = BareSleep(1000)
    experiment = {"name": "axes", "mode": "pid", "duration_s": seconds + 1.0,
                  "axes": {axis: {"reference": {"kind": "raster"}} for axis in AXES}}
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        with StageGraph(axes=AXES, layout="per_axis", bag=bag) as graph:
            with sleep:
                results = graph.run(experiment)
            graph.stop_recording()
        each = [_answers(bag, axis, results[axis].first_seq + 1000, results[axis].last_seq)
                for axis in AXES]
    return sleep.seen, min(answered for answered, _ in each), max(age for _, age in each)


def _answers(bag: Path, axis: str, first: int, last: int) -> tuple[float, float]:
    measurement, command, amplifier = (
        read_bag(bag, [topic])[topic] for topic in (
            f"/stage/{axis}/{name}" for name in ("measurement", "command", "amplifier")))
    late = (command["header.stamp"] - command["measurement_stamp"]) * 1e-6
    inside = (command["measurement_seq"] >= first) & (command["measurement_seq"] <= last)
    at = dict(zip(measurement["seq"].tolist(), measurement["header.stamp"].tolist(), strict=True))
    ages = [(stamp - at[seq]) * 1e-6 for seq, stamp in zip(
        amplifier["measurement_seq"].tolist(), amplifier["header.stamp"].tolist(), strict=True)
        if first <= seq <= last and seq in at]
    return (100.0 * int(np.sum(late[inside] <= 1.0)) / (last - first + 1),
            float(np.percentile(ages, 99)))


def _processor() -> tuple[int, int]:
    """Ticks since boot that the host gave to others, and all."""
    fields = [int(v) for v in Path("/proc/stat").read_text("utf-8").split("\n")[0].split()[1:9]]
    return fields[7], sum(fields)
