"""All that depends on the parameters but not on the motion, and the state at the beginning.

The linear part of one axis is a state space, put together from stamps.
The state is s = [position and velocity of the first mode, the states of amplifier and coil, the
states of effects]. `a` has shape (n, n + 1): ds/dt = a[:, :n] s + a[:, n] u with the delayed and
limited input u. `rows` has shape (ROWS, n + 1) and tells, in the same columns, what position and
velocity of the driven point and the drive are; ROW_FORCE_IN holds ds/dt per newton at the point.

An effect's stamp changes them: in the stage "modes" position, velocity and force input, in the
stage "amplifier" the drive, in the stage "mechanics" it adds forces at the point, and in the stage
"sensor" it changes the reading, which is the position before.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.model.kernel.algebra import exponential, fill, put_scaled, row_value
from dfm_stage.model.kernel.compiled import compiled, entry, lean
from dfm_stage.model.kernel.hooks import command_inputs, stamp, start_states
from dfm_stage.model.kernel.slots import (
    AMPERES,
    AMPLIFIER,
    AMPLIFIER_STAMPS,
    AMPLIFIER_STATE,
    AT_A,
    AT_DISCRETE,
    AT_END,
    AT_HEAD,
    AT_HELD,
    AT_HISTORY,
    AT_INITIAL,
    AT_NODE,
    AT_REGISTERS,
    AT_ROWS,
    AT_STAGES,
    AT_STATE,
    AT_STICK_END,
    AT_STICK_NODE,
    BACK_EMF,
    BRISTLES,
    COIL_STATE,
    CONSTANT_FORCE,
    CURVATURE,
    CURVED,
    DAMPING,
    DELAY,
    DEPTH,
    DIRECTED,
    FORCE_CONSTANT,
    FRACTION,
    HISTORY,
    INDUCTANCE,
    LEVEL,
    LEVELS,
    MASS,
    MECHANICS_STAMPS,
    MODE,
    MODE_STAMPS,
    ORDER,
    PERIOD,
    RESISTANCE,
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_HOLD,
    ROW_POSITION,
    ROW_READING,
    ROW_VELOCITY,
    ROWS,
    SAMPLE,
    SCALE,
    SENSOR_STAMPS,
    SLOPE,
    STEP,
    STEPS,
    STIFFNESS,
    TRIED,
    WHOLE,
    WORK_SIZE,
    Array,
    Layout,
)
from dfm_stage.model.kernel.tables import fastest_rate, fill_tables, hold_row

SHORTEST = 0.2
"""The shortest step times the fastest rate, for which the Taylor series of events are exact."""
SETTLED_S = 1e12
"""The constant input before a record has lasted so long, s."""
SMOOTH_LEVELS = 9
"""Levels of halving where no force has a kink or a reversal to come close to."""
INSTANT = 1e-6
"""A lag shorter than this part of a sample period is taken as none."""


@lean
def lag(a: Array, rows: Array, state: int, time_constant: float, shortest: float) -> None:
    """Put a first-order lag into the drive; none where it is shorter than `shortest`."""
    if state < 0 or time_constant <= shortest:
        return
    for j in range(rows.shape[1]):
        a[state, j] = rows[ROW_DRIVE, j] / time_constant
        rows[ROW_DRIVE, j] = 0.0
    a[state, state] -= 1.0 / time_constant
    rows[ROW_DRIVE, state] = 1.0


@lean
def assemble(layout: Layout, theta: Array, period: float, a: Array,
             rows: Array) -> None:
    """Fill `a` and `rows` for the parameters `theta`."""
    shortest = INSTANT * period
    n = a.shape[0]
    fill(a, 0.0)
    fill(rows, 0.0)
    mass = theta[MASS]
    a[0, 1] = 1.0
    a[1, 0] = -theta[STIFFNESS] / mass
    a[1, 1] = -theta[DAMPING] / mass
    rows[ROW_POSITION, 0] = 1.0
    rows[ROW_VELOCITY, 1] = 1.0
    rows[ROW_FORCE_IN, 1] = 1.0 / mass
    stamp(layout, theta, MODE_STAMPS, a, rows)

    rows[ROW_DRIVE, n] = 1.0
    lag(a, rows, layout[AMPLIFIER_STATE], theta[AMPLIFIER], shortest)
    stamp(layout, theta, AMPLIFIER_STAMPS, a, rows)
    for j in range(n):
        rows[ROW_DRIVE, j] -= theta[BACK_EMF] * rows[ROW_VELOCITY, j]
    if theta[RESISTANCE] > 0.0:
        lag(a, rows, layout[COIL_STATE], theta[INDUCTANCE] / theta[RESISTANCE],
            shortest)

    for i in range(n):
        share = rows[ROW_FORCE_IN, i] * theta[FORCE_CONSTANT]
        if share != 0.0:
            for j in range(n + 1):
                a[i, j] += share * rows[ROW_DRIVE, j]
    stamp(layout, theta, MECHANICS_STAMPS, a, rows)

    for j in range(n + 1):
        rows[ROW_READING, j] = rows[ROW_POSITION, j]
    stamp(layout, theta, SENSOR_STAMPS, a, rows)


@compiled
def block(work: Array, layout: Layout, at: int, rows: int, columns: int) -> Array:
    """The block of `work` at `at` as a matrix."""
    first = layout[at]
    return work[first:first + rows * columns].reshape(rows, columns)


@compiled
def _pieces(work: Array, first: int, levels: int, rows: int, columns: int) -> Array:
    """The tables that begin at work[first:]: (2, levels, rows, columns), one for each piece."""
    return work[first:first + 2 * levels * rows * columns].reshape(2, levels, rows, columns)


@compiled
def tables(work: Array, layout: Layout) -> tuple[Array, Array, Array, Array]:
    """node (2, L, n + 5, 9), end (2, L, n + 5, n), stick_node (2, L, n + 1, 6) and
    stick_end (2, L, n + 1, n); see `kernel.tables`. The first index is the piece of the sample.
    """
    n, levels = layout[ORDER], layout[LEVELS]
    sticks = levels if layout[DIRECTED] == 1 else 0
    return (_pieces(work, layout[AT_NODE], levels, n + 5, 9),
            _pieces(work, layout[AT_END], levels, n + 5, n),
            _pieces(work, layout[AT_STICK_NODE], sticks, n + 1, 6),
            _pieces(work, layout[AT_STICK_END], sticks, n + 1, n))


@entry
def prepare(layout: Layout, theta: Array, work: Array) -> None:
    """Fill `work` with all that depends on the parameters; the state is left alone."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    period = head[PERIOD]
    a = block(work, layout, AT_A, n, n + 1)
    rows = block(work, layout, AT_ROWS, ROWS, n + 1)
    assemble(layout, theta, period, a, rows)
    head[WHOLE] = np.floor(theta[DELAY] / period + 1e-9)
    head[FRACTION] = theta[DELAY] / period - head[WHOLE]
    if head[FRACTION] < 1e-9:
        head[FRACTION] = 0.0
    discrete = block(work, layout, AT_DISCRETE, n, n + 7)
    _discretise(a, rows, period, head[FRACTION], theta[CONSTANT_FORCE], discrete)
    if layout[CURVED] == 0:
        return
    gain = theta[FORCE_CONSTANT] * (theta[RESISTANCE] if theta[RESISTANCE] > 0.0 else 1.0)
    head[AMPERES] = 1.0 / gain if gain != 0.0 else 0.0
    hold_row(a, rows)
    held = block(work, layout, AT_HELD, n, n + 1)
    for i in range(n):
        for j in range(n + 1):
            held[i, j] = a[i, j] + rows[ROW_FORCE_IN, i] * rows[ROW_HOLD, j]
    rate = period * fastest_rate(a, n) / SHORTEST
    depth = max(12 if layout[LEVELS] > SMOOTH_LEVELS else 8, int(np.ceil(np.log2(rate))))
    head[DEPTH] = min(depth, layout[LEVELS] - 1)
    node, end, stick_node, stick_end = tables(work, layout)
    for piece in range(2):
        length = period * (head[FRACTION] if piece == 0 else 1.0 - head[FRACTION])
        if length > 0.0:
            fill_tables(a, held, rows, theta[FORCE_CONSTANT], length, int(head[DEPTH]),
                        layout[DIRECTED] == 1, node[piece], end[piece],
                        stick_node[piece], stick_end[piece])


