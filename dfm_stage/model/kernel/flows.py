"""Forces with time, command, current and states of their own, where the motion has come to.

The time at the beginning of a step and its length stand in the head of `work`.
"""

from __future__ import annotations

from dfm_stage.model.kernel.collocated import ONE, STAGES, SWEEPS
from dfm_stage.model.kernel.compiled import at, inlined, pointer
from dfm_stage.model.kernel.hooks import THREE, call_flow
from dfm_stage.model.kernel.slots import (
    AMPERES,
    AT_BRISTLE,
    AT_HEAD,
    AT_SCRATCH,
    AT_STAGES,
    CODE,
    ENTRY,
    FIRST,
    FLOWS,
    NOW,
    ORDER,
    OUT,
    OWN,
    Array,
    Layout,
)
from dfm_stage.model.kernel.tables import POINT_1, POINT_2

Four = tuple[float, float, float, float]


@inlined
def flow_force(layout: Layout, theta: Array, work: Array, x: float, v: float, d: float,
               u: float, later: float, z: int) -> float:
    """The force of all flows at one point, N, `later` (s) than the beginning of the step; their
    states stand at work[z:], behind the bristles. `d` is the actuator's force."""
    total = 0.0
    head = at(layout, AT_HEAD)
    for entry in range(at(layout, FLOWS), at(layout, FLOWS + 1), ENTRY):
        own = at(layout, entry + FIRST)
        states = pointer(work, z + own)
        total += call_flow(at(layout, entry + CODE), (
            at(work, head + NOW) + later, 0.0, x, x, x, x, v, v, v, v, d, d, d, d, u,
            at(work, head + AMPERES), states, states,
            pointer(work, at(layout, AT_STAGES) + STAGES * own),
            pointer(theta, at(layout, entry + OWN)), pointer(work, head + OUT), ONE, 0))
    return total


@inlined
def flow_steps(layout: Layout, theta: Array, work: Array, x: Four, v: Four, d: Four, u: float,
               h: float, sweeps: int) -> Four:
    """Move the states of all flows on by h (s), to scratch; the forces at the three later points
    of the step, N, and how many flows have a kink in the step, or more than UNSETTLED. For
    `sweeps` see `collocated`; `flow_force` at the beginning of the step comes before."""
    g1 = g2 = g3 = crossed = 0.0
    head = at(layout, AT_HEAD)
    z, moved = at(layout, AT_BRISTLE), at(layout, AT_SCRATCH) + at(layout, ORDER)
    for entry in range(at(layout, FLOWS), at(layout, FLOWS + 1), ENTRY):
        own = at(layout, entry + FIRST)
        crossed += call_flow(at(layout, entry + CODE), (
            at(work, head + NOW), h, x[0], x[1], x[2], x[3], v[0], v[1], v[2], v[3],
            d[0], d[1], d[2], d[3], u, at(work, head + AMPERES), pointer(work, z + own),
            pointer(work, moved + own), pointer(work, at(layout, AT_STAGES) + STAGES * own),
            pointer(theta, at(layout, entry + OWN)), pointer(work, head + OUT), THREE, sweeps))
        g1 += at(work, head + OUT)
        g2 += at(work, head + OUT + 1)
        g3 += at(work, head + OUT + 2)
    return g1, g2, g3, crossed


@inlined
def flow_ends(layout: Layout, theta: Array, work: Array, x: float, x_end: float, v: float,
              v_end: float, d: float, d_end: float, u: float, h: float) -> float:
    """As `flow_steps` for a step of which both ends are known; the force at its end, N. Between
    them the position is the cubic through both, with their speeds."""
    rise, s0, s1 = x_end - x, h * v, h * v_end
    c2, c3 = 3.0 * rise - 2.0 * s0 - s1, s0 + s1 - 2.0 * rise
    x1 = x + POINT_1 * (s0 + POINT_1 * (c2 + POINT_1 * c3))
    x2 = x + POINT_2 * (s0 + POINT_2 * (c2 + POINT_2 * c3))
    return flow_steps(layout, theta, work, (x, x1, x2, x_end), (
        v, v + POINT_1 * (v_end - v), v + POINT_2 * (v_end - v), v_end), (
        d, d + POINT_1 * (d_end - d), d + POINT_2 * (d_end - d), d_end), u, h, -SWEEPS)[2]
