"""The plant of the measured-like corpus: library effects, and effects that are in no library.

Twenty steps a sample of the classical Runge-Kutta method. Delays and shifts are whole numbers of
these steps, so a held command changes only between them. Dry friction, whose level may depend on
position, speed and load, is a switch between sliding and sticking: a reversal is found by regula
falsi on the step, a breakaway at the next step (the force that is missed is second order in it).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

STEPS = 20
"""Steps a sample; delays and shifts are multiples of a sample / STEPS."""
X1, V1, X2, V2, LAG, LAG2, CREEP, WEN, BRISTLE, MAXWELL, SAG, MOUNT, MOUNT_V = (
    *range(10), 13, 14, 15)
STATES = 16
MAXWELLS = 4
HELD, LINEAR, BAND_LIMITED = range(3)
INPUT, SEEN, READING, POSITION, SPEED, ACCELERATION, MISSING, REST = range(8)
ROWS = 8
SLIDE_FREE = 2


class Physics(NamedTuple):
    """Parameters in SI units; what is zero is not there. `remainder.py` says what each does."""

    mass: float = 1.0
    damping: float = 0.0
    stiffness: float = 0.0
    force_constant: float = 1.0
    lag: float = 0.0
    k3: float = 0.0
    k2: float = 0.0
    coulomb: float = 0.0
    lugre_force: float = 0.0
    lugre_stiffness: float = 0.0
    lugre_ratio: float = 1.0
    lugre_speed: float = 1.0
    lugre_damping: float = 0.0
    wen_stiffness: float = 0.0
    wen_yield: float = 1.0
    wen_shape: float = 0.5
    wen_exponent: float = 1.0
    drag: float = 0.0
    offset: float = 0.0
    second_lag: float = 0.0
    limit: float = math.inf
    slope: float = 0.0
    droop: float = 0.0
    share: float = 0.0
    mode_hz: float = 0.0
    mode_zeta: float = 0.0
    creep_stiffness: float = 0.0
    creep_time: float = 1.0
    shake: float = 0.0
    shake_hz: float = 0.0
    shake_phase: float = 0.0
    eddy: float = 0.0
    eddy_speed: float = 1.0
    damping_x: float = 0.0
    damping_x2: float = 0.0
    damping_direction: float = 0.0
    root_drag: float = 0.0
    bump: float = 0.0
    bump_speed: float = 1.0
    level_wave: float = 0.0
    level_length: float = 1.0
    load_friction: float = 0.0
    motor_wave: float = 0.0
    motor_length: float = 1.0
    play_stiffness: float = 0.0
    play_width: float = 0.0
    stiffness_rate: float = 0.0
    maxwell_stiffness: float = 0.0
    maxwell_time: float = 1.0
    soft_gain: float = 0.0
    dead_zone: float = 0.0
    slew: float = 0.0
    sag: float = 0.0
    sag_time: float = 1.0
    gain_noise: float = 0.0
    cogging: float = 0.0
    cogging_length: float = 1.0
    cogging_phase: float = 0.0
    gravity: float = 0.0
    gravity_length: float = 1.0
    stop_stiffness: float = 0.0
    stop_gap: float = 0.0
    stop_one_sided: float = 0.0
    cable: float = 0.0
    distortion_even: float = 0.0
    distortion_odd: float = 0.0
    mount_hz: float = 0.0
    mount_zeta: float = 0.0


@njit(cache=True)
def _drive(y: Any, p: Physics, u: float, gain: float, d: Any) -> float:
    """Force of the motor at rest in the middle (N); fills the derivatives of its states."""
    if p.dead_zone > 0.0:
        u = u - min(max(u, -p.dead_zone), p.dead_zone)
    if p.soft_gain != 0.0:
        u *= max(1.0 - p.soft_gain * abs(u), 0.2)
    if p.sag != 0.0:
        d[SAG] = (u * u - y[SAG]) / p.sag_time
        u *= max(1.0 - p.sag * y[SAG], 0.2)
    if p.lag > 0.0:
        d[LAG] = (u - y[LAG]) / p.lag
        u = y[LAG]
    if p.second_lag > 0.0:
        d[LAG2] = (u - y[LAG2]) / p.second_lag
        u = y[LAG2]
    return p.force_constant * u * (1.0 + p.gain_noise * gain)


@njit(cache=True)
def _static_forces(t: float, x: float, v: float, p: Physics) -> float:
    """Forces of position, speed and time (N), the linear spring and damper not among them."""
    force = p.offset - (p.k3 * x + p.k2) * x * x - p.drag * abs(v) * v
    force -= (p.damping_x + p.damping_x2 * x) * x * v + p.damping_direction * abs(v)
    force -= p.stiffness_rate * t * x + p.cable * max(x, 0.0)
    if p.eddy != 0.0:
        force -= p.eddy * v / (1.0 + (v / p.eddy_speed) ** 2)
    if p.root_drag != 0.0:
        force -= p.root_drag * math.copysign(math.sqrt(abs(v)), v)
    if p.shake != 0.0:
        force += p.shake * math.sin(2.0 * math.pi * p.shake_hz * t + p.shake_phase)
    if p.cogging != 0.0:
        force += p.cogging * math.sin(2.0 * math.pi * x / p.cogging_length + p.cogging_phase)
    if p.gravity != 0.0:
        force -= p.gravity * math.sin(x / p.gravity_length)
    if p.stop_stiffness != 0.0:
        force -= p.stop_stiffness * max(x - p.stop_gap, 0.0)
        if p.stop_one_sided == 0.0:
            force -= p.stop_stiffness * min(x + p.stop_gap, 0.0)
    return force


@njit(cache=True)
def _memory_forces(x: float, v: float, y: Any, p: Physics, played: float, d: Any) -> float:
    """Forces with states of their own (N); fills the states' derivatives."""
    force = -p.play_stiffness * played
    if p.creep_stiffness != 0.0:
        d[CREEP] = (x - y[CREEP]) / p.creep_time
        force -= p.creep_stiffness * (x - y[CREEP])
    if p.wen_stiffness != 0.0:
        w = y[WEN]
        force -= p.wen_stiffness * p.wen_yield * w
        turn = p.wen_shape * (1.0 if v * w > 0.0 else -1.0 if v * w < 0.0 else 0.0)
        d[WEN] = v / p.wen_yield * (
            1.0 - abs(w) ** p.wen_exponent * (turn + 1.0 - p.wen_shape))
    if p.lugre_stiffness > 0.0:
        level = p.lugre_force * (1.0 + (p.lugre_ratio - 1.0)
                                 * math.exp(-(v / p.lugre_speed) ** 2))
        d[BRISTLE] = v - p.lugre_stiffness * abs(v) * y[BRISTLE] / level
        force -= p.lugre_stiffness * y[BRISTLE] + p.lugre_damping * d[BRISTLE]
    if p.maxwell_stiffness != 0.0:
        settle = p.maxwell_time
        for i in range(MAXWELL, MAXWELL + MAXWELLS):
            force -= p.maxwell_stiffness * (x - y[i])
            d[i] = (x - y[i]) / settle
            settle *= 6.0
    return force


