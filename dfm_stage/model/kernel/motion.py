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

from __future__ import annotations

from math import inf

from dfm_stage.model.kernel.algebra import cubic_at, outside, row_value
from dfm_stage.model.kernel.collocated import FEW, SWEEPS
from dfm_stage.model.kernel.collocated import UNSETTLED as UNSETTLED_STATES
from dfm_stage.model.kernel.compiled import at, inlined, lean, pointer
from dfm_stage.model.kernel.events import bristle_force, cell, friction, pushed
from dfm_stage.model.kernel.flows import flow_force, flow_steps
from dfm_stage.model.kernel.hooks import THREE, call_bristle, call_force, point_force
from dfm_stage.model.kernel.slots import (
    AT_BRISTLE,
    AT_END,
    AT_HEAD,
    AT_NODE,
    AT_ROWS,
    AT_SCRATCH,
    AT_STATE,
    AT_STICK_END,
    AT_STICK_NODE,
    BRISTLE_STEPS,
    BRISTLES,
    CODE,
    CONSTANT_FORCE,
    CUBIC_PART,
    CURVATURE,
    DEPTH,
    DIRECTED,
    DRY_FRICTION,
    ENTRY,
    FIRST,
    FLOWS,
    FORCE_CONSTANT,
    FORCES,
    FRICTIONS,
    KEPT,
    LEVEL,
    LEVELS,
    MODE,
    NOW,
    ORDER,
    OUT,
    OWN,
    ROW_DRIVE,
    ROW_POSITION,
    ROW_VELOCITY,
    SCALE,
    SLOPE,
    SPAN,
    STEP,
    TRIED,
    USES_DRIVE,
    USES_SPEED,
    Array,
    Layout,
)
from dfm_stage.model.kernel.tables import CUBIC, FROM_VALUES, POINT_1, POINT_2, POINTS

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]

UNRESOLVED = 2e-3      # cubic part of the force, over the largest force so far
UNSETTLED = 1e-9      # expected change in the next iteration, over the largest force so far
FAINT = 1e-5           # forces this small beside the actuator's need not be resolved
ITERATIONS = 8
PATIENT = 3            # iterations after which the states of flows are made to settle
ACCEPTED, TOO_COARSE, REVERSAL = 0, 1, 2
C0, C1, C2, C3 = CUBIC / 20.0
_SLOPE = FROM_VALUES[1] + 2.0 * FROM_VALUES[2] + 3.0 * FROM_VALUES[3]
_BEND = FROM_VALUES[2] + 3.0 * FROM_VALUES[3]
S0, S1, S2, S3 = _SLOPE
B0, B1, B2, B3 = _BEND


@inlined
def slip(layout: Layout, theta: Array, work: Array, table: int, direction: int, u: float,
         force: Array, r0: float, dr: float, last: bool) -> int:
    """Try one step of moving; its end goes to scratch, bristles behind it.

    `force` are the coefficients of the outside force in the sample, of which the step covers
    [r0, r0 + dr]; `last` says that it cannot be halved. What step control needs goes to the head.
    """
    n, head, rows = at(layout, ORDER), at(layout, AT_HEAD), at(layout, AT_ROWS)
    state, directed = at(layout, AT_STATE), at(layout, DIRECTED) == 1
    e0, e1, e2, e3 = _given(theta, direction, force, r0, dr)
    x0 = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
    v0 = row_value(work, rows + ROW_VELOCITY * (n + 1), state, n, u)
    f0 = e0 + _force_now(layout, theta, work, x0, v0, u, direction)
    f1, f2, f3, v1, v2, v3, largest, settled = _collocated(
        layout, theta, work, at(layout, AT_NODE) + 9 * (n + 5) * table, x0, v0, u, f0,
        (e1, e2, e3), direction)
    if directed and _reverses(direction * v0, direction * v1, direction * v2, direction * v3):
        return REVERSAL
    unresolved = abs(C0 * f0 + C1 * f1 + C2 * f2 + C3 * f3)
    # an iteration that overflows is no answer, though infinity is within any share of infinity
    if not last and not (settled and unresolved <= UNRESOLVED * largest < inf):
        return TOO_COARSE
    work[head + CUBIC_PART] = unresolved
    work[head + SCALE] = largest
    work[head + SLOPE] = S0 * f0 + S1 * f1 + S2 * f2 + S3 * f3
    work[head + CURVATURE] = B0 * f0 + B1 * f1 + B2 * f2 + B3 * f3
    _finish(work, n, at(layout, AT_END) + n * (n + 5) * table, state, at(layout, AT_SCRATCH), u,
            f0, f1, f2, f3)
    return ACCEPTED


