"""The corpus's own plant: every effect written out, integrated by Runge-Kutta in fine steps.

State: modes (x1, v1, x2, v2), amplifier, second amplifier lag, coil, creep, Bouc-Wen and bristle;
behind them, where one of the uncommon effects is there, their states (`uncommon`).
The held command changes at t_k + delay; each piece between changes is integrated by classical
RK4 with steps of at most `finest`. Dry friction is an event-driven switch between sliding and
sticking: the instant of each reversal and breakaway is found by regula falsi on the RK4 step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from benchmarks.corpus import uncommon

FIELDS = (
    "mass", "damping", "stiffness", "force_constant", "lag", "delay", "resistance",
    "inductance", "emf", "zero", "resolution",
    "k3", "k2", "coulomb", "lugre_force", "lugre_stiffness", "lugre_ratio", "lugre_speed",
    "lugre_damping", "wen_stiffness", "wen_yield", "wen_shape", "wen_exponent", "drag", "offset",
    "second_lag", "limit", "slope", "droop", "share", "mode_hz", "mode_zeta", "other_ratio",
    "other_stiffness", "step", "ripple", "ripple_period", "ripple_phase", "creep_stiffness",
    "creep_time", "drift_rate", "drift_decay", "shake", "shake_hz", "shake_phase",
    "eddy", "eddy_speed")
(MASS, DAMPING, STIFFNESS, FORCE_CONSTANT, LAG, DELAY, RESISTANCE, INDUCTANCE, EMF, ZERO,
 RESOLUTION, K3, K2, COULOMB, LUGRE_FORCE, LUGRE_STIFFNESS, LUGRE_RATIO, LUGRE_SPEED,
 LUGRE_DAMPING, WEN_STIFFNESS, WEN_YIELD, WEN_SHAPE, WEN_EXPONENT, DRAG, OFFSET, SECOND_LAG,
 LIMIT, SLOPE, DROOP, SHARE, MODE_HZ, MODE_ZETA, OTHER_RATIO, OTHER_STIFFNESS, STEP, RIPPLE,
 RIPPLE_PERIOD, RIPPLE_PHASE, CREEP_STIFFNESS, CREEP_TIME, DRIFT_RATE, DRIFT_DECAY, SHAKE,
 SHAKE_HZ, SHAKE_PHASE, EDDY, EDDY_SPEED) = range(len(FIELDS))
X1, V1, X2, V2, AMP, AMP2, COIL, CREEP, WEN, BRISTLE = range(10)
STATES = 10
OTHER_PER_SAMPLE = 20
COMMON = len(FIELDS)
FINER = 16
"""Parts of a step within which a piecewise force changes its piece."""


def numbers(values: dict[str, float]) -> Any:
    """The parameters as the plant's array; what is not named is zero (no limit: infinite).

    Of two lags in a row, which commute, the faster one comes first. The array is longer if one of
    the uncommon effects is there.
    """
    filled = np.zeros(len(FIELDS))
    filled[LIMIT] = math.inf
    for name, value in values.items():
        if name in FIELDS:
            filled[FIELDS.index(name)] = value
    lags = sorted(lag for lag in filled[[LAG, SECOND_LAG]] if lag > 0.0)
    filled[[LAG, SECOND_LAG]] = [*lags, 0.0, 0.0][:2]
    further = uncommon.packed({n: v for n, v in values.items() if n not in FIELDS})
    return np.concatenate([filled, further]) if np.any(further) else filled


@njit(cache=True)
def _neighbour(t: float, period: float, other: Any) -> float:
    """Position of the other axis at time t: cubic Lagrange on its fine grid."""
    if other.size == 0:
        return 0.0
    place = t / period * OTHER_PER_SAMPLE
    i = min(max(int(place), 1), other.size - 3)
    f = place - i
    return (-f * (f - 1) * (f - 2) / 6 * other[i - 1] + (f + 1) * (f - 1) * (f - 2) / 2 * other[i]
            - (f + 1) * f * (f - 2) / 2 * other[i + 1] + (f + 1) * f * (f - 1) / 6 * other[i + 2])


@njit(cache=True)
def _amplified(command: float, y: Any, p: Any, d: Any) -> float:
    """What comes out of the amplifier; fills the derivatives of its states."""
    if p.size > COMMON:
        command = uncommon.commanded(command, y[STATES:], p[COMMON:], d[STATES:])
    if p[LAG] > 0.0:
        d[AMP] = (command - y[AMP]) / p[LAG]
        command = y[AMP]
    if p[SECOND_LAG] > 0.0:
        d[AMP2] = (command - y[AMP2]) / p[SECOND_LAG]
        command = y[AMP2]
    return command


@njit(cache=True)
def _slopes(t: float, y: Any, p: Any, command: float, direction: int, near: float,
            d: Any) -> tuple[float, float]:
    """Fill the derivatives d; return the friction force that would hold the stage still, and the
    level of dry friction (N).

    direction: +1 and -1 sliding, 0 sticking, 2 no dry friction.
    """
    share = p[SHARE]
    x = (1.0 - share) * y[X1] + share * y[X2]
    v = (1.0 - share) * y[V1] + share * y[V2]
    level, more = p[COULOMB], p.size > COMMON
    driven = _amplified(command, y, p, d) - p[EMF] * v
    if p[INDUCTANCE] > 0.0:
        d[COIL] = (driven - y[COIL]) * p[RESISTANCE] / p[INDUCTANCE]
        driven = y[COIL]
    force = p[FORCE_CONSTANT] * driven * (1.0 + p[SLOPE] * x - p[DROOP] * x * x) + p[OFFSET]
    if more:
        level += uncommon.level(x, v, force - p[OFFSET], p[COMMON:])
        force += uncommon.forces(t, x, v, y[STATES:], p[COMMON:], d[STATES:])
    force -= (p[K3] * x + p[K2]) * x * x + p[DRAG] * abs(v) * v
    if p[EDDY] != 0.0:
        force -= p[EDDY] * v / (1.0 + (v / p[EDDY_SPEED]) ** 2)
    if p[SHAKE] != 0.0:
        force += p[SHAKE] * math.sin(2.0 * math.pi * p[SHAKE_HZ] * t + p[SHAKE_PHASE])
    if p[OTHER_STIFFNESS] != 0.0:
        force -= p[OTHER_STIFFNESS] * near
    if p[CREEP_STIFFNESS] != 0.0:
        force -= p[CREEP_STIFFNESS] * (x - y[CREEP])
        d[CREEP] = (x - y[CREEP]) / p[CREEP_TIME]
    if p[WEN_STIFFNESS] != 0.0:
        w = y[WEN]
        force -= p[WEN_STIFFNESS] * p[WEN_YIELD] * w
        turn = p[WEN_SHAPE] * (1.0 if v * w > 0.0 else -1.0 if v * w < 0.0 else 0.0)
        d[WEN] = v / p[WEN_YIELD] * (
            1.0 - abs(w) ** p[WEN_EXPONENT] * (turn + 1.0 - p[WEN_SHAPE]))
    if p[LUGRE_FORCE] > 0.0:
        limit = p[LUGRE_FORCE] * (1.0 + (p[LUGRE_RATIO] - 1.0)
                                  * math.exp(-(v / p[LUGRE_SPEED]) ** 2))
        d[BRISTLE] = v - p[LUGRE_STIFFNESS] * abs(v) * y[BRISTLE] / limit
        force -= p[LUGRE_STIFFNESS] * y[BRISTLE] + p[LUGRE_DAMPING] * d[BRISTLE]
    first = (p[DAMPING] * y[V1] + p[STIFFNESS] * y[X1]) / p[MASS]
    second = 0.0
    if share != 0.0:
        omega = 2.0 * math.pi * p[MODE_HZ]
        second = 2.0 * p[MODE_ZETA] * omega * y[V2] + omega * omega * y[X2]
    still = p[MASS] * ((1.0 - share) * first + share * second) - force
    if direction == 0:
        force += still
    elif direction != 2:
        force -= level * direction
    d[X1] = y[V1]
    d[V1] = force / p[MASS] - first
    d[X2] = y[V2]
    d[V2] = force / p[MASS] - second if share != 0.0 else 0.0
    return still, level


@njit(cache=True)
def _rk4(t: float, h: float, y: Any, p: Any, command: float, direction: int, period: float,
         other: Any, k: Any, trial: Any, after: Any) -> None:
    """One classical Runge-Kutta step of length h from y into `after`."""
    start, middle, end = 0.0, 0.0, 0.0
    if other.size > 0:
        start = _neighbour(t, period, other)
        middle = _neighbour(t + 0.5 * h, period, other)
        end = _neighbour(t + h, period, other)
    _slopes(t, y, p, command, direction, start, k[0])
    for i in range(y.size):
        trial[i] = y[i] + 0.5 * h * k[0, i]
    _slopes(t + 0.5 * h, trial, p, command, direction, middle, k[1])
    for i in range(y.size):
        trial[i] = y[i] + 0.5 * h * k[1, i]
    _slopes(t + 0.5 * h, trial, p, command, direction, middle, k[2])
    for i in range(y.size):
        trial[i] = y[i] + h * k[2, i]
    _slopes(t + h, trial, p, command, direction, end, k[3])
    for i in range(y.size):
        after[i] = y[i] + h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])


@njit(cache=True)
def _event(t: float, y: Any, p: Any, command: float, direction: int, period: float, other: Any,
           k: Any) -> float:
    """What changes sign when the mode ends: the speed, or the reserve of static friction."""
    if direction != 0:
        return direction * ((1.0 - p[SHARE]) * y[V1] + p[SHARE] * y[V2])
    still, level = _slopes(t, y, p, command, 0, _neighbour(t, period, other), k[0])
    return level - abs(still)


@njit(cache=True)
def _stopped(t: float, y: Any, p: Any, command: float, period: float, other: Any, k: Any) -> int:
    """The mode of a stage at rest: 0 sticks, else the direction in which it breaks away."""
    still, level = _slopes(t, y, p, command, 0, _neighbour(t, period, other), k[0])
    if abs(still) <= level:
        return 0
    return -1 if still > 0.0 else 1


@njit(cache=True)
def _dry(t: float, h: float, y: Any, p: Any, command: float, direction: int, period: float,
         other: Any, k: Any, trial: Any, after: Any) -> int:
    """Advance y by h with dry friction; return the mode afterwards."""
    share, left = p[SHARE], h
    if direction == 0:
        direction = _stopped(t, y, p, command, period, other, k)
    for _ in range(20):
        if left <= 1e-13:
            break
        _rk4(t, left, y, p, command, direction, period, other, k, trial, after)
        value = _event(t + left, after, p, command, direction, period, other, k)
        if value >= 0.0:
            for i in range(y.size):
                y[i] = after[i]
            break
        low, high, at_low, at_high = 0.0, left, 0.0, value
        at_low = max(_event(t, y, p, command, direction, period, other, k), 0.0)
        if direction != 0 and at_low == 0.0:
            low = min(1e-9, 0.1 * left)  # just broken away: the speed is still zero
            _rk4(t, low, y, p, command, direction, period, other, k, trial, after)
            at_low = max(_event(t + low, after, p, command, direction, period, other, k), 0.0)
        middle = low
        for _ in range(60):
            if at_low == 0.0 or high - low < 1e-13:
                middle = high
                break
            middle = low + (high - low) * min(max(at_low / (at_low - at_high), 0.02), 0.98)
            _rk4(t, middle, y, p, command, direction, period, other, k, trial, after)
            value = _event(t + middle, after, p, command, direction, period, other, k)
            if value > 0.0:
                low, at_low = middle, value
                at_high *= 0.5
            else:
                high, at_high = middle, value
                at_low *= 0.5
            if abs(value) < 1e-13:
                break
        _rk4(t, middle, y, p, command, direction, period, other, k, trial, after)
        for i in range(y.size):
            y[i] = after[i]
        t += middle
        left -= middle
        if direction != 0:
            y[V1] -= (1.0 - share) * y[V1] + share * y[V2]
            direction = _stopped(t, y, p, command, period, other, k)
        else:
            still, _ = _slopes(t, y, p, command, 0, _neighbour(t, period, other), k[0])
            direction = -1 if still > 0.0 else 1
    return direction


@njit(cache=True)
def _step(t: float, h: float, y: Any, p: Any, command: float, direction: int, period: float,
          other: Any, k: Any, trial: Any, after: Any) -> int:
    """Advance y by one step of length h; return the mode."""
    if direction != 2:
        return _dry(t, h, y, p, command, direction, period, other, k, trial, after)
    _rk4(t, h, y, p, command, direction, period, other, k, trial, after)
    for j in range(y.size):
        y[j] = after[j]
    return direction


@njit(cache=True)
def _place(y: Any, p: Any) -> tuple[float, float]:
    """Position (m) and speed (m/s)."""
    share = p[SHARE]
    return (1.0 - share) * y[X1] + share * y[X2], (1.0 - share) * y[V1] + share * y[V2]


@njit(cache=True)
def _pieces(t: float, h: float, y: Any, p: Any, command: float, direction: int, period: float,
            other: Any, k: Any, trial: Any, after: Any) -> int:
    """The same with uncommon effects: finer where a force changes its piece; the sensor's lag."""
    q, first, mode = p[COMMON:], y.copy(), direction
    x, v = _place(y, p)
    direction = _step(t, h, y, p, command, direction, period, other, k, trial, after)
    if uncommon.zone(x, v, q) != uncommon.zone(*_place(y, p), q):
        y[:] = first
        direction = mode
        for i in range(FINER):
            direction = _step(t + i * h / FINER, h / FINER, y, p, command, direction, period,
                              other, k, trial, after)
    if q[uncommon.SENSOR_LAG] > 0.0:
        y[STATES + uncommon.LAGGED] = uncommon.followed(
            first[STATES + uncommon.LAGGED], h, q[uncommon.SENSOR_LAG], x, v, *_place(y, p))
    return direction


