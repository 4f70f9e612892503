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
from numpy.typing import NDArray
from scipy.optimize import minimize

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.fitting import central_differences
from dfm_stage.identification.frequency_response import FrequencyResponse
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.quantity import Quantity, propagate

FEWEST_FREQUENCIES = 4
"""Two numbers each, for five coefficients: of three, one number would judge the fit."""
LOW = np.array([-10.0, 1e-3, 1e-2, 0.0, 0.0])
HIGH = np.array([10.0, 1e3, 1e2, 20.0, 20.0])
"""Bounds: numerator, damping and stiffness over their start, lag and delay in samples."""
MAX_DAMPING_RATIO = 0.999
"""The stage is underdamped; at 1 the two poles meet and the partial fractions have no value."""
ITERATIONS, TOLERANCE = 300, 1e-15
"""Of the search: it is cheap, and is to end at the minimum, not near it."""
AT_BOUND = 1e-9
"""Share of the range, or scaled constraint, within which a bound or constraint is active."""
STEP, SMALLEST = 1e-5, 1e-2
"""Relative step of the Jacobian, and the scaled coefficient below which it is absolute."""
SHORTEST_LAG = 1e-9
"""Lag (samples) that stands for none in the partial fractions."""
_NAMES = ("numerator", "damping", "stiffness", "lag", "delay")


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
    if measured.omega.size < FEWEST_FREQUENCIES:
        raise IdentificationError(f"{measured.omega.size} frequencies are too few for a transfer "
                                  "function: measure four or more")
    misfit = _Misfit(measured, static_gain)
    found = minimize(
        misfit.cost, misfit.start, jac=misfit.slope, method="SLSQP",
        bounds=list(zip(LOW, HIGH, strict=True)),
        constraints=[{"type": "ineq", "fun": each} for each in misfit.constraints.values()],
        options={"maxiter": ITERATIONS, "ftol": TOLERANCE})
    if not np.all(np.isfinite(found.x)) or not math.isfinite(misfit.cost(found.x)):
        raise IdentificationError(f"the constrained minimisation failed: {found.message}; measure "
                                  "closer to the resonance")
    v = np.clip(found.x, LOW, HIGH)
    at_bound = np.minimum(v - LOW, HIGH - v) < AT_BOUND * (HIGH - LOW)
    active = (*(name for name, each in zip(_NAMES, at_bound, strict=True) if each),
              *(name for name, each in misfit.constraints.items() if each(v) < AT_BOUND))
    return _result(v * misfit.scale, misfit.covariance(v, ~at_bound), measured.unit,
                   math.sqrt(misfit.cost(v)), active,
                   "converged" if found.success else found.message)


def _result(values: Array, covariance: Array, unit: str, misfit: float, active: tuple[str, ...],
            status: str) -> ConstrainedFit:
    def of(function: Callable[[Array], float], its_unit: str) -> Quantity:
        return propagate(function, values, covariance, its_unit)

    return ConstrainedFit(
        _plant(values), of(lambda x: float(x[0]), f"{unit}/s^2"), of(lambda x: float(x[1]), "1/s"),
        of(lambda x: float(x[2]), "1/s^2"), of(lambda x: float(x[3]), "s"),
        of(lambda x: float(x[4]), "s"), of(lambda x: math.sqrt(x[2]), "rad/s"),
        of(lambda x: float(x[1]) / (2.0 * math.sqrt(x[2])), ""),
        of(lambda x: float(x[0] / x[2]), unit), misfit, active, status)


class _Misfit:
    """The relative misfit of scaled coefficients v (5,), where it starts, what constrains it.

    Lag and delay are counted in samples, the rest in units of the start.
    """

    def __init__(self, measured: FrequencyResponse, static_gain: Quantity | None) -> None:
        start, period = _start(measured), measured.sample_period
        self.measured = measured
        self.scale = np.array([*np.abs(start[:3]), period, period])
        self.start = start / self.scale
        self.constraints: dict[str, Callable[[Array], float]] = {"underdamped": self._underdamped}
        if static_gain is not None:
            low, high = static_gain.ci95 or (static_gain.value, static_gain.value)
            unit, size = self.scale[0] / self.scale[2], abs(static_gain.value)
            self.constraints |= {
                "gain above": lambda v: float((v[0] / v[2] * unit - low) / size),
                "gain below": lambda v: float((high - v[0] / v[2] * unit) / size)}

    def relative(self, v: Array) -> Array:
        """Return H / G - 1, real and imaginary parts one after the other."""
        measured = self.measured
        error = _response(v * self.scale, measured.omega,
                          measured.sample_period) / measured.response - 1.0
        return np.concatenate((error.real, error.imag))

    def jacobian(self, v: Array) -> Array:
        """Return the Jacobian of `relative`; all but the numerator stay positive."""
        low = np.array([-np.inf, 0.0, 0.0, 0.0, 0.0])
        return central_differences(self.relative, v, STEP * np.maximum(np.abs(v), SMALLEST), low,
                                   np.full(v.size, np.inf))

    def cost(self, v: Array) -> float:
        """Return the mean squared misfit."""
        rest = self.relative(v)
        return float(rest @ rest) / self.measured.omega.size

    def slope(self, v: Array) -> Array:
        """Return the gradient of `cost`."""
        return np.asarray(2.0 / self.measured.omega.size * self.jacobian(v).T @ self.relative(v))

    def covariance(self, v: Array, free: NDArray[np.bool_]) -> Array:
        """Sandwich (White 1980): what noise, or the misfit where it is larger, does to v.

        In the units of the coefficients; zero for those that are not `free`.
        """
        part = self.jacobian(v)[:, free]
        noise = 0.5 * self.measured.variance / np.abs(self.measured.response) ** 2
        weight = np.maximum(np.concatenate((noise, noise)), self.relative(v)**2)
        inverse = np.linalg.pinv(part.T @ part)
        full = np.zeros((v.size, v.size))
        full[np.ix_(free, free)] = inverse @ (part.T * weight) @ part @ inverse
        return full * np.outer(self.scale, self.scale)

    def _underdamped(self, v: Array) -> float:
        c, k = (v * self.scale)[1:3]
        return float((4.0 * MAX_DAMPING_RATIO**2 * k - c * c) / self.scale[2])


def _response(x: Array, omega: Array, period: float) -> Complex:
    """Return what `LinearPlant.sampled_response` gives, by partial fractions instead of matrices.

    A pole p behind a hold and a delay of n samples and a fraction f gives
    z^-n (b0 + b1 / z) / (z - e^(pT)), b0 = (e^(p (T - f)) - 1) / p, b1 = e^(p (T - f))
    (e^(p f) - 1) / p.
    """
    b, c, k = (float(each) for each in x[:3])
    lag, delay = max(float(x[3]), SHORTEST_LAG * period), max(float(x[4]), 0.0)
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
