"""Entry points for periodic motion and for many parameter sets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.kernel.algebra import multiply, solve
from dfm_stage.model.kernel.compiled import compiled, entry
from dfm_stage.model.kernel.record import run
from dfm_stage.model.kernel.setup import block, prepare, reset, restart
from dfm_stage.model.kernel.slots import (
    AT_BRISTLE,
    AT_DISCRETE,
    AT_HEAD,
    AT_HISTORY,
    AT_STATE,
    BRISTLES,
    CURVED,
    ORDER,
    PERIOD,
    SAMPLE,
    SIGNALS,
    WHOLE,
)

Array = NDArray[np.float64]
Layout = NDArray[np.int64]
DONE, DRIFTS, UNSETTLED = 0, 1, 2
PERIODS = 400
TOLERANCE = 1e-10
MEMORY = 6


@entry
def many(on: int, layout: Layout, table: Array, past_input: float, inputs: Array, force: Array,
         other: Array, signal: int, steady: bool, work: Array, out: Array,
         status: Layout) -> None:
    """Row by row of `table` (P, THETA_SIZE): prepare, reset, run; out[row] is that signal."""
    rows_out = np.full(len(SIGNALS), -1)
    rows_out[signal] = 0
    for row in range(table.shape[0]):
        theta = table[row]
        prepare(on, layout, theta, work)
        reset(on, layout, theta, past_input, work)
        status[row] = DONE
        if steady:
            status[row] = settle(on, layout, theta, work, inputs, force, other)
        if status[row] == DONE:
            run(on, layout, theta, work, inputs, force, other, rows_out, out[row:row + 1])


@entry
def settle(on: int, layout: Layout, theta: Array, work: Array, inputs: Array, force: Array,
           other: Array) -> int:
    """Set the state to that of the periodic motion under inputs of one period.

    Linear models: exactly, from the period's response to zero and the power of the propagator.
    Others: from there by repeating the period, with Anderson acceleration (J. ACM 12 (1965) 547).
    Returns DONE, DRIFTS (no spring: there is none) or UNSETTLED.
    """
    n, samples = layout[ORDER], inputs.shape[0]
    back = int(work[layout[AT_HEAD] + WHOLE]) + 1
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + back]
    past = np.empty(back)
    for k in range(back):
        past[k] = inputs[(k - back) % samples]
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    begin = np.zeros(n)
    outcome = _linear_settle(on, layout, theta, work, inputs, force, other, past, begin)
    if outcome == DONE or layout[CURVED] == 1:
        state[:] = begin
    if layout[CURVED] == 1:
        outcome = _repeat(on, layout, theta, work, inputs, force, other, past)
    history[:] = past
    work[layout[AT_HEAD] + SAMPLE] = 0.0
    restart(layout, work)
    return outcome


@compiled
def _linear_settle(on: int, layout: Layout, theta: Array, work: Array, inputs: Array,
                   force: Array, other: Array, past: Array, begin: Array) -> int:
    n = layout[ORDER]
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + past.shape[0]]
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    history[:] = past
    state[:] = 0.0
    straight = layout.copy()
    straight[CURVED] = 0
    none, nothing = np.full(len(SIGNALS), -1), np.empty((0, inputs.shape[0]))
    run(on, straight, theta, work, inputs, force, other, none, nothing)
    discrete = block(work, layout, AT_DISCRETE, n, n + 7)
    power, square, product = discrete[:, :n].copy(), np.empty((n, n)), np.eye(n)
    exponent = inputs.shape[0]
    while exponent > 0:
        if exponent % 2 == 1:
            multiply(product, power, square)
            product[:] = square
        multiply(power, power, square)
        power[:] = square
        exponent //= 2
    change = state.copy()
    if not solve(np.eye(n) - product, change):
        return DRIFTS
    begin[:] = change
    return DONE


@compiled
def _repeat(on: int, layout: Layout, theta: Array, work: Array, inputs: Array, force: Array,
            other: Array, past: Array) -> int:
    """Repeat the period from the present state until it returns to itself."""
    n = layout[ORDER]
    size = n + BRISTLES
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + past.shape[0]]
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    z = work[layout[AT_BRISTLE]:layout[AT_BRISTLE] + BRISTLES]
    none, nothing = np.full(len(SIGNALS), -1), np.empty((0, inputs.shape[0]))
    points, misses = np.zeros((MEMORY, size)), np.zeros((MEMORY, size))
    scale, point, miss = np.zeros(size), np.empty(size), np.empty(size)
    point[:n] = state
    point[n:] = z
    kept, best = 0, np.inf
    for _ in range(PERIODS):
        state[:] = point[:n]
        z[:] = point[n:]
        history[:] = past
        restart(layout, work)
        run(on, layout, theta, work, inputs, force, other, none, nothing)
        miss[:n] = state
        miss[n:] = z
        error = 0.0
        for i in range(size):
            scale[i] = max(scale[i], abs(miss[i]), 1e-100)
            miss[i] -= point[i]
            error = max(error, abs(miss[i]) / scale[i])
        if error < TOLERANCE:
            state[:] = point[:n]
            z[:] = point[n:]
            return DONE
        if not np.isfinite(error):
            return UNSETTLED
        if error > 10.0 * best:
            kept = 0
        best = min(best, error)
        if kept == MEMORY:
            points[:-1] = points[1:]
            misses[:-1] = misses[1:]
            kept -= 1
        points[kept] = point
        misses[kept] = miss
        kept += 1
        _accelerate(points[:kept], misses[:kept], scale, point)
    return UNSETTLED


@compiled
def _accelerate(points: Array, misses: Array, scale: Array, point: Array) -> None:
    """The next point: the combination of the last ones whose miss is smallest, plus that miss."""
    kept, size = points.shape
    last = kept - 1
    point[:] = points[last] + misses[last]
    if last == 0:
        return
    matrix, weights = np.empty((last, last)), np.empty(last)
    for i in range(last):
        weights[i] = 0.0
        for k in range(size):
            weights[i] += (misses[last, k] - misses[i, k]) * misses[last, k] / scale[k] ** 2
        for j in range(last):
            total = 0.0
            for k in range(size):
                total += ((misses[last, k] - misses[i, k]) * (misses[last, k] - misses[j, k])
                          / scale[k] ** 2)
            matrix[i, j] = total * (1.0 + 1e-12 if i == j else 1.0)
    if not solve(matrix, weights):
        return
    for i in range(last):
        for k in range(size):
            point[k] -= weights[i] * (points[last, k] + misses[last, k]
                                      - points[i, k] - misses[i, k])
