"""One sample of a model with nonlinear forces: exact linear part, collocated force, exact events.

Over a step the force on the driven point is represented by the cubic through its values at the
four Lobatto points; the linear part answers it exactly (see `tables`), and the values are found by
fixed-point iteration (exponential Lobatto collocation, order six in the end point). Where the
cubic does not resolve the force, or the iteration does not contract, the step is halved, down to
2^-depth of the piece; afterwards steps grow again.

Friction and hysteresis act differently in the two directions, so no step crosses a reversal: it
is approached by halving and then located inside the shortest step on the Taylor series of the
state. There the point either sticks, if friction can hold it, or turns. While it sticks, the
constrained linear part is propagated exactly until the force that holds it exceeds the friction,
located in the same way.

Everything lives in the flat array `work`; arguments called node, state, z, ... are first indices.
"""

# ruff: noqa: ARG001
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.kernel.algebra import cubic_at, row_value
from dfm_stage.model.kernel.compiled import inlined, lean
from dfm_stage.model.kernel.events import cell, pushed
from dfm_stage.model.kernel.hooks import (
    bristle_force,
    bristle_steps,
    point_force,
    spring_force,
)
from dfm_stage.model.kernel.memory import at
from dfm_stage.model.kernel.slots import (
    ACTUATOR_FORCES,
    AT_BRISTLE,
    AT_END,
    AT_HEAD,
    AT_NODE,
    AT_ROWS,
    AT_SCRATCH,
    AT_STATE,
    AT_STICK_END,
    AT_STICK_NODE,
    BRISTLED,
    BRISTLES,
    CONSTANT_FORCE,
    CUBIC_PART,
    CURVATURE,
    DEPTH,
    DIRECTED,
    DRY_FRICTION,
    FORCE_CONSTANT,
    FORCED,
    LEVEL,
    LEVELS,
    MODE,
    ORDER,
    POLYNOMIAL,
    ROW_DRIVE,
    ROW_POSITION,
    ROW_VELOCITY,
    SCALE,
    SLOPE,
    STEP,
    TRIED,
)
from dfm_stage.model.kernel.tables import CUBIC, FROM_VALUES, POINT_1, POINT_2

Array = NDArray[np.float64]
Layout = NDArray[np.int64]

UNRESOLVED = 2e-3      # cubic part of the force, over the largest force so far
UNSETTLED = 1e-9      # expected change in the next iteration, over the largest force so far
FAINT = 1e-5           # forces this small beside the actuator's need not be resolved
ITERATIONS = 8
ACCEPTED, TOO_COARSE, REVERSAL = 0, 1, 2
C0, C1, C2, C3 = CUBIC / 20.0
_SLOPE = FROM_VALUES[1] + 2.0 * FROM_VALUES[2] + 3.0 * FROM_VALUES[3]
_BEND = FROM_VALUES[2] + 3.0 * FROM_VALUES[3]
S0, S1, S2, S3 = _SLOPE
B0, B1, B2, B3 = _BEND


@inlined
def _plain_force(on: int, theta: Array, work: Array, x: float, v: float, d: float,
                 z: int) -> float:
    return point_force(on, theta, x, v, d)


@inlined
def _spring_force(on: int, theta: Array, work: Array, x: float, v: float, d: float,
                  z: int) -> float:
    return spring_force(on, theta, x, v, d)


@inlined
def _whole_force(on: int, theta: Array, work: Array, x: float, v: float, d: float,
                 z: int) -> float:
    return point_force(on, theta, x, v, d) + bristle_force(on, theta, work, z, v)


@inlined
def _no_bristles(on: int, theta: Array, work: Array, z: int, dx: float, v0: float, v1: float,
                 after: int) -> None:
    pass


