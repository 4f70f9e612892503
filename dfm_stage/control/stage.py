"""The linear part of a model as control sees it: checked, sampled, its highest mode and its loop.

`LinearPart` and `Sampled` are the model's own (`dfm_stage.model.linear`): modes, damping,
back-EMF, coil, lags, creep and whatever an effect adds to the linear part is in them, nonlinear
forces are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains
from dfm_stage.model import Model
from dfm_stage.model.linear import LinearPart, Sampled, linear_part

__all__ = ["LinearStage", "Margins", "Sampled", "StateSpace", "closed_loop", "closed_loop_poles",
           "command_limit", "controller_response", "frequency_grid", "highest_mode",
           "linear_stage", "loop_gain", "loop_margins", "margins", "pid_system", "radius",
           "sample_model", "sample_stage"]
LinearStage = LinearPart
StateSpace = tuple[Array, Array, Array, float]


def linear_stage(model: Model) -> LinearStage:
    """Return the linear part of a one-axis model to design on.

    Raises
    ------
    ControlError
        If mass or force_constant is not above zero, or the model has several axes.
    """
    if model.axes:
        raise ControlError(f"model {model.name} has the axes {', '.join(model.axes)}; design on "
                           "model.axis(name)")
    _check(model.base)
    return linear_part(model)


def _check(base: Mapping[str, float]) -> None:
    for name in ("mass", "force_constant"):
        if not base.get(name, 0.0) > 0.0:
            raise ControlError(f"the model's base needs {name} above zero to design on it")


def sample_stage(base: Mapping[str, float], sample_period_s: float) -> Sampled:
    """Return the base model of a model.yaml, sampled with a zero-order hold.

    Raises
    ------
    ControlError
        If mass or force_constant is missing or not above zero.
    """
    _check(base)
    return sample_model(Model("stage", sample_period_s, {"damping": 0.0, **base}))


def sample_model(model: Model, sample_period_s: float | None = None) -> Sampled:
    """Return the linear part of a one-axis model, sampled; by default with its own period.

    Raises
    ------
    ControlError
        As `linear_stage`.
    """
    return linear_stage(model).sampled(sample_period_s or model.sample_period)


def command_limit(model: Model, output_limit_v: float) -> float:
    """Return the largest command that has an effect: the limit, or the model's own."""
    return min(output_limit_v, model.effective_base()["command_limit"])


def highest_mode(model: Model) -> tuple[float, float]:
    """Return frequency (Hz) and damping ratio of the fastest vibration of a one-axis model.

    Raises
    ------
    ControlError
        As `linear_stage`, or if nothing in it vibrates.
    """
    stage = linear_stage(model)
    poles = np.linalg.eigvals(stage.a[:stage.motion, :stage.motion])
    fastest = max(poles[poles.imag > 0.0], key=abs, default=None)
    if fastest is None:
        raise ControlError(f"model {model.name} has no mode: it has no spring, or one so damped "
                           "that nothing vibrates")
    return float(abs(fastest)) / (2.0 * math.pi), max(0.0, float(-fastest.real / abs(fastest)))


def pid_system(gains: PidGains, sample_period_s: float) -> StateSpace:
    """Return (A, b, c, d) of the unlimited `Pid` from y to u with the reference at zero.

    States: integral, derivative, and with a notch its two in the transposed direct form II.
    """
    tf, h = gains.derivative_filter_s, sample_period_s
    decay, per_dt = tf / (tf + h), 1.0 / (tf + h)
    a, c = np.diag([1.0, decay]), np.array([1.0, gains.kd])
    b, d = np.array([gains.ki * h, per_dt * (decay - 1.0)]), gains.kp + gains.kd * per_dt
    notch = gains.notch(h)
    if notch is not None:
        b_0, b_1, b_2, a_1, a_2 = notch.coefficients
        into, own = np.array([b_1 - a_1 * b_0, b_2 - a_2 * b_0]), np.array([[-a_1, 1], [-a_2, 0]])
        a = np.block([[a, np.zeros((2, 2))], [np.outer(into, c), own]])
        b, c, d = np.append(b, into * d), np.append(b_0 * c, [1.0, 0.0]), b_0 * d
    return a, -b, c, -d


