"""One frequency after another: settle, measure, go on without a jump of the phase."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Array, Timing, Values
from dfm_stage.trajectory.waveform import RAMP, amplitude_parameters


@dataclass(frozen=True)
class Segment:
    """Samples `first` to `end` (not included) at one frequency, to be measured from `settled`."""

    frequency_hz: float
    first: int
    settled: int
    end: int

    def to_list(self) -> list[float]:
        """As a bag keeps it."""
        return [self.frequency_hz, self.first, self.settled, self.end]


def stepped_sine_parameters(suffix: str, unit: str, amplitude: float) -> tuple[Parameter, ...]:
    """Return the parameter table of a stepped sine in `unit`."""
    return (*amplitude_parameters(suffix, unit, amplitude),
            Parameter("low_hz", 1.0, "Hz", "lowest frequency", 1e-6),
            Parameter("high_hz", 70.0, "Hz", "highest frequency", 1e-6),
            Parameter("count", 20.0, "", "number of frequencies, evenly spaced in logarithm",
                      1.0, 1e5),
            Parameter("settle_s", 2.0, "s", "time at each frequency before it is measured", 0.0),
            Parameter("measure_s", 2.0, "s", "time over which it is measured", 1e-6),
            RAMP)


STEPPED_SINE_OPTIONS = (
    Option("frequencies_hz", (), "frequencies in order, instead of low, high and count",
           unit="Hz"),
    Option("rising", False, "from low to high; else from high to low, so that the motion still "
           "dying away is the smaller one"),
)


def stepped_sine(values: Values, timing: Timing,
                 suffix: str) -> tuple[Array, tuple[Segment, ...], int]:
    """Return the signal (N,), its segments that fit into it whole, and the samples of the ramp.

    A sin(phi) with phi continuous; what is left of the time after the last frequency is zero.
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
        u = np.minimum(np.arange(timing.count) / ramp, 1.0)
        signal *= u**3 * (10.0 + u * (6.0 * u - 15.0))
    rms = values.number(f"rms_{suffix}")
    signal *= rms * math.sqrt(2.0) if rms > 0.0 else values.number(f"amplitude_{suffix}")
    return signal, tuple(segments), ramp


def _spaced(values: Values) -> Array:
    low, high = values.number("low_hz"), values.number("high_hz")
    if low > high:
        raise values.error("low_hz", f"low_hz = {low:g} Hz is above high_hz = {high:g} Hz")
    frequencies = np.geomspace(low, high, values.whole("count"))
    return np.asarray(frequencies if values.flag("rising") else frequencies[::-1])