@inlined
def _force_now(layout: Layout, theta: Array, work: Array, x: float, v: float, u: float,
               direction: int) -> float:
    """The force of the effects at the beginning of a step, N."""
    n, drive = at(layout, ORDER), 0.0
    if at(layout, USES_DRIVE) == 1:
        row = at(layout, AT_ROWS) + ROW_DRIVE * (n + 1)
        drive = theta[FORCE_CONSTANT] * row_value(work, row, at(layout, AT_STATE), n, u)
    force = point_force(layout, theta, FORCES, x, v, drive)
    if at(layout, FRICTIONS) < at(layout, BRISTLE_STEPS + 1):   # the two stand side by side
        force += (bristle_force(layout, theta, work, v)
                  - direction * point_force(layout, theta, FRICTIONS, x, v, drive))
    if at(layout, FLOWS) < at(layout, FLOWS + 1):
        force += flow_force(layout, theta, work, x, v, drive, u, 0.0, at(layout, AT_BRISTLE))
    return force


@inlined
def _collocated(layout: Layout, theta: Array, work: Array, node: int, x0: float, v0: float,
                u: float, f0: float, given: Three, direction: int) -> tuple[
                    float, float, float, float, float, float, float, bool]:
    """Find the forces at the three later points: these, the speeds there, the largest force so
    far, and whether the iteration has settled on a force without a kink. `given` does not depend
    on the motion.
    """
    n, head, state = at(layout, ORDER), at(layout, AT_HEAD), at(layout, AT_STATE)
    speed = at(layout, USES_SPEED) == 1
    xa, va, xb, vb, xc, vc = _six(work, n, node, state, u, f0)
    slope, curvature = at(work, head + SLOPE), at(work, head + CURVATURE)
    f1 = f0 + POINT_1 * (slope + POINT_1 * curvature)
    f2 = f0 + POINT_2 * (slope + POINT_2 * curvature)
    f3 = f0 + (slope + curvature)
    largest, settled, before = at(work, head + SCALE), False, 0.0
    p, q, w = node + 9 * (n + 2), node + 9 * (n + 3), node + 9 * (n + 4)
    v1 = v2 = v3 = d0 = crossed = 0.0
    flows = at(layout, FLOWS) < at(layout, FLOWS + 1)
    if flows and at(layout, USES_DRIVE) == 1:
        d0 = theta[FORCE_CONSTANT] * row_value(
            work, at(layout, AT_ROWS) + ROW_DRIVE * (n + 1), state, n, u)
    for iteration in range(ITERATIONS):
        x1 = xa + (at(work, p) * f1 + at(work, q) * f2 + at(work, w) * f3)
        x2 = xb + (at(work, p + 2) * f1 + at(work, q + 2) * f2 + at(work, w + 2) * f3)
        x3 = xc + (at(work, p + 4) * f1 + at(work, q + 4) * f2 + at(work, w + 4) * f3)
        if speed:
            v1 = va + (at(work, p + 1) * f1 + at(work, q + 1) * f2 + at(work, w + 1) * f3)
            v2 = vb + (at(work, p + 3) * f1 + at(work, q + 3) * f2 + at(work, w + 3) * f3)
            v3 = vc + (at(work, p + 5) * f1 + at(work, q + 5) * f2 + at(work, w + 5) * f3)
        d = _drives(layout, work, node + 6, u, (f0, f1, f2, f3))
        g1, g2, g3 = _three_forces(layout, theta, work, (x0, x1, x2, x3), (v0, v1, v2, v3), d,
                                   direction)
        if flows:
            e1, e2, e3, crossed = flow_steps(
                layout, theta, work, (x0, x1, x2, x3), (v0, v1, v2, v3), (d0, d[0], d[1], d[2]), u,
                at(work, head + SPAN),
                -FEW if iteration == 0 else FEW if iteration < PATIENT else SWEEPS)
            g1, g2, g3 = g1 + e1, g2 + e2, g3 + e3
        g1, g2, g3 = given[0] + g1, given[1] + g2, given[2] + g3
        change = max(abs(g1 - f1), abs(g2 - f2), abs(g3 - f3))
        f1, f2, f3 = g1, g2, g3
        largest = max(largest, abs(f0), abs(f3))
        allowed = UNSETTLED * largest
        if crossed < UNSETTLED_STATES and (change * change <= allowed * before
                                           or change <= 10.0 * allowed):
            settled = True
            break
        before = change
    return f1, f2, f3, v1, v2, v3, largest, settled and crossed == 0.0


