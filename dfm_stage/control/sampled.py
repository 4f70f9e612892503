"""A second-order stage behind amplifier lag and delay, sampled exactly, and its loop margins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sampled:
    """x[k+1] = a x[k] + b u[k], y[k] = c x[k]; shapes (n, n), (n,), (n,), units V and m."""

    a: Array
    b: Array
    c: Array
    sample_period_s: float

    def response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Return y/u at frequencies of shape (F,), m/V, complex (F,)."""
        z = np.exp(2j * math.pi * np.asarray(frequency_hz) * self.sample_period_s)
        eye = np.eye(self.b.size)
        solved = np.linalg.solve(z[:, None, None] * eye - self.a,
                                 np.broadcast_to(self.b[:, None], (z.size, self.b.size, 1)))
        return np.asarray(solved[:, :, 0] @ self.c)


def sample_stage(base: Mapping[str, float], sample_period_s: float) -> Sampled:
    """Return the base model of a model.yaml, sampled with a zero-order hold.

    Position k is taken before input k acts; input k is held for one period, delayed by
    `delay`, and passes a first-order lag `amplifier_time_constant`. A delay that is no whole
    number of samples is exact too (Astrom and Wittenmark, Computer-Controlled Systems, sec. 2.3).

    Raises
    ------
    ControlError
        If mass or force_constant is missing or not above zero.
    """
    for name in ("mass", "force_constant"):
        if not base.get(name, 0.0) > 0.0:
            raise ControlError(f"the model's base needs {name} above zero to design on it")
    mass, lag, h = base["mass"], base.get("amplifier_time_constant", 0.0), sample_period_s
    a = np.array([[0.0, 1.0], [-base.get("stiffness", 0.0) / mass,
                               -base.get("damping", 0.0) / mass]])
    b = np.array([0.0, base["force_constant"] / mass])
    if lag > 0.0:
        a = np.block([[a, b[:, None]], [np.zeros((1, 2)), np.full((1, 1), -1.0 / lag)]])
        b = np.array([0.0, 0.0, 1.0 / lag])
    delay = base.get("delay", 0.0) / h
    whole = math.floor(delay + 1e-9)
    late = max(0.0, delay - whole) * h
    phi, new = _held(a, b, h - late)
    phi_late, old = _held(a, b, late)
    a_d, old = phi @ phi_late, phi @ old
    n, m = b.size, whole + (1 if late > 1e-9 * h else 0)
    full = np.zeros((n + m, n + m))
    full[:n, :n] = a_d
    b_full = np.zeros(n + m)
    if m == 0:
        b_full[:n] = new
    else:
        # The state holds u[k-m] ... u[k-1], oldest first.
        full[:n, n] = old if late > 1e-9 * h else new
        if late > 1e-9 * h:
            if m > 1:
                full[:n, n + 1] = new
            else:
                b_full[:n] = new
        for i in range(m - 1):
            full[n + i, n + i + 1] = 1.0
        b_full[-1] = 1.0
    c = np.zeros(n + m)
    c[0] = 1.0
    return Sampled(full, b_full, c, h)


def _held(a: Array, b: Array, seconds: float) -> tuple[Array, Array]:
    from scipy.linalg import expm
    n = b.size
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = a, b
    phi = expm(block * seconds)
    return phi[:n, :n], phi[:n, n]


def closed_loop_poles(stage: Sampled, gains: PidGains) -> NDArray[np.complex128]:
    """Return the eigenvalues of stage and unlimited PID in the z-plane, shape (n + 3,)."""
    h, tf = stage.sample_period_s, gains.derivative_filter_s
    decay, per_dt, n = tf / (tf + h), 1.0 / (tf + h), stage.b.size
    # States: stage, integral, derivative d[k-1], y[k-1]; output u = -kp y + I + kd d[k].
    d_row = np.concatenate((-per_dt * stage.c, [0.0, decay, per_dt]))
    u_row = gains.kd * d_row + np.concatenate((-gains.kp * stage.c, [1.0, 0.0, 0.0]))
    full = np.zeros((n + 3, n + 3))
    full[:n, :n] = stage.a
    full[:n] += np.outer(stage.b, u_row)
    full[n, :n], full[n, n] = -gains.ki * h * stage.c, 1.0
    full[n + 1] = d_row
    full[n + 2, :n] = stage.c
    return np.asarray(np.linalg.eigvals(full), dtype=np.complex128)


def controller_response(gains: PidGains, frequency_hz: Array,
                        sample_period_s: float) -> NDArray[np.complex128]:
    """Return the law of `Pid` from -y to u at frequencies of shape (F,), V/m, complex (F,)."""
    h, tf = sample_period_s, gains.derivative_filter_s
    z = np.exp(2j * math.pi * np.asarray(frequency_hz) * h)
    return np.asarray(gains.kp + gains.ki * h / (z - 1.0)
                      + gains.kd * (z - 1.0) / ((tf + h) * z - tf))


@dataclass(frozen=True)
class Margins:
    """Distances of a loop from instability.

    `modulus` is the smallest distance of the loop's frequency response from -1 (the inverse of
    the largest sensitivity), `gain` the smallest factor by which the gain may grow, `phase_deg`
    the smallest phase that may be lost at a crossover, `crossover_hz` the highest frequency where
    the loop gain is one. Infinite or NaN where there is no such crossing.
    """

    stable: bool
    modulus: float
    gain: float
    phase_deg: float
    crossover_hz: float


def margins(stage: Sampled, gains: PidGains) -> Margins:
    """Return the margins of the sampled loop, from 5,000 frequencies up to half the rate."""
    nyquist = 0.5 / stage.sample_period_s
    f = np.geomspace(nyquist * 1e-5, nyquist, 5000)
    loop = stage.response(f) * controller_response(gains, f, stage.sample_period_s)
    size, angle = np.abs(loop), np.unwrap(np.angle(loop))
    crossings = np.flatnonzero((size[:-1] >= 1.0) != (size[1:] >= 1.0))
    turns = (angle + math.pi) / (2.0 * math.pi)
    through = np.flatnonzero(np.floor(turns[:-1]) != np.floor(turns[1:]))
    at = 1.0 / size[through]
    lost = np.degrees(np.abs((angle[crossings] + 2.0 * math.pi) % (2.0 * math.pi) - math.pi))
    return Margins(
        stable=bool(np.max(np.abs(closed_loop_poles(stage, gains))) < 1.0),
        modulus=float(np.min(np.abs(1.0 + loop))),
        gain=float(np.min(at[at > 1.0], initial=math.inf)),
        phase_deg=float(np.min(lost, initial=math.inf)),
        crossover_hz=float(f[crossings[-1]]) if crossings.size else math.nan)