def closed_loop(stage: Sampled, law: StateSpace) -> Array:
    """Return the matrix of a stage under a law (A, b, c, d) from y to u."""
    a, b, c, d = law
    return np.block([[stage.a + d * np.outer(stage.b, stage.c), np.outer(stage.b, c)],
                     [np.outer(b, stage.c), a]])


def radius(matrix: Array) -> float:
    """Return the largest absolute eigenvalue: a sampled loop is stable where it is below one."""
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def closed_loop_poles(stage: Sampled, gains: PidGains) -> Complex:
    """Return the eigenvalues of stage and unlimited PID in the z-plane, shape (n + 2,), with a
    notch (n + 4,)."""
    return np.asarray(np.linalg.eigvals(closed_loop(
        stage, pid_system(gains, stage.sample_period_s))), dtype=np.complex128)


def controller_response(gains: PidGains, frequency_hz: Array,
                        sample_period_s: float) -> Complex:
    """Return the law of `Pid` from -y to u at frequencies of shape (F,), V/m, complex (F,)."""
    h, tf = sample_period_s, gains.derivative_filter_s
    z = np.exp(2j * math.pi * np.asarray(frequency_hz) * h)
    law = (gains.kp + gains.ki * h / (z - 1.0)
           + gains.kd * (z - 1.0) / ((tf + h) * z - tf))
    notch = gains.notch(h)
    if notch is not None:
        b_0, b_1, b_2, a_1, a_2 = notch.coefficients
        law = law * ((b_0 * z + b_1) * z + b_2) / ((z + a_1) * z + a_2)
    return np.asarray(law)


@dataclass(frozen=True)
class Margins:
    """Distances of a loop from instability.

    `modulus` is the smallest distance of the loop's frequency response from -1 (the inverse of
    the largest sensitivity). `gain` is the smallest factor by which the gain may grow. `phase_deg`
    is the smallest phase that may be lost at a crossover. `crossover_hz` is the highest frequency
    where the loop gain is one. Infinite or NaN where there is no such crossing.
    """

    stable: bool
    modulus: float
    gain: float
    phase_deg: float
    crossover_hz: float


def loop_gain(stage: Sampled, gains: PidGains) -> tuple[Array, Complex]:
    """Return frequencies (F,), Hz, and the loop gain (F,) of stage and PID at these."""
    f = frequency_grid(stage)
    return f, stage.response(f) * controller_response(gains, f, stage.sample_period_s)


def margins(stage: Sampled, gains: PidGains) -> Margins:
    """Return the margins of the sampled loop of `Pid`, as `loop_margins`."""
    loop = closed_loop(stage, pid_system(gains, stage.sample_period_s))
    return loop_margins(*loop_gain(stage, gains), radius(loop) < 1.0)


def frequency_grid(stage: Sampled) -> Array:
    """Return 5,000 frequencies up to half the rate, in Hz, and a denser set at each resonance."""
    nyquist = 0.5 / stage.sample_period_s
    poles = np.linalg.eigvals(stage.a)
    rates = np.log(poles[np.abs(poles) > 1e-6].astype(complex)) / stage.sample_period_s
    near = [np.abs(rate.imag) + np.abs(rate.real) * np.linspace(-8.0, 8.0, 161)
            for rate in rates if rate.imag > 0.0]
    f = np.concatenate((np.geomspace(nyquist * 1e-5, nyquist, 5000),
                        *(each / (2.0 * math.pi) for each in near)))
    return np.unique(f[(f >= nyquist * 1e-5) & (f <= nyquist)])


def loop_margins(frequency_hz: Array, loop: Complex, stable: bool) -> Margins:
    """Return the margins of a loop gain (F,) with negative feedback, given at frequencies (F,)."""
    f = frequency_hz
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    crossings = np.flatnonzero((size[:-1] >= 1.0) != (size[1:] >= 1.0))
    turns = (angle + math.pi) / (2.0 * math.pi)
    at = 1.0 / size[np.flatnonzero(np.floor(turns[:-1]) != np.floor(turns[1:]))]
    lost = np.degrees(np.abs((angle[crossings] + 2.0 * math.pi) % (2.0 * math.pi) - math.pi))
    return Margins(
        stable=stable,
        modulus=float(np.min(np.abs(1.0 + loop))),
        gain=float(np.min(at[at > 1.0], initial=math.inf)),
        phase_deg=float(np.min(lost, initial=math.inf)),
        crossover_hz=float(f[crossings[-1]]) if crossings.size else math.nan)
