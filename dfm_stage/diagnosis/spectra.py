"""Lines in the residual: over time (a vibration), and over position (the scale's own errors)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    COARSER,
    FEWEST_CYCLES,
    FEWEST_LEVELS,
    FILTER_HIGHEST,
    FINEST_PATTERN,
    GAP_LEAST,
    LATTICE_MISS,
    MOTION_ABOVE,
)

BINS = 1 << 18
PADDING = 500
"""Samples by which a filtered signal is continued at its ends."""


def frequency_peaks(residuals: Sequence[Array], sample_period: float, count: int = 3,
                    lowest_hz: float = 0.0) -> list[float]:
    """Frequencies (Hz) of the highest peaks in the summed periodograms of `residuals` (N,)."""
    size = 4 * (1 << max(r.size for r in residuals).bit_length())
    power = np.zeros(size // 2 + 1)
    for r in residuals:
        power += np.abs(np.fft.rfft(r - r.mean(), size)) ** 2
    hertz = np.fft.rfftfreq(size, sample_period)
    apart = size // min(r.size for r in residuals)
    power[hertz < lowest_hz] = 0.0
    return [float(hertz[k]) for k in _peaks(power, 2 * apart, count)]


def position_peaks(positions: Sequence[Array], residuals: Sequence[Array], count: int = 3,
                   cycles: float = FEWEST_CYCLES) -> list[float]:
    """Periods of the strongest patterns of `residuals` (N,) over `positions` (N,)."""
    low = min(float(p.min()) for p in positions)
    high = max(float(p.max()) for p in positions)
    travel = high - low
    if travel <= 0.0:
        return []
    bins = np.zeros(BINS)
    for p, r in zip(positions, residuals, strict=True):
        place = np.clip(((p - low) / travel * (BINS - 1)).astype(np.int64), 0, BINS - 1)
        bins += np.bincount(place, weights=r - r.mean(), minlength=BINS)
    turns = np.arange(2 * BINS + 1) / (4.0 * travel * BINS / (BINS - 1))
    turns = turns[turns <= FINEST_PATTERN * BINS / travel]
    power = np.abs(np.fft.rfft(bins, 4 * BINS)[:turns.size]) ** 2
    power[turns < cycles / travel] = 0.0
    return [float(1.0 / turns[k]) for k in _peaks(power, 8, count) if power[k] > 0.0]


def density(signal: Array, length: int, sample_period: float = 1.0) -> tuple[Array, Array]:
    """Frequencies (Hz) and one-sided power spectral density (F,) of `signal` (N,).

    Welch's method: periodograms of Hann windows of `length` samples without their mean, which
    overlap by half. scipy.signal has the same, and takes as long to import as a fit takes.
    """
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    parts = sliding_window_view(signal, length)[::length - length // 2]
    spectra = np.fft.rfft(window * (parts - parts.mean(axis=1, keepdims=True)), axis=1)
    power: Array = np.mean(np.abs(spectra) ** 2, axis=0)
    power *= 2.0 * sample_period / float(window @ window)
    power[0] *= 0.5
    if length % 2 == 0:
        power[-1] *= 0.5
    return np.asarray(np.fft.rfftfreq(length, sample_period)), power


def denoised(signal: Array) -> Array:
    """`signal` (N,) without the noise above the frequency where its motion sinks into it.

    Forward and backward through a Butterworth filter, so that nothing is delayed.
    """
    from scipy.signal import butter, sosfiltfilt  # slow to import, and seldom needed

    frequencies, power = density(signal, min(1024, signal.size // 4))
    noise = float(np.median(power[-power.size // 4:]))
    moving = np.flatnonzero(power > MOTION_ABOVE * noise)
    edge = 1.5 * 2.0 * float(frequencies[moving[-1]]) if moving.size else 1.0
    if edge >= FILTER_HIGHEST:
        return signal
    return np.asarray(sosfiltfilt(butter(6, max(edge, 0.02), output="sos"), signal,
                                  padlen=min(PADDING, signal.size - 1)))


def lattice(values: Array) -> float | None:
    """The step of which all `values` (N,) are multiples apart, None where there is none.

    Values may be rounded further, to something finer: the step is made out from small gaps first,
    so that the larger ones are counted in steps without a slip.
    """
    levels = np.unique(values)
    if levels.size < FEWEST_LEVELS or levels.size > values.size // 2:
        return None
    gaps = np.diff(levels)
    gaps = gaps[gaps > GAP_LEAST * float(np.max(gaps))]
    step = reach = float(np.min(gaps))
    while reach < float(np.max(gaps)):
        reach *= 3.0
        near = gaps[gaps <= reach]
        step = float(np.sum(near) / np.sum(np.rint(near / step)))
    miss = np.abs(gaps / step - np.rint(gaps / step))
    return step if float(np.mean(miss)) < LATTICE_MISS else None


def read_off(values: Array, resolution: float) -> float | None:
    """The step in which a reading (N,) counts, where it is coarser than the encoder's resolution:
    read off the data, not to be estimated."""
    step = lattice(values)
    return step if step is not None and not is_resolution(step, resolution) else None


def is_resolution(step: float, resolution: float) -> bool:
    """Whether a reading that counts in `step` counts in the encoder's resolution: 0 is none."""
    return step <= COARSER * resolution


def _peaks(power: Array, apart: int, count: int) -> list[int]:
    left, found = power.copy(), []
    for _ in range(count):
        k = int(np.argmax(left))
        if left[k] <= 0.0:
            break
        found.append(k)
        left[max(0, k - apart):k + apart + 1] = 0.0
    return found
