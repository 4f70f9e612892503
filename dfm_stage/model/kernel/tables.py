"""Exact propagators of the linear part over dyadic fractions of a sample.

A step of length h starts at the state s, with the input u held and a force f on the driven point
that is a cubic in time, given by its values f0..f3 at the Lobatto points 0, (1 -+ 1/sqrt(5))/2
and 1 of the step. Then, exactly,

    (x1, v1, x2, v2, x3, v3, d1, d2, d3) = [s, u, f0..f3] . node,    s(h) = [s, u, f0..f3] . end

with position x, velocity v and actuator force d at the last three points. While friction holds
the point (x' = 0), the force that holds it is a linear function of the state; with it eliminated,

    (h1, h2, h3, d1, d2, d3) = [s, u] . stick_node,                  s(h) = [s, u] . stick_end

with the force h that holds the point.

Tables exist for both pieces of a sample (before and after the input switches) and for the levels
0..depth, level l having steps of 2^-l of the piece.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.model.kernel.algebra import (
    assign,
    balance,
    exponential,
    largest_row,
    multiply,
    put_scaled,
)
from dfm_stage.model.kernel.compiled import compiled, lean
from dfm_stage.model.kernel.slots import (
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_HOLD,
    ROW_POSITION,
    ROW_VELOCITY,
    Array,
)

POINT_1 = 0.5 * (1.0 - 1.0 / math.sqrt(5.0))
POINT_2 = 0.5 * (1.0 + 1.0 / math.sqrt(5.0))
POINTS = (POINT_1, POINT_2, 1.0)
FROM_VALUES = np.linalg.inv(np.vander([0.0, *POINTS], 4, increasing=True))
"""Monomial coefficients of the cubic through values at the four points: FROM_VALUES @ f."""
CUBIC = FROM_VALUES[3]


@compiled
def fastest_rate(a: Array, n: int) -> float:
    """An upper bound of the rates of a (1/s): the norm of the balanced matrix."""
    scaled, scale = np.empty((n, n)), np.empty(n)
    assign(a, scaled)
    balance(scaled, scale)
    return largest_row(scaled)


@lean
def hold_row(a: Array, rows: Array) -> None:
    """Fill ROW_HOLD: the force on the point (N) that keeps x'' zero, per state and input."""
    n = a.shape[0]
    mobility = 0.0
    for i in range(n):
        mobility += rows[ROW_VELOCITY, i] * rows[ROW_FORCE_IN, i]
    for j in range(n + 1):
        total = 0.0
        for i in range(n):
            total += rows[ROW_VELOCITY, i] * a[i, j]
        rows[ROW_HOLD, j] = -total / mobility


@compiled
def fill_tables(a: Array, held: Array, rows: Array, gain: float, length: float, depth: int,
                sticks: bool, node: Array, end: Array, stick_node: Array,
                stick_end: Array) -> None:
    """The tables of one piece of the given length (s): node (L, n + 5, 9), end (L, n + 5, n),
    stick_node (L, n + 1, 6), stick_end (L, n + 1, n), with L > depth. `held` is `a` with the point
    held.
    """
    n = a.shape[0]
    size = n + 5
    shortest = length * 0.5 ** depth
    big, power, other = np.empty((size, size)), np.empty((size, size)), np.empty((size, size))
    for i in range(3):
        put_scaled(a, n, POINTS[i] * shortest, big)
        for row in range(n):
            big[row, n + 1] = rows[ROW_FORCE_IN, row] * (POINTS[i] * shortest)
        for j in range(1, 4):
            big[n + j, n + j + 1] = POINTS[i]
        exponential(big, power)
        for level in range(depth, -1, -1):
            _take(power, rows, gain, 2.0 ** (depth - level), i, node[level], end[level])
            multiply(power, power, other)
            assign(other, power)
    if sticks:
        _fill_stick_tables(held, rows, gain, shortest, depth, stick_node, stick_end)


@compiled
def _fill_stick_tables(held: Array, rows: Array, gain: float, shortest: float, depth: int,
                       stick_node: Array, stick_end: Array) -> None:
    n = held.shape[0]
    small, power, other = (np.empty((n + 1, n + 1)), np.empty((n + 1, n + 1)),
                           np.empty((n + 1, n + 1)))
    for i in range(3):
        put_scaled(held, n, POINTS[i] * shortest, small)
        exponential(small, power)
        for level in range(depth, -1, -1):
            _take_stick(power, rows, gain, i, stick_node[level], stick_end[level])
            multiply(power, power, other)
            assign(other, power)


@lean
def _take_stick(power: Array, rows: Array, gain: float, point: int, node: Array,
                end: Array) -> None:
    """One point of one level while the point sticks; the last one is the end of the step."""
    n = rows.shape[1] - 1
    for j in range(n + 1):
        hold = drive = 0.0
        for k in range(n + 1):
            hold += rows[ROW_HOLD, k] * power[k, j]
            drive += rows[ROW_DRIVE, k] * power[k, j]
        node[j, point] = hold
        node[j, 3 + point] = gain * drive
        for row in range(n):
            end[j, row] = power[row, j]


@compiled
def _take(power: Array, rows: Array, gain: float, units: float, point: int, node: Array,
          end: Array) -> None:
    """One point of one level; time in `power` is counted in steps of the deepest level."""
    n = rows.shape[1] - 1
    taken = np.empty((n, n + 5))
    for i in range(n):
        for j in range(n + 1):
            taken[i, j] = power[i, j]
        for j in range(4):
            total = 0.0
            factor = 1.0
            for m in range(4):
                factor *= max(m, 1) / (units if m > 0 else 1.0)
                total += power[i, n + 1 + m] * factor * FROM_VALUES[m, j]
            taken[i, n + 1 + j] = total
    for j in range(n + 5):
        x = v = drive = 0.0
        for i in range(n):
            x += rows[ROW_POSITION, i] * taken[i, j]
            v += rows[ROW_VELOCITY, i] * taken[i, j]
            drive += rows[ROW_DRIVE, i] * taken[i, j]
        node[j, 2 * point] = x
        node[j, 2 * point + 1] = v
        node[j, 6 + point] = gain * drive
    node[n, 6 + point] += gain * rows[ROW_DRIVE, n]
    if point == 2:
        assign(taken.T, end)
