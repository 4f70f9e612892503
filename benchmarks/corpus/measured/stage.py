"""Random stages and bodies, and how they are run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt

from benchmarks.corpus.linear import transfer
from benchmarks.corpus.measured import inputs, plant
from benchmarks.corpus.measured.plant import STEPS, Physics
from benchmarks.corpus.signals import gains as loop_gains
from benchmarks.corpus.stage import log_uniform

NO_LOOP = np.zeros(4)
PERIODS = (2e-4, 5e-4, 1e-3, 1e-3, 2e-3, 5e-3)
FILTER_ORDER, FILTER_EDGE = 8, 0.4
"""Butterworth filter before both converters of a band-limited record; edge over sampling rate."""
ANTI_ALIAS = butter(FILTER_ORDER, 2.0 * FILTER_EDGE / STEPS, output="sos")
MOST_MOTION = 6.0
"""Peak motion over the one that was wanted, from which a draw is given up."""


@dataclass(frozen=True)
class Sensor:
    """noise: RMS (m), of which the share `colour` of the power is 1/f; resolution (m)."""

    noise: float
    colour: float = 0.0
    resolution: float = 0.0


@dataclass(frozen=True)
class Stage:
    """A stage with a spring or a free body. base: SI, delay a multiple of period / STEPS;
    amplitude: peak motion of the largest run (m)."""

    base: dict[str, float]
    period: float
    amplitude: float
    sensor: Sensor
    mount: dict[str, float] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether it has no spring."""
        return "stiffness" not in self.base

    @property
    def natural(self) -> float:
        """Natural frequency over sampling rate; of a free body a scan's pace."""
        if self.free:
            return 0.01
        return math.sqrt(self.base["stiffness"] / self.base["mass"]) * self.period / 2.0 / math.pi

    @property
    def delay_steps(self) -> int:
        """Delay in steps of the plant."""
        return round(self.base.get("delay", 0.0) / self.period * STEPS)

    @property
    def late(self) -> float:
        """Delay, lag and the lag of the sensor's mount together, in samples."""
        mount = 0.0
        if self.mount:
            mount = self.mount["mount_zeta"] / (math.pi * self.mount["mount_hz"])
        return (self.base.get("delay", 0.0) + self.base.get("amplifier_time_constant", 0.0)
                + mount) / self.period

    def physics(self, **effects: float) -> Physics:
        """The plant with so many effects."""
        return Physics(
            mass=self.base["mass"], damping=self.base.get("damping", 0.0),
            stiffness=self.base.get("stiffness", 0.0),
            force_constant=self.base["force_constant"],
            lag=self.base.get("amplifier_time_constant", 0.0))._replace(**self.mount, **effects)


@dataclass(frozen=True)
class Run:
    """An experiment as it is asked for, and the convention of its record.

    command (N,) V: the input, or with gains what is added to the loop's; hold: HELD, LINEAR or
    BAND_LIMITED; shift: steps by which the plant sees the input column later; draw: draws such a
    run anew, of so many samples.
    """

    kind: str
    command: Any
    reference: Any
    gains: Any = field(default_factory=lambda: NO_LOOP)
    hold: int = plant.HELD
    shift: int = 0
    draw: Callable[[np.random.Generator, int], Run] | None = field(default=None, compare=False)

    @cached_property
    def fine(self) -> Any:
        """The band-limited command at half steps."""
        return inputs.band_limited(self.command)

    @cached_property
    def filtered(self) -> Any:
        """The same at the plant's steps, (STEPS N,), behind the filter of the record."""
        return anti_aliased(self.fine[:-1:2])

    @property
    def closed(self) -> bool:
        """Whether a controller ran."""
        return bool(np.any(self.gains))

    def scaled(self, factor: float) -> Run:
        """The same experiment, so many times as large."""
        return replace(self, command=factor * self.command, reference=factor * self.reference)

    def again(self, rng: np.random.Generator) -> Run:
        """The same experiment with another random signal: as open_run drew it, and as large."""
        assert self.draw is not None
        other = self.draw(rng, len(self.command))
        return other.scaled(float(np.max(np.abs(self.command)) / np.max(np.abs(other.command))))