@njit(cache=True)
def _level(x: float, v: float, motor: float, p: Physics) -> float:
    """Level of dry friction (N)."""
    level = p.coulomb + p.load_friction * abs(motor)
    if p.level_wave != 0.0:
        level += p.level_wave * (1.0 + math.sin(x / p.level_length))
    if p.bump != 0.0:
        level += p.bump * math.exp(-(v / p.bump_speed) ** 2)
    return level


@njit(cache=True)
def _slopes(t: float, y: Any, p: Physics, u: float, gain: float, played: float, direction: int,
            d: Any) -> tuple[float, float]:
    """Fill the derivatives d; return all forces but dry friction, and its level (N).

    direction: +1 and -1 sliding, 0 sticking, SLIDE_FREE without dry friction.
    """
    share = p.share
    x = (1.0 - share) * y[X1] + share * y[X2]
    v = (1.0 - share) * y[V1] + share * y[V2]
    motor = _drive(y, p, u, gain, d)
    motor *= 1.0 + p.slope * x - p.droop * x * x
    if p.motor_wave != 0.0:
        motor *= 1.0 + p.motor_wave * math.sin(x / p.motor_length)
    force = motor + _static_forces(t, x, v, p) + _memory_forces(x, v, y, p, played, d)
    spring = p.damping * y[V1] + p.stiffness * y[X1]
    level = _level(x, v, motor, p)
    total = force - spring
    if direction == 0:
        total = 0.0
    elif direction != SLIDE_FREE:
        total -= level * direction
    d[X1], d[V1] = y[V1], total / p.mass
    if share != 0.0:
        w = 2.0 * math.pi * p.mode_hz
        d[X2] = y[V2]
        d[V2] = force / p.mass - 2.0 * p.mode_zeta * w * y[V2] - w * w * y[X2]
    if p.mount_hz > 0.0:
        w = 2.0 * math.pi * p.mount_hz
        d[MOUNT] = y[MOUNT_V]
        d[MOUNT_V] = w * w * (x - y[MOUNT]) - 2.0 * p.mount_zeta * w * y[MOUNT_V]
    return force - spring, level


