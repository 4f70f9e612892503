"""Inputs and references of the corpus: multisines, chirps, scans, and a controller's gains."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.corpus.linear import discrete, transfer


def multisine(rng: np.random.Generator, period: float, samples: int, repeat_s: float,
              low_hz: float, high_hz: float, odd: bool) -> Any:
    """A random-phase multisine of unit peak, (samples,); odd ones leave a third of lines out."""
    length = round(repeat_s / period)
    lines = np.arange(max(1, math.ceil(low_hz * repeat_s)), int(high_hz * repeat_s) + 1)
    if odd:
        lines = lines[lines % 2 == 1]
        lines = lines[rng.random(lines.size) > 1.0 / 3.0]
    spectrum = np.zeros(length // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * rng.uniform(0.0, 2.0 * math.pi, lines.size))
    wave = np.fft.irfft(spectrum, length)
    return np.resize(wave / np.max(np.abs(wave)), samples)


def chirp(period: float, samples: int, low_hz: float, high_hz: float, sweep_s: float) -> Any:
    """A logarithmic sweep of unit amplitude up and down again, repeated, (samples,)."""
    time = np.arange(samples) * period
    phase_in = np.mod(time, 2.0 * sweep_s)
    part = np.where(phase_in < sweep_s, phase_in, 2.0 * sweep_s - phase_in) / sweep_s
    hertz = low_hz * (high_hz / low_hz) ** part
    return np.sin(2.0 * math.pi * np.cumsum(hertz) * period)


def scan(rng: np.random.Generator, period: float, samples: int, line_hz: float) -> Any:
    """Triangles with rounded turns on a slow staircase of amplitude, unit peak, (samples,)."""
    time = np.arange(samples) * period
    triangle = 2.0 / math.pi * np.arcsin(0.985 * np.sin(2.0 * math.pi * line_hz * time))
    width = max(3, round(0.06 / line_hz / period))
    window = np.hanning(width + 2)[1:-1]
    padded = np.concatenate([np.zeros(width), triangle])
    smooth = np.convolve(padded, window / window.sum())[width:width + samples]
    lines = np.floor(time * line_hz).astype(int)
    height = rng.uniform(0.25, 1.0, lines[-1] + 1)[lines]
    height[lines == 1] = 1.0
    kernel = np.hanning(round(1.0 / line_hz / period) + 2)[1:-1]
    padded = np.concatenate([np.full(kernel.size, height[0]), height])
    height = np.convolve(padded, kernel / kernel.sum())[kernel.size:kernel.size + samples]
    wave = smooth * height
    return wave / np.max(np.abs(wave))


def steps(rng: np.random.Generator, period: float, samples: int, hold_s: float) -> Any:
    """Random levels held for `hold_s` with ramps of a tenth of it, unit peak, (samples,)."""
    hold = round(hold_s / period)
    levels = np.repeat(rng.uniform(-1.0, 1.0, samples // hold + 2), hold)
    ramp = np.full(max(1, hold // 10), 1.0)
    wave = np.convolve(np.concatenate([np.zeros(ramp.size), levels]), ramp / ramp.sum())
    wave = wave[ramp.size:ramp.size + samples]
    return wave / np.max(np.abs(wave))


def gains(base: Mapping[str, float], period: float) -> Any:
    """kp, ki, kd and filter time of a loop with a sensitivity peak below 2, as fast as allowed.

    A PID around the mass line where delay and lag leave room, else an integrator.
    """
    hertz = np.geomspace(0.05, 0.499 / period, 400)
    plant = transfer(base, period, hertz)
    z = np.exp(2j * math.pi * hertz * period)
    natural = math.sqrt(base.get("stiffness", 0.0) / base["mass"])
    candidates = []
    for crossing in np.geomspace(2.0 * math.pi * 150.0, max(1.2 * natural, 20.0), 12):
        if crossing < 1.2 * natural:
            break
        kp = base["mass"] * crossing**2 / 3.0 / base["force_constant"]
        candidates.append((kp, kp * crossing / 9.0, 3.0 * kp / crossing,
                           1.0 / (3.0 * crossing)))
    static = base.get("stiffness", 1.0) / base["force_constant"]
    candidates += [(0.0, share * static * natural, 0.0, period) for share in (0.1, 0.03, 0.01)]
    for kp, ki, kd, filtering in candidates:
        difference = 1.0 - 1.0 / z
        law = kp + ki * period / difference + kd * difference / period / (
            1.0 + filtering / period * difference)
        if np.max(1.0 / np.abs(1.0 + law * plant)) < 2.0 and _stable(
                base, period, kp, ki, kd, filtering):
            return np.array([kp, ki, kd, filtering])
    return np.array([0.0, 0.003 * static * natural, 0.0, period])


def _stable(base: Mapping[str, float], period: float, kp: float, ki: float, kd: float,
            filtering: float) -> bool:
    """Whether the sampled loop's eigenvalues lie inside the unit circle."""
    phi, before, now, whole = discrete(base, period)
    n = len(now)
    size = n + whole + 1 + 3  # states, old commands, integral, filtered difference, last error
    at, integral, slope, last = n, n + whole + 1, n + whole + 2, n + whole + 3
    share = period / (filtering + period)
    error = np.zeros(size)
    error[0] = -1.0
    filtered = np.eye(size)[slope] * (1.0 - share) + share * (error - np.eye(size)[last])
    summed = np.eye(size)[integral] + ki * period * error
    command = kp * error + summed + kd / period * filtered
    held = [command, *np.eye(size)[at:at + whole + 1]]
    step = np.zeros((size, size))
    step[:n, :n] = phi
    step[:n] += np.outer(before, held[whole + 1]) + np.outer(now, held[whole])
    step[at:at + whole + 1] = held[:whole + 1]
    step[integral], step[slope], step[last] = summed, filtered, error
    return bool(np.max(np.abs(np.linalg.eigvals(step))) < 1.0)
