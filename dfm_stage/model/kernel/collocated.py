"""The machine code of a `flow`: a force with states of its own, along a step of the motion.

Over a step of length h the states z are the polynomials of order four that satisfy z' = rate at
the four Lobatto points of the motion (Lobatto IIIA, order six, A-stable: Hairer and Wanner,
Solving Ordinary Differential Equations II, sec. IV.5). They are found by
repeated substitution, and where that takes long by Newton's method with the derivative of each
rate by its own state, which serves until it takes long again. Where that does not converge the forces are NaN, and the simulator halves the step.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from dfm_stage.model.kernel.compiled import inlined
from dfm_stage.model.kernel.tables import FROM_VALUES, POINTS

Hook = Callable[..., Any]
carray: Any = numba.carray  # type: ignore[attr-defined]
STAGES = 10
"""Numbers kept for each state: its rates at the four points, its values at the last three, and the
derivatives of the rates by the state there."""
SWEEPS, PATIENCE, SETTLED = 20, 7, 1e-10
"""Repetitions at most, those after which the derivatives are taken anew, and the change over the
size of a state at which they end."""
NUDGE = 1e-6
"""Relative change of a state for such a derivative."""
ONE = 1
_INTEGRALS = np.vander(POINTS, 4, increasing=True) * np.array(POINTS)[:, None] \
    / np.arange(1.0, 5.0) @ FROM_VALUES
"""(3, 4): integrals of the cubic through values at the four points up to each of the later ones,
per step length."""
(A0, A1, A2, A3), (B0, B1, B2, B3), (C0, C1, C2, C3) = _INTEGRALS.tolist()
P1, P2 = POINTS[0], POINTS[1]


TINY = 1e-200
"""A state, or its change in a step, that is nothing."""


@inlined
def _newton(e1: float, e2: float, e3: float, j1: float, j2: float,
            j3: float) -> tuple[float, float, float]:
    """Solve (1 - A diag(j)) d = e for the three later points of one state."""
    if j1 == 0.0 and j2 == 0.0 and j3 == 0.0:
        return e1, e2, e3
    a, b, c = 1.0 - A1 * j1, -A2 * j2, -A3 * j3
    d, e, f = -B1 * j1, 1.0 - B2 * j2, -B3 * j3
    g, k, m = -C1 * j1, -C2 * j2, 1.0 - C3 * j3
    p, q, r = e * m - f * k, f * g - d * m, d * k - e * g
    whole = a * p + b * q + c * r
    return ((p * e1 + (c * k - b * m) * e2 + (b * f - c * e) * e3) / whole,
            (q * e1 + (a * m - c * g) * e2 + (c * d - a * f) * e3) / whole,
            (r * e1 + (b * g - a * k) * e2 + (a * e - b * d) * e3) / whole)


def collocated(hook: Hook, side: Hook, values: Hook, states: int) -> Hook:
    """The machine code of the hooks `flow` and `side` with a number of states."""

    @inlined
    def derivatives(h: float, t: float, x1: float, x2: float, x3: float, v1: float, v2: float,
                    v3: float, d1: float, d2: float, d3: float, u: float, per: float, kept: Any,
                    rate: Any, own: Any) -> None:
        """Those of each rate by its own state at the later points; of no other by it."""
        for j in range(3):
            x, v, d = (x1, x2, x3)[j], (v1, v2, v3)[j], (d1, d2, d3)[j]
            now = t + h * (P1, P2, 1.0)[j]
            z = kept[(4 + j) * states:(5 + j) * states]
            for k in range(states):
                here, found = z[k], kept[(1 + j) * states + k]
                nudge = NUDGE * (abs(here) + abs(h * found))
                kept[(7 + j) * states + k] = 0.0
                if nudge > TINY:
                    z[k] = here + nudge
                    hook(now, x, v, u, per * d, z, rate, own)
                    z[k] = here
                    kept[(7 + j) * states + k] = (rate[k] - found) / nudge

    def still(t: float, h: float, x0: float, x1: float, x2: float, x3: float, v0: float,
              v1: float, v2: float, v3: float, d0: float, d1: float, d2: float, d3: float,
              u: float, per: float, z: Any, moved: Any, stages: Any, p: Any, out: Any,
              count: int, fresh: int) -> float:
        """Return the force (N) at the first point. Of THREE points they go to `out`, and the
        result is 1 where not all points are on one side of every kink, else 0."""
        own, none = values(p), carray(z, (0,))
        if count == ONE:
            return float(hook(t, x0, v0, u, per * d0, none, none, own))
        out[0] = hook(t + P1 * h, x1, v1, u, per * d1, none, none, own)
        out[1] = hook(t + P2 * h, x2, v2, u, per * d2, none, none, own)
        out[2] = hook(t + h, x3, v3, u, per * d3, none, none, own)
        here = side(t, x0, v0, u, per * d0, none, own)
        crossed = (here != side(t + P1 * h, x1, v1, u, per * d1, none, own)
                   or here != side(t + P2 * h, x2, v2, u, per * d2, none, own)
                   or here != side(t + h, x3, v3, u, per * d3, none, own))
        return 1.0 if crossed else 0.0

    def flow(t: float, h: float, x0: float, x1: float, x2: float, x3: float, v0: float,
             v1: float, v2: float, v3: float, d0: float, d1: float, d2: float, d3: float,
             u: float, per: float, z: Any, moved: Any, stages: Any, p: Any, out: Any,
             count: int, fresh: int) -> float:
        """As `still`, and z at the end of the step goes to `moved`. `fresh` begins a new step;
        else `stages` holds what was found for nearly the same motion."""
        own, begin, kept = values(p), carray(z, (states,)), carray(stages, (STAGES * states,))
        r0, r1 = kept[:states], kept[states:2 * states]
        r2, r3 = kept[2 * states:3 * states], kept[3 * states:4 * states]
        z1, z2 = kept[4 * states:5 * states], kept[5 * states:6 * states]
        rate = carray(moved, (states,))
        z3, j1 = kept[6 * states:7 * states], kept[7 * states:8 * states]
        j2, j3 = kept[8 * states:9 * states], kept[9 * states:]
        if count == ONE:
            return float(hook(t, x0, v0, u, per * d0, begin, r0, own))
        if fresh == 1:
            hook(t, x0, v0, u, per * d0, begin, r0, own)
            for k in range(states):
                z1[k] = begin[k] + P1 * h * r0[k]
                z2[k] = begin[k] + P2 * h * r0[k]
                z3[k] = begin[k] + h * r0[k]
        for sweep in range(SWEEPS):
            f1 = hook(t + P1 * h, x1, v1, u, per * d1, z1, r1, own)
            f2 = hook(t + P2 * h, x2, v2, u, per * d2, z2, r2, own)
            f3 = hook(t + h, x3, v3, u, per * d3, z3, r3, own)
            if sweep == PATIENCE:
                derivatives(h, t, x1, x2, x3, v1, v2, v3, d1, d2, d3, u, per, kept, rate, own)
            settled = True
            for k in range(states):
                y1 = begin[k] + h * (A0 * r0[k] + A1 * r1[k] + A2 * r2[k] + A3 * r3[k])
                y2 = begin[k] + h * (B0 * r0[k] + B1 * r1[k] + B2 * r2[k] + B3 * r3[k])
                y3 = begin[k] + h * (C0 * r0[k] + C1 * r1[k] + C2 * r2[k] + C3 * r3[k])
                e1, e2, e3 = _newton(y1 - z1[k], y2 - z2[k], y3 - z3[k],
                                     h * j1[k], h * j2[k], h * j3[k])
                z1[k] += e1
                z2[k] += e2
                z3[k] += e3
                size = abs(begin[k]) + abs(z1[k]) + abs(z2[k]) + abs(z3[k])
                if not abs(e1) + abs(e2) + abs(e3) <= SETTLED * size:
                    settled = False
            if settled:
                out[0], out[1], out[2] = f1, f2, f3
                for k in range(states):
                    moved[k] = z3[k]
                here = side(t, x0, v0, u, per * d0, begin, own)
                crossed = (here != side(t + P1 * h, x1, v1, u, per * d1, z1, own)
                           or here != side(t + P2 * h, x2, v2, u, per * d2, z2, own)
                           or here != side(t + h, x3, v3, u, per * d3, z3, own))
                return 1.0 if crossed else 0.0
        for k in range(states):
            moved[k] = z3[k]
            z1[k] = z2[k] = z3[k] = begin[k]
        out[0] = out[1] = out[2] = np.nan
        return 1.0

    return flow if states else still
