"""Simulation speed beside hand-written C, SciPy and python-control, all in the same run.

Nonlinear: cubic stiffness and Coulomb friction under a held multisine. The C program is classical
RK4 and does what a careful author would: friction in the direction of motion, each step cut where
the velocity changes sign (found by regula falsi on the step length), then sticking or turning. Its
number of steps per sample is the smallest power of two at which its largest error is no greater
than ours; the reference is the same program with steps so fine that halving them changes nothing.
How it does at one step a sample stands beside it.

Linear: the stage with one and with two modes, of order two and four. `lfilter` filters with its
exact hold-equivalent transfer function, `lsim` and `control.forced_response` simulate the same
system.
"""

from __future__ import annotations

import ctypes
import math
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.figure import Figure
from dfm_stage.errors import DfmError
from dfm_stage.model import Model, Simulator

Array = NDArray[np.float64]
PERIOD_S = 1e-3
ROUNDING_M = 1e-14
STAGE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082}
CUBIC = 3e6
FRICTION = 0.05
FINEST = 128

C_SOURCE = r"""
#include <math.h>
typedef struct { double x, v; } State;
typedef struct { double w, c, k, k3; } Stage;

static inline State rk4(const Stage *p, State s, double f, double h) {
    double a1 = p->w * (f - p->c * s.v - s.x * (p->k + p->k3 * s.x * s.x));
    double x2 = s.x + 0.5 * h * s.v, v2 = s.v + 0.5 * h * a1;
    double a2 = p->w * (f - p->c * v2 - x2 * (p->k + p->k3 * x2 * x2));
    double x3 = s.x + 0.5 * h * v2, v3 = s.v + 0.5 * h * a2;
    double a3 = p->w * (f - p->c * v3 - x3 * (p->k + p->k3 * x3 * x3));
    double x4 = s.x + h * v3, v4 = s.v + h * a3;
    double a4 = p->w * (f - p->c * v4 - x4 * (p->k + p->k3 * x4 * x4));
    State end = {s.x + h / 6.0 * (s.v + 2.0 * (v2 + v3) + v4),
                 s.v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4)};
    return end;
}

void simulate(const double *u, double *out, long samples, long n, double period, double m,
              double c, double k, double g, double k3, double friction) {
    Stage p = {1.0 / m, c, k, k3};
    State s = {0.0, 0.0};
    int way = 0;
    for (long i = 0; i < samples; ++i) {
        double drive = g * u[i];
        out[i] = s.x;
        for (long j = 0; j < n; ++j) {
            double left = period / n;
            for (int event = 0; event < 8 && left > 0.0; ++event) {
                if (way == 0) {
                    double net = drive - s.x * (k + k3 * s.x * s.x);
                    if (fabs(net) <= friction) break;
                    way = net > 0.0 ? 1 : -1;
                }
                State t = rk4(&p, s, drive - way * friction, left);
                if (way * t.v >= 0.0) { s = t; break; }
                double low = 0.0, high = left, from = s.v, to = t.v, cut = left;
                for (int try = 1; try < 60 && fabs(t.v) > 1e-15; ++try) {
                    cut = low + (high - low) * (from / (from - to));
                    if (!(cut > low && cut < high) || try % 3 == 0) cut = 0.5 * (low + high);
                    t = rk4(&p, s, drive - way * friction, cut);
                    if (way * t.v > 0.0) { low = cut; from = t.v; } else { high = cut; to = t.v; }
                }
                s.x = t.x;
                s.v = 0.0;
                left -= cut;
                way = 0;
            }
        }
    }
}
"""


def figures(quick: bool = False) -> list[Figure]:
    """Measure the nonlinear and the linear simulation."""
    return [_nonlinear(quick), *_linear(quick)]


def _paired(first: Callable[[], object], second: Callable[[], object],
            rounds: int) -> tuple[float, float, float]:
    """Median seconds of both, and the median of their ratio first/second, measured in turns."""
    pairs = []
    first()
    second()
    for _ in range(rounds):
        t0 = time.perf_counter()
        first()
        t1 = time.perf_counter()
        second()
        pairs.append((t1 - t0, time.perf_counter() - t1))
    return (statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs),
            statistics.median(a / b for a, b in pairs))


def _multisine(samples: int, amplitude: float) -> Array:
    rng = np.random.default_rng(7)
    t = PERIOD_S * np.arange(samples)
    f = np.arange(0.5, 25.0, 0.5)[:, None]
    signal = np.cos(2.0 * math.pi * f * t + rng.uniform(0.0, 2.0 * math.pi, f.shape)).sum(axis=0)
    return np.asarray(amplitude * signal / np.std(signal))