@njit(cache=True)
def _advance(t: float, length: float, longest: float, y: Any, p: Any, command: float,
             direction: int, period: float, other: Any, k: Any, trial: Any, after: Any) -> int:
    """Advance y under a constant command in steps of at most `longest`; return the mode."""
    steps = math.ceil(length / longest - 1e-9)
    for i in range(steps):
        h = length / steps
        if p.size > COMMON:
            direction = _pieces(t + i * h, h, y, p, command, direction, period, other, k, trial,
                                after)
        else:
            direction = _step(t + i * h, h, y, p, command, direction, period, other, k, trial,
                              after)
    return direction


@njit(cache=True)
def _slewing(t: float, length: float, longest: float, y: Any, p: Any, command: float,
             direction: int, period: float, other: Any, k: Any, trial: Any,
             after: Any) -> tuple[int, float]:
    """Advance y while the amplifier's output runs after the command; the mode and the time."""
    if p.size == COMMON or p[COMMON + uncommon.SLEW_RATE] == 0.0:
        return direction, 0.0
    rate, output = p[COMMON + uncommon.SLEW_RATE], STATES + uncommon.SLEWED
    gap = command - y[output]
    taken = min(abs(gap) / rate, length)
    y[STATES + uncommon.SLOPE] = math.copysign(rate, gap)
    direction = _advance(t, taken, longest, y, p, command, direction, period, other, k, trial,
                         after)
    y[STATES + uncommon.SLOPE] = 0.0
    if taken < length:
        y[output] = command
    return direction, taken


