"""How often the 95 % intervals of the estimation hold the truth, open and closed loop.

Records come from a simulator of this file's own (SciPy's exact discretisation at a tenth of the
sample period, a PID written out, its own coloured noise), never from the library's.
"""

from __future__ import annotations

import math
import os
import secrets
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import cont2discrete, lfilter

from benchmarks.figure import Figure

Array = NDArray[np.float64]

PERIOD_S = 1e-3
FINE = 10
SAMPLES = 8000
MASS = 1.082
NAMES = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay")
START = {"mass": MASS, "damping": 1.6, "stiffness": 620.0, "force_constant": 1.05,
         "amplifier_time_constant": 0.8e-3, "delay": 1.2e-3}
BAR_LOW, BAR_HIGH = 92.0, 98.0


@dataclass(frozen=True)
class Case:
    """One experiment: loop, noise RMS (m) and whether the stage moves when recording starts."""

    key: str
    closed: bool
    noise_rms_m: float
    transient: bool
    seed: int


CASES = tuple(
    Case(f"coverage.{'closed' if closed else 'open'}_loop_percent{suffix}", closed, noise,
         transient, 20_260 + 10 * closed + k)
    for closed in (False, True)
    for k, (suffix, noise, transient) in enumerate((
        ("", 1e-7, False), (".five_fold_noise", 5e-7, False), (".transient", 1e-7, True))))


def simulate(case: Case, records: int, seed: int) -> tuple[Array, Array, dict[str, Array]]:
    """Return inputs and outputs (R, N) and the true parameters, each (R,)."""
    rng = np.random.default_rng(seed)
    truth = {"damping": 1.845 * rng.uniform(0.7, 1.3, records),
             "stiffness": 650.0 * rng.uniform(0.9, 1.1, records),
             "force_constant": 1.082 * rng.uniform(0.9, 1.1, records),
             "amplifier_time_constant": 1e-3 * rng.uniform(0.7, 1.3, records),
             "delay": 1e-3 * np.round(rng.uniform(0.7, 1.3, records) * FINE) / FINE}
    step = np.empty((records, 3, 3))
    drives = np.zeros((records, 3, 3))  # columns: input k, k - 1, k - 2
    for r in range(records):
        step[r], drives[r] = sampled({n: float(v[r]) for n, v in truth.items()})
    excitation = np.array([_multisine(rng) for _ in range(records)])
    noise = case.noise_rms_m * np.array([_coloured(rng, r) for r in range(records)])
    state = np.zeros((records, 3))
    if case.transient:
        state[:, 1] = 2e-4 * rng.standard_normal(records)
        state[:, 2] = 5e-3 * rng.standard_normal(records)
    inputs, outputs = np.empty((records, SAMPLES)), np.empty((records, SAMPLES))
    pid = _Pid(records)
    recent = np.zeros((records, 3))
    for k in range(SAMPLES):
        outputs[:, k] = state[:, 1] + noise[:, k]
        inputs[:, k] = (pid.step(2e-5 * excitation[:, k] - outputs[:, k]) if case.closed
                        else 0.08 * excitation[:, k])
        recent = np.column_stack((inputs[:, k], recent[:, :2]))
        state = np.einsum("rij,rj->ri", step, state) + np.einsum("rij,rj->ri", drives, recent)
    return inputs, outputs, truth


