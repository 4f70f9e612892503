"""Reversal, sticking and breakaway inside the shortest step, located on Taylor series."""

from __future__ import annotations

from dfm_stage.model.kernel.algebra import outside, row_value
from dfm_stage.model.kernel.compiled import inlined, lean
from dfm_stage.model.kernel.flows import flow_ends, flow_force
from dfm_stage.model.kernel.hooks import bristle_steps, point_force
from dfm_stage.model.kernel.slots import (
    AT_A,
    AT_BRISTLE,
    AT_HEAD,
    AT_HELD,
    AT_ROWS,
    AT_SCRATCH,
    AT_STATE,
    BRISTLES,
    CONSTANT_FORCE,
    DRY_FRICTION,
    FORCE_CONSTANT,
    FORCES,
    FRICTIONS,
    KEPT,
    NOW,
    ORDER,
    OUT,
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_HOLD,
    ROW_POSITION,
    ROW_VELOCITY,
    STEPS,
    Array,
    Layout,
)

TERMS = 12
EVENTS = 6


@inlined
def bristle_force(layout: Layout, theta: Array, work: Array, v: float) -> float:
    """The force of the effects with memory where the point is now, N."""
    z = layout[AT_BRISTLE]
    return bristle_steps(layout, theta, work, z, 0.0, v, v, z, layout[AT_HEAD] + OUT)


@inlined
def friction(layout: Layout, theta: Array, x: float, v: float, d: float) -> float:
    """The size of the dry friction at one point, N; `d` is the actuator's force."""
    return float(theta[DRY_FRICTION] + point_force(layout, theta, FRICTIONS, x, v, d))


@inlined
def beyond(push: float, dry: float) -> float:
    """The part of a force at rest that dry friction does not hold, N."""
    if push > dry:
        return push - dry
    return push + dry if push < -dry else 0.0


@lean
def pushed(layout: Layout, theta: Array, work: Array, u: float, force: Array,
           r: float) -> float:
    """The force that dry friction does not hold at rest, N; the point moves that way."""
    n, rows, state = layout[ORDER], layout[AT_ROWS], layout[AT_STATE]
    x = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
    drive = theta[FORCE_CONSTANT] * row_value(work, rows + ROW_DRIVE * (n + 1), state, n, u)
    push: float = (theta[CONSTANT_FORCE] + bristle_force(layout, theta, work, 0.0)
            + point_force(layout, theta, FORCES, x, 0.0, drive)
            + flow_force(layout, theta, work, x, 0.0, drive, u, 0.0, layout[AT_BRISTLE])
            - row_value(work, rows + ROW_HOLD * (n + 1), state, n, u)) + outside(force, r)
    return beyond(push, friction(layout, theta, x, 0.0, drive))


@lean
def cell(layout: Layout, theta: Array, work: Array, u: float, force: Array, r0: float,
         dr: float, length: float, mode: int) -> int:
    """Advance the state over the shortest step, of `length` (s), with the events in it.

    `force` and [r0, r0 + dr] as in `motion.slip`. Returns the mode at its end.
    """
    n, rows, state = layout[ORDER], layout[AT_ROWS], layout[AT_STATE]
    steps, now, rate = layout[AT_HEAD] + STEPS, layout[AT_HEAD] + NOW, dr / length
    done = 0.0
    for event in range(EVENTS):
        left = length - done
        if left <= 0.0:
            break
        work[steps] += 1.0
        start, last = r0 + rate * done, event == EVENTS - 1
        if mode == 0:
            taken, mode = _held(layout, theta, work, u, force, start, rate, left, last)
            done += taken
            work[now] += taken
            continue
        taken = _moving(layout, theta, work, u, force, start, rate, left, mode, last)
        done += taken
        work[now] += taken
        if taken < left:
            _halt(work, n, rows, state, u)
            push = pushed(layout, theta, work, u, force, r0 + rate * done)
            mode = 0 if push == 0.0 else (1 if push > 0.0 else -1)
    speed = row_value(work, rows + ROW_VELOCITY * (n + 1), state, n, u)
    if mode != 0 and mode * speed < 0.0:
        _halt(work, n, rows, state, u)
        mode = 0
    return mode