@inlined
def _three_forces(layout: Layout, theta: Array, work: Array, x: Four, v: Four,
                  d: Three, direction: int) -> Three:
    """The forces of the effects at the three later points of a step, N."""
    g1 = g2 = g3 = 0.0
    out = at(layout, AT_HEAD) + OUT
    for entry in range(at(layout, FORCES), at(layout, FORCES + 1), ENTRY):
        g1 += call_force(at(layout, entry + CODE), (
            x[1], x[2], x[3], v[1], v[2], v[3], d[0], d[1], d[2],
            pointer(theta, at(layout, entry + OWN)), pointer(work, out), THREE))
        g2 += at(work, out)
        g3 += at(work, out + 1)
    if at(layout, FRICTIONS) == at(layout, BRISTLE_STEPS + 1):  # the two stand side by side
        return g1, g2, g3
    for entry in range(at(layout, FRICTIONS), at(layout, FRICTIONS + 1), ENTRY):
        g1 -= direction * call_force(at(layout, entry + CODE), (
            x[1], x[2], x[3], v[1], v[2], v[3], d[0], d[1], d[2],
            pointer(theta, at(layout, entry + OWN)), pointer(work, out), THREE))
        g2 -= direction * at(work, out)
        g3 -= direction * at(work, out + 1)
    z, moved = at(layout, AT_BRISTLE), at(layout, AT_SCRATCH) + at(layout, ORDER)
    for entry in range(at(layout, BRISTLE_STEPS), at(layout, BRISTLE_STEPS + 1), ENTRY):
        own = at(layout, entry + FIRST)
        work[moved + own] = call_bristle(at(layout, entry + CODE), (
            at(work, z + own), x[1] - x[0], x[2] - x[1], x[3] - x[2], v[0], v[1], v[2], v[3],
            pointer(theta, at(layout, entry + OWN)), pointer(work, out), THREE))
        g1 += at(work, out)
        g2 += at(work, out + 1)
        g3 += at(work, out + 2)
    return g1, g2, g3


@inlined
def _given(theta: Array, direction: int, force: Array, r0: float, dr: float) -> Four:
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
def _drives(layout: Layout, work: Array, column: int, u: float, f: Four) -> Three:
    """The actuator's force at the three later points, N; zero where no effect asks for it."""
    if at(layout, USES_DRIVE) == 0:
        return 0.0, 0.0, 0.0
    n, state = at(layout, ORDER), at(layout, AT_STATE)
    return (_drive(work, n, column, state, u, f), _drive(work, n, column + 1, state, u, f),
            _drive(work, n, column + 2, state, u, f))


@inlined
def _drive(work: Array, n: int, column: int, state: int, u: float, f: Four) -> float:
    """The actuator's force at one point, N."""
    t = column + 9 * n
    total: float = at(work, t) * u + at(work, t + 9) * f[0] + at(work, t + 18) * f[1]
    total += at(work, t + 27) * f[2] + at(work, t + 36) * f[3]
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


@lean
def stick(layout: Layout, theta: Array, work: Array, table: int, u: float, force: Array,
          r0: float, dr: float) -> int:
    """Try one step of sticking; REVERSAL where friction cannot hold the point all the time."""
    n, state, scratch = layout[ORDER], layout[AT_STATE], layout[AT_SCRATCH]
    node = layout[AT_STICK_NODE] + 6 * (n + 1) * table
    end = layout[AT_STICK_END] + n * (n + 1) * table
    x = row_value(work, layout[AT_ROWS] + ROW_POSITION * (n + 1), state, n, u)
    rest = theta[CONSTANT_FORCE] + bristle_force(layout, theta, work, 0.0)
    flowing = (0.0, 0.0, 0.0, 0.0)
    if layout[FLOWS] < layout[FLOWS + 1]:
        flowing = flow_steps(layout, theta, work, (x, x, x, x), (0.0, 0.0, 0.0, 0.0),
                             _stuck_drives(layout, theta, work, node, u), u,
                             work[layout[AT_HEAD] + SPAN], -SWEEPS)
    for i in range(3):
        hold = work[node + 6 * n + i] * u
        drive = work[node + 6 * n + 3 + i] * u
        for j in range(n):
            hold += work[node + 6 * j + i] * work[state + j]
            drive += work[node + 6 * j + 3 + i] * work[state + j]
        push = (rest + point_force(layout, theta, FORCES, x, 0.0, drive) - hold
                + flowing[i] + outside(force, r0 + dr * POINTS[i]))
        dry = friction(layout, theta, x, 0.0, drive)
        if not abs(push) <= dry:                        # not a number is no answer
            return REVERSAL
    for i in range(n):
        total = work[end + n * n + i] * u
        for j in range(n):
            total += work[end + n * j + i] * work[state + j]
        work[scratch + i] = total
    return ACCEPTED