@dataclass(frozen=True)
class Outcome:
    """What a run gave: columns of the log (N,), and the plant's rows at the samples."""

    command: Any
    seen: Any
    clean: Any
    rows: Any


def draw_stage(rng: np.random.Generator, *, free: bool = False,
               late: float | None = None) -> Stage:
    """A stage or a free body. late: bound of lag and delay together in samples."""
    period = float(rng.choice(PERIODS))
    mass = log_uniform(rng, 0.05, 5.0)
    natural = 2.0 * math.pi * log_uniform(rng, 0.004, 0.05) / period
    base = {"mass": mass, "force_constant": log_uniform(rng, 0.5, 5.0)}
    if free:
        base["damping"] = mass * log_uniform(rng, 1e-3, 2e-2) / period
    else:
        base["stiffness"] = mass * natural**2
        base["damping"] = 2.0 * log_uniform(rng, 0.01, 0.15) * mass * natural
    most = float(rng.uniform(0.0, 1.0)) if late is None else late
    if most >= 0.15 and rng.random() < 0.5:
        base["amplifier_time_constant"] = period * rng.uniform(0.1, most)
    left = most - base.get("amplifier_time_constant", 0.0) / period
    steps = int(rng.integers(0, max(int(left * STEPS), 0) + 1))
    if steps and rng.random() < 0.7:
        base["delay"] = steps * period / STEPS
    amplitude = log_uniform(rng, 1e-4, 3e-2)
    noise = amplitude * log_uniform(rng, 3e-5, 3e-3)
    sensor = Sensor(noise, rng.uniform(0.3, 0.9) if rng.random() < 0.25 else 0.0,
                    noise * rng.uniform(0.3, 2.0) if rng.random() < 0.3 else 0.0)
    return Stage(base, period, amplitude, sensor)


def with_mount(rng: np.random.Generator, stage: Stage) -> Stage:
    """The same stage, its sensor on a mount that resonates above what is excited."""
    hertz = rng.uniform(0.3, 0.45) / stage.period
    return replace(stage, mount={"mount_hz": hertz, "mount_zeta": rng.uniform(0.02, 0.1)})


def open_run(rng: np.random.Generator, stage: Stage, kind: str, samples: int, *,
             hold: int = plant.HELD, shift: int = 0) -> Run:
    """A run by its input alone, whose linear motion has the stage's amplitude."""
    low = stage.natural * rng.uniform(0.05, 0.3)
    high = min(stage.natural * log_uniform(rng, 3.0, 20.0), 0.4)

    def draw(source: np.random.Generator, count: int) -> Run:
        wave = inputs.command(source, kind, count, max(low, 3.0 / samples), high)
        wave *= stage.amplitude / linear_peak(stage, wave)
        return Run(kind, wave, np.zeros(count), hold=hold, shift=shift, draw=draw)

    return draw(rng, samples)


def linear_peak(stage: Stage, wave: Any) -> float:
    """Peak motion (m) of the linear stage, by its frequency response."""
    spectrum = np.fft.rfft(wave, 2 * len(wave))
    hertz = np.fft.rfftfreq(2 * len(wave)) / stage.period
    s = 2j * math.pi * np.maximum(hertz, hertz[1])
    gain = stage.base["force_constant"] / (
        stage.base["mass"] * s * s + stage.base["damping"] * s + stage.base.get("stiffness", 0.0))
    return float(np.max(np.abs(np.fft.irfft(spectrum * gain)[:len(wave)])))


