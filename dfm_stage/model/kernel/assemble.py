"""The linear part of one axis as a state space, put together from stamps.

The state is s = [position and velocity of the first mode, the states of amplifier and coil, the
states of effects]. `a` has shape (n, n + 1): ds/dt = a[:, :n] s + a[:, n] u with the delayed and
limited input u. `rows` has shape (ROWS, n + 1) and tells, in the same columns, what position and
velocity of the driven point and the drive are; ROW_FORCE_IN holds ds/dt per newton at the point.

An effect's stamp changes them: in the stage "modes" position, velocity and force input, in the
stage "amplifier" the drive, in the stage "mechanics" it adds forces at the point.
"""

from __future__ import annotations

from dfm_stage.model.kernel.algebra import fill
from dfm_stage.model.kernel.compiled import lean
from dfm_stage.model.kernel.hooks import stamp
from dfm_stage.model.kernel.slots import (
    AMPLIFIER,
    AMPLIFIER_STAMPS,
    AMPLIFIER_STATE,
    BACK_EMF,
    COIL_STATE,
    DAMPING,
    FORCE_CONSTANT,
    INDUCTANCE,
    MASS,
    MECHANICS_STAMPS,
    MODE_STAMPS,
    RESISTANCE,
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_POSITION,
    ROW_VELOCITY,
    STIFFNESS,
    Array,
    Layout,
)

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
