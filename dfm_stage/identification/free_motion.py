"""Short windows of a record in which the stage still rings: what is asked for, less the ringing.

Each window is a sum of known columns (an offset, a sine) and of the free motion of the stage's own
poles. The poles are common to all windows and found with everything else in one separable
least-squares problem (Golub and Pereyra, SIAM J. Numer. Anal. 10, 1973), so that a lightly damped
stage need not be waited for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.fitting import noise_level

EVALUATIONS = 30
"""Of the search for the poles, at most: a bound of time, as it starts close by."""
RINGS = 1.2
"""Another mode is looked for while more than this many times the noise is left over."""
HELPS = 0.9
"""A mode is kept that leaves less than this share of what was left over without it."""
START_DAMPING = 0.03
"""Damping ratio from which the search for a pole starts, that of a flexure in air."""
FREQUENCY_RANGE, LARGEST_DECAY = (0.5, 20.0), 20.0
"""Frequency and decay over their starts, within which the search stays."""
GRID = 160
"""Frequencies at which the rest is looked at: 3 % apart over two decades."""


@dataclass(frozen=True)
class Window:
    """Output (N,) at times (N,) s from the window's start, and its known columns (N, c).

    `omega` is the frequency (rad/s) of a sine among the columns, zero for none.
    """

    time: Array
    output: Array
    known: Array
    omega: float = 0.0

    @property
    def noise(self) -> float:
        """Standard deviation of white noise, from second differences."""
        return noise_level(self.output)

    def design(self, poles: Array) -> Array:
        """Columns known and those of the free motion of `poles` (decay, frequency, ...)."""
        columns = [self.known]
        for decay, omega in poles.reshape(-1, 2):
            envelope = np.exp(-decay * self.time)
            columns += [(envelope * np.cos(omega * self.time))[:, None],
                        (envelope * np.sin(omega * self.time))[:, None]]
        return np.concatenate(columns, axis=1)

    def rest(self, poles: Array) -> Array:
        """What is left of the output, (N,)."""
        design = self.design(poles)
        size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
        design /= size
        # Normal equations: well conditioned here, and ten times faster than a QR of each window.
        gram = design.T @ design + 1e-12 * np.eye(size.size)
        return np.asarray(self.output - design @ np.linalg.solve(gram, design.T @ self.output))

    def solve(self, poles: Array) -> Solved:
        """Return the amplitudes of the known columns."""
        design = self.design(poles)
        x, *_ = np.linalg.lstsq(design, self.output, rcond=None)
        rest = self.output - design @ x
        dof = max(self.output.size - design.shape[1], 1)
        variance = float(rest @ rest) / dof
        count = self.known.shape[1]
        inverse = np.linalg.pinv(design.T @ design)
        return Solved(np.asarray(x[:count]), np.asarray(variance * inverse[:count, :count]), dof)


@dataclass(frozen=True)
class Solved:
    """Amplitudes (c,) of the known columns with covariance (c, c) and degrees of freedom."""

    amplitude: Array
    covariance: Array
    dof: int


def ringing_poles(windows: Sequence[Window], low: float, high: float,
                  most: int = 2) -> Array:
    """Return decay (1/s) and frequency (rad/s) of up to `most` modes that ring in the windows.

    Frequencies are looked for from `low` to `high` rad/s, and taken out one after the other while
    more than the noise is left.
    """
    noise = math.sqrt(sum(w.noise**2 for w in windows) / len(windows))
    poles: Array = np.empty(0)
    while poles.size < 2 * most and _left(windows, poles) > RINGS * noise:
        guess = np.concatenate((poles, _strongest(windows, poles, low, high)))
        found = _refined(windows, guess)
        if _left(windows, found) > HELPS * _left(windows, poles):
            break
        poles = found
    return poles


def _left(windows: Sequence[Window], poles: Array) -> float:
    rest = np.concatenate([w.rest(poles) for w in windows])
    return float(np.sqrt(np.mean(rest**2)))


def _refined(windows: Sequence[Window], guess: Array) -> Array:
    scale = np.maximum(np.abs(guess), 1e-3)
    size = max(_left(windows, guess), 1e-15)
    found = least_squares(
        lambda p: np.concatenate([w.rest(p * scale) for w in windows]) / size, guess / scale,
        bounds=(np.where(np.arange(guess.size) % 2, FREQUENCY_RANGE[0], 0.0),
                np.where(np.arange(guess.size) % 2, FREQUENCY_RANGE[1], LARGEST_DECAY)),
        x_scale=0.01, max_nfev=EVALUATIONS)
    return np.asarray(found.x * scale)


def _strongest(windows: Sequence[Window], poles: Array, low: float, high: float) -> Array:
    """Start from the frequency at which the windows' rest is the strongest."""
    grid = np.geomspace(low, high, GRID)
    power = np.zeros(grid.size)
    # Four samples of the highest frequency are enough to find the strongest one.
    period = float(windows[0].time[1])
    stride = max(1, int(math.pi / (2.0 * high * period)))
    turns: dict[int, Complex] = {}
    for w in windows:
        rest = (w.rest(poles) * np.hanning(w.time.size))[::stride]
        if rest.size not in turns:
            turns[rest.size] = np.exp(-1j * np.outer(grid, w.time[::stride]))
        line = np.abs(turns[rest.size] @ rest) ** 2
        own = (w.omega > 0.0) & (np.abs(grid - w.omega) < 2.0 * math.pi / w.time[-1])
        power += np.where(own, 0.0, line)
    omega = float(grid[int(np.argmax(power))])
    return np.array([START_DAMPING * omega, omega])
