"""Coloured noise: the autoregression, its order, and covariances against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter, welch

from dfm_stage.identification.noise import fit_noise, score_covariance, whiten

POLY = np.array([1.0, -1.6, 0.8])


def coloured(seed, samples=20_000):
    rng = np.random.default_rng(seed)
    return 0.3 * lfilter([1.0], POLY, rng.standard_normal(samples + 500))[500:]


def test_finds_the_coefficients_and_the_innovations():
    models = [fit_noise(coloured(seed)) for seed in range(10)]
    assert np.median([m.order for m in models]) <= 5
    for model in models:
        np.testing.assert_allclose(model.coefficients[:2], POLY[1:], atol=0.04)
        assert model.sigma == pytest.approx(0.3, rel=0.02)


def test_white_noise_needs_no_model():
    orders = [fit_noise(np.random.default_rng(s).standard_normal(5000)).order for s in range(20)]
    assert np.median(orders) == 0


def test_whitening_inverts_the_colour():
    noise = coloured(1)
    white = whiten(noise, POLY)
    assert white.size == noise.size - 2
    assert np.std(white) == pytest.approx(0.3, rel=0.02)
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.02


@pytest.mark.parametrize("shape", [(100,), (3, 100), (2, 3), (2, 2), (1, 1)])
def test_whitening_is_the_filter_of_scipy_once_it_is_filled(shape):
    signal = np.random.default_rng(3).standard_normal(shape)
    np.testing.assert_allclose(whiten(signal, POLY), lfilter(POLY, [1.0], signal)[..., 2:],
                               atol=1e-14)


def test_spectrum_is_one_sided_power_density():
    model = fit_noise(coloured(2, 200_000))
    frequency, power = welch(coloured(2, 200_000), fs=1000.0, nperseg=1024)
    middle = slice(10, 400)
    ours = model.spectrum(2 * np.pi * frequency[middle], 1e-3)
    assert np.median(ours / power[middle]) == pytest.approx(1.0, abs=0.05)


def test_score_covariance_is_that_of_repeated_experiments():
    samples = 4000
    t = np.arange(samples) * 1e-3
    jacobian = np.column_stack([np.sin(40 * t), np.cos(160 * t), np.exp(-t)])
    scores = np.array([jacobian.T @ coloured(s, samples) for s in range(100, 500)])
    expected = np.cov(scores.T)
    estimated = np.mean([score_covariance(jacobian, coloured(s, samples))[0]
                         for s in range(20)], axis=0)
    np.testing.assert_allclose(np.diag(estimated), np.diag(expected), rtol=0.25)
    # As if white: wrong by the spectrum's shape, several times.
    naive = np.var(coloured(0)) * np.sum(jacobian**2, axis=0)
    assert np.max(np.abs(np.log(naive / np.diag(expected)))) > np.log(2.0)


def test_the_band_that_a_fit_took_is_put_back():
    """A fit of forty neighbouring lines takes their power out of what is left."""
    samples = 2048
    t = np.arange(samples)
    lines = np.arange(100, 140)
    columns = np.column_stack([f(2.0 * np.pi * k * t / samples) for k in lines
                               for f in (np.cos, np.sin)])
    taken = columns / np.linalg.norm(columns, axis=0)
    noise = np.random.default_rng(3).standard_normal((200, samples))
    left = noise - (noise @ taken) @ taken.T
    probe = np.cos(2.0 * np.pi * 120 * t / samples)[:, None]
    plain, back = (np.mean([score_covariance(probe, r, use)[0][0, 0] for r in left])
                   for use in (None, taken))
    true = float(np.sum(probe**2))
    assert plain < 0.5 * true
    assert back == pytest.approx(true, rel=0.25)
