"""Regression by blocks against the plain way of doing the same."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.diagnosis.blocks import Blocks, block_edges, jackknife, log_ratio


@pytest.fixture
def data():
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((600, 3)) * (1.0, 1e-3, 1e2)
    target = columns @ (2.0, 3e3, -1e-2) + 0.3 * rng.standard_normal(600)
    return columns, target, np.array([0, 150, 320, 400, 600])


def left_out(columns, target, edges, block, fitted):
    kept = np.concatenate([np.arange(edges[b], edges[b + 1]) for b in range(edges.size - 1)
                           if b != block and fitted[b]])
    return np.linalg.lstsq(columns[kept], target[kept], rcond=None)[0]


@pytest.mark.parametrize("fitted", [[True] * 4, [True, True, True, False]])
def test_every_block_is_predicted_without_itself(data, fitted):
    columns, target, edges = data
    found = Blocks(np.column_stack((columns, target)), edges, fitted).fit([0, 1, 2], 3)
    for b in range(4):
        part = slice(edges[b], edges[b + 1])
        values = left_out(columns, target, edges, b, fitted)
        left = target[part] - columns[part] @ values
        assert found.errors[b] == pytest.approx(np.mean(left**2), rel=1e-6)
    assert found.left_out.shape == (sum(fitted), 3)
    np.testing.assert_allclose(found.coefficients, left_out(columns, target, edges, 9, fitted),
                               rtol=1e-6)


def test_coefficients_by_group_are_those_of_groups_fitted_alone(data):
    columns, target, edges = data
    blocks = Blocks(np.column_stack((columns, target)), edges, [True] * 4)
    groups = np.array([0, 0, 1, 1])
    found = blocks.fit_by_group([], [0, 1, 2], 3, groups)
    for b in range(4):
        alone = groups == groups[b]
        values = left_out(columns, target, edges, b, alone)
        part = slice(edges[b], edges[b + 1])
        left = target[part] - columns[part] @ values
        assert found.errors[b] == pytest.approx(np.mean(left**2), rel=1e-6)


def test_a_ridge_never_fits_noise_better_than_nothing():
    rng = np.random.default_rng(3)
    columns, target = rng.standard_normal((400, 60)), rng.standard_normal(400)
    blocks = Blocks(np.column_stack((columns, target)), np.arange(0, 401, 40), [True] * 10)
    plain = blocks.fit(range(60), 60).errors.mean()
    held = blocks.ridge_fit([], range(60), 60, (1e-4, 1.0, 100.0)).errors.mean()
    assert held < 1.02 * np.mean(target**2) < plain


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(2).standard_normal(50)
    without = (values.sum() - values) / 49
    assert jackknife(without[:, None])[0] == pytest.approx(np.std(values, ddof=1) / np.sqrt(50))


def test_a_margin_counts_every_block_the_same():
    better = np.array([1.0, 1e6, 1e-6, 1.0])
    mean, error = log_ratio(better, 2.0 * better)
    assert mean == pytest.approx(np.log(2.0))
    assert error == pytest.approx(0.0, abs=1e-12)


def test_no_block_lies_across_two_runs():
    edges, owner = block_edges([1000, 300, 5], 13, 10)
    assert {0, 1000, 1300, 1305} <= set(edges.tolist())
    assert owner.tolist() == [0] * 10 + [1] * 3 + [2]
