"""One axis of one record, as identification takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.periods import find_period
from dfm_stage.identification.run import Run
from dfm_stage.recording import AxisRecord


@dataclass(frozen=True)
class Source:
    """One axis of one record, ready for identification."""

    name: str
    axis: AxisRecord
    sample_period: float
    warnings: tuple[str, ...] = ()

    @property
    def driver(self) -> Array | None:
        """The signal that excites a closed loop, None where there is none but the input."""
        for signal in (self.axis.extra.get("excitation"), self.axis.reference):
            if signal is not None and np.all(np.isfinite(signal)) and np.ptp(signal) > 0.0:
                return signal
        return None

    def run(self) -> Run:
        """Return what output-error estimation takes."""
        return Run(self.name, self.axis.input, self.axis.position, self.sample_period)

    @property
    def period(self) -> int | None:
        """The period of the excitation in samples, None where it does not repeat."""
        for signal in (self.driver, self.axis.input):
            found = find_period(signal) if signal is not None else None
            if found is not None:
                return found.period
        return None
