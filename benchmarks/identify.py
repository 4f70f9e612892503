"""identify on the paper's stage: how close, and how often the intervals hold, over 400 seeds.

The stage (mass 1.082 kg, damping 1.845 N s/m, 650 N/m, 1.082 N/V, amplifier lag and delay 1 ms,
50 nm counts, 50 nm of noise) is simulated by the simulator of the coverage benchmark, never by the
library's; every seed has its own phases and noise. The records start from rest, and the transient
is left to the command.
"""

from __future__ import annotations

import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from benchmarks.coverage import MASS, PERIOD_S, sampled, wilson
from benchmarks.figure import Figure

Array = NDArray[np.float64]

STAGE = {"damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
         "amplifier_time_constant": 1e-3, "delay": 1e-3}
COUNT_M = NOISE_M = 5e-8
AMPLITUDE_V = 0.08
PERIOD_SAMPLES, PERIODS = 4000, 6
TRUTH = {"natural_frequency_hz": math.sqrt(650.0 / MASS) / (2.0 * math.pi),
         "damping_ratio": 1.845 / (2.0 * math.sqrt(650.0 * MASS)), "gain": 1.082 / 650.0}
BARS = {"natural_frequency_hz": 0.5, "damping_ratio": 3.0, "gain": 0.5}
FIRST_SEED = 4100


def record(seed: int) -> tuple[Array, Array]:
    """Return command (V) and reading (m), (N,): an odd multisine of 1 to 70 Hz, 0.08 V peak."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(PERIOD_SAMPLES) * PERIOD_S
    lines = np.arange(5, round(70.0 * PERIOD_SAMPLES * PERIOD_S) + 1, 2)
    phases = rng.uniform(0.0, 2.0 * math.pi, lines.size)
    wave = np.cos(2.0 * math.pi / (PERIOD_SAMPLES * PERIOD_S) * lines[:, None] * time_s
                  + phases[:, None]).sum(axis=0)
    command = np.tile(AMPLITUDE_V * wave / np.max(np.abs(wave)), PERIODS)
    step, drives = sampled(STAGE)
    state, recent = np.zeros(3), np.zeros(3)
    position = np.empty(command.size)
    for k, volts in enumerate(command):
        position[k] = state[1]
        recent[1:] = recent[:-1]
        recent[0] = volts
        state = step @ state + drives @ recent
    noisy = position + NOISE_M * rng.standard_normal(command.size)
    return command, COUNT_M * np.round(noisy / COUNT_M)


def identified(seed: int) -> dict[str, tuple[float, bool]]:
    """Return per figure how far it is off, in percent, and whether its interval holds."""
    from dfm_stage.identification import Source, identify
    from dfm_stage.recording import AxisRecord

    found = identify([Source("record", AxisRecord(*record(seed)), PERIOD_S)])
    fitted = found.transfer_function
    assert fitted is not None
    named = {"natural_frequency_hz": found.natural_frequency_hz,
             "damping_ratio": found.damping_ratio, "gain": found.gain,
             "response.natural_frequency_hz": fitted.natural_frequency_hz(),
             "response.damping_ratio": fitted.damping_ratio(),
             "response.gain": fitted.static_gain()}
    return {name: (100.0 * abs(q.value / TRUTH[name.rpartition(".")[2]] - 1.0),
                   q.covers(TRUTH[name.rpartition(".")[2]])) for name, q in named.items()}


def figures(quick: bool = False) -> list[Figure]:
    """Return the largest deviations over all seeds, and the coverage of the intervals."""
    seeds = range(FIRST_SEED, FIRST_SEED + (10 if quick else 400))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    begin = time.perf_counter()
    cores = len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        answers = list(pool.map(identified, seeds, chunksize=2))
    seconds = (time.perf_counter() - begin) / len(seeds)
    what = f"{len(seeds)} records of {PERIODS * PERIOD_SAMPLES * PERIOD_S:g} s"
    found = []
    for name, bar in BARS.items():
        worst = max(a[name][0] for a in answers)
        peer = max(a[f"response.{name}"][0] for a in answers)
        found.append(Figure(
            f"identify.{name}_deviation", worst, "%", bar, "fit to the frequency response alone",
            peer, worst / peer, f"largest of {what}, seeds from {FIRST_SEED}", "at most"))
    for name in BARS:
        hits = sum(a[name][1] for a in answers)
        other = sum(a[f"response.{name}"][1] for a in answers)
        low, high = wilson(hits, len(answers))
        found.append(Figure(
            f"identify.{name}_coverage", 100.0 * hits / len(answers), "%", 90.0,
            "fit to the frequency response alone", 100.0 * other / len(answers), None,
            f"intervals that hold over {what}; Wilson interval", "between", 99.0, low, high,
            "95 %"))
    found.append(Figure("identify.seconds", seconds, "s", how=f"mean over {what}, simulation "
                        "included, on all cores"))
    return found


if __name__ == "__main__":
    for each in figures():
        print(f"{each.key:42s} {each.value:9.5f} {each.unit} met {each.met} peer "
              f"{each.peer_value}  {each.how}")
