"""The linear part of a model, and what a controller sees of it once a sample.

    s' = a s + b u(t - delay) + g f,    y = c s

with command u (V or A), a force f (N) on the moving mass and position y (m). First and second
mode, damping, back-EMF, coil and amplifier lag are in it, nonlinear effects are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dfm_stage.control.errors import ControlError
from dfm_stage.model import BASE_PARAMETERS, EFFECTS, Model

Array = NDArray[np.float64]
_BASE_NAMES = {parameter.name for parameter in BASE_PARAMETERS}


@dataclass(frozen=True)
class Sampled:
    """x[k+1] = a x[k] + b u[k] + g f[k], y[k] = c x[k]; shapes (n, n), (n,), (n,), (n,).

    u in V or A, f in N, y in m. `g` is empty where no force was asked for. The last `delayed`
    states are inputs on their way, oldest first.
    """

    a: Array
    b: Array
    c: Array
    sample_period_s: float
    g: Array = field(default_factory=lambda: np.empty(0))
    delayed: int = 0

    def response(self, frequency_hz: Array) -> NDArray[np.complex128]:
        """Return y/u at frequencies of shape (F,), m/V, complex (F,)."""
        z = np.exp(2j * math.pi * np.asarray(frequency_hz) * self.sample_period_s)
        n = self.b.size - self.delayed
        arriving = z[:, None] ** -np.arange(self.delayed, 0, -1)
        driven = self.b[:n] + arriving @ self.a[:n, n:].T
        solved = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a[:n, :n],
                                 driven[:, :, None])
        return np.asarray(solved[:, :, 0] @ self.c[:n])


@dataclass(frozen=True)
class LinearStage:
    """a (n, n), b, g, c (n,) of the equation above, and the delay in s."""

    a: Array
    b: Array
    g: Array
    c: Array
    delay_s: float

    def sampled(self, sample_period_s: float) -> Sampled:
        """Return the stage sampled with zero-order holds on u and f.

        Position k is taken before input k acts. A delay that is no whole number of samples is
        exact too (Astrom and Wittenmark, Computer-Controlled Systems, sec. 2.3). The state is that
        of the stage, then the inputs on their way, oldest first.
        """
        h = sample_period_s
        delay = self.delay_s / h
        whole = math.floor(delay + 1e-9)
        late = delay - whole if delay - whole > 1e-9 else 0.0
        phi, new = _held(self.a, self.b, (1.0 - late) * h)
        phi_late, old = _held(self.a, self.b, late * h)
        n, m = self.b.size, whole + (1 if late else 0)
        a, b = np.zeros((n + m, n + m)), np.zeros(n + m)
        a[:n, :n] = phi @ phi_late
        if m == 0:
            b[:n] = new
        else:
            a[:n, n] = phi @ old if late else new
            if late and m > 1:
                a[:n, n + 1] = new
            elif late:
                b[:n] = new
            a[range(n, n + m - 1), range(n + 1, n + m)] = 1.0
            b[-1] = 1.0
        rest = np.zeros(m)
        return Sampled(a, b, np.concatenate((self.c, rest)), h,
                       np.concatenate((_held(self.a, self.g, h)[1], rest)), m)


def _held(a: Array, b: Array, seconds: float) -> tuple[Array, Array]:
    from scipy.linalg import expm
    n = b.size
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = a, b
    phi = expm(block * seconds)
    return phi[:n, :n], phi[:n, n]


def linear_stage(base: Mapping[str, float],
                 second_mode: Mapping[str, float] | None = None,
                 second_lag_s: float = 0.0) -> LinearStage:
    """Return the linear stage of a model's `base`, with the effect `second_mode` if given, and
    with a second lag of the amplifier behind that of `base`.

    Raises
    ------
    ControlError
        If mass or force_constant is missing or not above zero.
    """
    for name in ("mass", "force_constant"):
        if not base.get(name, 0.0) > 0.0:
            raise ControlError(f"the model's base needs {name} above zero to design on it")
    mass = base["mass"]
    share = second_mode["share"] if second_mode else 0.0
    a = np.array([[0.0, 1.0], [-base.get("stiffness", 0.0) / mass,
                               -base.get("damping", 0.0) / mass]])
    c, g = np.array([1.0 - share, 0.0]), np.array([0.0, 1.0 / mass])
    if second_mode:
        w = 2.0 * math.pi * second_mode["frequency"]
        other = np.array([[0.0, 1.0], [-w * w, -2.0 * second_mode["damping_ratio"] * w]])
        a = np.block([[a, np.zeros((2, 2))], [np.zeros((2, 2)), other]])
        c, g = np.concatenate((c, [share, 0.0])), np.tile(g, 2)
    b, emf = base["force_constant"] * g, base.get("back_emf", 0.0)
    velocity = np.concatenate(([0.0], c[:-1]))
    coil = base.get("coil_inductance", 0.0) / max(base.get("coil_resistance", 0.0), 1e-300)
    if coil > 0.0:
        a, b, g, c = _behind(a, b, g, c, coil)
        a[-1, :-1] -= emf * velocity / coil
    else:
        a = a - np.outer(b, emf * velocity)
    for lag_s in (base.get("amplifier_time_constant", 0.0), second_lag_s):
        if lag_s > 0.0:
            a, b, g, c = _behind(a, b, g, c, lag_s)
    return LinearStage(a, b, g, c, base.get("delay", 0.0))


def _behind(a: Array, b: Array, g: Array, c: Array,
            lag_s: float) -> tuple[Array, Array, Array, Array]:
    """Put a first-order lag before the input; its output is the new, last state."""
    n = b.size
    full = np.zeros((n + 1, n + 1))
    full[:n, :n], full[:n, n], full[n, n] = a, b, -1.0 / lag_s
    b = np.zeros(n + 1)
    b[n] = 1.0 / lag_s
    return full, b, np.append(g, 0.0), np.append(c, 0.0)


def sample_stage(base: Mapping[str, float], sample_period_s: float) -> Sampled:
    """Return the base model of a model.yaml, sampled with a zero-order hold.

    Raises
    ------
    ControlError
        If mass or force_constant is missing or not above zero.
    """
    return linear_stage(base).sampled(sample_period_s)


def sample_model(model: Model, sample_period_s: float | None = None) -> Sampled:
    """Return the linear part of a one-axis model, sampled; by default with its own period.

    Effects that are only more of a base parameter (a transport delay) are added to it, the lag of
    an amplifier bandwidth stands behind that of the base.

    Raises
    ------
    ControlError
        If mass or force_constant is not above zero, or the model has several axes.
    """
    if model.axes:
        raise ControlError(f"model {model.name} has the axes {', '.join(model.axes)}; design on "
                           "model.axis(name)")
    mode = model.effect("second_mode")
    return linear_stage(effective_base(model), mode.parameters if mode else None,
                        _bandwidth_lag_s(model)).sampled(sample_period_s or model.sample_period)


def effective_base(model: Model) -> dict[str, float]:
    """Return the base parameters of a one-axis model with the effects that only add to one."""
    base = dict(model.base)
    for use in model.effects:
        effect = EFFECTS[use.name]
        name = effect.adds_to
        if name in _BASE_NAMES:
            base[name] = base.get(name, 0.0) + use.parameters[effect.parameters[0].name]
    return base


def lags_s(model: Model) -> tuple[float, ...]:
    """Return the first-order lags between command and force: amplifier and coil, s."""
    base = effective_base(model)
    coil = base.get("coil_inductance", 0.0) / max(base.get("coil_resistance", 0.0), 1e-300)
    return base.get("amplifier_time_constant", 0.0), _bandwidth_lag_s(model), coil


def _bandwidth_lag_s(model: Model) -> float:
    lag = model.effect("amplifier_bandwidth")
    return lag.parameters["time_constant"] if lag else 0.0


def command_limit(model: Model, output_limit_v: float) -> float:
    """Return the largest command that has an effect: the limit, or the model's saturation."""
    found = model.effect("saturation")
    return min(output_limit_v, found.parameters["limit"]) if found else output_limit_v
