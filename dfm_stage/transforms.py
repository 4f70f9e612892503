"""The few transforms that a diagnosis needs, of NumPy alone.

scipy.fft has them, too; but to import it, or any other part of SciPy, takes a fifth of the time
to the first answer. What is seldom needed of SciPy is imported where it is used.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from dfm_stage.arrays import Array, Complex


def cosine_transform(values: Array) -> Array:
    """Return the orthonormal DCT-II (..., N) of `values` (..., N) along the last axis.

    By one real FFT of the even samples, followed by the odd ones backward (Makhoul 1980).
    """
    count = values.shape[-1]
    mixed = np.concatenate((values[..., ::2], values[..., 1::2][..., ::-1]), axis=-1)
    spectrum = np.fft.rfft(mixed) * (np.sqrt(2.0 / count) * _turns(count))
    found = np.empty(values.shape)
    found[..., :count // 2 + 1] = spectrum.real
    found[..., count // 2 + 1:] = -spectrum.imag[..., (count - 1) // 2:0:-1]
    found[..., 0] *= np.sqrt(0.5)
    return found


def inverse_cosine_transform(lines: Array) -> Array:
    """Return that of which `cosine_transform` makes `lines` (..., N)."""
    count = lines.shape[-1]
    spectrum = lines[..., :count // 2 + 1].astype(complex)
    spectrum[..., 0] *= np.sqrt(2.0)
    spectrum[..., 1:].imag = -lines[..., :(count - 1) // 2:-1]
    mixed = np.fft.irfft(spectrum * (np.sqrt(0.5 * count) / _turns(count)), count)
    found = np.empty(lines.shape)
    found[..., ::2] = mixed[..., :(count + 1) // 2]
    found[..., 1::2] = mixed[..., :(count - 1) // 2:-1]
    return found


def _turns(count: int) -> Complex:
    return np.asarray(np.exp(-0.5j * np.pi * np.arange(count // 2 + 1) / count))


def longer_length(least: int) -> int:
    """Return the least length from `least` on that an FFT is fast at: 2^a 3^b 5^c."""
    return min(length for length in _smooth(2 * least) if length >= least)


def shorter_length(most: int) -> int:
    """Return the largest length up to `most` that an FFT is fast at: 2^a 3^b 5^c."""
    return max(length for length in _smooth(most) if length <= most)


@cache
def _smooth(limit: int) -> list[int]:
    found = [1]
    for prime in (2, 3, 5):
        multiples = found
        while multiples:
            multiples = [prime * length for length in multiples if prime * length <= limit]
            found = found + multiples
    return found
