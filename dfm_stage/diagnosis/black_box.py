"""A black box for the missing force: what could be predicted of it, whatever its physics.

Polynomials and random Fourier features (Rahimi and Recht, NIPS 2007) of position, speed,
acceleration, the motion a quarter of a period ago, and slowly varying amplitude. Fitted with a
ridge and held out by blocks, it bounds from below what a perfect model could reach. The input is
not among its arguments: the target is made of it, and would be predicted by itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.force_domain import RunForces

FOURIER = 80
"""Random Fourier features."""
SCALES = (0.4, 1.0)
"""Spread of their wave numbers, over the standard deviation of what they are of."""
PERIODS = 4.0
"""Periods of the motion over which its amplitude is averaged."""
SEED = 1


def features(runs: Sequence[RunForces]) -> list[Array]:
    """(c, N) of each run, behind its filter; scaled alike, so that amplitude tells."""
    return _filtered(runs, _functions)


def position_velocity(runs: Sequence[RunForces]) -> list[Array]:
    """The same of position and velocity alone: what a force without memory may depend on."""
    return _filtered(runs, _functions_of_motion)


def _filtered(runs: Sequence[RunForces],
              functions: Callable[[Array], list[Array]]) -> list[Array]:
    arguments = [_arguments(run) for run in runs]
    pooled = np.concatenate(arguments, axis=1)
    middle = pooled.mean(axis=1, keepdims=True)
    spread = np.maximum(pooled.std(axis=1, keepdims=True), 1e-300)
    return [np.array([run.filtered(f) for f in functions((own - middle) / spread)])
            for run, own in zip(runs, arguments, strict=True)]


def _arguments(run: RunForces) -> Array:
    """(7, N): position, speed, acceleration, both a quarter period ago, amplitude, direction."""
    from scipy.ndimage import uniform_filter1d

    t, size = run.trajectory, run.grid.size
    speed = max(float(np.std(t.v)), 1e-300)
    quarter = 0.5 * math.pi * float(np.std(t.x)) / speed / run.grid.period
    ago = int(min(max(quarter, 1.0), size // 8))
    window = int(min(max(4.0 * PERIODS * quarter, 3.0), size // 4))
    amplitude = np.sqrt(np.maximum(uniform_filter1d(t.v**2, window), 0.0))  # a running sum
    direction = t.v / np.hypot(t.v, max(2.0 * t.speed_noise, DIRECTED * speed))
    before = np.maximum(np.arange(size) - ago, 0)
    return np.array([t.x, t.v, t.a, t.x[before], t.v[before], amplitude, direction])


DIRECTED = 1e-3
"""Share of the RMS speed at which a direction is half known."""


def _functions(z: Array) -> list[Array]:
    """Functions (N,) of the scaled arguments."""
    x, v, a, x_ago, v_ago, amplitude, direction = z
    found = [direction, direction * x, direction * v, direction * x**2, direction * v**2,
             direction * amplitude, amplitude, amplitude * x, amplitude * v, x_ago, v_ago,
             amplitude**2 * x, amplitude**2 * v, a * x, a * x**2, a * v]
    found += _powers(x, v)
    draw = np.random.default_rng(SEED)
    for k in range(FOURIER):
        used = 2 if k % 2 else len(z)
        wave = SCALES[k % len(SCALES)] * draw.standard_normal(used)
        found.append(np.cos(wave @ z[:used] + 2.0 * math.pi * draw.random()))
    return found


def _functions_of_motion(z: Array) -> list[Array]:
    """Functions (N,) of scaled position, speed and direction."""
    x, v, direction = z[0], z[1], z[-1]
    found = [direction, direction * x, direction * v, direction * x**2, direction * v**2,
             *_powers(x, v)]
    draw = np.random.default_rng(SEED)
    for k in range(FOURIER):
        wave = SCALES[k % len(SCALES)] * draw.standard_normal(2)
        found.append(np.cos(wave @ z[:2] + 2.0 * math.pi * draw.random()))
    return found


def _powers(x: Array, v: Array) -> list[Array]:
    return [x**i * v**j for i in range(6) for j in range(6 - i) if i + j > 1]