@njit(cache=True)
def _rk4(t: float, h: float, y: Any, p: Physics, u: Any, gain: float, played: float,
         direction: int, k: Any, trial: Any, after: Any) -> None:
    """One step of length h from y into `after`; u: the command at its start, middle and end."""
    _slopes(t, y, p, u[0], gain, played, direction, k[0])
    for i in range(STATES):
        trial[i] = y[i] + 0.5 * h * k[0, i]
    _slopes(t + 0.5 * h, trial, p, u[1], gain, played, direction, k[1])
    for i in range(STATES):
        trial[i] = y[i] + 0.5 * h * k[1, i]
    _slopes(t + 0.5 * h, trial, p, u[1], gain, played, direction, k[2])
    for i in range(STATES):
        trial[i] = y[i] + h * k[2, i]
    _slopes(t + h, trial, p, u[2], gain, played, direction, k[3])
    for i in range(STATES):
        after[i] = y[i] + h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@njit(cache=True)
def _begins(t: float, y: Any, p: Physics, u: float, gain: float, played: float, k: Any) -> int:
    """The mode of a body at rest: 0 sticks, else the direction in which it breaks away."""
    force, level = _slopes(t, y, p, u, gain, played, 0, k[0])
    return 0 if abs(force) <= level else 1 if force > 0.0 else -1


@njit(cache=True)
def _dry(t: float, h: float, y: Any, p: Physics, u: Any, gain: float, played: float,
         direction: int, k: Any, trial: Any, after: Any) -> int:
    """Advance y by h with dry friction; return the mode afterwards."""
    if direction == 0:
        direction = _begins(t, y, p, u[0], gain, played, k)
    _rk4(t, h, y, p, u, gain, played, direction, k, trial, after)
    if direction == 0 or after[V1] * direction >= 0.0:
        y[:] = after
        return direction
    low, high, at_low, at_high = 0.0, h, y[V1] * direction, after[V1] * direction
    middle = 0.0
    for _ in range(12):
        middle = low + (high - low) * min(max(at_low / (at_low - at_high), 0.01), 0.99)
        _rk4(t, middle, y, p, u, gain, played, direction, k, trial, after)
        value = after[V1] * direction
        if abs(value) < 1e-12 * p.mass:
            break
        if value > 0.0:
            low, at_low, at_high = middle, value, 0.5 * at_high
        else:
            high, at_high, at_low = middle, value, 0.5 * at_low
    y[:] = after
    y[V1] = 0.0
    direction = _begins(t + middle, y, p, u[1], gain, played, k)
    _rk4(t + middle, h - middle, y, p, u, gain, played, direction, k, trial, after)
    y[:] = after
    return direction


@njit(cache=True)
def _command(place: int, hold: int, command: Any, fine: Any, u: Any) -> None:
    """Command at start, middle and end of step `place`, counted from the first sample."""
    if hold == BAND_LIMITED:
        for i in range(3):
            u[i] = fine[min(max(2 * place + i, 0), fine.size - 1)]
        return
    k = place // STEPS
    last = command.size - 1
    here = command[min(max(k, 0), last)]
    u[:] = here if k >= 0 else 0.0
    if hold == LINEAR:
        begin = here if k >= 0 else 0.0
        rise = command[min(max(k + 1, 0), last)] - begin if k >= -1 else 0.0
        for i in range(3):
            u[i] = begin + rise * ((place - k * STEPS) + 0.5 * i) / STEPS


@njit(cache=True)
def _slewed(u: Any, before: float, most: float) -> float:
    """Bound the command's change since the last step; return the command at the end."""
    u[2] = min(max(u[2], before - most), before + most)
    u[0] = before
    u[1] = 0.5 * (before + u[2])
    return u[2]


@njit(cache=True)
def _reading(y: Any, p: Physics) -> float:
    """What the sensor sees without noise (m)."""
    x = y[MOUNT] if p.mount_hz > 0.0 else (1.0 - p.share) * y[X1] + p.share * y[X2]
    return x + (p.distortion_even + p.distortion_odd * x) * x * x


