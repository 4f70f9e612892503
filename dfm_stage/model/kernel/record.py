"""Entry points of the compiled simulator: prepare an axis, run it over samples, run many sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.kernel.algebra import exponential, multiply
from dfm_stage.model.kernel.assemble import assemble
from dfm_stage.model.kernel.compiled import compiled, entry
from dfm_stage.model.kernel.linear import steps, steps_with_force
from dfm_stage.model.kernel.slots import (
    AT_A,
    AT_DISCRETE,
    AT_HEAD,
    AT_HISTORY,
    AT_ROWS,
    AT_STATE,
    CONSTANT_FORCE,
    CURRENT,
    DELAY,
    FIRST_INITIAL,
    FORCE,
    FORCE_CONSTANT,
    FRACTION,
    HISTORY,
    LAYOUT_FIXED,
    LIMIT,
    ORDER,
    OUTPUT,
    PERIOD,
    POSITION,
    RESISTANCE,
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_POSITION,
    ROW_VELOCITY,
    ROWS,
    SAMPLE,
    VELOCITY,
    WHOLE,
    ZERO,
)

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Layout = NDArray[np.int64]
BLOCK = 256


@compiled
def _view(work: Array, layout: Layout, at: int, rows: int, columns: int) -> Array:
    first = layout[at]
    return work[first:first + rows * columns].reshape(rows, columns)


@entry
def prepare(on: Flags, layout: Layout, theta: Array, work: Array) -> None:
    """Fill `work` with all that depends on the parameters; the state is left alone."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    a = _view(work, layout, AT_A, n, n + 1)
    rows = _view(work, layout, AT_ROWS, ROWS, n + 1)
    assemble(on, layout, theta, a, rows)
    period = head[PERIOD]
    whole = np.floor(theta[DELAY] / period + 1e-9)
    fraction = theta[DELAY] / period - whole
    if fraction < 1e-9:
        fraction = 0.0
    head[WHOLE], head[FRACTION] = whole, fraction
    discrete = _view(work, layout, AT_DISCRETE, n, n + 7)
    _discretise(a, rows, period, fraction, theta[CONSTANT_FORCE], discrete)


@compiled
def _discretise(a: Array, rows: Array, period: float, fraction: float, constant: float,
                out: Array) -> None:
    """out = [E | old | new | constant | force r^0..r^3], see `linear.steps_with_force`."""
    n = a.shape[0]
    size = n + 5
    big, result = np.zeros((size, size)), np.empty((size, size))
    for i in range(n):
        for j in range(n + 1):
            big[i, j] = a[i, j] * period
        big[i, n + 1] = rows[ROW_FORCE_IN, i] * period
    for j in range(1, 4):
        big[n + j, n + j + 1] = 1.0
    exponential(big, result)
    factorial = 1.0
    for j in range(4):
        factorial *= max(j, 1)
        for i in range(n):
            out[i, n + 3 + j] = result[i, n + 1 + j] * factorial
    for i in range(n):
        out[i, :n] = result[i, :n]
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
    state = work[layout[AT_STATE]:]
    head[SAMPLE] = 0.0
    states = layout.shape[0] - LAYOUT_FIXED
    for named in range(states):
        index = layout[LAYOUT_FIXED + named]
        if index >= 0:
            state[index] = theta[FIRST_INITIAL + named]
    first = layout[AT_HISTORY]
    work[first:first + layout[HISTORY]] = past_input


@entry
def run(on: Flags, layout: Layout, theta: Array, work: Array, inputs: Array, force: Array,
        other: Array, rows_out: Layout, out: Array) -> int:
    """Advance by len(inputs) samples and write the signals before each step.

    `force` (N, 4) are the coefficients of an outside force in each sample, or (0, 4); `other`
    (N,) the position of the neighbouring axis, or (0,). Signal s goes to out[rows_out[s]], or
    nowhere if that is negative.
    """
    samples, n = inputs.shape[0], layout[ORDER]
    head = work[layout[AT_HEAD]:]
    back = int(head[WHOLE]) + 1
    applied = np.empty(samples + back)
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + back]
    applied[:back] = history
    applied[back:] = inputs
    history[:] = applied[samples:]
    limit = theta[LIMIT]
    for k in range(samples + back):
        applied[k] = min(max(applied[k], -limit), limit)

    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    rows = _view(work, layout, AT_ROWS, ROWS, n + 1)
    discrete = _view(work, layout, AT_DISCRETE, n, n + 7)
    a, old, new = discrete[:, :n], discrete[:, n].copy(), discrete[:, n + 1].copy()
    constant, ext = discrete[:, n + 2].copy(), discrete[:, n + 3:]
    buffer = np.empty((n, min(BLOCK, samples)))
    for first in range(0, samples, BLOCK):
        block = buffer[:, :min(BLOCK, samples - first)]
        if force.shape[0] > 0:
            steps_with_force(a, old, new, constant, ext, state, applied, force, first, block)
        else:
            steps(a, old, new, constant, state, applied, first, block)
        _signals(rows, theta, block, applied, first, rows_out, out)
    if rows_out[OUTPUT] >= 0:
        out[rows_out[OUTPUT]] += theta[ZERO]
    head[SAMPLE] += samples
    return 0


