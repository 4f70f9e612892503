"""Entry points of the compiled simulator: samples in, signals out."""

from __future__ import annotations

import numpy as np

from dfm_stage.model.kernel.algebra import outside, row_value
from dfm_stage.model.kernel.compiled import at, compiled, entry, lean
from dfm_stage.model.kernel.events import bristle_force, friction
from dfm_stage.model.kernel.flows import flow_force
from dfm_stage.model.kernel.hooks import (
    add_to_commands,
    command_inputs,
    encode_means,
    other_stiffness,
    point_force,
    sense_errors,
)
from dfm_stage.model.kernel.linear import steps
from dfm_stage.model.kernel.motion import advance_piece
from dfm_stage.model.kernel.setup import block
from dfm_stage.model.kernel.slots import (
    ACCELERATION,
    ACTUATOR_FORCES,
    ALLOWED,
    AT_A,
    AT_BRISTLE,
    AT_DISCRETE,
    AT_HEAD,
    AT_HISTORY,
    AT_ROWS,
    AT_STATE,
    CONSTANT_FORCE,
    CURRENT,
    CURVED,
    DIRECTED,
    ENCODES,
    FORCE,
    FORCE_CONSTANT,
    FORCES,
    FRACTION,
    LIMIT,
    MODE,
    NOISE,
    NOW,
    ORDER,
    OUTPUT,
    PERIOD,
    POSITION,
    READING,
    RESISTANCE,
    ROW_DRIVE,
    ROW_FORCE_IN,
    ROW_HOLD,
    ROW_POSITION,
    ROW_READING,
    ROW_VELOCITY,
    ROWS,
    SAMPLE,
    SENSES,
    SIGNALS,
    STEPS,
    TRIED,
    VELOCITY,
    WHOLE,
    ZERO,
    Array,
    Layout,
)

BLOCK = 256
DIVERGED = 1e12
"""A position beyond this has escaped; the states are NaN from then on."""
STIFF_SAMPLES = 2000.0
"""So are they once the steps beyond those allowed a sample are those allowed so many samples: with
a force this stiff a record would take minutes, and its motion would be in doubt."""


@entry
def run(layout: Layout, theta: Array, work: Array, inputs: Array, force: Array,
        other: Array, rows_out: Layout, out: Array) -> None:
    """Advance by len(inputs) samples and write the signals before each step.

    `force` (N, 4) are the coefficients of the outside force in each sample, or (0, 4); `other`
    (N, 4) those of the position of the neighbouring axis, or (0, 4). Signal s goes to
    out[rows_out[s]], or nowhere if that is negative.
    """
    samples, n = inputs.shape[0], layout[ORDER]
    head = work[layout[AT_HEAD]:]
    applied = _applied(layout, theta, work, inputs)
    pushed = _outside_force(layout, theta, force, other)
    state = work[layout[AT_STATE]:layout[AT_STATE] + n]
    rows = block(work, layout, AT_ROWS, ROWS, n + 1)
    discrete = block(work, layout, AT_DISCRETE, n, n + 7)
    a, old, new = discrete[:, :n], discrete[:, n].copy(), discrete[:, n + 1].copy()
    constant, ext = discrete[:, n + 2].copy(), discrete[:, n + 3:]
    states = np.empty((n, min(BLOCK, samples)))
    felt = out[rows_out[ACCELERATION]] if rows_out[ACCELERATION] >= 0 else out[0, :0]
    for first in range(0, samples, BLOCK):
        count = min(BLOCK, samples - first)
        if layout[CURVED] == 1:
            _curved_steps(layout, theta, work, applied, pushed, first, count, states, felt)
        else:
            steps(a, old, new, constant, ext, state, applied, pushed, first, count, states)
            if felt.shape[0] > 0:
                _linear_acceleration(layout, theta, work, states, applied, pushed, first, count,
                                     felt)
        _signals(layout, rows, theta, states, applied, first, count, rows_out, out)
    _readings(layout, theta, head[PERIOD], head[SAMPLE], other, rows_out, out)
    head[SAMPLE] += samples
    if layout[CURVED] == 0:
        head[STEPS] += samples


@entry
def peek(layout: Layout, theta: Array, work: Array, other: Array, out: Array) -> None:
    """All signals but the acceleration at the present sample, (7, 1); nothing is advanced."""
    n = layout[ORDER]
    head = work[layout[AT_HEAD]:]
    rows = block(work, layout, AT_ROWS, ROWS, n + 1)
    applied = work[layout[AT_HISTORY]:layout[AT_HISTORY] + 1].copy()
    applied[0] = min(max(applied[0], -theta[LIMIT]), theta[LIMIT])
    add_to_commands(layout, theta, applied, int(head[SAMPLE] - head[WHOLE]) - 1, head[PERIOD])
    everything, first = np.arange(len(SIGNALS)), int(layout[ORDER] * 0)
    state = block(work, layout, AT_STATE, n, 1)
    _signals(layout, rows, theta, state, applied, first, 1, everything, out)
    _readings(layout, theta, head[PERIOD], head[SAMPLE], other, everything, out)


