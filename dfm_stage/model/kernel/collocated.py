"""The machine code of a `flow`: a force with states of its own, along a step of the motion.

Over a step of length h the states z are the polynomials of order four that satisfy z' = rate at
the four Lobatto points of the motion (Lobatto IIIA, order six, A-stable: Hairer and Wanner,
Solving Ordinary Differential Equations II, sec. IV.5). They are found by repeated substitution,
and where that takes long by Newton's method with the derivative of each rate by its own state,
which serves until it takes long again. Where that does not converge the forces are NaN, and the
simulator halves the step.
"""

# ruff: noqa: ARG001 (all have one signature, whether or not they use all of it)
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
SWEEPS, PATIENCE, SETTLED = 20, 3, 1e-10
"""Repetitions at most, those after which the derivatives are taken anew, and the change over the
size of a state at which they end."""
FEW = 5
"""Repetitions while the motion itself is not settled."""
UNSETTLED = 100.0
"""More than the kinks of all flows."""
NUDGE = 1e-6
"""Relative change of a state for such a derivative."""
TINY = 1e-200
"""A state, or its change in a step, that is nothing."""
ONE = 1
_INTEGRALS = np.vander(POINTS, 4, increasing=True) * np.array(POINTS)[:, None] \
    / np.arange(1.0, 5.0) @ FROM_VALUES
"""(3, 4): integrals of the cubic through values at the four points up to each of the later ones,
per step length."""
(A0, A1, A2, A3), (B0, B1, B2, B3), (C0, C1, C2, C3) = _INTEGRALS.tolist()
P1, P2 = POINTS[0], POINTS[1]
Three = tuple[float, float, float]


def collocated(hook: Hook, side: Hook, values: Hook, states: int) -> Hook:
    """The machine code of the hooks `flow` and `side` with a number of states.

    It returns the force (N) at the first point. Of THREE points they go to `out`, and the result
    is 1 where not all points are on one side of every kink, else 0; z at the end of the step goes
    to `moved`, and where it has not settled after `sweeps` the result is UNSETTLED. A negative
    number of sweeps begins a new step, at the point that the force was last asked for; else
    `stages` holds what was found for nearly the same motion. `per` is amperes per newton of the
    actuator's forces d.
    """
    return _with_states(hook, side, values, states) if states else _without(hook, side, values)


def _without(hook: Hook, side: Hook, values: Hook) -> Hook:
    def still(t: float, h: float, x0: float, x1: float, x2: float, x3: float, v0: float,
              v1: float, v2: float, v3: float, d0: float, d1: float, d2: float, d3: float,
              u: float, per: float, z: Any, moved: Any, stages: Any, p: Any, out: Any,
              count: int, sweeps: int) -> float:
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

    return still


def _with_states(hook: Hook, side: Hook, values: Hook, states: int) -> Hook:
    derivatives, improve = _derivatives(hook, states), _improve(states)

    def flow(t: float, h: float, x0: float, x1: float, x2: float, x3: float, v0: float,
             v1: float, v2: float, v3: float, d0: float, d1: float, d2: float, d3: float,
             u: float, per: float, z: Any, moved: Any, stages: Any, p: Any, out: Any,
             count: int, sweeps: int) -> float:
        own, begin, rate = values(p), carray(z, (states,)), carray(moved, (states,))
        kept = carray(stages, (STAGES * states,))
        r0, r1 = kept[:states], kept[states:2 * states]
        r2, r3 = kept[2 * states:3 * states], kept[3 * states:4 * states]
        z1, z2 = kept[4 * states:5 * states], kept[5 * states:6 * states]
        z3 = kept[6 * states:7 * states]
        if count == ONE:
            return float(hook(t, x0, v0, u, per * d0, begin, r0, own))
        if sweeps < 0:
            for k in range(states):
                z1[k] = begin[k] + P1 * h * r0[k]
                z2[k] = begin[k] + P2 * h * r0[k]
                z3[k] = begin[k] + h * r0[k]
        for sweep in range(abs(sweeps)):
            out[0] = hook(t + P1 * h, x1, v1, u, per * d1, z1, r1, own)
            out[1] = hook(t + P2 * h, x2, v2, u, per * d2, z2, r2, own)
            out[2] = hook(t + h, x3, v3, u, per * d3, z3, r3, own)
            if sweep == PATIENCE:
                derivatives(h, t, (x1, x2, x3), (v1, v2, v3), (per * d1, per * d2, per * d3), u,
                            kept, rate, own)
            if improve(h, begin, kept):
                for k in range(states):
                    moved[k] = z3[k]
                here = side(t, x0, v0, u, per * d0, begin, own)
                crossed = (here != side(t + P1 * h, x1, v1, u, per * d1, z1, own)
                           or here != side(t + P2 * h, x2, v2, u, per * d2, z2, own)
                           or here != side(t + h, x3, v3, u, per * d3, z3, own))
                return 1.0 if crossed else 0.0
        for k in range(states):
            moved[k] = z3[k]
        if abs(sweeps) == SWEEPS:
            out[0] = out[1] = out[2] = np.nan
        return UNSETTLED

    return flow


def _improve(states: int) -> Hook:
    @inlined
    def improve(h: float, begin: Any, kept: Any) -> bool:
        """Take the states at the later points from the rates there; whether they have settled."""
        settled = True
        for k in range(states):
            r0, r1, r2, r3 = (kept[k], kept[states + k], kept[2 * states + k],
                              kept[3 * states + k])
            at1, at2, at3 = 4 * states + k, 5 * states + k, 6 * states + k
            e1, e2, e3 = _newton(
                begin[k] + h * (A0 * r0 + A1 * r1 + A2 * r2 + A3 * r3) - kept[at1],
                begin[k] + h * (B0 * r0 + B1 * r1 + B2 * r2 + B3 * r3) - kept[at2],
                begin[k] + h * (C0 * r0 + C1 * r1 + C2 * r2 + C3 * r3) - kept[at3],
                h * kept[7 * states + k], h * kept[8 * states + k], h * kept[9 * states + k])
            kept[at1] += e1
            kept[at2] += e2
            kept[at3] += e3
            size = abs(begin[k]) + abs(kept[at1]) + abs(kept[at2]) + abs(kept[at3])
            if not abs(e1) + abs(e2) + abs(e3) <= SETTLED * size:
                settled = False
        return settled

    return improve


def _derivatives(hook: Hook, states: int) -> Hook:
    @inlined
    def derivatives(h: float, t: float, x: Three, v: Three, i: Three, u: float, kept: Any,
                    rate: Any, own: Any) -> None:
        """Those of each rate by its own state at the later points, by differences."""
        for j in range(3):
            z = kept[(4 + j) * states:(5 + j) * states]
            for k in range(states):
                here, found = z[k], kept[(1 + j) * states + k]
                nudge = NUDGE * (abs(here) + abs(h * found))
                kept[(7 + j) * states + k] = 0.0
                if nudge > TINY:
                    z[k] = here + nudge
                    hook(t + h * (P1, P2, 1.0)[j], x[j], v[j], u, i[j], z, rate, own)
                    z[k] = here
                    kept[(7 + j) * states + k] = (rate[k] - found) / nudge

    return derivatives


@inlined
def _newton(e1: float, e2: float, e3: float, j1: float, j2: float, j3: float) -> Three:
    """Solve (1 - A diag(j)) d = e for the three later points of one state, by Cramer's rule."""
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
