"""Sine, chirp, multisine, with their first two time derivatives, and stepped sine."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Timing, Values


def _no_lines() -> Lines:
    return np.zeros(0, dtype=np.int64)


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


@dataclass(frozen=True)
class Waveform:
    """A signal of shape (N,) with its rate and curvature (first and second derivative), which are
    empty for voltages with jumps; `segments` are those of a stepped sine.

    `period_samples` is 0 where the signal does not repeat on the sample grid. `excited_lines` and
    `detection_lines` are harmonic numbers of 1 / (period_samples * sample_period).
    """

    value: Array
    rate: Array = field(default_factory=lambda: np.zeros(0))
    curvature: Array = field(default_factory=lambda: np.zeros(0))
    period_samples: int = 0
    periods: int = 0
    ramp_samples: int = 0
    excited_lines: Lines = field(default_factory=_no_lines)
    detection_lines: Lines = field(default_factory=_no_lines)
    crest_factor: float = math.nan
    segments: tuple[Segment, ...] = ()


def smooth_step(u: Array) -> tuple[Array, Array, Array]:
    """Return S(u) = 10u^3 - 15u^4 + 6u^5 and its first two derivatives, constant outside [0, 1].

    S rises from 0 to 1 with zero slope and curvature at both ends; it is the point-to-point
    movement of least squared jerk (Flash and Hogan, J. Neuroscience 5, 1985).
    """
    u = np.clip(u, 0.0, 1.0)
    return (u**3 * (10.0 + u * (6.0 * u - 15.0)),
            30.0 * u**2 * (1.0 - u)**2,
            60.0 * u * (1.0 - u) * (1.0 - 2.0 * u))


def crest_factor(signal: Array) -> float:
    """Return peak over RMS; NaN for a signal that is zero throughout."""
    rms = math.sqrt(float(np.mean(np.square(signal)))) if signal.size else 0.0
    return float(np.max(np.abs(signal))) / rms if rms > 0.0 else math.nan


def amplitude_parameters(suffix: str, unit: str, amplitude: float) -> tuple[Parameter, ...]:
    """Return the amplitude parameters of a waveform in `unit`."""
    return (
        Parameter(f"amplitude_{suffix}", amplitude, unit,
                  "largest absolute value of the signal (its peak)", 0.0),
        Parameter(f"rms_{suffix}", 0.0, unit,
                  "RMS of the signal; above zero it replaces the amplitude", 0.0),
    )


RAMP = Parameter("ramp_s", 0.0, "s", "time over which the signal fades in smoothly", 0.0)


def sine_parameters(suffix: str, unit: str, amplitude: float) -> tuple[Parameter, ...]:
    """Return the parameter table of a sine in `unit`."""
    return (*amplitude_parameters(suffix, unit, amplitude),
            Parameter("frequency_hz", 1.0, "Hz", "frequency", 1e-6),
            Parameter("phase_deg", 0.0, "deg", "phase at the start", -360.0, 360.0),
            Parameter("periods", 0.0, "", "number of periods; 0 = to the end", 0.0),
            RAMP)


def chirp_parameters(suffix: str, unit: str, amplitude: float) -> tuple[Parameter, ...]:
    """Return the parameter table of a chirp in `unit`."""
    return (*amplitude_parameters(suffix, unit, amplitude),
            Parameter("low_hz", 1.0, "Hz", "frequency at the start of a sweep", 1e-6),
            Parameter("high_hz", 70.0, "Hz", "frequency at the end of a sweep", 1e-6),
            Parameter("period_s", 20.0, "s", "duration of one sweep", 1e-6),
            Parameter("periods", 1.0, "", "number of sweeps; 0 = to the end", 0.0),
            Parameter("ramp_s", 0.0, "s",
                      "time over which every sweep fades in and out smoothly", 0.0))


CHIRP_OPTIONS = (Option("sweep", "linear", "how the frequency grows",
                        choices=("linear", "logarithmic")),)


def multisine_parameters(suffix: str, unit: str, amplitude: float) -> tuple[Parameter, ...]:
    """Return the parameter table of a multisine in `unit`."""
    return (*amplitude_parameters(suffix, unit, amplitude),
            Parameter("low_hz", 1.0, "Hz", "lower edge of the excited band", 0.0),
            Parameter("high_hz", 70.0, "Hz", "upper edge of the excited band", 1e-6),
            Parameter("period_s", 8.0, "s", "period, a whole number of samples", 1e-6),
            Parameter("periods", 0.0, "", "number of periods; 0 = to the end", 0.0),
            Parameter("group", 4.0, "", "odd lines per group with one detection line", 2.0),
            RAMP)


MULTISINE_OPTIONS = (
    Option("odd", False, "excite odd harmonics only, so that even distortion shows apart"),
    Option("detection_lines", False,
           "leave one odd line per group unexcited, so that odd distortion shows (needs odd)"),
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


def sine(values: Values, timing: Timing, suffix: str) -> Waveform:
    """A sin(2 pi f t + phase); `period_samples` is 0 where the period is no whole number."""
    frequency = values.number("frequency_hz")
    _below_nyquist(values, "frequency_hz", timing)
    exact = 1.0 / (frequency * timing.sample_period_s)
    period = round(exact) if abs(exact - round(exact)) < 1e-6 * exact else 0
    end = _end(values, exact, timing)
    index = np.arange(timing.count) % period if period else np.arange(timing.count)
    omega = 2.0 * math.pi * frequency
    angle = omega * (index * timing.sample_period_s) + math.radians(values.number("phase_deg"))
    amplitude = scale_of(values, suffix, 1.0, math.sqrt(0.5))
    wave = (amplitude * np.sin(angle), amplitude * omega * np.cos(angle),
            -amplitude * omega**2 * np.sin(angle))
    ramp = values.samples(values.number("ramp_s"), "ramp_s", timing)
    value, rate, curvature = _cut(_faded(wave, _fade_in(timing, ramp)), end)
    return Waveform(value, rate, curvature, period, end // period if period else 0, ramp,
                    np.ones(1 if period else 0, dtype=np.int64), crest_factor=math.sqrt(2.0))


def chirp(values: Values, timing: Timing, suffix: str) -> Waveform:
    """A sin(phi(t)) with d phi/dt = 2 pi f(t); every sweep starts at phase zero.

    Linear: f = f0 + (f1 - f0) t / T. Logarithmic: f = f0 (f1 / f0)^(t / T). The crest factor is
    that of one sweep, or of its part that fits into the run.
    """
    for name in ("low_hz", "high_hz"):
        _below_nyquist(values, name, timing)
    low, high = values.number("low_hz"), values.number("high_hz")
    seconds = values.number("period_s")
    period = values.samples(seconds, "period_s", timing)
    end = _end(values, period, timing)
    ramp = values.samples(values.number("ramp_s"), "ramp_s", timing)
    if 2 * ramp > period:
        raise values.error("ramp_s", f"ramp_s = {values.number('ramp_s'):g} s is more than half "
                                     f"of period_s = {seconds:g} s")
    t = np.arange(min(period, timing.count), dtype=np.float64) * timing.sample_period_s
    two_pi = 2.0 * math.pi
    if values.word("sweep") == "linear" or low == high:
        slope = (high - low) / seconds
        angle = two_pi * (low * t + 0.5 * slope * t**2)
        omega = two_pi * (low + slope * t)
        omega_rate = np.full(t.size, two_pi * slope)
    else:
        growth = math.log(high / low) / seconds
        omega = two_pi * low * np.exp(growth * t)
        angle = (omega - two_pi * low) / growth
        omega_rate = growth * omega
    amplitude = scale_of(values, suffix, 1.0, math.sqrt(0.5))
    sweep = (amplitude * np.sin(angle), amplitude * omega * np.cos(angle),
             amplitude * (omega_rate * np.cos(angle) - omega**2 * np.sin(angle)))
    if ramp:
        scale = ramp * timing.sample_period_s
        head = smooth_step(t / scale)
        tail = smooth_step((seconds - t) / scale)
        fade = (head[0] * tail[0],
                (head[1] * tail[0] - head[0] * tail[1]) / scale,
                (head[2] * tail[0] - 2.0 * head[1] * tail[1] + head[0] * tail[2]) / scale**2)
        sweep = _faded(sweep, fade)
    value, rate, curvature = _cut(_repeated(sweep, timing.count), end)
    return Waveform(value, rate, curvature, period, end // period, ramp,
                    crest_factor=crest_factor(sweep[0]))


def multisine(values: Values, timing: Timing, suffix: str) -> Waveform:
    """Sum of cosines of equal amplitude and random phase on the lines of one period.

    The lines h satisfy low_hz <= h / period_s <= high_hz; with `odd` only odd h, and with
    `detection_lines` one random line of every full `group` of odd lines is left out
    (Pintelon and Schoukens, System Identification, 2nd ed., sec. 4.3).
    """
    seconds = values.number("period_s")
    period = values.samples(seconds, "period_s", timing)
    _below_nyquist(values, "high_hz", timing)
    rng = np.random.default_rng(timing.seed)
    lines, detection = _choose_lines(values, period * timing.sample_period_s, rng)
    ramp = values.samples(values.number("ramp_s"), "ramp_s", timing)
    end = _end(values, period, timing)

    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(2j * math.pi * rng.random(lines.size))
    omega = 2.0 * math.pi * np.arange(spectrum.size) / (period * timing.sample_period_s)
    unit = np.fft.irfft(spectrum, period)
    scale = scale_of(values, suffix, float(np.max(np.abs(unit))),
                     math.sqrt(float(np.mean(unit**2))))
    one = (scale * unit, scale * np.fft.irfft(1j * omega * spectrum, period),
           -scale * np.fft.irfft(omega**2 * spectrum, period))
    wave = _faded(_repeated(one, timing.count), _fade_in(timing, ramp))
    value, rate, curvature = _cut(wave, end)
    return Waveform(value, rate, curvature, period, end // period, ramp, lines, detection,
                    crest_factor(unit))


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


Triple = tuple[Array, Array, Array]


def _choose_lines(values: Values, seconds: float,
                  rng: np.random.Generator) -> tuple[Lines, Lines]:
    low, high = band(values)
    lines = np.arange(max(1, math.ceil(low * seconds * (1.0 - 1e-9))),
                      math.floor(high * seconds * (1.0 + 1e-9)) + 1, dtype=np.int64)
    odd = values.flag("odd")
    if odd:
        lines = lines[lines % 2 == 1]
    if not lines.size:
        raise values.error("period_s", f"no {'odd ' if odd else ''}line of {1 / seconds:g} Hz "
                                       f"lies in {low:g} to {high:g} Hz; lengthen period_s")
    if not values.flag("detection_lines"):
        return lines, _no_lines()
    if not odd:
        raise values.error("detection_lines", "detection_lines needs odd: true")
    group = values.whole("group")
    groups = lines.size // group
    if groups == 0:
        raise values.error("group", f"{lines.size} odd lines do not fill one group of {group}; "
                                    f"lengthen period_s or widen the band")
    left_out = np.arange(groups) * group + rng.integers(0, group, groups)
    return np.delete(lines, left_out), lines[left_out]


def band(values: Values) -> tuple[float, float]:
    """Return the edges of a band of frequencies, Hz, the lower one first."""
    low, high = values.number("low_hz"), values.number("high_hz")
    if low > high:
        raise values.error("low_hz", f"low_hz = {low:g} Hz is above high_hz = {high:g} Hz")
    return low, high


def _below_nyquist(values: Values, name: str, timing: Timing) -> None:
    nyquist = 0.5 / timing.sample_period_s
    if values.number(name) >= nyquist * (1.0 - 1e-12):
        raise values.error(name, f"{name} = {values.number(name):g} Hz is not below half the "
                                 f"sample rate, {nyquist:g} Hz")


def scale_of(values: Values, suffix: str, peak: float, rms: float) -> float:
    """Return the factor that gives a signal of this peak and RMS the amplitude asked for."""
    wanted_rms = values.number(f"rms_{suffix}")
    return wanted_rms / rms if wanted_rms > 0.0 else values.number(f"amplitude_{suffix}") / peak


def _end(values: Values, period: float, timing: Timing) -> int:
    periods = values.whole("periods")
    return min(timing.count, round(periods * period)) if periods else timing.count


def _fade_in(timing: Timing, ramp: int) -> Triple | None:
    if not ramp:
        return None
    scale = ramp * timing.sample_period_s
    head = smooth_step(np.arange(timing.count) / ramp)
    return head[0], head[1] / scale, head[2] / scale**2


def _faded(wave: Triple, fade: Triple | None) -> Triple:
    if fade is None:
        return wave
    x, dx, ddx = wave
    w, dw, ddw = fade
    return w * x, dw * x + w * dx, ddw * x + 2.0 * dw * dx + w * ddx


def _repeated(wave: Triple, count: int) -> Triple:
    return np.resize(wave[0], count), np.resize(wave[1], count), np.resize(wave[2], count)


def _cut(wave: Triple, end: int) -> Triple:
    for each in wave:
        each[end:] = 0.0
    return wave