def _slip(force_at: Callable[..., float], move: Callable[..., None]) -> Callable[..., int]:

    @lean
    def slip(on: int, theta: Array, work: Array, n: int, head: int, rows: int, node: int,
             end: int, state: int, z: int, scratch: int, direction: int, directed: bool,
             u: float, force: Array, r0: float, dr: float, last: bool) -> int:
        """Try one step of moving; its end goes to scratch, bristles behind it.

        `force` are the coefficients of the outside force in the sample, of which the step covers
        [r0, r0 + dr]; `last` says that it cannot be halved. What step control needs goes to the
        head.
        """
        e0, e1, e2, e3 = _given(theta, direction, force, r0, dr)
        x0 = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
        v0 = row_value(work, rows + ROW_VELOCITY * (n + 1), state, n, u)
        driven = on & ACTUATOR_FORCES != 0
        d0 = d1 = d2 = d3 = 0.0
        if driven:
            d0 = theta[FORCE_CONSTANT] * row_value(work, rows + ROW_DRIVE * (n + 1), state, n, u)
        f0 = e0 + force_at(on, theta, work, x0, v0, d0, z)
        xa, va, xb, vb, xc, vc = _six(work, n, node, state, u, f0)
        slope, curvature = at(work, head + SLOPE), at(work, head + CURVATURE)
        f1 = f0 + POINT_1 * (slope + POINT_1 * curvature)
        f2 = f0 + POINT_2 * (slope + POINT_2 * curvature)
        f3 = f0 + (slope + curvature)
        largest, settled, before = at(work, head + SCALE), False, 0.0
        p, q, w = node + 9 * (n + 2), node + 9 * (n + 3), node + 9 * (n + 4)
        z1, z2, z3 = scratch + n + BRISTLES, scratch + n + 2 * BRISTLES, scratch + n
        v1 = v2 = v3 = 0.0
        for _ in range(ITERATIONS):
            x1 = xa + (at(work, p) * f1 + at(work, q) * f2 + at(work, w) * f3)
            v1 = va + (at(work, p + 1) * f1 + at(work, q + 1) * f2 + at(work, w + 1) * f3)
            x2 = xb + (at(work, p + 2) * f1 + at(work, q + 2) * f2 + at(work, w + 2) * f3)
            v2 = vb + (at(work, p + 3) * f1 + at(work, q + 3) * f2 + at(work, w + 3) * f3)
            x3 = xc + (at(work, p + 4) * f1 + at(work, q + 4) * f2 + at(work, w + 4) * f3)
            v3 = vc + (at(work, p + 5) * f1 + at(work, q + 5) * f2 + at(work, w + 5) * f3)
            if driven:
                d1 = _drive(work, n, node + 6, state, u, f0, f1, f2, f3)
                d2 = _drive(work, n, node + 7, state, u, f0, f1, f2, f3)
                d3 = _drive(work, n, node + 8, state, u, f0, f1, f2, f3)
            move(on, theta, work, z, x1 - x0, v0, v1, z1)
            move(on, theta, work, z1, x2 - x1, v1, v2, z2)
            move(on, theta, work, z2, x3 - x2, v2, v3, z3)
            g1 = e1 + force_at(on, theta, work, x1, v1, d1, z1)
            g2 = e2 + force_at(on, theta, work, x2, v2, d2, z2)
            g3 = e3 + force_at(on, theta, work, x3, v3, d3, z3)
            change = max(abs(g1 - f1), abs(g2 - f2), abs(g3 - f3))
            f1, f2, f3 = g1, g2, g3
            largest = max(largest, abs(f0), abs(f3))
            allowed = UNSETTLED * largest
            if change * change <= allowed * before or change <= 10.0 * allowed:
                settled = True
                break
            before = change
        if directed and _reverses(direction * v0, direction * v1, direction * v2, direction * v3):
            return REVERSAL
        unresolved = abs(C0 * f0 + C1 * f1 + C2 * f2 + C3 * f3)
        if not last and not (settled and unresolved <= UNRESOLVED * largest):
            return TOO_COARSE
        work[head + CUBIC_PART] = unresolved
        work[head + SCALE] = largest
        work[head + SLOPE] = S0 * f0 + S1 * f1 + S2 * f2 + S3 * f3
        work[head + CURVATURE] = B0 * f0 + B1 * f1 + B2 * f2 + B3 * f3
        _finish(work, n, end, state, scratch, u, f0, f1, f2, f3)
        return ACCEPTED

    return slip