@entry
def peek(on: Flags, layout: Layout, theta: Array, work: Array, out: Array) -> None:
    """The signals at the present sample, shape (5, 1); nothing is advanced."""
    n = layout[ORDER]
    rows = _view(work, layout, AT_ROWS, ROWS, n + 1)
    state = _view(work, layout, AT_STATE, n, 1)
    applied = work[layout[AT_HISTORY]:layout[AT_HISTORY] + 1].copy()
    limit = theta[LIMIT]
    applied[0] = min(max(applied[0], -limit), limit)
    _signals(rows, theta, state, applied, 0, np.arange(5), out)
    out[OUTPUT, 0] += theta[ZERO]


@compiled
def _signals(rows: Array, theta: Array, block: Array, applied: Array, first: int,
             rows_out: Layout, out: Array) -> None:
    if rows_out[POSITION] >= 0:
        _signal(rows[ROW_POSITION], 1.0, block, applied, first, out[rows_out[POSITION]])
    if rows_out[VELOCITY] >= 0:
        _signal(rows[ROW_VELOCITY], 1.0, block, applied, first, out[rows_out[VELOCITY]])
    if rows_out[OUTPUT] >= 0:
        _signal(rows[ROW_POSITION], 1.0, block, applied, first, out[rows_out[OUTPUT]])
    per_ohm = 1.0 / theta[RESISTANCE] if theta[RESISTANCE] > 0.0 else 1.0
    if rows_out[CURRENT] >= 0:
        _signal(rows[ROW_DRIVE], per_ohm, block, applied, first, out[rows_out[CURRENT]])
    if rows_out[FORCE] >= 0:
        _signal(rows[ROW_DRIVE], theta[FORCE_CONSTANT], block, applied, first,
                out[rows_out[FORCE]])


@compiled
def _signal(row: Array, factor: float, block: Array, applied: Array, first: int,
            out: Array) -> None:
    n, samples = block.shape
    started = False
    for j in range(n):
        if row[j] != 0.0:
            gain = row[j] * factor
            if started:
                for k in range(samples):
                    out[first + k] += gain * block[j, k]
            else:
                for k in range(samples):
                    out[first + k] = gain * block[j, k]
            started = True
    if row[n] != 0.0:
        gain = row[n] * factor
        for k in range(samples):
            out[first + k] = gain * applied[first + k] + (out[first + k] if started else 0.0)
        started = True
    if not started:
        for k in range(samples):
            out[first + k] = 0.0


@entry
def many(on: Flags, layout: Layout, period: float, table: Array, past_input: float,
         inputs: Array, force: Array, other: Array, signal: int, steady: bool, work: Array,
         out: Array, status: Layout) -> None:
    """Row by row of `table` (P, THETA_SIZE): prepare, reset, run; out[row] is that signal."""
    rows_out = np.full(5, -1)
    rows_out[signal] = 0
    for row in range(table.shape[0]):
        theta = table[row]
        work[layout[AT_HEAD] + PERIOD] = period
        prepare(on, layout, theta, work)
        reset(layout, theta, past_input, work)
        if steady:
            status[row] = settle(on, layout, theta, work, inputs, force, other)
        if status[row] == 0:
            status[row] = run(on, layout, theta, work, inputs, force, other, rows_out,
                              out[row:row + 1])


@entry
def settle(on: Flags, layout: Layout, theta: Array, work: Array, inputs: Array, force: Array,
           other: Array) -> int:
    """Set the state to that of the periodic motion under inputs of one period; 1 if none is."""
    n, samples = layout[ORDER], inputs.shape[0]
    head = work[layout[AT_HEAD]:]
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    back = int(head[WHOLE]) + 1
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + back]
    for k in range(back):
        history[k] = inputs[(k - back) % samples]
    state[:] = 0.0
    none, nothing = np.full(5, -1), np.empty((0, samples))
    run(on, layout, theta, work, inputs, force, other, none, nothing)
    discrete = _view(work, layout, AT_DISCRETE, n, n + 7)
    power, square, product = discrete[:, :n].copy(), np.empty((n, n)), np.eye(n)
    exponent = samples
    while exponent > 0:
        if exponent % 2 == 1:
            multiply(product, power, square)
            product[:] = square
        multiply(power, power, square)
        power[:] = square
        exponent //= 2
    head[SAMPLE] = 0.0
    return _solve(np.eye(n) - product, state)


@compiled
def _solve(a: Array, b: Array) -> int:
    """b = a^-1 b by elimination with row pivots; 1 if a is singular to working precision."""
    n = b.shape[0]
    for i in range(n):
        pivot = i
        for j in range(i + 1, n):
            if abs(a[j, i]) > abs(a[pivot, i]):
                pivot = j
        if abs(a[pivot, i]) < 1e-13:
            return 1
        for j in range(n):
            a[i, j], a[pivot, j] = a[pivot, j], a[i, j]
        b[i], b[pivot] = b[pivot], b[i]
        for j in range(i + 1, n):
            ratio = a[j, i] / a[i, i]
            for k in range(i, n):
                a[j, k] -= ratio * a[i, k]
            b[j] -= ratio * b[i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    return 0
