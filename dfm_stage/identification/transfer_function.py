"""Fitting the physical transfer function to a measured frequency response.

Maximum likelihood for circular noise of known variance per line: the weighted squares of
(H(omega; theta) - G) / sigma are minimised (Pintelon and Schoukens, System Identification, 2nd
ed., ch. 9), H being the exact sampled response of modes behind hold, lag and delay.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.fitting import central_differences
from dfm_stage.identification.frequency_response import FrequencyResponse
from dfm_stage.identification.least_squares import minimise
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.quantity import Quantity, propagate

DAMPING_RATIOS = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)
LATENESS = (0.0, 1.0, 3.0)
"""Damping ratios and delays (samples) from which the search for a mode starts."""
GRID = 120
"""Frequencies of a mode from which the search starts, besides those that were measured."""
EQUAL_SHARE = 0.05
"""Share of the response added to the noise in the search for a start: no line rules it alone."""
LATEST = 1000.0
"""Bound of lag and of delay, samples."""
STEP, SMALLEST_STEP = 1e-5, 1e-3
"""Step of the Jacobian over a coefficient, and the least of that over its scale."""
SMALLEST_SCALE = 1e-6
"""Scale (SI) of a coefficient that starts at zero."""
FEWEST_FREE = 2
"""Numbers that must be left over of the coefficients, to judge the misfit by."""
LEVEL = 0.999
"""Quantile of chi-square over which a misfit is more than noise, and widens the intervals."""
SURE = 1e-6
"""Share of the response that no line is taken to be better known than: rounding of a record."""
RANK = 1e-12
"""Over the largest: singular values and columns below it are rounding."""


@dataclass(frozen=True)
class TransferFunctionFit:
    """A fitted plant: `values` (p,) named `names`, with `covariance` (p, p).

    `misfit` is the reduced chi-square: 1 where the model explains the response to its noise.
    """

    plant: LinearPlant
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    dof: float
    misfit: float
    status: str
    message: str
    unit: str
    _build: Callable[[Array], LinearPlant]

    @property
    def ok(self) -> bool:
        """Whether the search converged."""
        return self.status == "converged"

    def quantity(self, name: str) -> Quantity:
        """Return one coefficient with its interval."""
        j = self.names.index(name)
        return propagate(lambda x: float(x[j]), self.values, self.covariance, self.units[j],
                         self.dof)

    def natural_frequency_hz(self, mode: int = 0) -> Quantity:
        """Return the undamped natural frequency of a mode in Hz."""
        return self._derived(lambda plant: plant.modes[mode].natural_frequency_hz, "Hz")

    def damping_ratio(self, mode: int = 0) -> Quantity:
        """Return the damping ratio of a mode."""
        return self._derived(lambda plant: plant.modes[mode].damping_ratio, "")

    def static_gain(self) -> Quantity:
        """Return output per constant input; infinite for a free body."""
        return self._derived(lambda plant: plant.static_gain, self.unit)

    def _derived(self, function: Callable[[LinearPlant], float], unit: str) -> Quantity:
        if not math.isfinite(function(self.plant)):
            return Quantity(math.inf, unit, None)
        return propagate(lambda x: function(self._build(x)), self.values, self.covariance,
                         unit, self.dof)

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"parameters": {n: self.quantity(n).to_dict() for n in self.names},
                "misfit": float(self.misfit), "status": self.status, "message": self.message}


def fit_transfer_function(measured: FrequencyResponse, *, modes: int = 1,
                          free_body: bool = False, lag: bool = True, delay: bool = True,
                          max_iterations: int = 60) -> TransferFunctionFit:
    """Fit `modes` modes, the first without a spring if `free_body`, behind `lag` and `delay`.

    Raises
    ------
    IdentificationError
        If there are fewer lines than the coefficients need.
    """
    shape = _Shape(modes, free_body, lag, delay, measured)
    sigma = _sigma(measured)
    if 2 * measured.omega.size < len(shape.names) + FEWEST_FREE:
        raise IdentificationError(f"{measured.omega.size} lines are too few for "
                                  f"{len(shape.names)} coefficients: excite more lines or fit "
                                  "fewer modes")

    def residual(x: Array) -> Array:
        error: Complex = (shape.plant(x).sampled_response(measured.omega, measured.sample_period)
                 - measured.response) / sigma * math.sqrt(2.0)
        return np.asarray(np.concatenate((error.real, error.imag)))

    start = shape.start(sigma)
    scale = shape.scale(start)
    low, high = shape.limits()

    def jacobian(x: Array, _: Array) -> Array:
        step = STEP * np.maximum(np.abs(x), SMALLEST_STEP * scale)
        return central_differences(residual, x, step, low, high)

    solution = minimise(residual, jacobian, start, scale, low, high,
                        max_iterations=max_iterations)
    from scipy.special import chdtri

    freedom = solution.residual.size - len(shape.names)
    misfit = solution.cost / max(freedom, 1)
    excess = misfit if misfit > chdtri(freedom, 1.0 - LEVEL) / freedom else 1.0
    covariance = _covariance(solution.jacobian) * excess
    status = "converged" if solution.converged else "not_converged"
    message = solution.reason
    if solution.converged and excess > 1.0:
        message = (f"the model misses the response by {math.sqrt(misfit):.1f} times its noise: "
                   "intervals are widened by that; a mode or a nonlinearity is missing")
    return TransferFunctionFit(
        shape.plant(solution.x), shape.names, shape.units, solution.x, covariance,
        measured.dof * measured.omega.size, misfit, status, message, measured.unit, shape.plant)


def _covariance(jacobian: Array) -> Array:
    """Return (J^T J)^-1 (p, p), infinite for coefficients that do not matter."""
    norms = np.linalg.norm(jacobian, axis=0)
    seen = norms > RANK * np.max(norms)
    scaled = jacobian[:, seen] / norms[seen]
    covariance = np.zeros((norms.size, norms.size))
    covariance[np.ix_(seen, seen)] = np.linalg.pinv(scaled.T @ scaled, rcond=RANK) / np.outer(
        norms[seen], norms[seen])
    covariance[~seen, ~seen] = np.inf
    return covariance


def _sigma(measured: FrequencyResponse) -> Array:
    """Return the standard error per line, never below `SURE` of the response."""
    return np.maximum(np.sqrt(measured.variance), SURE * np.abs(measured.response))


class _Shape:
    """How the vector of coefficients is laid out."""

    def __init__(self, modes: int, free_body: bool, lag: bool, delay: bool,
                 measured: FrequencyResponse) -> None:
        self.free_body, self.lag, self.delay = free_body, lag, delay
        self.measured = measured
        self.marks = [f"_{i + 1}" for i in range(modes)] if modes > 1 else [""]
        units = {"numerator": f"{measured.unit}/s^2", "damping": "1/s", "stiffness": "1/s^2"}
        layout = {f"{name}{mark}": unit for mark in self.marks for name, unit in units.items()}
        if free_body:
            del layout[f"stiffness{self.marks[0]}"]
        layout |= {"lag": "s"} if lag else {}
        layout |= {"delay": "s"} if delay else {}
        self.names, self.units = tuple(layout), tuple(layout.values())
        self.late = np.array([name in ("lag", "delay") for name in self.names])

    def plant(self, x: Array) -> LinearPlant:
        v = dict(zip(self.names, x.tolist(), strict=True))
        return LinearPlant(
            tuple(Mode(v[f"numerator{mark}"], v[f"damping{mark}"], v.get(f"stiffness{mark}", 0.0))
                  for mark in self.marks),
            max(v.get("lag", 0.0), 0.0), max(v.get("delay", 0.0), 0.0))

    def vector(self, plant: LinearPlant) -> Array:
        values = {"lag": plant.lag, "delay": plant.delay}
        for mark, mode in zip(self.marks, plant.modes, strict=True):
            values |= {f"{name}{mark}": value for name, value in vars(mode).items()}
        return np.array([values[name] for name in self.names])

    def scale(self, start: Array) -> Array:
        return np.maximum(np.abs(start), np.where(self.late, self.measured.sample_period,
                                                  SMALLEST_SCALE))

    def limits(self) -> tuple[Array, Array]:
        low = np.array([-np.inf if n.startswith("numerator") else 0.0 for n in self.names])
        return low, np.where(self.late, LATEST * self.measured.sample_period, np.inf)

    def start(self, sigma: Array) -> Array:
        """Search a grid of poles, one mode after the other; numerators follow linearly."""
        omega, response = self.measured.omega, self.measured.response
        period = self.measured.sample_period
        weight = 1.0 / (sigma + EQUAL_SHARE * np.abs(response))
        s = 1j * omega
        hold = -np.expm1(-s * period) / (s * period)
        grid = np.unique(np.concatenate((np.geomspace(0.5 * omega[0], 1.2 * omega[-1], GRID),
                                         omega)))
        sprung = np.array([(2.0 * z * w, w * w) for w in grid for z in DAMPING_RATIOS])
        free = np.array([(c, 0.0) for c in (0.0, *grid / 10.0)])
        late_by = LATENESS if self.lag or self.delay else (0.0,)
        found: list[tuple[float, float]] = []
        late = 0.0
        for i in range(len(self.marks)):
            pairs = free if self.free_body and i == 0 else sprung
            best = math.inf
            for lateness in late_by:
                shift = hold * np.exp(-s * lateness * period) * weight
                fixed = np.array([shift / (s * s + c * s + k) for c, k in found])
                trial = shift / (s * s + pairs[:, :1] * s + pairs[:, 1:])
                costs = _costs(fixed.reshape(-1, s.size), trial, response * weight)
                at = int(np.argmin(costs))
                if costs[at] < best:
                    best, late = float(costs[at]), lateness * period
                    pair = (float(pairs[at, 0]), float(pairs[at, 1]))
            found.append(pair)
        shift = hold * np.exp(-s * late)
        basis = np.array([shift * weight / (s * s + c * s + k) for c, k in found], dtype=complex)
        numerators = _solve(basis[None], response * weight)[0]
        modes = tuple(Mode(float(b), c, k)
                      for b, (c, k) in zip(numerators, found, strict=True))
        both = self.lag and self.delay
        return self.vector(LinearPlant(modes, 0.5 * late if both else late * self.lag,
                                       0.5 * late if both else late * self.delay))


def _costs(fixed: Complex, trial: Complex, target: Complex) -> Array:
    """Return the cost (G,) of the best real sum of `fixed` (m, F) and each row of `trial` (G, F).
    """
    basis = np.concatenate((np.broadcast_to(fixed, (len(trial), *fixed.shape)),
                            trial[:, None, :]), axis=1)
    sums = np.einsum("gm,gmf->gf", _solve(basis, target), basis)
    return np.asarray(np.sum(np.abs(target - sums) ** 2, axis=1))


def _solve(basis: Complex, target: Complex) -> Array:
    """Return the real coefficients (G, m) of the least-squares sum of `basis` (G, m, F)."""
    gram = np.einsum("gif,gjf->gij", basis.conj(), basis).real
    right = np.einsum("gif,f->gi", basis.conj(), target).real
    norm = np.sqrt(np.maximum(np.einsum("gii->gi", gram), 1e-300))
    scaled = gram / (norm[:, :, None] * norm[:, None, :]) + 1e-9 * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(scaled, (right / norm)[:, :, None])[:, :, 0] / norm)