@inlined
def _given(theta: Array, direction: int, force: Array, r0: float,
           dr: float) -> tuple[float, float, float, float]:
    """The forces at the four points that do not depend on the motion, N."""
    e0 = theta[CONSTANT_FORCE] - direction * theta[DRY_FRICTION]
    if force.shape[0] == 0:
        return e0, e0, e0, e0
    return (e0 + cubic_at(force, r0), e0 + cubic_at(force, r0 + POINT_1 * dr),
            e0 + cubic_at(force, r0 + POINT_2 * dr), e0 + cubic_at(force, r0 + dr))


@inlined
def _six(work: Array, n: int, node: int, state: int, u: float,
         f0: float) -> tuple[float, float, float, float, float, float]:
    """Position and velocity at the three points, but for the forces there."""
    t = node + 9 * (n + 1)
    xa, va, xb = at(work, t) * f0, at(work, t + 1) * f0, at(work, t + 2) * f0
    vb, xc, vc = at(work, t + 3) * f0, at(work, t + 4) * f0, at(work, t + 5) * f0
    for j in range(n + 1):
        t = node + 9 * j
        s = u if j == n else at(work, state + j)
        xa += at(work, t) * s
        va += at(work, t + 1) * s
        xb += at(work, t + 2) * s
        vb += at(work, t + 3) * s
        xc += at(work, t + 4) * s
        vc += at(work, t + 5) * s
    return xa, va, xb, vb, xc, vc


@inlined
def _finish(work: Array, n: int, end: int, state: int, scratch: int, u: float, f0: float,
            f1: float, f2: float, f3: float) -> None:
    """The state at the end of the step."""
    t = end + n * n
    for i in range(n):
        total = at(work, t + i) * u + (at(work, t + n + i) * f0 + at(work, t + 2 * n + i) * f1)
        total += at(work, t + 3 * n + i) * f2 + at(work, t + 4 * n + i) * f3
        for j in range(n):
            total += at(work, end + n * j + i) * at(work, state + j)
        work[scratch + i] = total


@inlined
def _drive(work: Array, n: int, column: int, state: int, u: float, f0: float, f1: float,
           f2: float, f3: float) -> float:
    """The actuator's force at one point, N."""
    t = column + 9 * n
    total = at(work, t) * u + at(work, t + 9) * f0 + at(work, t + 18) * f1
    total += at(work, t + 27) * f2 + at(work, t + 36) * f3
    for j in range(n):
        total += at(work, column + 9 * j) * at(work, state + j)
    return total


@inlined
def _reverses(v0: float, v1: float, v2: float, v3: float) -> bool:
    """True if the speed falls below zero, or has a minimum between its ends that may."""
    least = min(v1, v2)
    if least < 0.0 or v3 < 0.0:
        return True
    return least < v0 and least < v3 and least < 0.5 * (max(v0, v3) - least)


spring_slip = _slip(_spring_force, _no_bristles)
smooth_slip = _slip(_plain_force, _no_bristles)
bristle_slip = _slip(_whole_force, bristle_steps)


@lean
def stick(on: int, theta: Array, work: Array, n: int, rows: int, stick_node: int, stick_end: int,
          state: int, z: int, scratch: int, u: float, force: Array, r0: float,
          dr: float) -> int:
    """Try one step of sticking; REVERSAL where friction cannot hold the point all the time."""
    x = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
    rest = theta[CONSTANT_FORCE] + bristle_force(on, theta, work, z, 0.0)
    for i in range(3):
        hold = work[stick_node + 6 * n + i] * u
        drive = work[stick_node + 6 * n + 3 + i] * u
        for j in range(n):
            hold += work[stick_node + 6 * j + i] * work[state + j]
            drive += work[stick_node + 6 * j + 3 + i] * work[state + j]
        push = rest + point_force(on, theta, x, 0.0, drive) - hold
        if force.shape[0] > 0:
            push += cubic_at(force, r0 + dr * (POINT_1 if i == 0 else POINT_2 if i == 1 else 1.0))
        if abs(push) > theta[DRY_FRICTION]:
            return REVERSAL
    for i in range(n):
        total = work[stick_end + n * n + i] * u
        for j in range(n):
            total += work[stick_end + n * j + i] * work[state + j]
        work[scratch + i] = total
    return ACCEPTED


