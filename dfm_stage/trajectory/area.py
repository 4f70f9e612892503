"""Patterns of two axes over an area: each axis gets its part, told apart by the phase."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.parameter import Parameter
from dfm_stage.trajectory.kind import Array, Timing, Values
from dfm_stage.trajectory.waveform import RAMP, smooth_step

_CENTER = Parameter("center_m", 0.0, "m", "middle of the pattern")
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
Scan = tuple[Array, Array, Array, NDArray[np.bool_], int, int]


def spiral(values: Values, timing: Timing) -> Scan:
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
    steady = (s >= 1.0) & (s <= turns)
    return (values.number("center_m") + r * c, dr * c - r * w * si,
            (ddr - r * w * w) * c - 2.0 * dr * w * si, steady, period, 0)


def _area(s: Array) -> Array:
    """Integral of the smooth step from 0 to s: s - 1/2 from 1 on."""
    u = np.clip(s, 0.0, 1.0)
    return np.asarray(u**4 * (2.5 + u * (u - 3.0)) + np.maximum(s - 1.0, 0.0))


def lissajous(values: Values, timing: Timing) -> Scan:
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
