"""A number with its unit and its 95 % interval."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from dfm_stage.arrays import Array

COVERAGE = 0.95
"""Of every interval."""
STEP = 1e-3
"""Of the differences by which an estimate is carried on: standard errors, and relative where
there is none."""
UNMOVED = 1e-12
"""Relative change below which a figure does not depend on a parameter that is not known."""


@dataclass(frozen=True)
class Quantity:
    """`value` in `unit` with the 95 % interval `ci95`; None means held, not estimated."""

    value: float
    unit: str
    ci95: tuple[float, float] | None = None

    @property
    def half_width(self) -> float:
        """Half the width of the interval, zero for a held value."""
        return 0.0 if self.ci95 is None else 0.5 * (self.ci95[1] - self.ci95[0])

    def covers(self, truth: float) -> bool:
        """Whether the interval contains `truth`."""
        return self.ci95 is not None and self.ci95[0] <= truth <= self.ci95[1]

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it; limits that are not finite become null."""
        limits = None if self.ci95 is None else [
            float(x) if math.isfinite(x) else None for x in self.ci95]
        return {"value": float(self.value), "unit": self.unit, "ci95": limits}


def interval(value: float, std: float, dof: float = math.inf) -> tuple[float, float]:
    """Return the two-sided 95 % Student-t interval of an estimate with standard error `std`."""
    if not math.isfinite(std):
        return -math.inf, math.inf
    half = t95(dof) * std
    return value - half, value + half


def t95(dof: float) -> float:
    """Return the 97.5 % quantile of Student's t with `dof` degrees of freedom."""
    level = 0.5 * (1.0 + COVERAGE)
    return float(stats.t.ppf(level, max(dof, 1.0)) if math.isfinite(dof)
                 else stats.norm.ppf(level))


def propagate(function: Callable[[Array], float], values: Array, covariance: Array,
              unit: str, dof: float = math.inf) -> Quantity:
    """Carry an estimate through a smooth function (the delta method).

    `values` (n,) and `covariance` (n, n) describe the estimate; the gradient comes from central
    differences at a thousandth of a standard error.
    """
    value = function(values)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not np.all(np.isfinite(std)):
        std = np.where(np.isfinite(std), std, 0.0)
        for j in np.flatnonzero(~np.isfinite(np.diag(covariance))):
            shifted = values.copy()
            shifted[j] *= 1.0 + STEP
            if not math.isclose(function(shifted), value, rel_tol=UNMOVED):
                return Quantity(value, unit, (-math.inf, math.inf))
        covariance = np.where(np.isfinite(covariance), covariance, 0.0)
    gradient = np.zeros(values.size)
    for j in np.flatnonzero(std > 0.0):
        step = STEP * std[j]
        up, down = values.copy(), values.copy()
        up[j] += step
        down[j] -= step
        gradient[j] = (function(up) - function(down)) / (2.0 * step)
    variance = float(gradient @ covariance @ gradient)
    return Quantity(value, unit, interval(value, math.sqrt(max(variance, 0.0)), dof))