@compiled
def _discretise(a: Array, rows: Array, period: float, fraction: float, constant: float,
                out: Array) -> None:
    """out = [E | old | new | constant | force r^0..r^3], see `linear.steps`."""
    n = a.shape[0]
    big, result = np.empty((n + 5, n + 5)), np.empty((n + 5, n + 5))
    put_scaled(a, n, period, big)
    for i in range(n):
        big[i, n + 1] = rows[ROW_FORCE_IN, i] * period
    for j in range(1, 4):
        big[n + j, n + j + 1] = 1.0
    exponential(big, result)
    for i in range(n):
        for j in range(4):
            out[i, n + 3 + j] = result[i, n + 1 + j] * math.gamma(j + 1.0)
        for j in range(n):
            out[i, j] = result[i, j]
        out[i, n] = 0.0
        out[i, n + 1] = result[i, n]
        out[i, n + 2] = constant * result[i, n + 1]
    if fraction > 0.0:
        small, after = np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1))
        put_scaled(a, n, period * (1.0 - fraction), small)
        exponential(small, after)
        for i in range(n):
            out[i, n] = result[i, n] - after[i, n]
            out[i, n + 1] = after[i, n]


@entry
def reset(layout: Layout, theta: Array, past_input: float, work: Array) -> None:
    """Set the state to the initial states in `theta`, and the inputs before it to a constant."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    for i in range(n + layout[BRISTLES]):           # the bristles stand behind the state
        work[layout[AT_STATE] + i] = theta[layout[AT_INITIAL] + i]
    start_states(layout, theta, state)
    for k in range(layout[AT_REGISTERS], layout[AT_A]):
        work[k] = 0.0
    first = layout[AT_HISTORY]
    work[first] = past_input
    if past_input != 0.0:
        command_inputs(layout, theta, work, work[first:first + 1], SETTLED_S)
    for k in range(1, layout[HISTORY]):
        work[first + k] = work[first]
    head[SAMPLE] = head[STEPS] = 0.0
    restart(layout, work)


@entry
def restart(layout: Layout, work: Array) -> None:
    """Make step control forget the motion before, after the state has been set from outside."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    speed_row = layout[AT_ROWS] + ROW_VELOCITY * (n + 1)
    head[MODE] = np.sign(row_value(work, speed_row, layout[AT_STATE], n, 0.0))
    head[LEVEL] = head[SCALE] = head[SLOPE] = head[CURVATURE] = head[STEP] = 0.0
    head[TRIED] = 0.0
    for i in range(layout[AT_STAGES], layout[WORK_SIZE]):
        work[i] = 0.0
