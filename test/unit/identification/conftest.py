"""A stage simulated by SciPy alone, so that identification is not tested on its own reflection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import cont2discrete

Array = NDArray[np.float64]

PERIOD = 1e-3


@dataclass(frozen=True)
class ReferenceStage:
    """Mass, spring, damper behind lag and delay; the delay in fifths of a sample."""

    mass: float = 1.082
    damping: float = 1.845
    stiffness: float = 650.0
    force_constant: float = 1.082
    lag: float = 1e-3
    delay_fifths: int = 5
    second: tuple[float, float, float] | None = None  # share, frequency Hz, damping ratio

    @property
    def delay(self) -> float:
        return self.delay_fifths / 5 * PERIOD

    def matrices(self) -> tuple[Array, Array, Array]:
        share = self.second[0] if self.second else 0.0
        modes = [(1 - share, self.damping / self.mass, self.stiffness / self.mass)]
        if self.second:
            w = 2 * np.pi * self.second[1]
            modes.append((share, 2 * self.second[2] * w, w * w))
        n = 1 + 2 * len(modes)
        a, c = np.zeros((n, n)), np.zeros((1, n))
        a[0, 0] = -1 / self.lag
        for i, (part, damping, stiffness) in enumerate(modes):
            q = 1 + 2 * i
            a[q, q + 1] = 1
            a[q + 1, q], a[q + 1, q + 1] = -stiffness, -damping
            a[q + 1, 0] = part * self.force_constant / self.mass
            c[0, q] = 1
        b = np.zeros((n, 1))
        b[0, 0] = 1 / self.lag
        return a, b, c

    def response(self, omega: Array) -> NDArray[np.complex128]:
        """The sampled response by brute force: the fine discretisation lifted to one sample."""
        step, late, earlier, c = self.sampled()
        z = np.exp(1j * omega * PERIOD)
        drive = late[None, :] + earlier[0] / z[:, None] + earlier[1] / z[:, None] ** 2
        return np.array([(c @ np.linalg.solve(zi * np.eye(len(step)) - step, di))[0]
                         for zi, di in zip(z, drive, strict=True)])

    def sampled(self) -> tuple[Array, Array, Array, Array]:
        a, b, c = self.matrices()
        fine, pulse, *_ = cont2discrete((a, b, c, [[0.0]]), PERIOD / 5)
        n = len(a)
        drives, reached = np.zeros((4, n)), np.eye(n)
        for j in range(4, -1, -1):
            drives[-((j - self.delay_fifths) // 5)] += reached @ pulse[:, 0]
            reached = reached @ fine
        return reached, drives[0], drives[1:], c

    def simulate(self, command: Array | object, samples: int | None = None, *,
                 noise: Array | None = None, start: tuple[float, float] = (0.0, 0.0)
                 ) -> tuple[Array, Array]:
        """Return command and measured position (N,); a callable command closes the loop."""
        law = command if callable(command) else None
        given = None if law else np.asarray(command, dtype=float)
        count = samples if law else len(given)
        step, now, past, c = self.sampled()
        x = np.zeros(len(step))
        x[1], x[2] = start
        u, y = np.zeros(count), np.zeros(count)
        recent = np.zeros(3)
        for k in range(count):
            y[k] = c[0] @ x + (noise[k] if noise is not None else 0.0)
            u[k] = law(k, y[k]) if law else given[k]
            x = step @ x + now * u[k] + past.T @ recent
            recent = np.array([u[k], recent[0], recent[1]])
        return u, y


def random_phase(lines: Array, period: int, count: int, seed: int = 0) -> Array:
    """A multisine of unit RMS over `count` periods."""
    rng = np.random.default_rng(seed)
    t = np.arange(period)
    phases = rng.uniform(0, 2 * np.pi, len(lines))
    wave = np.cos(2 * np.pi * np.outer(lines, t) / period + phases[:, None]).sum(axis=0)
    return np.tile(wave / wave.std(), count)


@pytest.fixture
def reference_stage() -> type[ReferenceStage]:
    return ReferenceStage


@pytest.fixture
def multisine() -> object:
    return random_phase