def _compile(folder: str) -> Callable[[Array, Array, int], None]:
    source, library = Path(folder) / "stage.c", Path(folder) / "stage.so"
    source.write_text(C_SOURCE)
    try:
        subprocess.run(["gcc", "-O3", "-march=native", "-shared", "-fPIC", "-o", str(library),
                        str(source), "-lm"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        raise DfmError("the C program of the bench does not compile; install gcc") from error
    function = ctypes.CDLL(str(library)).simulate
    function.argtypes = [ctypes.c_void_p] * 2 + [ctypes.c_long] * 2 + [ctypes.c_double] * 7
    function.restype = None

    def simulate(inputs: Array, out: Array, steps: int) -> None:
        function(inputs.ctypes.data, out.ctypes.data, len(inputs), steps, PERIOD_S,
                 STAGE["mass"], STAGE["damping"], STAGE["stiffness"], STAGE["force_constant"],
                 CUBIC, FRICTION)

    return simulate


def _nonlinear(quick: bool) -> Figure:
    inputs = _multisine(4000 if quick else 24_000, 0.4)
    model = (Model("bench", PERIOD_S, STAGE).with_effect("cubic_stiffness", {"k3": CUBIC})
             .with_effect("coulomb_friction", {"force": FRICTION}))
    simulator = Simulator(model)
    with tempfile.TemporaryDirectory() as folder:
        simulate = _compile(folder)
        reference, finer, out = (np.empty(len(inputs)) for _ in range(3))
        simulate(inputs, reference, FINEST)
        simulate(inputs, finer, 2 * FINEST)
        doubt = float(np.max(np.abs(finer - reference)))
        ours = float(np.max(np.abs(simulator.output(inputs) - finer)))
        errors = {}
        for steps in (2 ** power for power in range(FINEST.bit_length())):
            simulate(inputs, out, steps)
            errors[steps] = float(np.max(np.abs(out - finer)))
            if errors[steps] <= max(ours, ROUNDING_M):
                break
        rounds = 9 if quick else 25
        mine, peer, ratio = _paired(lambda: simulator.output(inputs),
                                    lambda: simulate(inputs, out, steps), rounds)
        single = _paired(lambda: simulate(inputs, out, 1), lambda: None, rounds)[0]
    each = 1e9 / len(inputs)
    return Figure(
        "simulate.nonlinear_over_c", ratio, "", 1.0, f"C -O3 RK4, {steps} steps a sample, ns",
        peer * each, ratio,
        f"ours {mine * each:.0f} ns a sample, largest error {ours:.0e} m; C {errors[steps]:.0e} m "
        f"(with one step {single * each:.0f} ns and {errors[1]:.0e} m); reference good to "
        f"{doubt:.0e} m; cubic stiffness and Coulomb friction, {len(inputs)} samples, median of "
        f"{rounds} pairs", "at most")


def _linear(quick: bool) -> list[Figure]:
    import control
    from scipy.signal import StateSpace, cont2discrete, lfilter, lsim, ss2tf

    samples, rounds = (20_000, 9) if quick else (200_000, 25)
    inputs = _multisine(samples, 0.4)
    ratios, notes = {}, []
    share, frequency, damping = 0.07, 16.02, 0.01
    for order in (2, 4):
        model = Model("bench", PERIOD_S, STAGE)
        if order == 4:
            model = model.with_effect("second_mode", {"share": share, "frequency": frequency,
                                                      "damping_ratio": damping})
        a, b, c = _state_space(order, share, frequency, damping)
        discrete = cont2discrete((a, b, c, np.zeros((1, 1))), PERIOD_S)
        numerator, denominator = ss2tf(*discrete[:4])
        simulator = Simulator(model)
        ours, peer, ratio = _paired(partial(simulator.output, inputs),
                                    partial(lfilter, numerator[0], denominator, inputs), rounds)
        difference = np.max(np.abs(simulator.output(inputs)
                                   - lfilter(numerator[0], denominator, inputs)))
        ratios[order] = (1.0 / ratio, ours, peer)
        notes.append(f"order {order}: {ours / samples * 1e9:.1f} against "
                     f"{peer / samples * 1e9:.1f} ns, apart by {difference:.0e} m")
    found = []
    order = min(ratios, key=lambda n: ratios[n][0])
    found.append(Figure(
        "simulate.linear_lfilter_over_ours", ratios[order][0], "", 1.0, "scipy.signal.lfilter, ns",
        ratios[order][2] / samples * 1e9, ratios[order][0],
        f"the worse of {'; '.join(notes)}; {samples} samples, median of {rounds} pairs",
        "at least"))
    few = inputs[:2000 if quick else 10_000]
    t = PERIOD_S * np.arange(len(few))
    system, other = StateSpace(a, b, c, [[0.0]]), control.ss(a, b, c, 0.0)
    for key, name, work in (
            ("simulate.linear_lsim_over_ours", "scipy.signal.lsim",
             lambda: lsim(system, few, t, interp=False)),
            ("simulate.linear_python_control_over_ours", "control.forced_response",
             lambda: control.forced_response(other, t, few))):
        peer, _, _ = _paired(work, lambda: None, 5)
        ratio = (peer / len(few)) / (ratios[4][1] / samples)
        found.append(Figure(key, ratio, "", None, f"{name}, ns", peer / len(few) * 1e9, ratio,
                            f"order 4, ns a sample each, median of 5 over {len(few)} samples"))
    return found


def _state_space(order: int, share: float, frequency: float,
                 damping: float) -> tuple[Array, Array, Array]:
    m, c, k, g = (STAGE[n] for n in ("mass", "damping", "stiffness", "force_constant"))
    a, b, out = np.zeros((order, order)), np.zeros((order, 1)), np.zeros((1, order))
    a[:2, :2], b[1, 0], out[0, 0] = [[0.0, 1.0], [-k / m, -c / m]], g / m, 1.0
    if order == 4:
        w = 2.0 * math.pi * frequency
        a[2:, 2:], b[3, 0] = [[0.0, 1.0], [-w * w, -2.0 * damping * w]], g / m
        out[0] = [1.0 - share, 0.0, share, 0.0]
    return a, b, out