@njit(cache=True)
def _note(n: int, t: float, y: Any, p: Physics, without: Physics, plain: Physics, u: float,
          gain: float, played: float, direction: int, k: Any, out: Any) -> None:
    """Position, speed, acceleration, and the forces (N) that linear model and library miss."""
    share = p.share
    force, level = _slopes(t, y, p, u, gain, played, direction, k[0])
    out[POSITION, n] = (1.0 - share) * y[X1] + share * y[X2]
    out[SPEED, n] = (1.0 - share) * y[V1] + share * y[V2]
    out[ACCELERATION, n] = (1.0 - share) * k[0, V1] + share * k[0, V2]
    linear, _ = _slopes(t, y, plain, u, 0.0, 0.0, SLIDE_FREE, k[1])
    library, lower = _slopes(t, y, without, u, gain, played, direction, k[2])
    total, known = force, library
    if direction == 0:
        total, known = 0.0, library - min(max(library, -lower), lower)
    elif direction != SLIDE_FREE:
        total, known = force - level * direction, library - lower * direction
    out[MISSING, n] = total - linear
    out[REST, n] = total - known


@njit(cache=True)
def run(p: Physics, without: Physics, plain: Physics, period: float, hold: int, late: int,
        command: Any, fine: Any, gains: Any, reference: Any, noise: Any, wander: Any,
        resolution: float, start: Any, out: Any, readings: Any) -> None:
    """Simulate a record.

    p, without, plain: `packed` parameters; without the remainder, and of the linear model, they
    give rows MISSING and REST along the motion. late: steps by which the plant sees the command
    later (or, below zero, earlier). command (N,): held or linear; with gains it is added to the
    loop's. fine (2 STEPS N + 1,): a band-limited command at half steps. gains: kp (V/m), ki
    (V/(m s)), kd (V s/m), filter time (s). noise (N,) m; wander (N,): relative changes of the
    motor's gain where gain_noise asks for them. out: (ROWS, N). readings: (STEPS N,) without
    noise. A motion that escapes ends in NaN.
    """
    y, k, trial, after = start.copy(), np.zeros((4, STATES)), np.zeros(STATES), np.zeros(STATES)
    dry = p.coulomb > 0.0 or p.bump > 0.0 or p.level_wave > 0.0 or p.load_friction > 0.0
    mode = 0 if dry else SLIDE_FREE
    if dry and y[V1] != 0.0:
        mode = 1 if y[V1] > 0.0 else -1
    u, sent, played, before = np.zeros(3), command.copy(), 0.0, 0.0
    integral, filtered, last = 0.0, 0.0, 0.0
    closed = gains[0] != 0.0 or gains[1] != 0.0 or gains[2] != 0.0
    h = period / STEPS
    for n in range(command.size):
        out[READING, n] = _reading(y, p)
        seen = out[READING, n] + noise[n]
        if resolution > 0.0:
            seen = math.floor(seen / resolution + 0.5) * resolution
        if closed:
            error = reference[n] - seen
            integral += gains[1] * period * error
            filtered += (error - (last if n > 0 else error) - filtered) * period / (
                gains[3] + period)
            last = error
            sent[n] = command[n] + gains[0] * error + integral + gains[2] * filtered / period
        out[INPUT, n], out[SEEN, n] = sent[n], seen
        for j in range(STEPS):
            place = n * STEPS + j
            readings[place] = _reading(y, p)
            _command(place - late, hold, sent, fine, u)
            for i in range(3):
                u[i] = min(max(u[i], -p.limit), p.limit)
            if p.slew > 0.0:
                before = _slewed(u, before, p.slew * h)
            if j == 0:
                _note(n, n * period, y, p, without, plain, u[0], wander[n], played, mode, k, out)
            if dry:
                mode = _dry(place * h, h, y, p, u, wander[n], played, mode, k, trial, after)
            else:
                _rk4(place * h, h, y, p, u, wander[n], played, mode, k, trial, after)
                y[:] = after
            played = min(max(played, y[X1] - p.play_width), y[X1] + p.play_width)
        if not abs(y[X1]) < 1e3:
            out[:, n + 1:] = np.nan
            readings[(n + 1) * STEPS:] = np.nan
            return


PLAIN_FIELDS = ("mass", "damping", "stiffness", "force_constant", "lag")


def packed(p: Physics) -> Any:
    """The parameters as the record that the compiled plant reads, by reference."""
    return np.array([tuple(p)], dtype=[(name, np.float64) for name in Physics._fields])[0]


def linear_part(p: Physics) -> Physics:
    """The plant without any effect."""
    return Physics(**{name: getattr(p, name) for name in PLAIN_FIELDS})