@inlined
def _stuck_drives(layout: Layout, theta: Array, work: Array, node: int, u: float) -> Four:
    """The actuator's force (N) at the four points of a step of sticking."""
    n, state = layout[ORDER], layout[AT_STATE]
    row = layout[AT_ROWS] + ROW_DRIVE * (n + 1)
    d0 = theta[FORCE_CONSTANT] * row_value(work, row, state, n, u)
    d1, d2, d3 = work[node + 6 * n + 3] * u, work[node + 6 * n + 4] * u, work[node + 6 * n + 5] * u
    for j in range(n):
        d1 += work[node + 6 * j + 3] * work[state + j]
        d2 += work[node + 6 * j + 4] * work[state + j]
        d3 += work[node + 6 * j + 5] * work[state + j]
    return d0, d1, d2, d3


@lean
def advance_piece(layout: Layout, theta: Array, work: Array, which: int, u: float, force: Array,
                  r0: float, span: float, length: float) -> None:
    """Advance the state over piece `which` of a sample, during which the input is u.

    The piece lasts `length` (s) and covers [r0, r0 + span] of the sample; `force` are the
    coefficients of the outside force, or empty.
    """
    head, directed = layout[AT_HEAD], layout[DIRECTED] == 1
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
    begin = work[head + NOW]
    while position < units:
        work[head + TRIED] += 1.0
        work[head + NOW], work[head + SPAN] = begin + length * position / units, h
        r = r0 + span * position / units if force.shape[0] > 0 else r0
        table = which * layout[LEVELS] + level
        if directed and mode == 0:
            push = pushed(layout, theta, work, u, force, r)
            if push != 0.0:
                mode = 1 if push > 0.0 else -1
                _rescale(work, head, 0.0)
                continue
            outcome = stick(layout, theta, work, table, u, force, r, dr)
            work[head + CUBIC_PART] = 0.0
        else:
            outcome = slip(layout, theta, work, table, mode, u, force, r, dr, level == depth)
        if outcome != ACCEPTED and level < depth:
            level, size, h, dr = level + 1, size >> 1, 0.5 * h, 0.5 * dr
            _rescale(work, head, 0.5)
            continue
        if outcome == REVERSAL:
            mode = cell(layout, theta, work, u, force, r, dr, h, mode)
            _rescale(work, head, 0.0)
        else:
            _accept(layout, work, mode)
        position += size
        if (level > 0 and position % (2 * size) == 0
                and 16.0 * at(work, head + CUBIC_PART) <= UNRESOLVED * at(work, head + SCALE)):
            level, size, h, dr = level - 1, size << 1, 2.0 * h, 2.0 * dr
            _rescale(work, head, 2.0)
    work[head + LEVEL], work[head + MODE], work[head + STEP] = level, mode, h


@inlined
def _accept(layout: Layout, work: Array, mode: int) -> None:
    """Go to the end of the step that was tried; the bristles stay where the point sticks."""
    state, scratch = at(layout, AT_STATE), at(layout, AT_SCRATCH)
    n, kept = at(layout, ORDER), at(layout, KEPT)
    for i in range(n + (kept if mode != 0 else 0)):     # the bristles stand behind the state
        work[state + i] = at(work, scratch + i)
    for i in range(n + kept, n + at(layout, BRISTLES)):     # and the states of flows behind them
        work[state + i] = at(work, scratch + i)


@inlined
def _rescale(work: Array, head: int, ratio: float) -> None:
    """Slope and curvature of the force per step, for a step longer by `ratio`; 0 forgets them."""
    work[head + SLOPE] *= ratio
    work[head + CURVATURE] *= ratio * ratio