@lean
def advance_piece(on: int, layout: Layout, theta: Array, work: Array, which: int, u: float,
                  force: Array, r0: float, span: float, length: float) -> None:
    """Advance the state over piece `which` of a sample, during which the input is u.

    The piece lasts `length` (s) and covers [r0, r0 + span] of the sample; `force` are the
    coefficients of the outside force, or empty.
    """
    n, head, rows = layout[ORDER], layout[AT_HEAD], layout[AT_ROWS]
    state, z, scratch = layout[AT_STATE], layout[AT_BRISTLE], layout[AT_SCRATCH]
    tables, directed = which * layout[LEVELS], layout[DIRECTED] == 1
    depth, level, mode = (int(at(work, head + DEPTH)), int(at(work, head + LEVEL)),
                          int(at(work, head + MODE)))
    work[head + SCALE] = max(at(work, head + SCALE), FAINT * abs(theta[FORCE_CONSTANT] * u))
    units, position = 1 << depth, 0
    size, h = units >> level, length
    for _ in range(level):
        h *= 0.5
    if h != at(work, head + STEP):
        _rescale(work, head, h / at(work, head + STEP) if at(work, head + STEP) > 0.0 else 0.0)
    dr = span * (h / length)
    while position < units:
        work[head + TRIED] += 1.0
        r = r0 + span * position / units if force.shape[0] > 0 else r0
        table = tables + level
        if directed and mode == 0:
            push = pushed(on, theta, work, n, rows, state, z, u, force, r)
            if abs(push) > theta[DRY_FRICTION]:
                mode = 1 if push > 0.0 else -1
                _rescale(work, head, 0.0)
                continue
            outcome = stick(on, theta, work, n, rows, layout[AT_STICK_NODE] + 6 * (n + 1) * table,
                            layout[AT_STICK_END] + n * (n + 1) * table, state, z, scratch, u,
                            force, r, dr)
            work[head + CUBIC_PART] = 0.0
        elif on & FORCED & ~POLYNOMIAL == 0:
            outcome = spring_slip(
                on, theta, work, n, head, rows, layout[AT_NODE] + 9 * (n + 5) * table,
                layout[AT_END] + n * (n + 5) * table, state, z, scratch, mode, directed, u, force,
                r, dr, level == depth)
        elif on & BRISTLED:
            outcome = bristle_slip(
                on, theta, work, n, head, rows, layout[AT_NODE] + 9 * (n + 5) * table,
                layout[AT_END] + n * (n + 5) * table, state, z, scratch, mode, directed, u, force,
                r, dr, level == depth)
        else:
            outcome = smooth_slip(
                on, theta, work, n, head, rows, layout[AT_NODE] + 9 * (n + 5) * table,
                layout[AT_END] + n * (n + 5) * table, state, z, scratch, mode, directed, u, force,
                r, dr, level == depth)
        if outcome != ACCEPTED and level < depth:
            level, size, h, dr = level + 1, size >> 1, 0.5 * h, 0.5 * dr
            _rescale(work, head, 0.5)
            continue
        if outcome == REVERSAL:
            mode = cell(on, theta, work, layout, u, force, r, dr, h, mode)
            _rescale(work, head, 0.0)
        else:
            for i in range(n):
                work[state + i] = at(work, scratch + i)
            if on & BRISTLED and mode != 0:
                for i in range(BRISTLES):
                    work[z + i] = at(work, scratch + n + i)
        position += size
        if (level > 0 and position % (2 * size) == 0
                and 16.0 * at(work, head + CUBIC_PART) <= UNRESOLVED * at(work, head + SCALE)):
            level, size, h, dr = level - 1, size << 1, 2.0 * h, 2.0 * dr
            _rescale(work, head, 2.0)
    work[head + LEVEL], work[head + MODE], work[head + STEP] = level, mode, h


@inlined
def _rescale(work: Array, head: int, ratio: float) -> None:
    """Slope and curvature of the force per step, for a step longer by `ratio`; 0 forgets them."""
    work[head + SLOPE] *= ratio
    work[head + CURVATURE] *= ratio * ratio
