"""Transforms against SciPy, which has them and takes long to import."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.fft

from dfm_stage.transforms import (
    cosine_transform,
    inverse_cosine_transform,
    longer_length,
    shorter_length,
)


@pytest.mark.parametrize("shape", [(1,), (2,), (3,), (8,), (9,), (3, 100), (2, 101)])
def test_cosine_transforms_are_those_of_scipy(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).standard_normal(shape)
    np.testing.assert_allclose(cosine_transform(values), scipy.fft.dct(values, norm="ortho"),
                               atol=1e-12)
    np.testing.assert_allclose(inverse_cosine_transform(values),
                               scipy.fft.idct(values, norm="ortho"), atol=1e-12)


def test_fast_lengths_are_those_of_scipy() -> None:
    for length in (*range(1, 300), 15_999, 16_001):
        assert longer_length(length) == scipy.fft.next_fast_len(length, real=True)
        assert shorter_length(length) == scipy.fft.prev_fast_len(length, real=True)
