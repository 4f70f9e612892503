"""Sec. 4: PID by Ziegler and Nichols, the 5 um claim, and the resolution of the encoder."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from dfm_stage.control import (
    PidGains,
    Ultimate,
    margins,
    pid_for,
    sample_model,
    sample_stage,
    ultimate,
    ziegler_nichols,
)
from dfm_stage.model import Model
from dfm_stage.paper.row import PRINTED, Row, derived, ours_only, printed
from dfm_stage.paper.stage import DirectStage, Stage, closed_loop, tracking_error
from dfm_stage.paper.xy import smallest_step
from dfm_stage.recording import Record

STEP_M, SINE_M, SINE_HZ = 1e-3, 1e-3, 0.5
PLACED_HZ = 8.0
STEP = {"kind": "steps", "levels_m": [0.0, STEP_M], "dwell_s": 0.5}
SINE = {"kind": "sine", "amplitude_m": SINE_M, "frequency_hz": SINE_HZ, "ramp_s": 2.0}
COARSE_M = 1.02e-3
COARSE = {"kind": "steps", "levels_m": [0.0, COARSE_M], "dwell_s": 0.5}
HOLD = {"kind": "steps", "levels_m": [0.0, 1e-4], "dwell_s": 0.2}


@dataclass(frozen=True)
class PidTest:
    """The tuning and the records made with it.

    `swing` is the proportional loop at the ultimate gain; `step` and `sine` are under Ziegler and
    Nichols, `placed` the sine under gains placed on the model, with feedforward.
    """

    limit: Ultimate
    gains: PidGains
    swing: Record
    step: Record
    sine: Record
    placed: Record
    coarse: Record


def run_pid(stage: Stage, model: Model, step: Any) -> PidTest:
    """Tune on the model, then do everything on the stage; `step(name)` says what is done.

    Raises
    ------
    ControlError
        If the model's loop has no ultimate gain.
    """
    limit = ultimate(sample_model(model))
    gains = ziegler_nichols(limit)
    proportional = PidGains(kp=limit.gain_v_m, ki=0.0, kd=0.0, setpoint_weight=1.0)
    placed = pid_for(model.base, PLACED_HZ, sample_period_s=model.sample_period).gains
    step("proportional loop at the ultimate gain")
    swing = stage.run(closed_loop("ultimate_gain", HOLD, 3.0, proportional), model)
    step("1 mm step under PID")
    stepped = stage.run(closed_loop("zn_step", STEP, 5.0, gains), model)
    step("sine under PID")
    sine = stage.run(closed_loop("zn_sine", SINE, 8.0, gains), model)
    step("sine with feedforward")
    better = stage.run(closed_loop("placed_sine", SINE, 8.0, placed), model)
    coarse_base = {**model.base, "encoder_resolution": PRINTED["encoder.resolution"].value}
    coarse = DirectStage().run(closed_loop("coarse_step", COARSE, 5.0, gains),
                               replace(model, base=coarse_base, document=None))
    return PidTest(limit, gains, swing, stepped, sine, better, coarse)


def largest_error(record: Record, last_s: float) -> tuple[float, float]:
    """Return peak and RMS of true position less reference over the last seconds, m."""
    error = tracking_error(record)[-round(last_s / record.sample_period):]
    return float(np.max(np.abs(error))), float(np.sqrt(np.mean(error**2)))


def swing_of(record: Record) -> tuple[float, float]:
    """Return period (s) and growth per period of the oscillation at the ultimate gain."""
    y = record.axis(None).position[round(0.5 / record.sample_period):]
    y = y - np.mean(y)
    up = np.flatnonzero((y[:-1] < 0.0) & (y[1:] >= 0.0))
    if up.size < 4:
        return math.nan, math.nan
    period = float(np.polyfit(np.arange(up.size), up + y[up] / (y[up] - y[up + 1]),
                              1)[0]) * record.sample_period
    size = [float(np.ptp(y[a:b])) for a, b in pairwise(up)]
    growth = math.exp(float(np.polyfit(np.arange(len(size)), np.log(size), 1)[0]))
    return period, growth


def pid_rows(test: PidTest, model: Model) -> list[Row]:
    """Return the tuning and what it achieves."""
    claim = PRINTED["pid.accuracy"].value
    lag, delay = model.base.get("amplifier_time_constant", 0.0), model.base.get("delay", 0.0)
    bare, growing = _ultimate_without_delay(model)
    period, growth = swing_of(test.swing)
    step_peak, _ = largest_error(test.step, 0.5)
    sine_peak, sine_rms = largest_error(test.sine, 4.0)
    placed_peak, _ = largest_error(test.placed, 4.0)
    coarse_peak, _ = largest_error(test.coarse, 1.0)
    illegible = "the reference signal of the claim is not legible"
    return [
        ours_only("zn.without_delay", "ultimate gain without delay and lag, as Eq. 3 has it",
                  "sec. 4", bare, "V/m", "none: a second-order plant without delay never reaches "
                  f"-180 degrees; sampled, its gain grows {growing:.0f} times with a tenth of the "
                  "period; the paper's procedure needs a real loop"),
        ours_only("zn.ultimate_gain", "ultimate gain of the sampled loop", "sec. 4",
                  test.limit.gain_v_m, "V/m", f"with {1e3 * delay:g} ms delay, {1e3 * lag:g} ms "
                  f"amplifier lag, {1e3 * model.sample_period:g} ms sampling; the paper prints "
                  "none of its gains"),
        ours_only("zn.ultimate_period", "ultimate period, from the model", "sec. 4",
                  test.limit.period_s, "s", "where the loop's response is real and negative"),
        ours_only("zn.period_measured", "period of the loop held at that gain", "sec. 4", period,
                  "s", f"measured; the amplitude grows by {100.0 * (growth - 1.0):.2f} % a "
                  "period, so this is the limit"),
        ours_only("zn.kp", "K_p = 0.6 K_u", "Eq. 4", test.gains.kp, "V/m", "Ziegler and Nichols"),
        ours_only("zn.ki", "K_i = 1.2 K_u / P_u", "Eq. 4", test.gains.ki, "V/(m s)",
                  "Ziegler and Nichols"),
        ours_only("zn.kd", "K_d = 0.075 K_u P_u", "Eq. 4", test.gains.kd, "V s/m",
                  "Ziegler and Nichols, derivative filtered"),
        ours_only("zn.modulus_margin", "distance of the loop from -1", "sec. 4",
                  margins(sample_model(model), test.gains).modulus, "",
                  "0.5 and more is called robust: the rule is not 'optimal'"),
        printed("pid.accuracy", step_peak, f"largest error in the last 0.5 s of a "
                f"{1e3 * STEP_M:g} mm step under Ziegler-Nichols; {illegible}"),
        derived("pid.accuracy_sine", "the same claim on a moving reference", "abstract, Fig. 9",
                claim, sine_peak, "m", f"largest error on ±{1e3 * SINE_M:g} mm at {SINE_HZ:g} Hz "
                f"under Ziegler-Nichols ({1e6 * sine_rms:.0f} µm RMS): with that tuning the claim "
                f"can only hold at rest; {illegible}"),
        derived("pid.accuracy_feedforward", "the same sine with gains placed on the model and "
                "feedforward", "abstract, Fig. 9", claim, placed_peak, "m",
                f"poles at {PLACED_HZ:g} Hz and the inverse model: what the claim takes"),
        printed("encoder.resolution", smallest_step(test.step.axis(None).position),
                "smallest step between readings of the record; the maker's encoders of that kind "
                "count in 50 nm, so 50 µm is taken for a misprint"),
        derived("encoder.coarse", "error at rest if the encoder did resolve 50 µm", "sec. 3",
                claim, coarse_peak, "m", f"same loop, held at {1e3 * COARSE_M:g} mm, no multiple "
                "of 50 µm, simulated directly: such readings cannot carry 5 µm"),
    ]


def _ultimate_without_delay(model: Model) -> tuple[float, float]:
    """Return the ultimate gain of mass, spring and damper alone (infinite where it has none), and
    how it grows when a loop without delay or lag is sampled ten times faster."""
    bare = {name: model.base[name] for name in (
        "mass", "damping", "stiffness", "force_constant") if name in model.base}
    found = [ultimate(sample_stage(bare, model.sample_period / speed)).gain_v_m
             for speed in (1.0, 10.0, 100.0)]
    growth = found[2] / found[1]
    return (math.inf if growth > 3.0 else found[2]), growth