def sampled(truth: dict[str, float]) -> tuple[Array, Array]:
    """Return the step over a sample period and what inputs k, k - 1 and k - 2 add, by tenths."""
    lag = truth["amplifier_time_constant"]
    a = np.array([[-1.0 / lag, 0.0, 0.0], [0.0, 0.0, 1.0],
                  [truth["force_constant"] / MASS, -truth["stiffness"] / MASS,
                   -truth["damping"] / MASS]])
    b = np.array([[1.0 / lag], [0.0], [0.0]])
    fine, pulse, *_ = cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), PERIOD_S / FINE)
    late = round(truth["delay"] / PERIOD_S * FINE)
    drives = np.zeros((3, 3))
    reached = np.eye(3)
    for j in range(FINE - 1, -1, -1):
        drives[:, -((j - late) // FINE)] += reached @ pulse[:, 0]
        reached = reached @ fine
    return reached, drives


class _Pid:
    """kp 240 V/m, ki 1600 V/(m s), kd 9 V s/m with a 2 ms filter, for all records at once."""

    def __init__(self, records: int) -> None:
        self.integral, self.slope = np.zeros(records), np.zeros(records)
        self.last: Array | None = None

    def step(self, error: Array) -> Array:
        last = error if self.last is None else self.last
        self.integral = self.integral + 1600.0 * PERIOD_S * error
        self.slope = self.slope + ((error - last) / PERIOD_S - self.slope) / 3.0
        self.last = error
        return 240.0 * error + self.integral + 9.0 * self.slope


def _multisine(rng: np.random.Generator) -> Array:
    """Return an odd random-phase multisine of unit RMS, 0.5 to 150 Hz, period 2 s, (N,)."""
    time = np.arange(2000) * PERIOD_S
    lines = np.arange(1, 301, 2)
    phases = rng.uniform(0.0, 2.0 * math.pi, lines.size)
    wave = np.cos(math.pi * lines[:, None] * time + phases[:, None]).sum(axis=0)
    return np.resize(wave / np.std(wave), SAMPLES)


def _coloured(rng: np.random.Generator, index: int) -> Array:
    """Return noise of unit RMS: 64 % of its power coloured, the rest white."""
    white = rng.standard_normal(SAMPLES + 4000)
    kind = index % 3
    if kind == 0:
        poly = [1.0, -rng.uniform(0.8, 0.98)]
    elif kind == 1:
        omega = 2.0 * math.pi * rng.uniform(2.0, 60.0) * PERIOD_S
        radius = math.exp(-rng.uniform(0.05, 0.5) * omega)
        poly = [1.0, -2.0 * radius * math.cos(omega), radius**2]
    else:
        poly = [1.0, -0.995]
    coloured = lfilter([1.0], poly, white)[4000:]
    return np.asarray(0.8 * coloured / np.std(coloured) + 0.6 * rng.standard_normal(SAMPLES))


def covered(job: tuple[Array, Array, dict[str, float]]) -> tuple[list[bool], str]:
    """Estimate from one record; return per parameter whether its interval holds the truth."""
    from dfm_stage.identification import Run, fit_model
    from dfm_stage.model import Model

    inputs, outputs, truth = job
    model = Model("start", PERIOD_S, base=START)
    found = fit_model(model, [Run("record", inputs, outputs, PERIOD_S)], NAMES).estimate
    return [found.quantity(n).covers(truth[n]) for n in NAMES], found.status


def covered_by_textbook(job: tuple[Array, Array, dict[str, float]]) -> tuple[list[bool], str]:
    """The same from scipy.optimize.least_squares and sigma^2 (J^T J)^-1: noise taken as white."""
    inputs, outputs, truth = job
    low = np.array([0.0, 0.0, 0.0, 1e-5, 0.0, -np.inf, -np.inf, -np.inf])
    start = np.array([START[n] for n in NAMES] + [0.0, 0.0, 0.0])
    scale = np.array([1.0, 600.0, 1.0, 1e-3, 1e-3, 1e-4, 1e-3, 1e-6])

    def residual(z: Array) -> Array:
        return (_textbook_output(inputs, z * scale) - outputs) / 1e-7

    found = least_squares(residual, start / scale, bounds=(low / scale, np.inf), x_scale="jac",
                          jac="3-point")
    variance = 2.0 * found.cost / (outputs.size - start.size)
    error = np.sqrt(np.diag(variance * np.linalg.pinv(found.jac.T @ found.jac))) * scale
    hits = [bool(abs(found.x[j] * scale[j] - truth[n]) <= 1.96 * error[j])
            for j, n in enumerate(NAMES)]
    return hits, "converged" if found.success else "failed"


def _textbook_output(inputs: Array, x: Array) -> Array:
    """Simulate by transfer functions: held input split at the delay, then free motion."""
    damping, stiffness, force, lag, delay = x[:5]
    a = np.array([[-1.0 / lag, 0.0, 0.0], [0.0, 0.0, 1.0],
                  [force / MASS, -stiffness / MASS, -damping / MASS]])
    b = np.array([[1.0 / lag], [0.0], [0.0]])
    whole = int(delay / PERIOD_S)
    late = delay - whole * PERIOD_S
    system = (a, b, np.eye(3), np.zeros((3, 1)))
    step, _, *_ = cont2discrete(system, PERIOD_S)
    after, now, *_ = cont2discrete(system, PERIOD_S - late)
    before = after @ cont2discrete(system, late)[1] if late > 0.0 else np.zeros((3, 1))
    shifted = np.concatenate((np.zeros(whole + 2), inputs))[: inputs.size + 1]
    out = np.full(inputs.size, x[7])
    poles, modes = np.linalg.eig(step)
    drive = np.linalg.solve(modes, np.hstack([now, before, [[0.0], [x[5]], [x[6]]]]))
    pulse = np.zeros(inputs.size)
    pulse[0] = 1.0
    for i in range(3):
        feed = drive[i, 0] * shifted[1:] + drive[i, 1] * shifted[:-1]
        forced = lfilter([1.0], [1.0, -poles[i]], feed)
        free = drive[i, 2] * poles[i] ** np.arange(inputs.size)
        out = out + (modes[1, i] * (forced + free)).real
    return np.asarray(out)


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson interval of a rate, in percent."""
    z, rate = 1.959964, hits / count
    centre = (rate + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(rate * (1 - rate) / count
                                               + z * z / (4 * count * count))
    return 100.0 * (centre - half), 100.0 * (centre + half)


def measure(case: Case, records: int, seed: int, key: str, pool: Any,
            peers: int) -> Figure:
    """Run one case and say how often the intervals held."""
    inputs, outputs, truth = simulate(case, records, seed)
    jobs = [(inputs[r], outputs[r], {n: float(truth[n][r]) for n in NAMES})
            for r in range(records)]
    answers = list(pool.map(covered, jobs, chunksize=5))
    hits = np.array([a[0] for a in answers])
    low, high = wilson(int(hits.sum()), hits.size)
    each = ", ".join(f"{n} {100.0 * hits[:, j].mean():.1f}" for j, n in enumerate(NAMES))
    failed = sum(a[1] in ("failed", "not_converged") for a in answers)
    value = 100.0 * float(hits.mean())
    peer_value = None
    if peers:
        others = list(pool.map(covered_by_textbook, jobs[:peers], chunksize=2))
        peer_value = 100.0 * float(np.mean([a[0] for a in others]))
    how = (f"{records} records of {SAMPLES * PERIOD_S:g} s, coloured noise "
           f"{1e9 * case.noise_rms_m:g} nm RMS, seed {seed}; bar {BAR_LOW:g} to {BAR_HIGH:g}; "
           f"Wilson interval over {hits.size} intervals; {each}; "
           f"{failed} did not converge")
    if peers:
        how += f"; peer on the first {peers} records"
    return Figure(key, value, "%", BAR_LOW,
                  "scipy least_squares, white-noise covariance" if peers else None, peer_value,
                  None, how, "between", BAR_HIGH, low, high, "95 %")


def figures(quick: bool = False) -> list[Figure]:
    """Return coverage per case with frozen seeds, and once more with a fresh one."""
    records, peers = (30, 3) if quick else (300, 12)
    fresh = secrets.randbelow(2**31)
    found = []
    cores = len(os.sched_getaffinity(0))
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        for case in CASES:
            found.append(measure(case, records, case.seed, case.key, pool, peers))
            found.append(measure(case, records, fresh + case.seed, f"{case.key}.fresh", pool, 0))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Print the figures; `quick` as the only argument takes a tenth of the records."""
    import sys

    for figure in figures("quick" in (argv if argv is not None else sys.argv[1:])):
        print(f"{figure.key:50s} {figure.value:6.2f} % met {figure.met} peer {figure.peer_value}"
              f"\n    {figure.how}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