@njit(cache=True)
def _held(out: Any, n: int, past: float) -> float:
    """The command of sample n, or the constant one before the record."""
    return out[0, n] if n >= 0 else past


@njit(cache=True)
def _rounded(value: float, step: float) -> float:
    return value if step <= 0.0 else math.floor(value / step + 0.5) * step


@njit(cache=True)
def _reading(t: float, x: float, near: float, p: Any) -> float:
    """What the encoder sees, without noise and rounding (m)."""
    reading = x + p[ZERO] + p[OTHER_RATIO] * near
    if p[RIPPLE] != 0.0:
        reading += p[RIPPLE] * math.sin(2.0 * math.pi * x / p[RIPPLE_PERIOD] + p[RIPPLE_PHASE])
    if p[DRIFT_RATE] != 0.0 and p[DRIFT_DECAY] == 0.0:
        reading += p[DRIFT_RATE] * t
    elif p[DRIFT_RATE] != 0.0:
        reading -= p[DRIFT_RATE] * math.expm1(-p[DRIFT_DECAY] * t) / p[DRIFT_DECAY]
    return reading


@njit(cache=True)
def _longest(v: float, finest: float, period: float, p: Any) -> float:
    """Step (s) that friction with memory allows at the speed v."""
    longest = finest
    if p[LUGRE_FORCE] > 0.0 and v != 0.0:
        longest = min(longest, 0.25 * p[LUGRE_FORCE] / (p[LUGRE_STIFFNESS] * abs(v)))
    if p[WEN_STIFFNESS] != 0.0 and v != 0.0:
        longest = min(longest, 0.1 * p[WEN_YIELD] / abs(v))
    if p.size > COMMON:
        longest = min(longest, uncommon.longest(v, p[COMMON:]))
        if uncommon.moves_command(p[COMMON:]) and p[LAG] > 0.0:
            longest = min(longest, 0.5 * p[LAG])
    return max(longest, min(finest, period / 2000.0))


