"""The linear part of a model, continuous and sampled: what control and identification see of it.

    s' = a s + b u(t - delay) + g f,    y = c s

with command u (V or A), a force f (N) on the driven point and the reading y (m) of its position.
It is what the simulator assembles (`kernel.setup`), so whatever an effect stamps into it is in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.model.description import Model

LARGEST_CONDITION = 1e12
"""Of the scaled matrix of a stage that comes to rest; rounding alone leaves more than 1e15."""


def _none() -> Array:
    return np.empty(0)


@dataclass(frozen=True)
class Sampled:
    """x[k+1] = a x[k] + b u[k] + g f[k], y[k] = c x[k]; shapes (n, n), (n,), (n,), (n,).

    u in V or A, f in N, y in m. `g` is empty where no force was asked for. The last `delayed`
    states are inputs on their way, oldest first; the first `motion` ones are the stage's motion,
    and what is between them belongs to the actuator. `velocity` (n,) gives the point's, m/s.
    """

    a: Array
    b: Array
    c: Array
    sample_period_s: float
    g: Array = field(default_factory=_none)
    delayed: int = 0
    velocity: Array = field(default_factory=_none)
    motion: int = 0

    def response(self, frequency_hz: Array) -> Complex:
        """Return y/u at frequencies of shape (F,), m/V, complex (F,)."""
        z = np.exp(2j * math.pi * np.asarray(frequency_hz) * self.sample_period_s)
        n = self.b.size - self.delayed
        arriving = z[:, None] ** -np.arange(self.delayed, 0, -1)
        driven = self.b[:n] + arriving @ self.a[:n, n:].T
        solved = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a[:n, :n],
                                 driven[:, :, None])
        return np.asarray(solved[:, :, 0] @ self.c[:n])


@dataclass(frozen=True)
class LinearPart:
    """a (n, n), b, g, c (n,) of the equation above, and the delay in s.

    The first `motion` states are those of the stage's motion, the others of its actuator.
    `velocity` (n,) gives the point's velocity (m/s), `drive` (n + 1,) the drive (V or A) from the
    states and the command, `gain` is the force per drive (N/V or N/A).
    """

    a: Array
    b: Array
    g: Array
    c: Array
    delay_s: float = 0.0
    velocity: Array = field(default_factory=_none)
    drive: Array = field(default_factory=_none)
    gain: float = 1.0
    motion: int = 0
    states: tuple[str, ...] = ()

    @property
    def static_gain(self) -> float:
        """Position per unit of constant command; infinite for a free body."""
        scaled = self.a / np.abs(self.a).max(axis=1, keepdims=True)
        if np.linalg.cond(scaled) > LARGEST_CONDITION:
            return math.inf
        return float(-self.c @ np.linalg.solve(self.a, self.b))

    @property
    def lag_s(self) -> float:
        """By how much the drive lags behind a slow command while the point rests, s."""
        m = self.motion
        if m == self.b.size:
            return 0.0
        chain, row = self.a[m:, m:], self.drive[m:-1]
        late = np.linalg.solve(chain, self.b[m:])
        return float(row @ np.linalg.solve(chain, late) / (self.drive[-1] - row @ late))

    def response(self, omega: Array) -> Complex:
        """Return y/u (F,) at omega (F,) in rad/s, without hold and sampling."""
        s = 1j * np.asarray(omega, dtype=float)
        solved = np.linalg.solve(s[:, None, None] * np.eye(self.b.size) - self.a,
                                 np.broadcast_to(self.b[:, None], (s.size, self.b.size, 1)))
        return np.asarray((solved[:, :, 0] @ self.c) * np.exp(-s * self.delay_s))

    def sampled(self, sample_period_s: float) -> Sampled:
        """Return the stage sampled with zero-order holds on u and f.

        Position k is taken before input k acts. A delay that is no whole number of samples is
        exact too (Astrom and Wittenmark, Computer-Controlled Systems, sec. 2.3). The state is that
        of the stage, then the inputs on their way, oldest first.
        """
        h = sample_period_s
        delay = self.delay_s / h
        whole = math.floor(delay + 1e-9)
        late = delay - whole if delay - whole > 1e-9 else 0.0
        inputs = np.column_stack((self.b, self.g))
        phi, new = held(self.a, inputs, (1.0 - late) * h)
        phi_late, old = held(self.a, inputs, late * h)
        n, m = self.b.size, whole + (1 if late else 0)
        a, b = np.zeros((n + m, n + m)), np.zeros(n + m)
        a[:n, :n] = phi @ phi_late
        arriving = [(phi @ old)[:, 0], new[:, 0]] if late else [new[:, 0]]
        for k, column in enumerate(arriving):           # the oldest input on its way acts first
            if k < m:
                a[:n, n + k] = column
            else:
                b[:n] = column
        a[range(n, n + m - 1), range(n + 1, n + m)] = 1.0
        if m:
            b[-1] = 1.0
        rest = np.zeros(m)
        return Sampled(a, b, np.concatenate((self.c, rest)), h,
                       np.concatenate(((phi @ old + new)[:, 1], rest)), m,
                       np.concatenate((self.velocity, rest)), self.motion)


def held(a: Array, b: Array, seconds: float) -> tuple[Array, Array]:
    """Return the exact transition (n, n) and input matrix (n, m) over a time of constant input.

    Both stand in one matrix exponential (Van Loan, IEEE Trans. Autom. Control 23 (1978) 395).
    """
    from scipy.linalg import expm

    n, m = b.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = a, b
    full = expm(block * seconds) if seconds else np.eye(n + m)
    return full[:n, :n], full[:n, n:]


def linear_part(model: Model) -> LinearPart:
    """Return the linear part of a one-axis model, as the simulator assembles it.

    States that neither the command nor a force moves, such as those of a vibration, are not in it.
    """
    from dfm_stage.model.kernel import slots
    from dfm_stage.model.kernel.setup import prepare
    from dfm_stage.model.plan import Plan

    plan = Plan.of(model)
    layout, work, n = plan.layout.copy(), plan.work(), int(plan.layout[slots.ORDER])
    layout[slots.CURVED] = 0                                # the tables of forces are not needed
    prepare(layout, plan.theta, work)
    blocks = work[layout[slots.AT_A]:layout[slots.AT_DISCRETE]].reshape(-1, n + 1)
    a, rows = blocks[:n], blocks[n:]
    moved = (a[:, n] != 0.0) | (rows[slots.ROW_FORCE_IN, :n] != 0.0)
    for _ in range(n):
        moved |= (a[:, :n] != 0.0) @ moved
    actuator = {"amplifier", "coil", *(
        name for use in model.effects if use.effect.stage == "amplifier"
        for name in use.effect.state_names)}
    names = plan.states[:n]
    kept = sorted(np.flatnonzero(moved), key=lambda i: names[i] in actuator)
    motion = sum(names[i] not in actuator for i in kept)
    rows = rows[:, np.append(kept, n)]
    return LinearPart(
        a[np.ix_(kept, kept)], a[kept, n], rows[slots.ROW_FORCE_IN, :-1],
        rows[slots.ROW_READING, :-1], float(plan.theta[slots.DELAY]),
        rows[slots.ROW_VELOCITY, :-1], rows[slots.ROW_DRIVE],
        float(plan.theta[slots.FORCE_CONSTANT]), motion, tuple(names[i] for i in kept))
