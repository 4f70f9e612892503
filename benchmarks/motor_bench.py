"""A real two-inertia motor bench: models fitted to record A predict record B, which none has seen.

Commanded current to motor angle, 2500 Hz, the first (transient) period left out. Every model
starts record B from an initial state fitted to B; nothing else is adapted. The fit is
100 (1 - |error| / |measured - mean|), of the whole record and of the excited band, 11 to 250 Hz:
below it dry friction moves the motor in steps that no linear model follows.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.figure import Figure

Array = NDArray[np.float64]

PERIOD_S = 1.0 / 2500.0
FIRST = 2500
BAND_HZ = (10.5, 250.5)
ORDERS = (4, 5, 6, 8, 12)
BLACK_BOX_SAMPLES = 2500


def data_folder() -> Path | None:
    """Return the folder of the recorded data: $DFM_SHARED_DATA, or ../shared/data; or None."""
    named = os.environ.get("DFM_SHARED_DATA")
    root = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = root / "motor_bench_two_inertia"
    return folder if folder.is_dir() else None


def load(folder: Path, record: str) -> tuple[Array, Array]:
    """Return commanded current (A) and motor angle (rad) of record A or B, transient left out."""
    data = np.load(folder / f"motor_bench_multisine{record}.npz")
    return (np.asarray(data["iq_ref"][FIRST:], dtype=float),
            np.asarray(data["theta_motor"][FIRST:], dtype=float))


def fit_percent(measured: Array, simulated: Array) -> tuple[float, float]:
    """Return the fit of the whole record and of the excited band, in percent."""
    error = measured - simulated
    whole = np.linalg.norm(error) / np.linalg.norm(measured - measured.mean())
    band = np.linalg.norm(_band(error)) / np.linalg.norm(_band(measured))
    return 100.0 * (1.0 - float(whole)), 100.0 * (1.0 - float(band))


def _band(signal: Array) -> Array:
    spectrum = np.fft.rfft(signal - signal.mean())
    frequency = np.fft.rfftfreq(signal.size, PERIOD_S)
    spectrum[(frequency < BAND_HZ[0]) | (frequency > BAND_HZ[1])] = 0.0
    return np.asarray(np.fft.irfft(spectrum, signal.size))


def ours(modes: int, noise: str, a: tuple[Array, Array],
         b: tuple[Array, Array]) -> tuple[Array, str]:
    """Fit a rigid body, with a flexible mode if `modes` is 2, to A; return the output on B."""
    from dfm_stage.identification import Run, evaluate, fit_model
    from dfm_stage.model import Model

    model = Model("bench", PERIOD_S, drive="current", position_unit="rad", base={
        "mass": 1.0, "damping": 10.0, "force_constant": 100.0 * modes,
        "amplifier_time_constant": 1e-4, "delay": 3e-4})
    if modes == 2:
        model = model.with_effect("second_mode", {
            "share": 0.5, "frequency": 76.0, "damping_ratio": 0.02})
    found = fit_model(model, [Run("A", *a, PERIOD_S)], noise=noise)
    unseen = evaluate(found.model, Run("B", *b, PERIOD_S), noise=noise)
    said = ", ".join(f"{n} {q.value:.4g} +- {q.half_width:.1g}"
                     for n, q in found.estimate.quantities().items())
    return unseen.simulated, said


def least_squares_with_control(a: tuple[Array, Array],
                               b: tuple[Array, Array]) -> tuple[Array, str]:
    """The two-mode model by python-control and scipy.optimize, noise taken as white."""
    import control

    def sampled(p: Array) -> tuple[Array, Array, Array]:
        body, flexible, damping, omega, zeta, delay = p
        s = control.tf("s")
        plant = control.ss(body / (s**2 + damping * s)
                           + flexible / (s**2 + 2.0 * zeta * omega * s + omega**2))
        part = (1.0 - delay, delay)  # the input of this and of the sample before, by share
        discrete = control.c2d(plant, PERIOD_S, "zoh")
        size = discrete.nstates
        step = np.zeros((size + 1, size + 1))
        step[:size, :size], step[:size, size] = discrete.A, part[1] * discrete.B[:, 0]
        drive = np.append(part[0] * discrete.B[:, 0], 1.0)
        return step, drive, np.append(discrete.C[0], 0.0)

    scale = np.array([100.0, 100.0, 10.0, 480.0, 0.02, 0.5])

    def residual(z: Array) -> Array:
        return a[1] - free_start(*sampled(z * scale), *a)

    found = least_squares(residual, np.ones(6), bounds=(1e-3, [10, 10, 100, 2, 20, 2.0]),
                          diff_step=1e-5, max_nfev=25)
    return (free_start(*sampled(found.x * scale), *b),
            f"{found.nfev} evaluations, {found.message.lower()}")


def black_box(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[Array, str]:
    """Subspace identification (nfoursid); the order that fits A best, poles made stable."""
    pandas = import_module("pandas")
    identifier = import_module("nfoursid.nfoursid").NFourSID
    part = slice(0, BLACK_BOX_SAMPLES)
    inputs = a[0][part] / np.std(a[0])
    outputs = (a[1][part] - a[1][part].mean()) / np.std(a[1])
    found = identifier(pandas.DataFrame({"u": inputs, "y": outputs}), output_columns=["y"],
                       input_columns=["u"], num_block_rows=40)
    found.subspace_identification()
    gain = float(np.std(a[1]) / np.std(a[0]))
    best = (-math.inf, 0, b[1])
    for order in ORDERS:
        model, _ = found.system_identification(rank=order)
        step, drive = np.asarray(model.a), np.asarray(model.b)[:, 0] * gain
        output, direct = np.asarray(model.c)[0], float(np.asarray(model.d)[0, 0]) * gain
        on_a, on_b = (free_start(step, drive, output, u, y - direct * u) + direct * u
                      for u, y in (a, b))
        best = max(best, (fit_percent(a[1], on_a)[0], order, on_b), key=lambda each: each[0])
    return best[2], (f"order {best[1]} of {ORDERS}, 40 block rows, the first {BLACK_BOX_SAMPLES} "
                     "samples of A (its memory grows with the square)")


def free_start(step: Array, drive: Array, output: Array, inputs: Array,
               measured: Array) -> Array:
    """Simulate x+ = A x + b u, y = c x from the initial state and offset that suit best.

    Poles outside the unit circle are mirrored into it.
    """
    poles, modes = np.linalg.eig(step)
    outside = np.abs(poles) > 1.0 + 1e-9
    poles[outside] = 1.0 / np.conj(poles[outside])
    into = np.linalg.solve(modes, drive.astype(complex))
    out = output @ modes
    from scipy.signal import lfilter

    samples = np.arange(measured.size)
    forced = np.zeros(measured.size, dtype=complex)
    free = []
    before = np.concatenate(([0.0], inputs[:-1]))
    for pole, gain, weight in zip(poles, into, out, strict=True):
        forced += weight * lfilter([gain], [1.0, -pole], before)
        motion = weight * np.exp(np.log(complex(pole)) * samples) if abs(pole) > 0.0 else None
        if motion is not None and np.all(np.isfinite(motion)):
            free += [motion.real, motion.imag]
    basis = np.column_stack([*free, np.ones(measured.size)])
    size = np.maximum(np.linalg.norm(basis, axis=0), 1e-300)
    weights = np.linalg.lstsq(basis / size, measured - forced.real, rcond=1e-9)[0]
    return np.asarray(forced.real + (basis / size) @ weights)


def figures(quick: bool = False) -> list[Figure]:
    """Return how well each model, fitted to record A, predicts record B."""
    folder = data_folder()
    if folder is None:
        return [Figure("motor_bench.two_mode_fit_percent", math.nan, "%", how="left out: the "
                       "recorded data are not here (DFM_SHARED_DATA or ../shared/data)")]
    a, b = load(folder, "A"), load(folder, "B")
    if quick:
        a = (a[0][:12_500], a[1][:12_500])
    candidates: list[tuple[str, Callable[[], tuple[Array, str]]]] = [
        ("two_mode", lambda: ours(2, "auto", a, b)),
        ("two_mode_white", lambda: ours(2, "white", a, b)),
        ("one_mode", lambda: ours(1, "auto", a, b)),
        ("least_squares", lambda: least_squares_with_control(a, b)),
        ("nfoursid", lambda: black_box(a, b))]
    found: list[Figure] = []
    peer: tuple[str, float, float] | None = None
    for name, candidate in reversed(candidates):
        begin = time.perf_counter()
        try:
            simulated, said = candidate()
        except ImportError as error:
            found.append(Figure(f"motor_bench.{name}_fit_percent", math.nan, "%",
                                how=f"left out: {error.name} is not installed"))
            continue
        seconds = time.perf_counter() - begin
        whole, band = fit_percent(b[1], simulated)
        if name == "least_squares":
            peer = ("python-control + scipy least squares", whole, band)
        rms = float(np.sqrt(np.mean((b[1] - simulated) ** 2)))
        how = (f"fitted to A, whole record B: RMS error {1e3 * rms:.2f} mrad; {said}; "
               f"{seconds:.1f} s")
        beside = peer if name.startswith("two_mode") else None
        for suffix, value, other, text in (
                ("fit_percent", whole, 1, how),
                ("band_fit_percent", band, 2, f"the same, {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz")):
            found.append(Figure(
                f"motor_bench.{name}_{suffix}", value, "%",
                peer=beside[0] if beside else None,
                peer_value=float(beside[other]) if beside else None,
                ratio=value / float(beside[other]) if beside else None, how=text))
    return found[::-1]


if __name__ == "__main__":
    for each in figures():
        print(f"{each.key:42s} {each.value:7.2f} {each.unit}  peer {each.peer_value}  {each.how}")
