"""One axis of one record, as identification takes it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.convention import Convention, agreed, find_convention
from dfm_stage.identification.motion import ORDER
from dfm_stage.identification.periods import find_period
from dfm_stage.identification.run import Run
from dfm_stage.recording import AxisRecord, Record


@dataclass(frozen=True)
class Source:
    """One axis of one record, ready for identification."""

    name: str
    axis: AxisRecord
    sample_period: float
    warnings: tuple[str, ...] = ()
    known: Convention | None = None

    @classmethod
    def of(cls, record: Record, axis: str | None = None, name: str | None = None) -> Source:
        """Return one axis of a record.

        Raises
        ------
        RecordError
            If there is no such axis, or several and none is named.
        """
        return cls(name or record.provenance.source, record.axis(axis), record.sample_period,
                   tuple(record.warnings))

    @property
    def driver(self) -> Array | None:
        """The signal that excites a closed loop, None where there is none but the input."""
        for signal in (self.axis.extra.get("excitation"), self.axis.reference):
            if signal is not None and np.all(np.isfinite(signal)) and np.ptp(signal) > 0.0:
                return signal
        return None

    def run(self) -> Run:
        """Return what output-error estimation takes."""
        axis = self.axis
        beside = axis.velocity if axis.measures == "position" else None
        usable = beside is not None and np.all(np.isfinite(beside)) and np.ptp(beside) > 0.0
        return Run(self.name, axis.input, axis.position, self.sample_period,
                   measures=axis.measures, velocity=beside if usable else None
                   ).by(self.convention)

    @cached_property
    def convention(self) -> Convention:
        """What the input does between its samples: `known`, given with the record, or found in
        it."""
        axis = self.axis
        return self.known or find_convention(axis.input, axis.position, ORDER[axis.measures],
                                             hold=axis.input_hold, shift=axis.input_shift)

    @property
    def period(self) -> int | None:
        """The period of the excitation in samples, None where it does not repeat."""
        for signal in (self.driver, self.axis.input):
            found = find_period(signal) if signal is not None else None
            if found is not None:
                return found.period
        return None


def agreeing(sources: Iterable[Source]) -> list[Source]:
    """Return the sources of one set with what they say together of their inputs."""
    given = list(sources)
    return [replace(source, known=convention) for source, convention
            in zip(given, agreed([each.convention for each in given]), strict=True)]
