"""Voltages that excite the stage so that a record shows its dynamics."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory import csv_signal as _csv
from dfm_stage.trajectory import staircase as _staircase
from dfm_stage.trajectory import stepped_sine as _stepped
from dfm_stage.trajectory import waveform as _waveform
from dfm_stage.trajectory.kind import Array, Kind, Timing, Values, choose
from dfm_stage.trajectory.stepped_sine import Segment
from dfm_stage.trajectory.waveform import Lines, Waveform


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
    def time_s(self) -> Array:
        """Sample times, shape (N,), s."""
        return np.arange(self.voltage.size, dtype=np.float64) * self.sample_period_s

    @property
    def excited_hz(self) -> Array:
        """Frequencies of the excited lines, Hz."""
        return self._hz(self.excited_lines)

    @property
    def detection_hz(self) -> Array:
        """Frequencies of the detection lines, Hz."""
        return self._hz(self.detection_lines)

    def _hz(self, lines: Lines) -> Array:
        return np.asarray(lines / (max(1, self.period_samples) * self.sample_period_s))

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


_NONE = np.zeros(0, dtype=np.int64)


def _kind(name: str, description: str, parameters: tuple[Parameter, ...],
          maker: Callable[[Values, Timing], tuple[Array, int]],
          options: tuple[Option, ...] = ()) -> Kind[Excitation]:
    """Return a kind from what makes the voltage and its period."""
    def build(values: Values, timing: Timing) -> Excitation:
        voltage, period = maker(values, timing)
        return Excitation(voltage, name, timing.sample_period_s, period,
                          timing.count // period if period else 0, 0, _NONE, _NONE,
                          _waveform.crest_factor(voltage), timing.seed)
    return Kind(name, description, parameters, build, options)


def _steps(values: Values, timing: Timing) -> tuple[Array, int]:
    voltage, *_, period, _ = _staircase.staircase(values, timing, "v")
    return voltage, period


def _stepped_sine(values: Values, timing: Timing) -> Excitation:
    voltage, segments, ramp = _stepped.stepped_sine(values, timing, "v")
    return Excitation(voltage, "stepped_sine", timing.sample_period_s, 0, 0, ramp, _NONE, _NONE,
                      math.sqrt(2.0), timing.seed, segments)


Maker = Callable[[Values, Timing, str], Waveform]


def _from_waveform(name: str, maker: Maker) -> Callable[[Values, Timing], Excitation]:
    def build(values: Values, timing: Timing) -> Excitation:
        wave = maker(values, timing, "v")
        return Excitation(wave.value, name, timing.sample_period_s, wave.period_samples,
                          wave.periods, wave.ramp_samples, wave.excited_lines,
                          wave.detection_lines, wave.crest_factor, timing.seed)
    return build


EXCITATION_KINDS: dict[str, Kind[Excitation]] = {kind.name: kind for kind in (
    _kind("hold", "one constant voltage",
          (Parameter("voltage_v", 0.0, "V", "voltage to hold"),),
          lambda values, timing: (np.full(timing.count, values.number("voltage_v")), 0)),
    _kind("steps", "a list of levels or a staircase, by jumps or smooth moves",
          _staircase.staircase_parameters("v", "V", 0.5),
          _steps,
          _staircase.staircase_options("v", "V")),
    _kind("csv", "voltages from a CSV file, each row held to the next",
          _csv.csv_parameters("voltage"), _csv.csv_voltage, _csv.CSV_OPTIONS),
    Kind("sine", "one frequency", _waveform.sine_parameters("v", "V", 0.08),
         _from_waveform("sine", _waveform.sine)),
    Kind("stepped_sine", "one frequency after another, each settled and then measured",
         _stepped.stepped_sine_parameters("v", "V", 0.08), _stepped_sine,
         _stepped.STEPPED_SINE_OPTIONS),
    Kind("chirp", "a sweep through a band of frequencies",
         _waveform.chirp_parameters("v", "V", 0.08),
         _from_waveform("chirp", _waveform.chirp), _waveform.CHIRP_OPTIONS),
    Kind("multisine", "many frequencies at once with random phases, periodic",
         _waveform.multisine_parameters("v", "V", 0.08),
         _from_waveform("multisine", _waveform.multisine), _waveform.MULTISINE_OPTIONS),
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
    return kind.build(values, Timing.over(sample_period_s, duration_s, seed))
