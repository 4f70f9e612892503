"""A linear quadratic regulator with a Kalman filter, designed on a model as it is sampled.

The regulator minimises the sum of (y / error_m)^2 + (y' / velocity_m_s)^2 + (u / effort_v)^2, with
integral action also of (z / integral_m_s)^2, where z is the integral of r - y (Franklin, Powell
and Workman, Digital Control of Dynamic Systems, 3rd ed., ch. 9). Amplifier lag, the inputs on
their way through the delay and a second mode are states like the others.

The paper's regulator (sec. 5) is u = L (x_ref - x): a spring then leaves an error, because u is
zero only where the error is. `feedforward` adds what holds the stage on a reference with constant
acceleration: x_ref = X w and u_ref = U w with w = (r, r', r'') solve

    X S = A X + B U,    c X = (1, 0, 0),    S = [[1, h, h^2/2], [0, 1, h], [0, 0, 1]]

(the regulator equations: Francis, SIAM J. Control Optim. 15(3), 1977).

The Kalman filter is the steady one of a sampled stage, with or without a force that drifts:

    x[k+1] = A x[k] + B u[k] + w[k],    y[k] = c x[k] + v[k]
    x^[k] = x-[k] + K (y[k] - c x-[k]),    x-[k+1] = A x^[k] + B u[k]

K is the limit of the filter's gain, P c' / (c P c' + r) with P from the algebraic Riccati
equation (Anderson and Moore, Optimal Filtering, 1979, ch. 4). On a linear time-invariant stage the
gain gets there within the first second and stays; with it fixed, a sample costs two products with
a matrix instead of a covariance update. `KalmanDesign.reference_filter` is filterpy's filter with
the same matrices, for comparison and for whoever wants the covariance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.law import Entry, checked
from dfm_stage.control.stage import (
    Margins,
    Sampled,
    StateSpace,
    closed_loop,
    frequency_grid,
    loop_margins,
    radius,
    sample_model,
)
from dfm_stage.model import Model
from dfm_stage.model.parameter import Option, Parameter

UNKNOWN_NOISE_M = 5e-8
LQR_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("lqr_error_m", 2.5e-4, "m", "position error that costs as much as lqr_effort_v",
              1e-12, 1e3),
    Parameter("lqr_velocity_m_s", 1e3, "m/s", "velocity that costs as much as lqr_effort_v",
              1e-12, 1e9),
    Parameter("lqr_integral_m_s", 2e-5, "m s",
              "integral of the error that costs as much as lqr_effort_v", 1e-15, 1e9),
    Parameter("lqr_effort_v", 1.0, "V", "output that costs as much as the others", 1e-9, 1e6),
    Parameter("lqr_force_noise_n", 0.03, "N", "white force the filter reckons with", 1e-12, 1e6),
    Parameter("lqr_drift_n", 1.0, "N/sqrt(s)",
              "wandering of the force that is estimated, with lqr_disturbance", 1e-12, 1e6),
)
LQR_SWITCHES = (
    Option("lqr_integral", True, "integral action on the tracking error"),
    Option("lqr_disturbance", False, "estimate a drifting force and take it off the output"),
    Option("lqr_feedforward", True, "add the model's own input for the reference; without it, it "
           "is the paper's regulator"),
)
SPEC_PARAMETERS: tuple[Entry, ...] = (*LQR_PARAMETERS, *LQR_SWITCHES)
_TABLE = {each.name: each for each in SPEC_PARAMETERS}
_DEFAULT: dict[str, Any] = {name: each.default for name, each in _TABLE.items()}


@dataclass(frozen=True)
class LqrSpec:
    """What an LQR is to weigh and to contain; names and units as in the tables above.

    `lqr_integral` adds integral action, `lqr_disturbance` the estimate of a wandering force,
    which is taken off the output, `lqr_feedforward` the model's own input for the reference.

    Raises
    ------
    ControlError
        If a value is not a finite number in its range; the message names it.
    """

    lqr_error_m: float = _DEFAULT["lqr_error_m"]
    lqr_velocity_m_s: float = _DEFAULT["lqr_velocity_m_s"]
    lqr_integral_m_s: float = _DEFAULT["lqr_integral_m_s"]
    lqr_effort_v: float = _DEFAULT["lqr_effort_v"]
    lqr_force_noise_n: float = _DEFAULT["lqr_force_noise_n"]
    lqr_drift_n: float = _DEFAULT["lqr_drift_n"]
    lqr_integral: bool = True
    lqr_disturbance: bool = False
    lqr_feedforward: bool = True

    def __post_init__(self) -> None:
        for name, value in checked(_TABLE.values(), vars(self), "lqr").items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> LqrSpec:
        """Return the part of a controller's parameters that is an LQR's."""
        return cls(**{name: value for name, value in values.items() if name in _TABLE})

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name."""
        return asdict(self)


