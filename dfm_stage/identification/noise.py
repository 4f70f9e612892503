"""Coloured noise: autoregressive models, whitening, and what colour does to a covariance.

A record's residual v is described as A(q) v(t) = e(t) with A(q) = 1 + a1 q^-1 + ... + an q^-n and
e white (Ljung, System Identification, 2nd ed., ch. 4 and 10). Whitening prediction errors with A
makes least squares efficient, and, where the input is fed back from the output, consistent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array


@dataclass(frozen=True)
class NoiseModel:
    """A(q) v = e: `coefficients` (n,) are a1..an, `sigma` is the standard deviation of e."""

    coefficients: Array
    sigma: float

    @property
    def order(self) -> int:
        """Return n, the number of coefficients."""
        return int(self.coefficients.size)

    @property
    def polynomial(self) -> Array:
        """Return [1, a1, ..., an]."""
        return np.concatenate(([1.0], self.coefficients))

    def spectrum(self, omega: Array, sample_period: float) -> Array:
        """Return the one-sided power spectral density at `omega` (rad/s), unit^2/Hz."""
        z = np.exp(-1j * np.asarray(omega) * sample_period)
        response = np.polynomial.polynomial.polyval(z, self.polynomial)
        return np.asarray(2.0 * sample_period * self.sigma**2 / np.abs(response) ** 2)


def whiten(signal: Array, polynomial: Array) -> Array:
    """Filter `signal` (..., N) with A along its last axis; the first n samples are dropped."""
    order = polynomial.size - 1
    if order == 0:
        return signal
    out = np.empty((*signal.shape[:-1], max(signal.shape[-1] - order, 0)))
    for row in np.ndindex(out.shape[:-1]) if out.size else ():
        out[row] = np.convolve(signal[row], polynomial, "valid")
    return out


def burg(residual: Array, max_order: int) -> tuple[list[Array], Array]:
    """Return AR coefficients (without the leading 1) and innovation variances of orders 0..max.

    Burg's recursion: stable at every order and without the bias of windowed autocovariances.
    """
    forward = np.array(residual, dtype=float)
    backward = forward.copy()
    variances = [float(np.mean(forward**2))]
    models: list[Array] = [np.empty(0)]
    for _ in range(max_order):
        f, b = forward[1:], backward[:-1]
        power = float(f @ f + b @ b)
        reflection = -2.0 * float(f @ b) / power if power > 0.0 else 0.0
        previous = np.concatenate((models[-1], [0.0]))
        models.append(previous + reflection * np.concatenate((models[-1][::-1], [1.0])))
        variances.append(variances[-1] * max(1.0 - reflection**2, 1e-16))
        forward, backward = f + reflection * b, b + reflection * f
    return models, np.array(variances)


def select_order(variances: Array, samples: int) -> int:
    """Return the order that minimises the corrected Akaike criterion."""
    orders = np.arange(variances.size)
    room = np.maximum(samples - orders - 2, 1)
    aicc = samples * np.log(np.maximum(variances, 1e-300)) + 2.0 * (orders + 1) * samples / room
    return int(np.argmin(aicc))


def fit_noise(residual: Array, max_order: int | None = None) -> NoiseModel:
    """Fit an AR model to `residual` (N,), its order chosen by the Akaike criterion."""
    samples = int(residual.size)
    if max_order is None:
        max_order = default_order(samples)
    models, variances = burg(residual - residual.mean(), min(max_order, samples // 4))
    order = select_order(variances, samples)
    return NoiseModel(models[order], math.sqrt(variances[order]))


def default_order(samples: int) -> int:
    """Return the largest AR order considered for a record of `samples`."""
    return int(min(60, max(2, samples // 50)))


def score_covariance(scores: Array, white: Array,
                     taken: Array | None = None) -> tuple[Array, float]:
    """Return G^T S G (p, p), S the autocovariance of `white`, and its degrees of freedom.

    `scores` G (N, p) and `white` (N,) are in the units of the weighted residual. The middle of
    the sandwich covariance (Huber 1967; Soderstrom and Stoica 1989, ch. 7): the spectrum is
    estimated with a Parzen window of about sqrt(N) lags, degrees of freedom 3.71 N / lags.
    With `taken` (N, r), the part in these samples of orthonormal columns that span the slopes of
    the whole fit, the power that the fit itself took out of each band is put back: the spectrum
    is divided by one minus the leverage of its neighbourhood, as MacKinnon and White (1985) do
    sample by sample.
    """
    samples = white.size
    lags = int(min(max(math.sqrt(samples), 4), samples // 4))
    size = 1 << (samples + lags).bit_length()
    centred = white - white.mean()
    spectrum = _smoothed(np.abs(np.fft.rfft(centred, size)) ** 2 / samples, size, lags)
    spectrum = np.maximum(spectrum, 1e-3 * max(float(np.mean(centred**2)), 1e-300))
    if taken is not None:
        leverage = np.zeros(spectrum.size)
        for column in taken.T:
            leverage += np.abs(np.fft.rfft(column, size)) ** 2
        leverage = _smoothed(leverage / samples, size, lags)
        spectrum = spectrum / np.clip(1.0 - leverage, 0.2, 1.0)
    transform = np.fft.rfft(scores, size, axis=0)
    weight = np.full(spectrum.size, 2.0)
    weight[0] = weight[-1] = 1.0
    middle = (transform.conj().T * (weight * spectrum / size)) @ transform
    return np.asarray(middle.real), 3.71 * samples / max(lags, 1)


def _smoothed(power: Array, size: int, lags: int) -> Array:
    """Smooth a two-sided spectrum, given as (size // 2 + 1,), with a Parzen lag window."""
    covariance = np.fft.irfft(power, size)
    ratio = np.arange(lags + 1) / max(lags, 1)
    window = np.where(ratio <= 0.5, 1.0 - 6.0 * ratio**2 * (1.0 - ratio),
                      2.0 * (1.0 - ratio) ** 3)
    kept = np.zeros(size)
    kept[: lags + 1] = covariance[: lags + 1] * window
    kept[-lags:] = kept[lags:0:-1]
    return np.asarray(np.fft.rfft(kept).real)
