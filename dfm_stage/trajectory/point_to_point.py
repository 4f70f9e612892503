"""Point to point within a given velocity, acceleration and jerk, in the shortest time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Array, Timing, Values

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
    sign = math.copysign(j, distance_m)
    return times, sign * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])


def point_to_point(values: Values,
                   timing: Timing) -> tuple[Array, Array, Array, NDArray[np.bool_], int, int]:
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
    starts, states, jerks = [0.0], [(points[0], 0.0, 0.0)], [0.0]
    now, here = dwell, points[0]
    for target in targets:
        times, pushes = segments(target - here, *limits) if target != here else (
            np.zeros(7), np.zeros(7))
        x, v, a = here, 0.0, 0.0
        for seconds, push in zip(times.tolist(), pushes.tolist(), strict=True):
            starts.append(now)
            states.append((x, v, a))
            jerks.append(push)
            x, v, a = (x + seconds * (v + seconds * (a / 2.0 + seconds * push / 6.0)),
                       v + seconds * (a + seconds * push / 2.0), a + seconds * push)
            now += seconds
        here = target
        starts.append(now)
        states.append((here, 0.0, 0.0))
        jerks.append(0.0)
        # A movement ends between samples; the next one starts on one.
        now = math.ceil((now + dwell) / dt - 1e-9) * dt
    period = max(1, round(now / dt)) if repeat else 0
    index = np.maximum(np.arange(timing.count) - delay, 0)
    t = (index % period if period else index) * dt
    part = np.searchsorted(starts, t + 1e-12, side="right") - 1
    since, push = t - np.asarray(starts)[part], np.asarray(jerks)[part]
    x, v, a = np.asarray(states)[part].T
    held = (push == 0.0) & (v == 0.0) & (a == 0.0)
    return (x + since * (v + since * (a / 2.0 + since * push / 6.0)),
            v + since * (a + since * push / 2.0), a + since * push, held, period, delay)
