"""Commands of unit peak, and what a plant sees between their samples."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from benchmarks.corpus.measured.plant import STEPS

KINDS = ("multisine", "chirp", "steps", "prbs", "noise", "scan")
SMOOTH_KINDS = ("multisine", "chirp", "noise")
PASS, STOP = 0.36, 0.44
"""Of the sampling rate: up to where a band-limited command passes, and from where it is cut."""
RAMP = 0.02
"""Share of a record in which its command fades in, and out at the end."""


def command(rng: np.random.Generator, kind: str, samples: int, low: float, high: float) -> Any:
    """Samples (N,) of a command from zero, most of its content between two frequencies, which are
    shares of the sampling rate."""
    n = np.arange(samples)
    if kind == "multisine":
        length = samples // int(rng.integers(2, 5))
        lines = np.arange(max(1, math.ceil(low * length)), max(2, int(high * length)) + 1)
        spectrum = np.zeros(length // 2 + 1, dtype=complex)
        phases = rng.uniform(0.0, 2.0 * math.pi, lines.size)
        spectrum[lines] = np.exp(1j * phases) * lines ** float(rng.choice([0.0, -0.5]))
        wave = np.resize(np.fft.irfft(spectrum, length), samples)
    elif kind == "chirp":
        part = np.abs(np.mod(2.0 * n / samples * float(rng.integers(1, 4)), 2.0) - 1.0)
        wave = np.sin(2.0 * math.pi * np.cumsum(low * (high / low) ** (1.0 - part)))
    elif kind == "steps":
        hold = max(8, round(0.25 / max(low, 4.0 / samples)))
        wave = np.repeat(rng.uniform(-1.0, 1.0, samples // hold + 2), hold)[:samples]
    elif kind == "prbs":
        clock = max(1, round(0.3 / high))
        wave = np.repeat(rng.choice([-1.0, 1.0], samples // clock + 2), clock)[:samples]
    elif kind == "noise":
        spectrum = np.fft.rfft(rng.standard_normal(samples))
        f = np.fft.rfftfreq(samples)
        shape = 1.0 / (1.0 + (f / high) ** 8)
        growing = 1.0 if rng.random() < 0.5 else n / samples
        wave = np.fft.irfft(spectrum * shape * (f >= low), samples) * growing
    else:
        wave = 2.0 / math.pi * np.arcsin(0.98 * np.sin(2.0 * math.pi * np.cumsum(
            np.repeat(rng.uniform(0.7, 1.4, samples // 500 + 1), 500)[:samples] * 2.0 * low)))
    edge = max(8, round(RAMP * samples))
    fade = np.minimum(1.0, np.minimum(n, samples - 1 - n) / edge)
    wave = wave * 0.5 * (1.0 - np.cos(math.pi * fade))
    return wave / np.max(np.abs(wave))


def band_limited(samples: Any) -> Any:
    """The band-limited signal of command samples (N,) at half steps, (2 STEPS N + 1,)."""
    length = len(samples)
    spectrum = np.fft.rfft(samples)
    f = np.arange(spectrum.size) / length
    taper = np.clip((STOP - f) / (STOP - PASS), 0.0, 1.0)
    filled = np.zeros(STEPS * length + 1, dtype=complex)
    filled[:spectrum.size] = spectrum * np.sin(0.5 * math.pi * taper) ** 2
    wave = np.fft.irfft(filled, 2 * STEPS * length) * (2 * STEPS)
    return np.append(wave, wave[0])
