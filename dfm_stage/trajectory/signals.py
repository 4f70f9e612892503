"""What an axis is given: where it is to be, and voltages that excite it, on the sample grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array, Lines
from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory import csv_signal as _csv
from dfm_stage.trajectory import scans as _scans
from dfm_stage.trajectory import waveform as _waveform
from dfm_stage.trajectory.kind import Kind, Movement, Timing, Values, choose
from dfm_stage.trajectory.waveform import Segment, Waveform


@dataclass(frozen=True)
class Reference:
    """A movement; every array has shape (N,), sample k belongs to t_k = k * sample_period_s.

    `steady` is true where the part that counts is under way: the constant-velocity part of a
    raster line, the dwell of a step, everything after a fade-in. `period_samples` is 0 where the
    movement does not repeat; it repeats from `start_samples` on.
    """

    position: Array
    velocity: Array
    acceleration: Array
    steady: NDArray[np.bool_] = field(repr=False)
    kind: str
    sample_period_s: float
    period_samples: int = 0
    start_samples: int = 0

    @property
    def time_s(self) -> Array:
        """Sample times, shape (N,), s."""
        return np.arange(self.position.size, dtype=np.float64) * self.sample_period_s

    def metadata(self) -> dict[str, Any]:
        """Return what a recorder stores beside the signal, as plain numbers and strings."""
        return {"kind": self.kind, "sample_period_s": self.sample_period_s,
                "samples": int(self.position.size), "period_samples": self.period_samples,
                "start_samples": self.start_samples}


def _hold(values: Values, timing: Timing) -> Movement:
    zero = np.zeros(timing.count)
    return (np.full(timing.count, values.number("position_m")), zero, zero.copy(),
            np.ones(timing.count, dtype=bool), 0, 0)


def _waveform_of(maker: Callable[[Values, Timing, str], Waveform]
                 ) -> Callable[[Values, Timing], Movement]:
    def build(values: Values, timing: Timing) -> Movement:
        wave = maker(values, timing, "m")
        return (wave.value + values.number("center_m"), wave.rate, wave.curvature,
                np.arange(timing.count) >= wave.ramp_samples, wave.period_samples,
                wave.ramp_samples)
    return build


def _kind(name: str, description: str, parameters: tuple[Parameter, ...],
          maker: Callable[[Values, Timing], Movement],
          options: tuple[Option, ...] = ()) -> Kind[Reference]:
    """Return a kind from what makes position, velocity, acceleration, steady, period, start."""
    def build(values: Values, timing: Timing) -> Reference:
        position, velocity, acceleration, steady, period, start = maker(values, timing)
        return Reference(position, velocity, acceleration, steady, name, timing.sample_period_s,
                         period, start)
    return Kind(name, description, parameters, build, options)


_CENTER = Parameter("center_m", 0.0, "m", "position the signal is added to")

REFERENCE_KINDS: dict[str, Kind[Reference]] = {kind.name: kind for kind in (
    _kind("hold", "stay at one position",
         (Parameter("position_m", 0.0, "m", "position to hold"),), _hold),
    _kind("steps", "a list of levels or a staircase, by jumps or smooth moves",
         _scans.staircase_parameters("m", "m", 1e-3),
         lambda values, timing: _scans.staircase(values, timing, "m"),
         _scans.staircase_options("m", "m")),
    _kind("raster", "scan lines there and back with smooth turnarounds",
         _scans.RASTER_PARAMETERS, _scans.raster),
    _kind("spiral", "out from the middle and back in; each axis gets its part",
         _scans.SPIRAL_PARAMETERS, _scans.spiral),
    _kind("lissajous", "a sine of whole cycles per pattern on each axis",
         _scans.LISSAJOUS_PARAMETERS, _scans.lissajous),
    _kind("point_to_point", "the shortest moves within velocity, acceleration and jerk",
         _scans.POINT_PARAMETERS, _scans.point_to_point, _scans.POINT_OPTIONS),
    _kind("csv", "positions from a CSV file, joined smoothly",
         _csv.csv_parameters("position"), _csv.csv_movement, _csv.CSV_OPTIONS),
    _kind("sine", "one frequency", (*_waveform.sine_parameters("m", "m", 1e-3), _CENTER),
         _waveform_of(_waveform.sine)),
    _kind("chirp", "a sweep through a band of frequencies",
         (*_waveform.chirp_parameters("m", "m", 1e-4), _CENTER),
         _waveform_of(_waveform.chirp), _waveform.CHIRP_OPTIONS),
    _kind("multisine", "many frequencies at once with random phases, periodic",
         (*_waveform.multisine_parameters("m", "m", 1e-4), _CENTER),
         _waveform_of(_waveform.multisine), _waveform.MULTISINE_OPTIONS),
)}


def make_reference(spec: Mapping[str, Any], *, sample_period_s: float, duration_s: float,
                   seed: int = 0, where: str = "") -> Reference:
    """Return the movement that a specification describes.

    Parameters
    ----------
    spec : mapping
        `kind` (a key of `REFERENCE_KINDS`) and its settings, SI; the rest takes its default. An
        `amplitude_m` is the peak of the whole signal, `rms_m` (if above zero) its RMS instead.
    sample_period_s, duration_s : float
        The grid has round(duration_s / sample_period_s) samples.
    seed : int
        Fixes the random phases of a multisine.
    where : str
        Dotted place of `spec` in its file, for messages.

    Raises
    ------
    TrajectoryError
        If the kind or a setting is unknown, of a wrong type or out of range.
    """
    kind, values = choose(spec, REFERENCE_KINDS, where)
    return kind.made(values, Timing.over(sample_period_s, duration_s, seed))


@dataclass(frozen=True)
class Excitation:
    """A voltage of shape (N,), V, and what an analysis has to know about it.

    Line h is the frequency h / (period_samples * sample_period_s); `excited_lines` carry the
    signal, `detection_lines` were left out of it on purpose. `period_samples` is 0 where the
    signal does not repeat. The first `ramp_samples` fade in. `crest_factor` is peak over RMS of
    one period (of the whole signal where there is none), before fading in. `segments` are the
    frequencies of a stepped sine, each with its samples.
    """

    voltage: Array
    kind: str
    sample_period_s: float
    period_samples: int
    periods: int
    ramp_samples: int
    excited_lines: Lines
    detection_lines: Lines
    crest_factor: float
    seed: int = 0
    segments: tuple[Segment, ...] = ()

    @property
    def _period_s(self) -> float:
        return max(1, self.period_samples) * self.sample_period_s

    @property
    def excited_hz(self) -> Array:
        """Frequencies of the excited lines, Hz."""
        return np.asarray(self.excited_lines / self._period_s)

    @property
    def detection_hz(self) -> Array:
        """Frequencies of the detection lines, Hz."""
        return np.asarray(self.detection_lines / self._period_s)

    def metadata(self) -> dict[str, Any]:
        """Return what a recorder stores beside the signal, as plain numbers, strings, lists."""
        steps = {"segments": [each.to_list() for each in self.segments]} if self.segments else {}
        return {**steps, "kind": self.kind, "sample_period_s": self.sample_period_s,
                "samples": int(self.voltage.size), "period_samples": self.period_samples,
                "periods": self.periods, "ramp_samples": self.ramp_samples,
                "excited_lines": self.excited_lines.tolist(),
                "detection_lines": self.detection_lines.tolist(),
                "crest_factor": self.crest_factor if np.isfinite(self.crest_factor) else None,
                "seed": self.seed}


def _excitation(name: str, description: str, parameters: tuple[Parameter, ...],
                maker: Callable[[Values, Timing], Waveform],
                options: tuple[Option, ...] = ()) -> Kind[Excitation]:
    """Return a kind of voltage from what makes its waveform."""
    def build(values: Values, timing: Timing) -> Excitation:
        wave = maker(values, timing)
        return Excitation(wave.value, name, timing.sample_period_s, wave.period_samples,
                          wave.periods, wave.ramp_samples, wave.excited_lines,
                          wave.detection_lines, wave.crest_factor, timing.seed, wave.segments)
    return Kind(name, description, parameters, build, options)


def _levels(maker: Callable[[Values, Timing], tuple[Array, int]]
            ) -> Callable[[Values, Timing], Waveform]:
    """Return the waveform of a voltage with jumps from what makes it and its period."""
    def build(values: Values, timing: Timing) -> Waveform:
        voltage, period = maker(values, timing)
        return Waveform(voltage, period_samples=period,
                        periods=timing.count // period if period else 0,
                        crest_factor=_waveform.crest_factor(voltage))
    return build


EXCITATION_KINDS: dict[str, Kind[Excitation]] = {kind.name: kind for kind in (
    _excitation("hold", "one constant voltage",
                (Parameter("voltage_v", 0.0, "V", "voltage to hold"),),
                _levels(lambda values, timing: (
                    np.full(timing.count, values.number("voltage_v")), 0))),
    _excitation("steps", "a list of levels or a staircase, by jumps or smooth moves",
                _scans.staircase_parameters("v", "V", 0.5),
                _levels(lambda values, timing: _scans.staircase(values, timing, "v")[::4]),
                _scans.staircase_options("v", "V")),
    _excitation("csv", "voltages from a CSV file, each row held to the next",
                _csv.csv_parameters("voltage"), _levels(_csv.csv_voltage), _csv.CSV_OPTIONS),
    _excitation("sine", "one frequency", _waveform.sine_parameters("v", "V", 0.08),
                partial(_waveform.sine, suffix="v")),
    _excitation("stepped_sine", "one frequency after another, each settled and then measured",
                _waveform.STEPPED_SINE_PARAMETERS, _waveform.stepped_sine,
                _waveform.STEPPED_SINE_OPTIONS),
    _excitation("chirp", "a sweep through a band of frequencies",
                _waveform.chirp_parameters("v", "V", 0.08),
                partial(_waveform.chirp, suffix="v"), _waveform.CHIRP_OPTIONS),
    _excitation("multisine", "many frequencies at once with random phases, periodic",
                _waveform.multisine_parameters("v", "V", 0.08),
                partial(_waveform.multisine, suffix="v"), _waveform.MULTISINE_OPTIONS),
)}


def make_excitation(spec: Mapping[str, Any], *, sample_period_s: float, duration_s: float,
                    seed: int = 0, where: str = "") -> Excitation:
    """Return the voltage that a specification describes.

    Parameters
    ----------
    spec : mapping
        `kind` (a key of `EXCITATION_KINDS`) and its settings, SI; the rest takes its default. An
        `amplitude_v` is the peak of the whole signal (for a multisine: of one period of the sum,
        not of one line), `rms_v` (if above zero) its RMS instead.
    sample_period_s, duration_s : float
        The grid has round(duration_s / sample_period_s) samples.
    seed : int
        Fixes phases and detection lines of a multisine.
    where : str
        Dotted place of `spec` in its file, for messages.

    Raises
    ------
    TrajectoryError
        If the kind or a setting is unknown, of a wrong type or out of range, or a period is not a
        whole number of samples.
    """
    kind, values = choose(spec, EXCITATION_KINDS, where)
    return kind.made(values, Timing.over(sample_period_s, duration_s, seed))