@njit(cache=True)
def _begun(start: Any, p: Any) -> Any:
    """All states at the beginning; those of uncommon effects are at rest."""
    if p.size == COMMON:
        return start.copy()
    y = np.zeros(STATES + uncommon.STATES)
    y[:STATES] = start
    uncommon.begin(_place(y, p)[0], y[STATES:])
    return y


@njit(cache=True)
def _is_dry(p: Any) -> bool:
    """Whether there is dry friction."""
    return p[COULOMB] > 0.0 or (p.size > COMMON and uncommon.is_dry(p[COMMON:]))


@njit(cache=True)
def _sensed(x: float, y: Any, p: Any) -> float:
    """The position as the sensor has it (m)."""
    return uncommon.seen(x, y[STATES:], p[COMMON:]) if p.size > COMMON else x


@njit(cache=True)
def run(p: Any, period: float, finest: float, reference: Any, feed: Any, gains: Any, noise: Any,
        jitter: Any, other: Any, start: Any, past: float, out: Any) -> None:
    """Simulate a record; with gains all zero `feed` is the input, else it is added to the loop's.

    gains: kp (V/m), ki (V/(m s)), kd (V s/m), filter time of the derivative (s). `start` holds the
    states at t_0 and `past` the input before it. Rows of out: input (V), measured position (m),
    reading without noise and rounding (m), current (A; the drive in V without a resistance),
    position (m), speed (m/s).
    """
    more, y = p.size > COMMON, _begun(start, p)
    k, trial, after = np.zeros((4, y.size)), np.zeros(y.size), np.zeros(y.size)
    plays, shaped = np.zeros(uncommon.PLAYS), 0.0
    whole = math.floor(p[DELAY] / period + 1e-12)
    late = max(p[DELAY] - whole * period, 0.0)
    if late < 1e-12:
        late = 0.0
    dry = _is_dry(p)
    direction = 0 if dry else 2
    if dry and abs((1.0 - p[SHARE]) * y[V1] + p[SHARE] * y[V2]) > 0.0:
        direction = 1 if (1.0 - p[SHARE]) * y[V1] + p[SHARE] * y[V2] > 0.0 else -1
    integral, filtered, last = 0.0, 0.0, 0.0
    for n in range(feed.size):
        t = n * period
        share = p[SHARE]
        x = (1.0 - share) * y[X1] + share * y[X2]
        v = (1.0 - share) * y[V1] + share * y[V2]
        arrived = min(max(_held(out, n - whole - 1, past), -p[LIMIT]), p[LIMIT])
        reading = _reading(t, _sensed(x, y, p), _neighbour(t, period, other), p)
        seen = reading + noise[n] + v * jitter[n]
        seen = _rounded(_rounded(seen, p[STEP]), p[RESOLUTION])
        command = feed[n]
        if gains[0] != 0.0 or gains[1] != 0.0 or gains[2] != 0.0:
            error = reference[n] - seen
            integral += gains[1] * period * error
            filtered += (error - (last if n > 0 else error) - filtered) * period / (
                gains[3] + period)
            last = error
            command += gains[0] * error + integral + gains[2] * filtered / period
        out[0, n] = command
        new = min(max(_held(out, n - whole, past), -p[LIMIT]), p[LIMIT])
        amplified = arrived
        if more:
            arrived, shaped = shaped, uncommon.shaped(new, plays, p[COMMON:])
            new = shaped
            amplified = uncommon.commanded(arrived, y[STATES:], p[COMMON:], k[0, STATES:])
        if p[LAG] > 0.0:
            amplified = y[AMP]
        if p[SECOND_LAG] > 0.0:
            amplified = y[AMP2]
        driven = y[COIL] if p[INDUCTANCE] > 0.0 else amplified - p[EMF] * v
        out[1, n], out[2, n] = seen, reading
        out[3, n] = driven / p[RESISTANCE] if p[RESISTANCE] > 0.0 else driven
        out[4, n], out[5, n] = x, v
        longest = _longest(v, finest, period, p)
        for piece in range(2):
            length = late if piece == 0 else period - late
            if length <= 0.0:
                continue
            held = arrived if piece == 0 else new
            begin = t if piece == 0 else t + late
            direction, taken = _slewing(begin, length, longest, y, p, held, direction, period,
                                        other, k, trial, after)
            begin += taken
            length -= taken
            if 0.0 < p[LAG] < longest:  # a fast lag settles first; then it stays on the command
                settling = min(30.0 * p[LAG], length)
                direction = _advance(begin, settling, 0.5 * p[LAG], y, p, held, direction, period,
                                     other, k, trial, after)
                begin += settling
                length -= settling
                if length > 0.0:
                    y[AMP] = held
            direction = _advance(begin, length, longest, y, p, held, direction, period, other, k,
                                 trial, after)
        if not abs(y[X1]) < 1e3:
            for row in range(6):
                out[row, n + 1:] = np.nan
            return
