"""The record: what an experiment says about one or several axes, on one even time base.

Convention: `position[k]` is sampled at `time[k]`, before `input[k]` acts; `input[k]` is held until
`time[k + 1]`. Position k + 1 depends on inputs up to k.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.units import Measured, column_unit

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

FloatArray: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
HOLDS = ("zero", "first", "band_limited")
"""What an input does between its samples: stand, go straight to the next, or be band-limited."""


@dataclass(frozen=True)
class AxisRecord:
    """One axis; every array has shape (N,).

    Attributes
    ----------
    input : volts as applied (A with a current drive), in `input_unit`
    position : in `position_unit`; metres unless the source measures something else. Where
        `measures` says so it is the measured velocity or acceleration instead, in `output_unit`
    current : A, or None if it was not measured
    reference : wanted position in `position_unit`, or None
    extra : whatever else the source holds for this axis, for instance `excitation` (V), `command`
        (V) and `plant_position` (m) from a bag
    velocity : measured beside the position, in `position_unit`/s, or None
    measures : what `position` holds
    input_hold : what the input does between its samples, one of HOLDS; None to estimate it
    input_shift : samples by which the input acts later than its column says; None to estimate it
    """

    input: FloatArray
    position: FloatArray
    input_unit: str = "V"
    position_unit: str = "m"
    current: FloatArray | None = None
    reference: FloatArray | None = None
    extra: Mapping[str, FloatArray] = field(default_factory=dict)
    velocity: FloatArray | None = None
    measures: Measured = "position"
    input_hold: str | None = None
    input_shift: float | None = None

    @property
    def output_unit(self) -> str:
        """The unit of what `position` holds."""
        return self.position_unit + {"position": "", "velocity": "/s", "acceleration": "/s^2"}[
            self.measures]

    def arrays(self) -> dict[str, FloatArray]:
        """Return every array there is, by the name of its attribute or of the extra."""
        named = {"input": self.input, "position": self.position, "current": self.current,
                 "reference": self.reference, "velocity": self.velocity}
        return {name: array for name, array in named.items() if array is not None} | {
            **self.extra}

    def slice(self, part: slice) -> AxisRecord:
        """Return the samples in `part`."""
        cut = {name: array[part] for name, array in self.arrays().items()}
        extra = {name: cut.pop(name) for name in self.extra}
        own: dict[str, Any] = {**cut, "extra": extra}
        return replace(self, **own)


@dataclass(frozen=True)
class Provenance:
    """Where a record comes from.

    Attributes
    ----------
    source : the file or folder, as it was given
    kind : bag, csv, npz or mat
    fingerprint : `sha256:...` of the content; of large files `sha256-ends:...` of size and ends
    start_ns : time of the first sample, ns since the epoch; None if unknown
    model : text of the model.yaml inside a bag, or None
    parameters, versions : what the bag says of its run; empty if nothing
    """

    source: str
    kind: str
    fingerprint: str = ""
    start_ns: int | None = None
    model: str | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """The source and the first digits of its fingerprint, for the foot of a report."""
        how, _, digits = self.fingerprint.partition(":")
        return f"{self.source} ({how} {digits[:12]})" if digits else self.source


@dataclass(frozen=True)
class Record:
    """Samples of one or several axes on an even time base.

    Attributes
    ----------
    time
        (N,) s, `time[0] + k * sample_period`
    sample_period
        s
    axes
        By name.
    warnings
        What a reader should know about the data, in words; nothing is changed silently.
    """

    time: FloatArray
    sample_period: float
    axes: Mapping[str, AxisRecord]
    provenance: Provenance
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.time)

    @property
    def duration(self) -> float:
        """Seconds from the first sample to the end of the last one."""
        return len(self.time) * self.sample_period

    def axis(self, name: str | None = None) -> AxisRecord:
        """Return one axis; the name may be left out where there is only one.

        Raises
        ------
        RecordError
            If there is no such axis, or several and no name.
        """
        if name is None and len(self.axes) == 1:
            return next(iter(self.axes.values()))
        if name is None or name not in self.axes:
            said = "has several axes" if name is None else f"has no axis {name}"
            raise RecordError(f"{said}; choose one of "
                              f"{', '.join(self.axes)}", self.provenance.source)
        return self.axes[name]

    def slice(self, start: int, stop: int | None = None) -> Record:
        """Return the samples from `start` up to, not including, `stop`."""
        part = slice(start, stop)
        return replace(self, time=self.time[part],
                       axes={name: axis.slice(part) for name, axis in self.axes.items()})

    def columns(self) -> dict[str, FloatArray]:
        """Return the record as the columns that `read_record` understands, by name.

        `time_s`, and for each axis `input_v`, `position_m`, `velocity_m_s`, `current_a`,
        `reference_m` as far as there are, prefixed by the axis name where there are several axes.
        """
        return {"time_s": self.time, **{name: array for name, _, array in self._signals()}}

    def to_pandas(self) -> DataFrame:
        """Return the columns of `columns()`, and each axis's `extra`, over the time in s.

        `attrs` has the sample period in s, the source and its fingerprint.

        Raises
        ------
        MissingPackageError
            If pandas is not installed.
        """
        from dfm_stage.recording.frames import data_frame

        columns = {name: array for name, _, array in (*self._signals(), *self._extras())}
        return data_frame(columns, "time_s", self.time, self._about())

    def to_xarray(self) -> Dataset:
        """Return what `to_pandas` returns as variables with units, over the dimension `time_s`.

        Raises
        ------
        MissingPackageError
            If xarray is not installed.
        """
        from dfm_stage.recording.frames import data_set

        signals = (*self._signals(), *self._extras())
        units = {"time_s": "s", **{name: unit for name, unit, _ in signals}}
        found: Dataset = data_set({name: array for name, _, array in signals}, "time_s",
                                  self.time, self._about(), units)
        return found

    def _signals(self) -> Iterator[tuple[str, str, FloatArray]]:
        """Column, unit and array of what every record has a name for."""
        for prefix, axis in self._prefixed():
            unit, of_position = axis.output_unit, axis.position_unit
            yield f"{prefix}input_{column_unit(axis.input_unit)}", axis.input_unit, axis.input
            yield f"{prefix}{axis.measures}_{column_unit(unit)}", unit, axis.position
            if axis.velocity is not None:
                yield (f"{prefix}velocity_{column_unit(of_position)}_s", f"{of_position}/s",
                       axis.velocity)
            if axis.current is not None:
                yield f"{prefix}current_a", "A", axis.current
            if axis.reference is not None:
                yield (f"{prefix}reference_{column_unit(of_position)}", of_position,
                       axis.reference)

    def _extras(self) -> Iterator[tuple[str, str, FloatArray]]:
        for prefix, axis in self._prefixed():
            for name, array in axis.extra.items():
                yield f"{prefix}{name}", "", array

    def _prefixed(self) -> Iterator[tuple[str, AxisRecord]]:
        for name, axis in self.axes.items():
            yield f"{name}_" if len(self.axes) > 1 else "", axis

    def _about(self) -> dict[str, Any]:
        return {"sample_period_s": self.sample_period, "source": self.provenance.source,
                "fingerprint": self.provenance.fingerprint}
