"""Position, velocity and acceleration from whichever of them was measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import MOTION_ABOVE_NOISE
from dfm_stage.identification.periods import local_mean
from dfm_stage.recording.units import Measured

ORDER: Mapping[Measured, int] = {"position": 0, "velocity": 1, "acceleration": 2}
"""Of which order in the position's time derivatives each measured signal is."""
NEIGHBOURS = 1
"""Lines at either side over which power is averaged before it is set beside the noise."""


def differentiated(signal: Array, order: int, period: float) -> Array:
    """The time derivative of some order of `signal` (N,), sampled every `period` s; of a negative
    order its integral, without offset and drift.

    An integral takes in no line at which the signal is not above its noise: it would blow the
    noise up at low frequencies, twice over for an acceleration.
    """
    for _ in range(order):
        signal = np.asarray(np.gradient(signal, period))
    if order >= 0:
        return signal
    signal = signal - np.mean(signal)
    # what rings strongly leaks into all lines but those of a windowed signal
    power = local_mean(np.abs(np.fft.rfft(signal * np.hanning(signal.size))) ** 2, NEIGHBOURS)
    noise = float(np.median(power[-max(power.size // 4, 1):]))
    wave = np.concatenate((signal, signal[::-1]))       # goes on without a jump
    spectrum = np.fft.rfft(wave)
    spectrum[np.repeat(power, 2)[:spectrum.size] < MOTION_ABOVE_NOISE * noise] = 0.0
    spectrum[0] = 0.0
    omega = 2.0 * np.pi * np.arange(spectrum.size) / (wave.size * period)
    spectrum[1:] *= (1j * omega[1:]) ** order
    whole = np.fft.irfft(spectrum, wave.size)[:signal.size]
    trend = np.linspace(-1.0, 1.0, signal.size)[:, None] ** np.arange(1 - order)
    return np.asarray(whole - trend @ np.linalg.lstsq(trend, whole, rcond=None)[0])
