"""The raster line: a constant-velocity part there and back, joined by smooth turnarounds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.parameter import Parameter
from dfm_stage.trajectory.kind import Array, Timing, Values
from dfm_stage.trajectory.waveform import smooth_step

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


def raster(values: Values,
           timing: Timing) -> tuple[Array, Array, Array, NDArray[np.bool_], int, int]:
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
    area = u**4 * (2.5 + u * (u - 3.0))
    travelled = speed * np.minimum(t, line_s) + speed * turn_s * (u - 2.0 * area)
    position = center + sign * (travelled - 0.5 * length)
    velocity = sign * speed * (1.0 - 2.0 * s)
    acceleration = -sign * speed * 2.0 * ds / turn_s
    on_line = (u == 0.0) & (index >= 0)
    if lead:
        head = slice(0, min(lead, timing.count))
        start = _lead_in(np.arange(timing.count, dtype=np.float64)[head] * dt, lead * dt,
                         -0.5 * length, speed, turn_s)
        position[head] = center + start[0]
        velocity[head], acceleration[head] = start[1], start[2]
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
    return (before * s + speed * rush * u**4 * (2.5 + u * (u - 3.0)),
            before * ds / move + speed * v,
            before * dds / move**2 + speed * dv / rush)
