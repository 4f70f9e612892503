"""Covariance of the unknowns that are told, among many that are not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.identification.inference import uncertainty
from dfm_stage.identification.least_squares import Solution

SAMPLES, ALL, SIGMA = 6000, 12, 0.7


def solved(seed: int) -> tuple[SimpleNamespace, Solution]:
    """A linear fit of white noise, two runs: the criterion and its minimum."""
    rng = np.random.default_rng(seed)
    jacobian = rng.standard_normal((SAMPLES, ALL)) @ rng.standard_normal((ALL, ALL))
    noise = SIGMA * rng.standard_normal(SAMPLES)
    left = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
    runs = [SimpleNamespace(measured=[np.zeros(size)]) for size in (2000, 4000)]
    problem = SimpleNamespace(start=np.zeros(ALL), scale=np.ones(ALL), runs=runs)
    criterion = SimpleNamespace(problem=problem, polynomial=lambda *_: np.ones(1))
    return criterion, Solution(np.zeros(ALL), left, jacobian, float(left @ left), 1, True,
                               np.zeros(ALL, bool), "")


def test_of_white_noise_it_is_that_of_least_squares():
    found = [uncertainty(*solved(seed), np.arange(ALL)).covariance for seed in range(8)]
    expected = [SIGMA**2 * np.linalg.inv(solved(seed)[1].jacobian.T @ solved(seed)[1].jacobian)
                for seed in range(8)]
    ratios = [np.diag(a) / np.diag(b) for a, b in zip(found, expected, strict=True)]
    assert np.median(ratios) == pytest.approx(1.0, abs=0.05)


def test_of_some_unknowns_it_is_a_part_of_that_of_all():
    """A fit in windows has hundreds of states that nobody is told."""
    criterion, solution = solved(1)
    wanted = np.array([0, 3, 11])
    part = uncertainty(criterion, solution, wanted)
    whole = uncertainty(criterion, solution, np.arange(ALL))
    np.testing.assert_allclose(part.covariance, whole.covariance[np.ix_(wanted, wanted)],
                               rtol=1e-9, atol=0.0)
    assert part.dof == whole.dof
    assert part.lost.size == ALL
