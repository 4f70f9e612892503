"""The 95 % interval of an estimate, and of what follows from it."""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.quantity import Quantity

__all__ = ["Quantity", "interval", "propagate", "t95"]

COVERAGE = 0.95
"""Of every interval."""
SERIES_FROM = 300.0
"""Degrees of freedom from which a series in their reciprocal is good to 2e-13."""
STEP = 1e-3
"""Of the differences by which an estimate is carried on: standard errors, and relative where
there is none."""
UNMOVED = 1e-12
"""Relative change below which a figure does not depend on a parameter that is not known."""


def interval(value: float, std: float, dof: float = math.inf) -> tuple[float, float]:
    """Return the two-sided 95 % Student-t interval of an estimate with standard error `std`."""
    if not math.isfinite(std):
        return -math.inf, math.inf
    half = t95(dof) * std
    return value - half, value + half


def t95(dof: float) -> float:
    """Return the 97.5 % quantile of Student's t with `dof` degrees of freedom."""
    level = 0.5 * (1.0 + COVERAGE)
    z = NormalDist().inv_cdf(level)
    if dof < SERIES_FROM:
        from scipy.special import stdtrit  # slow to import, and long records need none

        return float(stdtrit(max(dof, 1.0), level))
    # Fisher and Cornish (1960): Abramowitz and Stegun, 26.7.5
    terms = ((1, 1, 0, 0, 0), (3, 16, 5, 0, 0), (-15, 17, 19, 3, 0),
             (-945, -1920, 1482, 776, 79))
    return z + sum(
        sum(factor * z ** (2 * k + 1) for k, factor in enumerate(term)) / scale / dof**power
        for power, (scale, term) in enumerate(zip((4, 96, 384, 92160), terms, strict=True), 1))


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