@lean
def _held(layout: Layout, theta: Array, work: Array, u: float, force: Array,
          start: float, rate: float, left: float, last: bool) -> tuple[float, int]:
    """Stick until the end or until breakaway; the time taken (s) and the mode then."""
    n, rows, state = layout[ORDER], layout[AT_ROWS], layout[AT_STATE]
    end = layout[AT_SCRATCH]
    terms = end + n + layout[BRISTLES]
    series = terms + n * TERMS
    drive_row = rows + ROW_DRIVE * (n + 1)
    _series(work, n, layout[AT_HELD], -1, state, u, 0.0, 0.0, terms)
    _scalar(work, n, rows + ROW_HOLD * (n + 1), terms, u, series)
    _at(work, n, terms, left, end)
    x = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
    drive = theta[FORCE_CONSTANT] * row_value(work, drive_row, state, n, u)
    drive_end = theta[FORCE_CONSTANT] * row_value(work, drive_row, end, n, u)
    z, moved = layout[AT_BRISTLE], end + n
    f = (point_force(layout, theta, FORCES, x, 0.0, drive) + outside(force, start)
         + flow_force(layout, theta, work, x, 0.0, drive, u, 0.0, z))
    f_end = (point_force(layout, theta, FORCES, x, 0.0, drive_end)
             + outside(force, start + rate * left)
             + flow_ends(layout, theta, work, x, x, 0.0, 0.0, drive, drive_end, u, left))
    for k in range(TERMS):
        work[series + k] = -work[series + k]
    work[series] += theta[CONSTANT_FORCE] + bristle_force(layout, theta, work, 0.0) + f
    work[series + 1] += (f_end - f) / left
    push = _value(work, series, left)
    dry = friction(layout, theta, x, 0.0, drive)
    dry_end = friction(layout, theta, x, 0.0, drive_end)
    if abs(push) <= dry_end or last:
        _at(work, n, terms, left, state)
        for i in range(layout[KEPT], layout[BRISTLES]):
            work[z + i] = work[moved + i]
        return left, 0
    mode = 1 if push > 0.0 else -1
    work[series] -= mode * dry
    work[series + 1] -= mode * (dry_end - dry) / left
    t = _root(work, series, 0.0, left) if mode * work[series] < 0.0 else 0.0
    _at(work, n, terms, t, state)
    if t > 0.0:
        flow_ends(layout, theta, work, x, x, 0.0, 0.0, drive,
                  drive + (drive_end - drive) * t / left, u, t)
        for i in range(layout[KEPT], layout[BRISTLES]):
            work[z + i] = work[moved + i]
    return t, mode


@lean
def _moving(layout: Layout, theta: Array, work: Array, u: float, force: Array,
            start: float, rate: float, left: float, mode: int, last: bool) -> float:
    """Move until the end or until the speed is zero; the time taken, s."""
    n, rows, state, z = layout[ORDER], layout[AT_ROWS], layout[AT_STATE], layout[AT_BRISTLE]
    end, moved = layout[AT_SCRATCH], layout[AT_SCRATCH] + n
    out = layout[AT_HEAD] + OUT
    terms = end + n + layout[BRISTLES]
    series = terms + n * TERMS
    x_row, v_row = rows + ROW_POSITION * (n + 1), rows + ROW_VELOCITY * (n + 1)
    d_row, push_row = rows + ROW_DRIVE * (n + 1), rows + ROW_FORCE_IN * (n + 1)
    gain = theta[FORCE_CONSTANT]
    x, v = row_value(work, x_row, state, n, u), row_value(work, v_row, state, n, u)
    d = gain * row_value(work, d_row, state, n, u)
    plain = theta[CONSTANT_FORCE] - mode * theta[DRY_FRICTION]
    varies = layout[FRICTIONS] < layout[FRICTIONS + 1]      # asked once: most have none
    f = (plain + bristle_force(layout, theta, work, v)
         + point_force(layout, theta, FORCES, x, v, d) + outside(force, start)
         + flow_force(layout, theta, work, x, v, d, u, 0.0, z))
    if varies:
        f -= mode * point_force(layout, theta, FRICTIONS, x, v, d)
    slope = 0.0
    for _ in range(2):
        _series(work, n, layout[AT_A], push_row, state, u, f, slope, terms)
        _at(work, n, terms, left, end)
        x_end, v_end = row_value(work, x_row, end, n, u), row_value(work, v_row, end, n, u)
        d_end = gain * row_value(work, d_row, end, n, u)
        f_end = (plain + bristle_steps(layout, theta, work, z, x_end - x, v, v_end, moved, out)
                 + point_force(layout, theta, FORCES, x_end, v_end, d_end)
                 + outside(force, start + rate * left)
                 + flow_ends(layout, theta, work, x, x_end, v, v_end, d, d_end, u, left))
        if varies:
            f_end -= mode * point_force(layout, theta, FRICTIONS, x_end, v_end, d_end)
        slope = (f_end - f) / left
    t = left
    if mode * v_end < 0.0 and not last:
        _scalar(work, n, v_row, terms, u, series)
        t = 0.0
        if mode * v > 0.0:
            t = _root(work, series, 0.0, left)
        elif mode * work[series + 1] > 0.0:
            for k in range(TERMS - 1):
                work[series + k] = work[series + k + 1]
            work[series + TERMS - 1] = 0.0
            t = _root(work, series, 0.0, left)
    if t > 0.0:
        _at(work, n, terms, t, state)
        x_end, v_end = row_value(work, x_row, state, n, u), row_value(work, v_row, state, n, u)
        bristle_steps(layout, theta, work, z, x_end - x, v, v_end, moved, out)
        flow_ends(layout, theta, work, x, x_end, v, v_end, d,
                  gain * row_value(work, d_row, state, n, u), u, t)
        for i in range(layout[BRISTLES]):
            work[z + i] = work[moved + i]
    return t


