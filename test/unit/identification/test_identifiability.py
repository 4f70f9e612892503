"""Combinations that cannot be told apart are named as a person would."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification.identifiability import judge

RNG = np.random.default_rng(0)
A, B, C = RNG.standard_normal((3, 500)) * 100.0
NONE = np.empty((500, 0))


def verdict(columns, values, units=None, nuisance=NONE):
    names = ("mass", "force_constant", "delay")[: len(columns)]
    values = np.array(values, dtype=float)
    return judge(names, values, units or ("",) * len(columns), np.abs(values) + 1.0,
                 np.array(columns).T, nuisance)


def test_all_told_apart():
    assert verdict([A, B, C], [1, 2, 3]).complete


@pytest.mark.parametrize(("columns", "values", "units", "said"), [
    ([A, -A / 2.0], [1.0, 2.0], ("kg", "N/V"), "only as a ratio"),
    ([A, A / 2.0], [1.0, 2.0], ("kg", "N/V"), "only as a product"),
    ([A, A], [1.0, 7.0], ("s", "s"), "only as their sum"),
    ([A, -A], [1.0, 7.0], ("s", "s"), "only as their difference"),
    ([A, 0.2 * A], [1.0, 7.0], ("kg", "s"), "only in combination"),
])
def test_pairs(columns, values, units, said):
    found = verdict(columns, values, units)
    assert said in found.text
    assert found.directions[0].members == ("mass", "force_constant")
    assert np.isinf(found.directions[0].std)


def test_three_that_scale_together():
    found = verdict([A, B, -(A + 2.0 * B) / 3.0], [1.0, 2.0, 3.0])
    assert "mass, force_constant and delay only as ratios" in found.text


def test_what_is_not_visible_at_all():
    found = verdict([A, 0.0 * A], [1.0, 2.0])
    assert found.directions[0].members == ("force_constant",)
    assert "do not show force_constant" in found.text


def test_weak_is_said_with_how_well():
    found = verdict([A, 1e-4 * B], [1.0, 1.0])
    assert 1.0 < found.directions[0].std < 10.0
    assert "hardly visible" in found.text


def test_what_an_offset_can_do_is_not_credited():
    assert not verdict([A, np.ones(500)], [1.0, 1.0], nuisance=np.ones((500, 1))).complete
