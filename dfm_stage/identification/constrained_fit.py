"""The transfer function by constrained minimisation of the response misfit, as the paper has it.

Sought are numerator, damping and stiffness of b / (s^2 + c s + k), and lag and delay before it,
that minimise the mean squared relative misfit |H / G - 1|^2 over the measured frequencies, under
bounds and the constraints that the stage is underdamped and, where a static test measured it, has
that static gain. Every frequency counts alike; `fit_transfer_function` weights by noise instead,
and the two check each other.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.frequency_response import FrequencyResponse
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.quantity import Quantity, propagate

LATEST = 20.0
"""Bound of lag and of delay, samples."""
_MAX_DAMPING_RATIO = 0.999


@dataclass(frozen=True)
class ConstrainedFit:
    """b / (s^2 + c s + k) behind lag and delay.

    `misfit` is the RMS of |H / G - 1|; `active` names the constraints the solution leans on.
    """

    plant: LinearPlant
    numerator: Quantity
    damping: Quantity
    stiffness: Quantity
    lag: Quantity
    delay: Quantity
    natural_frequency: Quantity
    damping_ratio: Quantity
    static_gain: Quantity
    misfit: float
    active: tuple[str, ...]
    status: str

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        names = ("numerator", "damping", "stiffness", "lag", "delay", "natural_frequency",
                 "damping_ratio", "static_gain")
        return {**{name: getattr(self, name).to_dict() for name in names}, "misfit": self.misfit,
                "active": list(self.active), "status": self.status}


def fit_constrained(measured: FrequencyResponse, *,
                    static_gain: Quantity | None = None) -> ConstrainedFit:
    """Fit one mode to `measured`; `static_gain` (with interval) becomes a constraint.

    Raises
    ------
    IdentificationError
        If there are fewer than four frequencies or the minimisation fails.
    """
    if measured.omega.size < 4:
        raise IdentificationError(f"{measured.omega.size} frequencies are too few for a transfer "
                                  "function: measure four or more")
    start = _start(measured)
    period = measured.sample_period
    # Lag and delay are counted in samples, the rest in units of the start.
    scale = np.array([*np.abs(start[:3]), period, period])
    low = np.array([-10.0, 1e-3, 1e-2, 0.0, 0.0])
    high = np.array([10.0, 1e3, 1e2, LATEST, LATEST])
    target = measured.response

    def relative(v: Array) -> Array:
        error = _response(v * scale, measured.omega, period) / target - 1.0
        return np.concatenate((error.real, error.imag))

    def cost(v: Array) -> float:
        rest = relative(v)
        return float(rest @ rest) / measured.omega.size

    def slope(v: Array) -> Array:
        return np.asarray(2.0 / measured.omega.size * _jacobian(relative, v).T @ relative(v))

    def underdamped(v: Array) -> float:
        c, k = (v * scale)[1:3]
        return float((4.0 * _MAX_DAMPING_RATIO**2 * k - c * c) / scale[2])

    constraints: list[dict[str, Any]] = [{"type": "ineq", "fun": underdamped}]
    if static_gain is not None:
        low_gain, high_gain = static_gain.ci95 or (static_gain.value, static_gain.value)
        unit = scale[0] / scale[2]

        def above(v: Array) -> float:
            return float((v[0] / v[2] * unit - low_gain) / abs(static_gain.value))

        def below(v: Array) -> float:
            return float((high_gain - v[0] / v[2] * unit) / abs(static_gain.value))

        constraints += [{"type": "ineq", "fun": above}, {"type": "ineq", "fun": below}]
    found = minimize(cost, start / scale, jac=slope, method="SLSQP",
                     bounds=list(zip(low, high, strict=True)), constraints=constraints,
                     options={"maxiter": 300, "ftol": 1e-15})
    if not np.all(np.isfinite(found.x)) or not math.isfinite(cost(found.x)):
        raise IdentificationError(f"the constrained minimisation failed: {found.message}; measure "
                                  "closer to the resonance")
    v = np.clip(found.x, low, high)
    names = ("numerator", "damping", "stiffness", "lag", "delay")
    active = [n for n, x, a, b in zip(names, v, low, high, strict=True)
              if x - a < 1e-9 * (b - a) or b - x < 1e-9 * (b - a)]
    blocked = [names.index(n) for n in active]
    tight = [label for label, each in zip(("underdamped", "gain above", "gain below"),
                                          constraints, strict=False)
             if each["fun"](v) < 1e-9]
    covariance = (_covariance(_jacobian(relative, v), relative(v), measured, blocked)
                  * np.outer(scale, scale))
    values = v * scale
    unit_b = f"{measured.unit}/s^2"

    def part(index: int, unit: str) -> Quantity:
        return propagate(lambda x: float(x[index]), values, covariance, unit)

    return ConstrainedFit(
        _plant(values), part(0, unit_b), part(1, "1/s"), part(2, "1/s^2"), part(3, "s"),
        part(4, "s"), propagate(lambda x: math.sqrt(x[2]), values, covariance, "rad/s"),
        propagate(lambda x: float(x[1]) / (2.0 * math.sqrt(x[2])), values, covariance, ""),
        propagate(lambda x: float(x[0] / x[2]), values, covariance, measured.unit),
        math.sqrt(cost(v)), (*active, *tight), "converged" if found.success else found.message)


def _response(x: Array, omega: Array, period: float) -> Complex:
    """Return what `LinearPlant.sampled_response` gives, by partial fractions instead of matrices.

    A pole p behind a hold and a delay of n samples and a fraction f gives
    z^-n (b0 + b1 / z) / (z - e^(pT)), b0 = (e^(p (T - f)) - 1) / p, b1 = e^(p (T - f))
    (e^(p f) - 1) / p.
    """
    b, c, k = (float(each) for each in x[:3])
    lag, delay = max(float(x[3]), 1e-9 * period), max(float(x[4]), 0.0)
    root = cmath.sqrt(0.25 * c * c - k)
    poles = (-0.5 * c + root, -0.5 * c - root, complex(-1.0 / lag))
    whole = math.floor(delay / period)
    late = delay - whole * period
    z = np.exp(1j * omega * period)
    total = np.zeros(omega.size, dtype=np.complex128)
    for i, p in enumerate(poles):
        others = [q for j, q in enumerate(poles) if j != i]
        residue = b / lag / ((p - others[0]) * (p - others[1]))
        ahead = cmath.exp(p * (period - late))
        first, second = (ahead - 1.0) / p, ahead * (cmath.exp(p * late) - 1.0) / p
        total += residue * (first + second / z) / (z - cmath.exp(p * period))
    return np.asarray(total * z ** (-whole))


def _plant(x: Array) -> LinearPlant:
    return LinearPlant((Mode(float(x[0]), float(x[1]), float(x[2])),), max(float(x[3]), 0.0),
                       max(float(x[4]), 0.0))


def _start(measured: FrequencyResponse) -> Array:
    """From the peak and the lowest frequency: w, gain, and the damping that makes that peak."""
    size = np.abs(measured.response)
    at = int(np.argmax(size))
    omega = float(measured.omega[at])
    low = float(measured.omega[0])
    gain = float(size[0]) * abs(1.0 - (low / omega)**2) if low < omega else float(size[0])
    sign = 1.0 if measured.response[0].real >= 0.0 or low >= omega else -1.0
    ratio = float(np.clip(gain / (2.0 * size[at]), 1e-3, 0.7))
    half = 0.5 * measured.sample_period
    return np.array([sign * gain * omega**2, 2.0 * ratio * omega, omega**2, half, half])


def _jacobian(residual: Callable[[Array], Array], v: Array) -> Array:
    columns = []
    for j in range(v.size):
        step = 1e-5 * max(abs(v[j]), 1e-2)
        up, down = v.copy(), v.copy()
        up[j] += step
        down[j] = max(v[j] - step, 0.0) if j > 0 else v[j] - step
        columns.append((residual(up) - residual(down)) / (up[j] - down[j]))
    return np.asarray(np.array(columns).T)


def _covariance(jacobian: Array, rest: Array, measured: FrequencyResponse,
                blocked: list[int]) -> Array:
    """Sandwich (White 1980): what noise, or the misfit where it is larger, does to the result."""
    free = [j for j in range(jacobian.shape[1]) if j not in blocked]
    part = jacobian[:, free]
    noise = 0.5 * measured.variance / np.abs(measured.response) ** 2
    weight = np.maximum(np.concatenate((noise, noise)), rest**2)
    inverse = np.linalg.pinv(part.T @ part)
    inner = inverse @ (part.T * weight) @ part @ inverse
    full = np.zeros((jacobian.shape[1], jacobian.shape[1]))
    full[np.ix_(free, free)] = inner
    return full
