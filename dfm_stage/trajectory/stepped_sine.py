"""One frequency after another: settle, measure, go on without a jump of the phase."""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Timing, Values
from dfm_stage.trajectory.waveform import (
    RAMP,
    Segment,
    Waveform,
    amplitude_parameters,
    band,
    scale_of,
    smooth_step,
)

STEPPED_SINE_PARAMETERS = (
    *amplitude_parameters("v", "V", 0.08),
    Parameter("low_hz", 1.0, "Hz", "lowest frequency", 1e-6),
    Parameter("high_hz", 70.0, "Hz", "highest frequency", 1e-6),
    Parameter("count", 20.0, "", "number of frequencies, evenly spaced in logarithm", 1.0, 1e5),
    Parameter("settle_s", 2.0, "s", "time at each frequency before it is measured", 0.0),
    Parameter("measure_s", 2.0, "s", "time over which it is measured", 1e-6),
    RAMP,
)
STEPPED_SINE_OPTIONS = (
    Option("frequencies_hz", (), "frequencies in order, instead of low, high and count",
           unit="Hz"),
    Option("rising", False, "from low to high; else from high to low, so that the motion still "
           "dying away is the smaller one"),
)


def stepped_sine(values: Values, timing: Timing) -> Waveform:
    """A sin(phi) with phi continuous; what is left of the time after the last frequency is zero.

    Its segments are those that fit into it whole.
    """
    listed = values.numbers("frequencies_hz")
    frequencies = listed if listed.size else _spaced(values)
    nyquist = 0.5 / timing.sample_period_s
    for f in frequencies:
        if not 0.0 < f < nyquist:
            raise values.error("frequencies_hz" if listed.size else "high_hz",
                               f"{f:g} Hz is not between 0 and half the sample rate, "
                               f"{nyquist:g} Hz")
    settle = values.samples(values.number("settle_s"), "settle_s", timing)
    measure = values.samples(values.number("measure_s"), "measure_s", timing)
    ramp = values.samples(values.number("ramp_s"), "ramp_s", timing)
    length = settle + measure
    signal, segments, phase = np.zeros(timing.count), [], 0.0
    for i, f in enumerate(frequencies):
        first = i * length
        step = 2.0 * math.pi * float(f) * timing.sample_period_s
        part = signal[first:first + length]
        part[:] = np.sin(phase + step * np.arange(part.size))
        phase = math.fmod(phase + step * length, 2.0 * math.pi)
        if first + length <= timing.count:
            segments.append(Segment(float(f), first, first + settle, first + length))
    if not segments:
        raise values.error("measure_s", f"one frequency takes {length * timing.sample_period_s:g} "
                                        "s, longer than the whole signal; lengthen duration_s")
    if ramp:
        signal *= smooth_step(np.arange(timing.count) / ramp)[0]
    signal *= scale_of(values, "v", 1.0, math.sqrt(0.5))
    return Waveform(signal, ramp_samples=ramp, crest_factor=math.sqrt(2.0),
                    segments=tuple(segments))


def _spaced(values: Values) -> Array:
    frequencies = np.geomspace(*band(values), values.whole("count"))
    return np.asarray(frequencies if values.flag("rising") else frequencies[::-1])
