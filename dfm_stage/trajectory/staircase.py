"""Levels held one after another: the steps of a reference or of a voltage."""

from __future__ import annotations

import numpy as np

from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Movement, Timing, Values
from dfm_stage.trajectory.waveform import smooth_step


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
    if repeat:
        now, before = stair % levels.size, (stair - 1) % levels.size
    else:
        now = np.minimum(stair, levels.size - 1)
        before = np.minimum(stair - 1, levels.size - 1)
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
