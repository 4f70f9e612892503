"""Small estimators that several analyses share."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dfm_stage.arrays import Array

TOP_DEGREE = 4
"""Degree of the polynomial through an extreme: a swing's own curve, and how it dies away."""
REAL_ROOT = 1e-9
"""Imaginary part (of half a window) up to which a root of the slope counts as real."""


def noise_level(signal: Array) -> float:
    """Return the standard deviation of white noise in a smooth signal, by second differences.

    Their variance is 1 + 4 + 1 = 6 times that of the noise.
    """
    return float(np.std(np.diff(signal, 2))) / math.sqrt(6.0)


def fit_line(x: Array, y: Array, weight: Array | None = None) -> tuple[Array, Array, Array]:
    """Fit y = slope x + offset by (weighted) least squares.

    Returns slope and offset (2,), what is left over, weighted (N,), and the inverse of the normal
    matrix (2, 2), by which the variance of the rest becomes that of slope and offset.
    """
    w = np.ones_like(y) if weight is None else weight
    design = np.column_stack((x, np.ones(len(x)))) * w[:, None]
    line, *_ = np.linalg.lstsq(design, y * w, rcond=None)
    return (np.asarray(line), np.asarray(y * w - design @ line),
            np.asarray(np.linalg.inv(design.T @ design)))


def turning_point(values: Array, at: int, reach: int) -> tuple[float, float]:
    """Return place (samples, with its fraction) and height of the extreme near sample `at`.

    It is that of a quartic through `reach` samples on either side.
    """
    u = np.arange(-reach, reach + 1) / reach
    fit = np.polynomial.Polynomial.fit(u, values[at - reach:at + reach + 1], TOP_DEGREE,
                                       domain=[-1, 1], window=[-1, 1])
    roots = fit.deriv().roots()
    real = roots.real[(np.abs(roots.imag) < REAL_ROOT) & (np.abs(roots.real) <= 1.0)]
    top = float(real[np.argmin(np.abs(real))]) if real.size else 0.0
    return at + top * reach, float(fit(top))


def central_differences(function: Callable[[Array], Array], x: Array, step: Array,
                        low: Array, high: Array) -> Array:
    """Return the Jacobian (N, p) of `function` at `x` (p,), its steps kept within the limits."""
    columns = []
    for j, (below, above) in enumerate(zip(np.maximum(x - step, low), np.minimum(x + step, high),
                                           strict=True)):
        up, down = x.copy(), x.copy()
        up[j], down[j] = above, below
        columns.append((function(up) - function(down)) / (above - below))
    return np.asarray(np.array(columns).T)