@lean
def _series(work: Array, n: int, a: int, push_row: int, state: int, u: float, f: float,
            slope: float, terms: int) -> None:
    """work[terms + n k:] t^k: the state under the force f + slope t; none if push_row < 0."""
    for i in range(n):
        work[terms + i] = work[state + i]
        work[terms + n + i] = row_value(work, a + i * (n + 1), state, n, u)
        if push_row >= 0:
            work[terms + n + i] += work[push_row + i] * f
    for k in range(2, TERMS):
        for i in range(n):
            total = work[push_row + i] * slope if k == 2 and push_row >= 0 else 0.0
            for j in range(n):
                total += work[a + i * (n + 1) + j] * work[terms + n * (k - 1) + j]
            work[terms + n * k + i] = total / k


@lean
def _at(work: Array, n: int, terms: int, t: float, out: int) -> None:
    for i in range(n):
        total = 0.0
        for k in range(TERMS - 1, -1, -1):
            total = total * t + work[terms + n * k + i]
        work[out + i] = total


@lean
def _scalar(work: Array, n: int, row: int, terms: int, u: float, out: int) -> None:
    """work[out + k] t^k = work[row:] . [state(t), u]"""
    for k in range(TERMS):
        work[out + k] = row_value(work, row, terms + n * k, n, u if k == 0 else 0.0)


@lean
def _value(work: Array, series: int, t: float) -> float:
    total = 0.0
    for k in range(TERMS - 1, -1, -1):
        total = total * t + work[series + k]
    return total


@lean
def _root(work: Array, series: int, low: float, high: float) -> float:
    """A root between two points of different sign, by Newton's method kept inside a bracket."""
    falling = _value(work, series, high) < 0.0
    t = high
    for _ in range(80):
        value = slope = 0.0
        for k in range(TERMS - 1, -1, -1):
            slope = slope * t + value
            value = value * t + work[series + k]
        if (value < 0.0) == falling:
            high = t
        else:
            low = t
        newton = t - value / slope if slope != 0.0 else low
        if not low < newton < high:
            newton = 0.5 * (low + high)
        if abs(newton - t) <= 1e-15 * high:
            return newton
        t = newton
    return t


@lean
def _halt(work: Array, n: int, rows: int, state: int, u: float) -> None:
    """Take the rest of the point's velocity out, as a blow at the point would."""
    v_row, push_row = rows + ROW_VELOCITY * (n + 1), rows + ROW_FORCE_IN * (n + 1)
    v = row_value(work, v_row, state, n, u)
    mobility = 0.0
    for i in range(n):
        mobility += work[v_row + i] * work[push_row + i]
    for i in range(n):
        work[state + i] -= work[push_row + i] * (v / mobility)
