"""Movements over an area or between points: raster, spiral, Lissajous, point to point, stairs.

Each function returns position, velocity, acceleration, where the part that counts is under way,
and the samples of the period (0: none) and of the start. A pattern of two axes is made axis by
axis: each gets its part, told apart by the phase.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Movement, Timing, Values
from dfm_stage.trajectory.waveform import RAMP, smooth_step

_CENTER = Parameter("center_m", 0.0, "m", "middle of the pattern")
RASTER_PARAMETERS = (
    Parameter("line_length_m", 5e-3, "m", "length of the constant-velocity part", 1e-9, 1.0),
    Parameter("line_time_s", 0.4, "s", "duration of the constant-velocity part", 1e-6),
    Parameter("turnaround_s", 0.1, "s", "duration of each reversal", 1e-6),
    Parameter("center_m", 0.0, "m", "middle of the line"),
    Parameter("lead_in_s", 0.5, "s",
              "smooth start from rest at the middle; 0 = start on the line at full speed", 0.0),
    Parameter("lead_out_s", 0.0, "s",
              "smooth stop at the middle after the last line back; 0 = scan to the end", 0.0),
    Parameter("rest_s", 0.0, "s", "rest after the smooth stop", 0.0),
)
SPIRAL_PARAMETERS = (
    Parameter("radius_m", 1e-3, "m", "largest radius", 1e-9, 1.0),
    Parameter("turns", 10.0, "", "whole turns from the middle to the radius", 1.0, 1e6),
    Parameter("turn_s", 0.5, "s", "duration of one turn", 1e-6),
    Parameter("phase_deg", 0.0, "deg", "0 for one axis, -90 for the other", -360.0, 360.0),
    _CENTER,
)
LISSAJOUS_PARAMETERS = (
    Parameter("amplitude_m", 1e-3, "m", "largest distance from the middle", 0.0),
    Parameter("pattern_s", 10.0, "s", "duration of the whole pattern, after which it repeats",
              1e-6),
    Parameter("cycles", 10.0, "", "whole cycles of this axis in a pattern; the axes' numbers "
              "without a common factor fill the area", 1.0, 1e9),
    Parameter("phase_deg", 0.0, "deg", "phase at the start", -360.0, 360.0),
    RAMP, _CENTER,
)
POINT_PARAMETERS = (
    Parameter("velocity_m_s", 0.02, "m/s", "largest velocity", 1e-9, 1e3),
    Parameter("acceleration_m_s2", 0.5, "m/s^2", "largest acceleration", 1e-9, 1e6),
    Parameter("jerk_m_s3", 50.0, "m/s^3", "largest jerk", 1e-9, 1e9),
    Parameter("dwell_s", 0.5, "s", "rest at each point", 0.0),
    Parameter("delay_s", 0.0, "s", "extra time on the first point", 0.0),
)
POINT_OPTIONS = (
    Option("points_m", (0.0, 1e-3), "points in order, starting on the first", unit="m"),
    Option("repeat", False, "go back to the first point and start over"),
)


def raster(values: Values, timing: Timing) -> Movement:
    """Return position, velocity, acceleration, where the line is, period and lead-in samples.

    With v = line_length_m / line_time_s the velocity in a turnaround of duration T is
    v (1 - 2 S(t/T)), S the smooth step 10u^3 - 15u^4 + 6u^5: velocity, acceleration and jerk are
    continuous, the acceleration is at most 3.75 v / T and the jerk at most 11.547 v / T^2. Past
    the end of the line the stage moves 0.34375 v T further and comes back to the same point.
    """
    length, line_s = values.number("line_length_m"), values.number("line_time_s")
    turn_s, center = values.number("turnaround_s"), values.number("center_m")
    speed, dt = length / line_s, timing.sample_period_s
    period = values.samples(2.0 * (line_s + turn_s), "line_time_s + turnaround_s, twice,", timing)
    lead = values.samples(values.number("lead_in_s"), "lead_in_s", timing)

    index = np.arange(timing.count) - lead
    t = (index % period) * dt
    back = t >= line_s + turn_s - 1e-9 * dt
    sign = np.where(back, -1.0, 1.0)
    t = np.where(back, t - (line_s + turn_s), t)
    t = np.where(np.abs(t - line_s) < 1e-9, line_s, t)
    u = np.maximum(t - line_s, 0.0) / turn_s
    s, ds, _ = smooth_step(u)
    travelled = speed * np.minimum(t, line_s) + speed * turn_s * (u - 2.0 * _area(u))
    position = center + sign * (travelled - 0.5 * length)
    velocity = sign * speed * (1.0 - 2.0 * s)
    acceleration = -sign * speed * 2.0 * ds / turn_s
    on_line = (u == 0.0) & (index >= 0)
    if lead:
        x, velocity[:lead], acceleration[:lead] = _lead_in(
            np.arange(float(min(lead, timing.count))) * dt, lead * dt, -0.5 * length, speed,
            turn_s)
        position[:lead] = center + x
    out_s = values.number("lead_out_s")
    if out_s > 0.0:
        turn = values.samples(turn_s, "turnaround_s", timing)
        out = values.samples(out_s, "lead_out_s", timing)
        rest = values.samples(values.number("rest_s"), "rest_s", timing)
        lines = (timing.count - lead - out - rest + turn) // period
        stop = lead + lines * period - turn
        if lines < 1:
            raise values.error("lead_out_s", "the duration leaves no time for one line there and "
                               f"back: {(lead + period - turn + out + rest) * dt:g} s are needed")
        # The way in, backwards; time -t turns the velocity about.
        t = np.maximum(out - np.arange(timing.count - stop), 0.0) * dt
        x, v, a = _lead_in(t, out * dt, -0.5 * length, speed, turn_s)
        position[stop:], velocity[stop:], acceleration[stop:] = center + x, -v, a
        on_line[stop:] = False
    return position, velocity, acceleration, on_line, period, lead


def _lead_in(t: Array, duration: float, end: float, speed: float,
             turn_s: float) -> tuple[Array, Array, Array]:
    """Move from rest at 0 to rest before the line, then speed up to reach `end` at `speed`.

    Speeding up takes 0.6875 of a turnaround (or half of a short lead-in), so that the movement
    goes no further out than a turnaround does.
    """
    rush = min(0.6875 * turn_s, 0.5 * duration)
    move = duration - rush
    before = end - 0.5 * speed * rush
    s, ds, dds = smooth_step(t / move)
    u = np.maximum(t - move, 0.0) / rush
    v, dv, _ = smooth_step(u)
    return (before * s + speed * rush * _area(u),
            before * ds / move + speed * v,
            before * dds / move**2 + speed * dv / rush)


def spiral(values: Values, timing: Timing) -> Movement:
    """Return position, velocity, acceleration, where the pitch is constant, period, start.

    r cos(2 pi t / turn_s + phase), out from the middle and back in. dr/dt rises smoothly within
    the first turn and falls within the one at the rim, so that the whole takes 2 (turns + 1)
    turns, starts at rest, and repeats.
    """
    turns, turn_s = values.whole("turns"), values.number("turn_s")
    dt = timing.sample_period_s
    turn = values.samples(turn_s, "turn_s", timing)
    half = (turns + 1) * turn
    period = 2 * half
    index = np.arange(timing.count) % period
    inwards = index > half
    s = np.where(inwards, period - index, index) / turn       # turns since, or until, the middle
    rise, fall = smooth_step(s), smooth_step(turns + 1.0 - s)
    area_rise, area_fall = _area(s), _area(turns + 1.0 - s)
    pitch, sign = values.number("radius_m") / turns, np.where(inwards, -1.0, 1.0)
    rate = 1.0 / (turn * dt)
    r = pitch * np.where(s < turns, area_rise, turns - area_fall)
    dr = sign * pitch * rate * np.where(s < turns, rise[0], fall[0])
    ddr = pitch * rate**2 * np.where(s < turns, rise[1], -fall[1])
    w = 2.0 * math.pi * rate
    angle = w * dt * (index % turn) + math.radians(values.number("phase_deg"))
    c, si = np.cos(angle), np.sin(angle)
    return (values.number("center_m") + r * c, dr * c - r * w * si,
            (ddr - r * w * w) * c - 2.0 * dr * w * si, (s >= 1.0) & (s <= turns), period, 0)


def _area(s: Array) -> Array:
    """Integral of the smooth step from 0 to s: s - 1/2 from 1 on."""
    u = np.clip(s, 0.0, 1.0)
    return np.asarray(u**4 * (2.5 + u * (u - 3.0)) + np.maximum(s - 1.0, 0.0))


def lissajous(values: Values, timing: Timing) -> Movement:
    """Return position, velocity, acceleration, what comes after fading in, period, start."""
    period = values.samples(values.number("pattern_s"), "pattern_s", timing)
    ramp = values.samples(values.number("ramp_s"), "ramp_s", timing)
    cycles, dt = values.whole("cycles"), timing.sample_period_s
    if 2 * cycles >= period:
        raise values.error("cycles", f"cycles = {cycles} in {period} samples is not below half "
                                     "the sample rate")
    w = 2.0 * math.pi * cycles / (period * dt)
    index = np.arange(timing.count)
    angle = w * dt * (index % period) + math.radians(values.number("phase_deg"))
    amplitude = values.number("amplitude_m")
    x, v = amplitude * np.sin(angle), amplitude * w * np.cos(angle)
    a = -w * w * x
    if ramp:
        s, ds, dds = smooth_step(index / ramp)
        ds, dds = ds / (ramp * dt), dds / (ramp * dt)**2
        x, v, a = s * x, ds * x + s * v, dds * x + 2.0 * ds * v + s * a
    return values.number("center_m") + x, v, a, index >= ramp, period, ramp


def segments(distance_m: float, velocity_m_s: float, acceleration_m_s2: float,
             jerk_m_s3: float) -> tuple[Array, Array]:
    """Return durations (7,), s, and jerks (7,), m/s^3, of the shortest move over a distance.

    Jerk is +j, 0, -j, 0, -j, 0, +j; where the distance is too short for the velocity or the
    acceleration they are not reached (Biagiotti and Melchiorri, Trajectory Planning for Automatic
    Machines and Robots, 2008, sec. 3.4).
    """
    d, v, a, j = abs(distance_m), velocity_m_s, acceleration_m_s2, jerk_m_s3
    jerk_s, speed_up_s = (a / j, a / j + v / a) if v * j >= a * a else (
        math.sqrt(v / j), 2.0 * math.sqrt(v / j))
    cruise_s = d / v - speed_up_s
    if cruise_s < 0.0:
        cruise_s = 0.0
        jerk_s = a / j
        if d >= 2.0 * a * jerk_s**2:
            speed_up_s = 0.5 * (jerk_s + math.sqrt(jerk_s**2 + 4.0 * d / a))
        else:
            jerk_s = (0.5 * d / j) ** (1.0 / 3.0)
            speed_up_s = 2.0 * jerk_s
    constant_s = max(0.0, speed_up_s - 2.0 * jerk_s)
    times = np.array([jerk_s, constant_s, jerk_s, cruise_s, jerk_s, constant_s, jerk_s])
    return times, math.copysign(j, distance_m) * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])


def point_to_point(values: Values, timing: Timing) -> Movement:
    """Return position, velocity, acceleration, where a point is held (N,), period and start."""
    points = values.numbers("points_m").tolist()
    if not points:
        raise values.error("points_m", "points_m is empty; give at least one point")
    repeat = values.flag("repeat")
    limits = [values.number(name) for name in ("velocity_m_s", "acceleration_m_s2", "jerk_m_s3")]
    dt = timing.sample_period_s
    dwell = values.samples(values.number("dwell_s"), "dwell_s", timing) * dt
    delay = values.samples(values.number("delay_s"), "delay_s", timing)
    targets = [*points[1:], *([points[0]] if repeat and points[0] != points[-1] else [])]
    parts = [(0.0, points[0], 0.0, 0.0, 0.0)]   # start, position, velocity, acceleration, jerk
    now, here = dwell, points[0]
    for target in targets:
        times, pushes = segments(target - here, *limits) if target != here else (
            np.zeros(7), np.zeros(7))
        x, v, a = here, 0.0, 0.0
        for seconds, push in zip(times.tolist(), pushes.tolist(), strict=True):
            parts.append((now, x, v, a, push))
            x, v, a = (x + seconds * (v + seconds * (a / 2.0 + seconds * push / 6.0)),
                       v + seconds * (a + seconds * push / 2.0), a + seconds * push)
            now += seconds
        here = target
        parts.append((now, here, 0.0, 0.0, 0.0))
        # A movement ends between samples; the next one starts on one.
        now = math.ceil((now + dwell) / dt - 1e-9) * dt
    period = max(1, round(now / dt)) if repeat else 0
    index = np.maximum(np.arange(timing.count) - delay, 0)
    t = (index % period if period else index) * dt
    table = np.array(parts)
    start, x, v, a, push = table[np.searchsorted(table[:, 0], t + 1e-12, side="right") - 1].T
    since = t - start
    held = (push == 0.0) & (v == 0.0) & (a == 0.0)
    return (x + since * (v + since * (a / 2.0 + since * push / 6.0)),
            v + since * (a + since * push / 2.0), a + since * push, held, period, delay)


def staircase_parameters(suffix: str, unit: str, step: float) -> tuple[Parameter, ...]:
    """Return the parameter table of steps in `unit`."""
    return (
        Parameter(f"start_{suffix}", 0.0, unit, "first level of a staircase"),
        Parameter(f"step_{suffix}", step, unit, "height of each stair"),
        Parameter("count", 1.0, "", "number of stairs", 1.0, 1e6),
        Parameter("dwell_s", 1.0, "s", "time from one step to the next", 1e-6),
        Parameter("delay_s", 0.0, "s", "extra time on the first level", 0.0),
        Parameter("rise_s", 0.0, "s", "time of a smooth move to the next level; 0 = a jump", 0.0),
    )


def staircase_options(suffix: str, unit: str) -> tuple[Option, ...]:
    """Return the options of steps in `unit`."""
    return (
        Option(f"levels_{suffix}", (), "levels in order, instead of a staircase", unit=unit),
        Option("down_again", False, "walk the levels back down to the first"),
        Option("repeat", False, "start over after the last level instead of holding it"),
    )


def staircase(values: Values, timing: Timing, suffix: str) -> Movement:
    """Return position, rate and curvature (N,), where a level is held (N,), period and start.

    A jump has no derivatives: rate and curvature are zero there. The period is in samples, 0 if
    the levels are not repeated.
    """
    levels = values.numbers(f"levels_{suffix}")
    if not levels.size:
        levels = (values.number(f"start_{suffix}")
                  + values.number(f"step_{suffix}")
                  * np.arange(values.whole("count") + 1, dtype=np.float64))
    repeat = values.flag("repeat")
    if values.flag("down_again"):
        levels = np.concatenate((levels, levels[-2::-1]))
    if repeat and levels.size > 1 and levels[-1] == levels[0]:
        levels = levels[:-1]
    dwell = values.samples(values.number("dwell_s"), "dwell_s", timing)
    delay = values.samples(values.number("delay_s"), "delay_s", timing)
    rise = values.number("rise_s")
    if rise > dwell * timing.sample_period_s * (1.0 + 1e-9):
        raise values.error("rise_s", f"rise_s = {rise:g} s is longer than dwell_s = "
                                     f"{dwell * timing.sample_period_s:g} s")

    since = np.arange(timing.count) - delay
    stair = np.maximum(since, 0) // dwell
    now, before = (each % levels.size if repeat else np.minimum(each, levels.size - 1)
                   for each in (stair, stair - 1))
    before = np.where(stair == 0, now, before)
    height = levels[now] - levels[before]
    period = dwell * levels.size if repeat else 0
    if rise == 0.0:
        zero = np.zeros(timing.count)
        return (levels[now], zero, zero.copy(), np.ones(timing.count, dtype=bool), period, delay)
    u = (since - stair * dwell) * timing.sample_period_s / rise
    s, ds, dds = smooth_step(u)
    return (levels[before] + height * s, height * ds / rise, height * dds / rise**2,
            (height == 0.0) | (u >= 1.0), period, delay)