@compiled
def _applied(layout: Layout, theta: Array, work: Array, inputs: Array) -> Array:
    """The limited inputs; number k acts before the switch inside sample k, k + 1 after it."""
    samples, head = inputs.shape[0], work[layout[AT_HEAD]:]
    back = int(head[WHOLE]) + 1
    history = work[layout[AT_HISTORY]:layout[AT_HISTORY] + back]
    applied = np.empty(samples + back)
    for k in range(back):
        applied[k] = history[k]
    for k in range(samples):
        applied[back + k] = inputs[k]
    command_inputs(layout, theta, work, applied[back:], head[PERIOD])
    for k in range(back):
        history[k] = applied[samples + k]
    for k in range(samples + back):
        applied[k] = min(max(applied[k], -theta[LIMIT]), theta[LIMIT])
    add_to_commands(layout, theta, applied, int(head[SAMPLE]) - back, head[PERIOD])
    return applied


@compiled
def _outside_force(layout: Layout, theta: Array, force: Array, other: Array) -> Array:
    stiffness = other_stiffness(layout, theta)
    if other.shape[0] == 0 or stiffness == 0.0:
        return force
    total = np.empty(other.shape)
    for k in range(other.shape[0]):
        for j in range(other.shape[1]):
            total[k, j] = stiffness * other[k, j]
            if force.shape[0] > 0:
                total[k, j] += force[k, j]
    return total


@lean
def _curved_steps(layout: Layout, theta: Array, work: Array, applied: Array,
                  force: Array, first: int, count: int, out: Array, felt: Array) -> None:
    """As `linear.steps`, with nonlinear forces; `force` may be empty. The acceleration goes to
    `felt`, which may be empty."""
    n, state, tried = layout[ORDER], layout[AT_STATE], layout[AT_HEAD] + TRIED
    allowed = work[layout[AT_HEAD] + ALLOWED]
    steps, now = layout[AT_HEAD] + STEPS, layout[AT_HEAD] + NOW
    period = work[layout[AT_HEAD] + PERIOD]
    fraction = work[layout[AT_HEAD] + FRACTION]
    push = force[0] if force.shape[0] > 0 else theta[:0]
    for k in range(count):
        for i in range(n):
            out[i, k] = work[state + i]
        if not abs(work[state]) < DIVERGED or at(work, tried) > STIFF_SAMPLES * allowed:
            for i in range(n):
                work[state + i] = np.nan
                for later in range(k, count):
                    out[i, later] = np.nan
            for later in range(first + k, min(first + count, felt.shape[0])):
                felt[later] = np.nan
            return
        if force.shape[0] > 0:
            push = force[first + k]
        number = work[layout[AT_HEAD] + SAMPLE] + first + k
        work[now] = number * period
        if felt.shape[0] > 0:
            felt[first + k] = _acceleration(layout, theta, work, applied[first + k], push)
        before = at(work, tried)
        for which in range(2):
            begin = 0.0 if which == 0 else fraction
            span = fraction if which == 0 else 1.0 - fraction
            if span > 0.0:
                work[now] = (number + begin) * period
                advance_piece(layout, theta, work, which, applied[first + k + which], push,
                              begin, span, span * period)
        work[steps] += at(work, tried) - before
        work[tried] = max(at(work, tried) - allowed, 0.0)


@lean
def _acceleration(layout: Layout, theta: Array, work: Array, u: float, force: Array) -> float:
    """x'' of the driven point now, m/s^2: what its forces, friction included, leave beyond those
    that would keep it from accelerating. `u` is the input that has acted until now."""
    n, rows, state = layout[ORDER], layout[AT_ROWS], layout[AT_STATE]
    x = row_value(work, rows + ROW_POSITION * (n + 1), state, n, u)
    v = row_value(work, rows + ROW_VELOCITY * (n + 1), state, n, u)
    drive = theta[FORCE_CONSTANT] * row_value(work, rows + ROW_DRIVE * (n + 1), state, n, u)
    push = (theta[CONSTANT_FORCE] + bristle_force(layout, theta, work, v)
            + point_force(layout, theta, FORCES, x, v, drive)
            + flow_force(layout, theta, work, x, v, drive, u, 0.0, layout[AT_BRISTLE])
            - row_value(work, rows + ROW_HOLD * (n + 1), state, n, u)) + outside(force, 0.0)
    if layout[DIRECTED] == 1:
        mode, dry = at(work, layout[AT_HEAD] + MODE), friction(layout, theta, x, v, drive)
        push -= mode * dry if mode != 0.0 else min(max(push, -dry), dry)
    return float(push * _mobility(block(work, layout, AT_ROWS, ROWS, n + 1), n))