def closed_run(rng: np.random.Generator, stage: Stage, samples: int) -> Run:
    """A run under a PID with random gains, which the user's model knows nothing of."""
    base = dict(stage.base)
    gains = loop_gains(base, stage.period)
    gains = gains * [rng.uniform(0.4, 1.0), rng.uniform(0.2, 1.0), rng.uniform(0.6, 1.0), 1.0]
    pace = stage.natural if not stage.free else log_uniform(rng, 0.001, 0.01)
    kind = str(rng.choice(["scan", "steps", "multisine", "chirp"]))
    wave = inputs.command(rng, kind, samples, max(0.2 * pace, 3.0 / samples), 2.0 * pace)
    reference = stage.amplitude * _smooth(wave, max(3, round(0.1 / pace)))
    feed = np.zeros(samples)
    if not stage.free:
        feed = rng.uniform(0.0, 0.9) * reference / float(np.real(transfer(
            base, stage.period, [1e-3])[0]))
    if rng.random() < 0.5:
        dither = inputs.command(rng, "multisine", samples, pace, min(15.0 * pace, 0.3))
        feed = feed + dither * 0.1 * stage.amplitude / linear_peak(stage, dither)
    return Run(f"closed_{kind}", feed, reference, gains)


def _smooth(wave: Any, width: int) -> Any:
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(wave, window / window.sum())[:len(wave)]


def coloured_noise(rng: np.random.Generator, samples: int, colour: float) -> Any:
    """Noise (N,) of unit RMS, of whose power the share `colour` falls with frequency."""
    white = rng.standard_normal(samples)
    if colour == 0.0:
        return white
    return math.sqrt(1.0 - colour) * white + math.sqrt(colour) * pink(rng, samples)


def pink(rng: np.random.Generator, samples: int) -> Any:
    """1/f noise (N,) of unit RMS and mean zero."""
    spectrum = np.fft.rfft(rng.standard_normal(2 * samples))
    spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
    spectrum[0] = 0.0
    wave = np.fft.irfft(spectrum)[:samples]
    wave -= wave.mean()
    return wave / np.sqrt(np.mean(wave**2))


def perform(stage: Stage, run: Run, p: Physics, without: Physics, noise: Any,
            wander: Any = None) -> Outcome:
    """Simulate a run from rest and log it. noise (N,) m of the sensor; wander (N,) of the motor.

    Raises ValueError if the motion does not stay in its range.
    """
    samples = len(run.command)
    fine = run.fine if run.hold == plant.BAND_LIMITED else np.zeros(1)
    start = np.zeros(plant.STATES)
    if not stage.free:
        start[[plant.X1, plant.CREEP, plant.MOUNT]] = p.offset / stage.base["stiffness"]
    out = np.empty((plant.ROWS, samples))
    readings = np.empty(STEPS * samples)
    plain = plant.linear_part(p)
    plant.run(plant.packed(p), plant.packed(without), plant.packed(plain), stage.period, run.hold,
              stage.delay_steps + run.shift, np.ascontiguousarray(run.command), fine, run.gains,
              run.reference, noise, np.zeros(samples) if wander is None else wander,
              stage.sensor.resolution, start, out, readings)
    peak = float(np.max(np.abs(out[plant.POSITION])))
    if not math.isfinite(peak) or peak > MOST_MOTION * stage.amplitude:
        raise ValueError(f"{run.kind}: the motion does not stay in its range")
    if run.hold != plant.BAND_LIMITED:
        return Outcome(out[plant.INPUT], out[plant.SEEN], out[plant.READING], out)
    clean = anti_aliased(readings)[::STEPS]
    seen = _rounded(clean + noise, stage.sensor.resolution)
    return Outcome(run.filtered[::STEPS], seen, clean, out)


def anti_aliased(readings: Any) -> Any:
    """Signal (STEPS N,) at the plant's steps behind the filter of a band-limited record."""
    return sosfilt(ANTI_ALIAS, readings)


def _rounded(values: Any, step: float) -> Any:
    return values if step <= 0.0 else np.floor(values / step + 0.5) * step