@dataclass(frozen=True)
class KalmanDesign:
    """A (n, n), B, c, gain (n,), noise covariance Q (n, n) and r (m^2), covariance P (n, n).

    With a drifting force the last state is that force in N.
    """

    A: Array
    B: Array
    c: Array
    gain: Array
    Q: Array
    r: float
    P: Array
    drifting_force: bool

    def reference_filter(self) -> Any:
        """Return filterpy's KalmanFilter with these matrices, its covariance in the steady state.

        Its order of calls is update(y), then predict(u).
        """
        from filterpy.kalman import KalmanFilter

        n = self.B.size
        found = KalmanFilter(dim_x=n, dim_z=1, dim_u=1)
        found.F, found.B, found.H = self.A, self.B[:, None], self.c[None]
        found.Q, found.R, found.P = self.Q, np.array([[self.r]]), self.P.copy()
        found.x = np.zeros((n, 1))
        return found


def kalman(stage: Sampled, *, noise_m: float, force_n: float,
           drift_n_per_root_s: float = 0.0) -> KalmanDesign:
    """Return the steady filter of a stage.

    Parameters
    ----------
    stage : Sampled
        With the direction `g` of a force.
    noise_m : float
        RMS of the reading's noise; rounding to a count q adds q^2 / 12.
    force_n : float
        RMS of a white force, held over each sample: how far the model is trusted.
    drift_n_per_root_s : float
        Above zero: a force that wanders by this much in a second is estimated too.

    Raises
    ------
    ControlError
        If a number is not above zero (the drift: below), or the stage cannot be observed.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    for name, value in (("noise_m", noise_m), ("force_n", force_n)):
        if not (math.isfinite(value) and value > 0.0):
            raise ControlError(f"kalman: {name} must be a number above zero, not {value!r}")
    if not (math.isfinite(drift_n_per_root_s) and drift_n_per_root_s >= 0.0):
        raise ControlError("kalman: drift_n_per_root_s must not be below zero, "
                           f"not {drift_n_per_root_s!r}")
    a, b, c = stage.a, stage.b, stage.c
    q = force_n**2 * np.outer(stage.g, stage.g)
    if drift_n_per_root_s > 0.0:
        a = np.block([[a, stage.g[:, None]], [np.zeros((1, b.size)), np.ones((1, 1))]])
        b, c, q = np.append(b, 0.0), np.append(c, 0.0), np.pad(q, (0, 1))
        q[-1, -1] = drift_n_per_root_s**2 * stage.sample_period_s
    # In units of the reading's noise everything is of a size that the solver likes.
    try:
        p = solve_discrete_are(a.T, c[:, None], q / noise_m**2, np.eye(1)) * noise_m**2
    except (LinAlgError, ValueError) as error:
        raise ControlError(f"kalman: the stage's states cannot be told from its position "
                           f"({error})") from error
    r = noise_m**2
    return KalmanDesign(a, b, c, p @ c / (c @ p @ c + r), q, r, p, drift_n_per_root_s > 0.0)


def reading_noise_m(base: dict[str, float]) -> float:
    """Return the RMS of noise and rounding of a model's reading, at least 1 pm.

    A model that says nothing of either, as one identified from a bag may, is taken to have
    50 nm: no noise at all would make the filter believe every count.
    """
    if "noise" not in base and "encoder_resolution" not in base:
        return UNKNOWN_NOISE_M
    return math.sqrt(max(base.get("noise", 0.0)**2
                         + base.get("encoder_resolution", 0.0)**2 / 12.0, 1e-24))


@dataclass(frozen=True, eq=False)
class LqrDesign:
    """Everything that `Lqg` runs on, and the margins of the loop at the plant's input.

    `gain` (n,) acts on the filter's state, `integral_gain` on the integral (V/(m s), positive),
    `reference_gain` (3,) on position, velocity and acceleration of the reference; `shape` (n, 3)
    is the state on the reference. `start` (n,) is the state per metre in which an unknown past is
    assumed.
    """

    spec: LqrSpec
    stage: Sampled
    filter: KalmanDesign
    gain: Array
    integral_gain: float
    reference_gain: Array
    shape: Array
    start: Array
    margins: Margins
    model: Model | None = None

    @property
    def sample_period_s(self) -> float:
        """The sample period it was designed for, s."""
        return self.stage.sample_period_s

    def controller(self) -> StateSpace:
        """Return (A, b, c, d) of the law from y to u with the reference at zero.

        State: prediction of the filter (n,), then the integral of r - y if there is one.
        """
        f, h = self.filter, self.sample_period_s
        n = f.B.size
        keep = np.eye(n) - np.outer(f.gain, f.c)
        out, through = -self.gain @ keep, float(-self.gain @ f.gain)
        a, b = f.A @ keep + np.outer(f.B, out), f.A @ f.gain + f.B * through
        if not self.integral_gain:
            return a, b, out, through
        ki = self.integral_gain
        a = np.block([[a, f.B[:, None] * ki], [np.zeros((1, n)), np.ones((1, 1))]])
        return a, np.append(b, -h), np.append(out, ki), through

    def response(self, frequency_hz: Array) -> Complex:
        """Return the law from -y to u at frequencies (F,), V/m, complex (F,)."""
        a, b, c, d = self.controller()
        return -(Sampled(a, b, c, self.sample_period_s).response(frequency_hz) + d)

    def closed_loop(self, stage: Sampled) -> Array:
        """Return the matrix of another stage, or the same, under this controller."""
        return closed_loop(stage, self.controller())

    def margins_on(self, stage: Sampled) -> Margins:
        """Return the margins with another stage, or the same."""
        f = frequency_grid(stage)
        return loop_margins(f, stage.response(f) * self.response(f),
                            radius(self.closed_loop(stage)) < 1.0)

    def steady_error(self, stage: Sampled, reference_m: float, force_n: float = 0.0) -> float:
        """Return r - y of `stage` at rest on a constant reference under a constant force, m.

        Raises
        ------
        ControlError
            If the loop with this stage is not stable, and so never at rest.
        """
        full = self.closed_loop(stage)
        if radius(full) >= 1.0:
            raise ControlError("steady error: the loop is not stable with this stage")
        n, m = stage.b.size, self.filter.B.size
        push = np.zeros(len(full))
        u = float(self.reference_gain[0]) * reference_m
        push[:n] = stage.b * u + stage.g * force_n
        push[n:n + m] = self.filter.B * u
        if self.integral_gain:
            push[n + m] = self.sample_period_s * reference_m
        rest = np.linalg.solve(np.eye(len(full)) - full, push)
        return reference_m - float(stage.c @ rest[:n])


def design_lqr(model: Model, spec: LqrSpec | None = None,
               sample_period_s: float | None = None) -> LqrDesign:
    """Return the LQR with Kalman filter for a one-axis model, by default at its own rate.

    Raises
    ------
    ControlError
        If the model cannot be controlled or observed, or the loop that results is not stable.
    """
    from scipy.linalg import LinAlgError, solve_discrete_are

    spec = spec or LqrSpec()
    stage = sample_model(model, sample_period_s)
    a, b, c, h = stage.a, stage.b, stage.c, stage.sample_period_s
    n = b.size
    q = np.outer(c, c) / spec.lqr_error_m**2 + np.outer(stage.velocity, stage.velocity) / (
        spec.lqr_velocity_m_s**2)
    if spec.lqr_integral:
        a = np.block([[a, np.zeros((n, 1))], [-h * c[None], np.ones((1, 1))]])
        b, q = np.append(b, 0.0), np.pad(q, (0, 1))
        q[n, n] = 1.0 / spec.lqr_integral_m_s**2
    try:
        p = solve_discrete_are(a, b[:, None], q, [[1.0 / spec.lqr_effort_v**2]])
    except (LinAlgError, ValueError) as error:
        raise ControlError(f"lqr: no regulator for model {model.name}: {error}") from error
    full = b @ p @ a / (b @ p @ b + 1.0 / spec.lqr_effort_v**2)
    observer = kalman(stage, noise_m=reading_noise_m(dict(model.base)),
                      force_n=spec.lqr_force_noise_n,
                      drift_n_per_root_s=spec.lqr_drift_n if spec.lqr_disturbance else 0.0)
    gain = full[:n]
    shape, feed = on_reference(stage)
    start = shape[:, 0].copy()
    start[stage.motion:] = 0.0
    reference_gain = (gain @ shape + feed if spec.lqr_feedforward
                      else np.array([float(gain @ start), 0.0, 0.0]))
    if spec.lqr_disturbance:
        gain = np.append(gain, -_against_force(stage, gain))
        start = np.append(start, 0.0)
        shape = np.vstack((shape, np.zeros((1, 3))))
    design = LqrDesign(spec, stage, observer, gain, float(-full[n]) if spec.lqr_integral else 0.0,
                       reference_gain, shape, start,
                       Margins(False, math.nan, math.nan, math.nan, math.nan))
    found = design.margins_on(stage)
    if not found.stable:
        raise ControlError(f"lqr: the loop with model {model.name} is not stable; weigh the "
                           "effort more or the error less")
    return replace(design, margins=found, model=model)


def on_reference(stage: Sampled) -> tuple[Array, Array]:
    """Return X (n, 3) and U (3,): state and input on a reference, per (r, r', r'').

    Raises
    ------
    ControlError
        If the stage cannot be held on a reference (a zero at rest).
    """
    h, n = stage.sample_period_s, stage.b.size
    s = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
    size = 3 * n
    system, right = np.zeros((size + 3, size + 3)), np.zeros(size + 3)
    system[:size, :size] = np.kron(s.T, np.eye(n)) - np.kron(np.eye(3), stage.a)
    system[:size, size:] = -np.kron(np.eye(3), stage.b[:, None])
    system[size:, :size] = np.kron(np.eye(3), stage.c[None])
    right[size] = 1.0
    try:
        solved = np.linalg.solve(system, right)
    except np.linalg.LinAlgError as error:
        raise ControlError("the stage cannot be held on a reference: no constant input moves "
                           "it") from error
    return np.asarray(solved[:size].reshape(3, n).T), np.asarray(solved[size:])


def _against_force(stage: Sampled, gain: Array) -> float:
    """Return the output per newton of a constant force that keeps y where it is."""
    n = stage.b.size
    system = np.block([[np.eye(n) - stage.a, -stage.b[:, None]], [stage.c[None], 0.0]])
    solved = np.linalg.solve(system, np.append(stage.g, 0.0))
    return float(solved[n] + gain @ solved[:n])
