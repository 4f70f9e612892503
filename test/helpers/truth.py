"""Records made without the library: Runge-Kutta methods, numpy noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SAMPLES, FINE = 1e-3, 10_000, 8
MASS, DAMPING, STIFFNESS, GAIN = 1.0, 4.0, 4000.0, 2.0
NOISE = 1e-7
CABLE = 220.0, 3e-4
"""Stiffness (N/m) of a cable, and the position (m) beyond which it pulls."""


def believed(**base: float) -> Model:
    """The model its user has: no effects."""
    return Model("believed", PERIOD, {"mass": MASS, "damping": DAMPING, "stiffness": STIFFNESS,
                                      "force_constant": GAIN, **base})


def multisine(seed: int, peak_v: float = 1.0, top_hz: float = 120.0) -> np.ndarray:
    """A random-phase multisine of period 2 s."""
    rng = np.random.default_rng(seed)
    length = 2000
    spectrum = np.zeros(length // 2 + 1, dtype=complex)
    lines = np.arange(1, int(top_hz * 2))
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    wave = np.fft.irfft(spectrum, length)
    return np.resize(peak_v * wave / np.max(np.abs(wave)), SAMPLES)


def scan(peak_v: float = 0.8) -> np.ndarray:
    """A slow sine with a growing amplitude and a faster one on it."""
    time = PERIOD * np.arange(SAMPLES)
    return peak_v * (0.3 + 0.07 * time) * np.sin(2 * np.pi * 2.3 * time) + 0.15 * np.sin(
        2 * np.pi * 9.1 * time)


def move(feed: np.ndarray, extra: Callable[[float, float], float] | None = None,
         stiffness: float = STIFFNESS, damping: float = DAMPING) -> np.ndarray:
    """Position (N,) of the stage from rest; `extra(x, v)` is a force (N) on it."""
    x = v = 0.0
    h = PERIOD / FINE
    out = np.empty(feed.size)

    def rate(x: float, v: float, u: float) -> float:
        force = GAIN * u - damping * v - stiffness * x
        return (force + (extra(x, v) if extra else 0.0)) / MASS

    for k, u in enumerate(feed.tolist()):
        out[k] = x
        for _ in range(FINE):
            a1 = rate(x, v, u)
            x2, v2 = x + 0.5 * h * v, v + 0.5 * h * a1
            a2 = rate(x2, v2, u)
            x3, v3 = x + 0.5 * h * v2, v + 0.5 * h * a2
            a3 = rate(x3, v3, u)
            x4, v4 = x + h * v3, v + h * a3
            a4 = rate(x4, v4, u)
            x += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
            v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return out


def record(feed: np.ndarray, position: np.ndarray, seed: int, name: str = "run") -> Record:
    """A record with white noise on the reading."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(feed.size)
    return Record(PERIOD * np.arange(feed.size), PERIOD,
                  {"x": AxisRecord(feed, position + noise)}, Provenance(name, "csv"))


def pulled(feed: np.ndarray) -> np.ndarray:
    """Position (N,) of the stage with the cable, from rest, by DOP853: the force has a kink."""
    k, x0 = CABLE
    state, out = np.zeros(2), np.empty(feed.size)

    def slope(_: float, s: np.ndarray, u: float) -> list[float]:
        force = GAIN * u - DAMPING * s[1] - STIFFNESS * s[0]
        return [s[1], (force - k * max(s[0] - x0, 0.0)) / MASS]

    for n, u in enumerate(feed):
        out[n] = state[0]
        state = solve_ivp(slope, (0.0, PERIOD), state, "DOP853", args=(u,), rtol=1e-9,
                          atol=1e-13).y[:, -1]
    return out
