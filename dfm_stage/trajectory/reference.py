"""Where the stage is to be: position, velocity and acceleration on the sample grid."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory import area as _area
from dfm_stage.trajectory import csv_signal as _csv
from dfm_stage.trajectory import point_to_point as _points
from dfm_stage.trajectory import raster as _raster
from dfm_stage.trajectory import staircase as _staircase
from dfm_stage.trajectory import waveform as _waveform
from dfm_stage.trajectory.kind import Array, Kind, Timing, Values, choose
from dfm_stage.trajectory.waveform import Waveform


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


Movement = tuple[Array, Array, Array, NDArray[np.bool_], int, int]


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
         _staircase.staircase_parameters("m", "m", 1e-3),
         lambda values, timing: _staircase.staircase(values, timing, "m"),
         _staircase.staircase_options("m", "m")),
    _kind("raster", "scan lines there and back with smooth turnarounds",
         _raster.RASTER_PARAMETERS, _raster.raster),
    _kind("spiral", "out from the middle and back in; each axis gets its part",
         _area.SPIRAL_PARAMETERS, _area.spiral),
    _kind("lissajous", "a sine of whole cycles per pattern on each axis",
         _area.LISSAJOUS_PARAMETERS, _area.lissajous),
    _kind("point_to_point", "the shortest moves within velocity, acceleration and jerk",
         _points.POINT_PARAMETERS, _points.point_to_point, _points.POINT_OPTIONS),
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
    return kind.build(values, Timing.over(sample_period_s, duration_s, seed))