@lean
def _mobility(rows: Array, n: int) -> float:
    """x'' of the driven point per newton on it, 1/kg."""
    total = 0.0
    for i in range(n):
        total += rows[ROW_VELOCITY, i] * rows[ROW_FORCE_IN, i]
    return total


@lean
def _linear_acceleration(layout: Layout, theta: Array, work: Array, states: Array, applied: Array,
                         force: Array, first: int, count: int, out: Array) -> None:
    """x'' of the driven point of a linear model, as `_signals` gives the others."""
    n = layout[ORDER]
    a = block(work, layout, AT_A, n, n + 1)
    rows = block(work, layout, AT_ROWS, ROWS, n + 1)
    mobility = _mobility(rows, n)
    for k in range(first, first + count):
        out[k] = mobility * theta[CONSTANT_FORCE]
        if force.shape[0] > 0:
            out[k] += mobility * force[k, 0]
    for j in range(n + 1):
        gain = 0.0
        for i in range(n):
            gain += rows[ROW_VELOCITY, i] * a[i, j]
        if gain != 0.0:
            column = states[j] if j < n else applied[first:first + count]
            for k in range(count):
                out[first + k] += gain * column[k]


@lean
def _signals(layout: Layout, rows: Array, theta: Array, states: Array, applied: Array, first: int,
             count: int, rows_out: Layout, out: Array) -> None:
    for signal in (POSITION, VELOCITY, READING, OUTPUT):
        if rows_out[signal] >= 0:
            row = rows[ROW_VELOCITY if signal == VELOCITY else
                       ROW_POSITION if signal == POSITION else ROW_READING]
            _signal(row, 1.0, states, applied, first, count, out[rows_out[signal]])
    if rows_out[CURRENT] >= 0:
        per_ohm = 1.0 / theta[RESISTANCE] if theta[RESISTANCE] > 0.0 else 1.0
        _signal(rows[ROW_DRIVE], per_ohm, states, applied, first, count, out[rows_out[CURRENT]])
    if rows_out[FORCE] >= 0:
        force = out[rows_out[FORCE]]
        _signal(rows[ROW_DRIVE], theta[FORCE_CONSTANT], states, applied, first, count, force)
        if layout[ACTUATOR_FORCES] < layout[ACTUATOR_FORCES + 1]:
            for k in range(count):
                x = v = 0.0
                for j in range(states.shape[0]):
                    x += rows[ROW_POSITION, j] * states[j, k]
                    v += rows[ROW_VELOCITY, j] * states[j, k]
                force[first + k] += point_force(layout, theta, ACTUATOR_FORCES, x, v,
                                                force[first + k])


@lean
def _signal(row: Array, factor: float, states: Array, applied: Array, first: int, count: int,
            out: Array) -> None:
    """out[first:] = factor row . [states, applied], skipping columns of zeros."""
    n = states.shape[0]
    started = False
    for j in range(n + 1):
        gain = row[j] * factor
        if gain == 0.0:
            continue
        column = states[j] if j < n else applied[first:first + count]
        if started:
            for k in range(count):
                out[first + k] += gain * column[k]
        elif gain == 1.0:
            for k in range(count):
                out[first + k] = column[k]
        else:
            for k in range(count):
                out[first + k] = gain * column[k]
        started = True
    if not started:
        for k in range(count):
            out[first + k] = 0.0


@compiled
def _readings(layout: Layout, theta: Array, period: float, sample: float, other: Array,
              rows_out: Layout, out: Array) -> None:
    """Turn positions into readings; see SimulationResult for what they are."""
    sensed = layout[SENSES] < layout[ENCODES + 1]       # the two tables stand side by side
    if theta[ZERO] == 0.0 and not sensed:
        return
    for signal in (READING, OUTPUT):
        if rows_out[signal] < 0:
            continue
        reading = out[rows_out[signal]]
        x = reading.copy()
        for k in range(reading.shape[0]):
            reading[k] = x[k] + theta[ZERO]
        sense_errors(layout, theta, x, int(sample), period, other, reading)
        if signal == OUTPUT:
            encode_means(layout, theta, theta[NOISE], reading)
