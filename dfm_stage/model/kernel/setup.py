"""All that depends on the parameters but not on the motion, and the state at the beginning."""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.model.kernel.algebra import exponential
from dfm_stage.model.kernel.assemble import assemble
from dfm_stage.model.kernel.compiled import compiled, entry
from dfm_stage.model.kernel.hooks import start_states
from dfm_stage.model.kernel.slots import (
    AT_A,
    AT_DISCRETE,
    AT_END,
    AT_HEAD,
    AT_HELD,
    AT_HISTORY,
    AT_INITIAL,
    AT_NODE,
    AT_ROWS,
    AT_STATE,
    AT_STICK_END,
    AT_STICK_NODE,
    BRISTLES,
    CONSTANT_FORCE,
    CURVATURE,
    CURVED,
    DELAY,
    DEPTH,
    DIRECTED,
    FORCE_CONSTANT,
    FRACTION,
    HISTORY,
    LEVEL,
    LEVELS,
    MODE,
    ORDER,
    PERIOD,
    ROW_FORCE_IN,
    ROW_HOLD,
    ROW_VELOCITY,
    ROWS,
    SAMPLE,
    SCALE,
    SLOPE,
    STEP,
    STEPS,
    TRIED,
    WHOLE,
    Array,
    Layout,
)
from dfm_stage.model.kernel.tables import fastest_rate, fill_tables, hold_row

SHORTEST = 0.2
"""The shortest step times the fastest rate, for which the Taylor series of events are exact."""


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
    hold_row(a, rows)
    held = block(work, layout, AT_HELD, n, n + 1)
    for i in range(n):
        for j in range(n + 1):
            held[i, j] = a[i, j] + rows[ROW_FORCE_IN, i] * rows[ROW_HOLD, j]
    rate = period * fastest_rate(a, n) / SHORTEST
    depth = max(12 if layout[DIRECTED] == 1 else 8, int(np.ceil(np.log2(rate))))
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
    big, result = np.zeros((n + 5, n + 5)), np.empty((n + 5, n + 5))
    for i in range(n):
        for j in range(n + 1):
            big[i, j] = a[i, j] * period
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
        small, after = np.zeros((n + 1, n + 1)), np.empty((n + 1, n + 1))
        for i in range(n):
            for j in range(n + 1):
                small[i, j] = a[i, j] * (period * (1.0 - fraction))
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
    first = layout[AT_HISTORY]
    for k in range(layout[HISTORY]):
        work[first + k] = past_input
    head[SAMPLE] = head[STEPS] = 0.0
    restart(layout, work)


@entry
def restart(layout: Layout, work: Array) -> None:
    """Make step control forget the motion before, after the state has been set from outside."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    rows = block(work, layout, AT_ROWS, ROWS, n + 1)
    speed = 0.0
    for j in range(n):
        speed += rows[ROW_VELOCITY, j] * work[layout[AT_STATE] + j]
    head[MODE] = np.sign(speed)
    head[LEVEL] = head[SCALE] = head[SLOPE] = head[CURVATURE] = head[STEP] = 0.0
    head[TRIED] = 0.0
