"""Quantiles and draws behind intervals, against SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from dfm_stage.identification.coordinates import DRAWS, _normal_draws
from dfm_stage.identification.quantity import SERIES_FROM, t95


@pytest.mark.parametrize("dof", [1.0, 2.5, 30.0, SERIES_FROM - 1.0, SERIES_FROM, 1e4, 1e12])
def test_the_quantile_is_that_of_student_s_t(dof: float) -> None:
    assert t95(dof) == pytest.approx(stats.t.ppf(0.975, dof), rel=3e-13)


def test_without_limit_it_is_that_of_the_normal_distribution() -> None:
    assert t95(math.inf) == pytest.approx(stats.norm.ppf(0.975), rel=1e-14)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_draws_are_normal_and_independent(dimensions: int) -> None:
    draws = _normal_draws(dimensions)
    assert draws.shape == (DRAWS, dimensions)
    np.testing.assert_allclose(np.cov(draws.T), np.eye(dimensions), atol=0.005)
    for column in draws.T:      # far nearer than random draws, of which 1 % reach 0.008 or less
        assert stats.kstest(column, "norm").statistic < 0.0005
    chi = np.sum(draws**2, axis=1)
    assert np.mean(chi < stats.chi2.ppf(0.95, dimensions)) == pytest.approx(0.95, abs=0.003)
