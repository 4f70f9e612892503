"""Levenberg-Marquardt against SciPy's, with bounds, and where a direction is lost."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from dfm_stage.identification.least_squares import minimise

T = np.linspace(0.0, 4.0, 200)


def decay(x):
    return x[0] * np.exp(-x[1] * T) * np.cos(x[2] * T)


DATA = decay([2.0, 0.7, 3.0]) + 0.05 * np.random.default_rng(1).standard_normal(T.size)
INF = np.full(3, np.inf)


def fit(residual, start, low=-INF, high=INF, scale=None, **options):
    def jacobian(x, r):
        h = 1e-7 * np.maximum(np.abs(x), 1e-9)
        return np.array([(residual(x + d) - residual(x - d)) / (2 * d.sum())
                         for d in np.diag(h)]).T

    start = np.array(start, dtype=float)
    scale = np.abs(start) + 1e-12 if scale is None else scale
    return minimise(residual, jacobian, start, scale, np.asarray(low, float),
                    np.asarray(high, float), **options)


def test_agrees_with_scipy():
    found = fit(lambda x: decay(x) - DATA, [1.0, 0.2, 2.6])
    theirs = least_squares(lambda x: decay(x) - DATA, [1.0, 0.2, 2.6], xtol=1e-14)
    assert found.converged
    np.testing.assert_allclose(found.x, theirs.x, rtol=1e-4)
    assert found.cost == pytest.approx(2 * theirs.cost, rel=1e-6)


def test_agrees_with_scipy_on_a_bound():
    low, high = [0, 0.9, 0], [10, 5, 10]
    found = fit(lambda x: decay(x) - DATA, [1.0, 1.2, 2.6], low, high)
    theirs = least_squares(lambda x: decay(x) - DATA, [1.0, 1.2, 2.6], bounds=(low, high),
                           xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert found.converged
    assert list(found.at_bound) == [False, True, False]
    np.testing.assert_allclose(found.x, theirs.x, rtol=2e-4)


def test_scales_of_fifteen_decades_live_together():
    scale = np.array([1e-9, 1e6, 1e-3])

    def residual(x):
        return (decay(x / scale * [1, 1, 1]) - DATA) * 1e-9

    found = fit(residual, np.array([1.0, 0.2, 2.6]) * scale)
    plain = fit(lambda x: decay(x) - DATA, [1.0, 0.2, 2.6])
    np.testing.assert_allclose(found.x / scale, plain.x, rtol=1e-4)


def test_a_direction_that_does_not_matter_stays_where_it_started():
    found = fit(lambda x: decay([x[0] * x[1], 0.7, 3.0]) - DATA, [1.0, 1.0, 5.0])
    assert found.converged
    assert found.x[0] * found.x[1] == pytest.approx(2.0, rel=0.02)
    assert found.x[0] == pytest.approx(found.x[1], rel=1e-3)
    assert found.x[2] == 5.0


def test_a_start_that_cannot_be_simulated_is_told():
    found = fit(lambda x: np.full(T.size, np.nan), [1.0, 1.0, 1.0])
    assert not found.converged
    assert "start" in found.reason


def test_steps_into_what_cannot_be_simulated_are_taken_back():
    def residual(x):
        return np.full(T.size, np.nan) if x[1] < 0.5 else decay(x) - DATA

    found = fit(residual, [1.0, 2.5, 2.6])
    assert found.converged
    assert found.x[1] == pytest.approx(0.7, abs=0.05)


def test_iterations_used_up_is_told():
    found = fit(lambda x: decay(x) - DATA, [1.0, 0.2, 2.0], max_iterations=1)
    assert not found.converged
    assert "iterations" in found.reason


@pytest.mark.parametrize(("left", "ends"), [(30.0, "converged slowly"), (0.9, "converged")])
def test_a_search_that_creeps_ends_where_much_more_than_noise_is_left(left, ends):
    missed = np.full(5000, left)

    def residual(x):  # a curved valley (Rosenbrock 1960) beside what no step changes
        return np.concatenate((missed, [1e4 * (x[1] - x[0] ** 2), 30.0 * (1.0 - x[0])]))

    def slopes(x, _):
        return np.vstack((np.zeros((missed.size, 2)), [-2e4 * x[0], 1e4], [-30.0, 0.0]))

    wide = 10.0 * np.ones(2)
    found = minimise(residual, slopes, [-1.0, 1.0], 0.1 * wide, -wide, wide, max_iterations=900,
                     tolerance=1e-6, least_share=1e-3)
    assert found.reason == ends
