"""The experiments by which a stage is characterised, and the analysis of each from its record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.identification.constrained_fit import ConstrainedFit, fit_constrained
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.frequency_response import FrequencyResponse, frequency_response
from dfm_stage.identification.ring_down import RingDown, ring_down
from dfm_stage.identification.static import StaticTest, static_test
from dfm_stage.identification.step_response import StepResponse, step_response
from dfm_stage.identification.stepped_sine import segments_in, stepped_sine_response
from dfm_stage.identification.transfer_function import TransferFunctionFit, fit_transfer_function
from dfm_stage.recording import AxisRecord, Record

EXPERIMENTS: Mapping[str, str] = {
    "static": "static", "decay": "free_decay", "step": "open_loop_step",
    "stepped_sine": "stepped_sine", "multisine": "multisine",
}
"""What can be characterised, and the experiment in config/experiments that does it."""
ANOTHER_MODE = 2.0
"""Misfit of one mode (1 = down to the noise) from which a second one is tried."""
SECOND_HELPS = 0.5
"""Share of that misfit that a second mode must come below to be kept."""


@dataclass(frozen=True)
class DynamicTest:
    """A measured frequency response and two fits to it.

    `constrained` minimises the relative misfit as the paper does, `likely` is the maximum
    likelihood under the measured noise, with a second mode where one does not do.
    """

    response: FrequencyResponse
    constrained: ConstrainedFit
    likely: TransferFunctionFit

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        response = self.response
        return {"constrained": self.constrained.to_dict(), "likelihood": self.likely.to_dict(),
                "frequency_hz": response.frequency_hz.tolist(),
                "real": response.response.real.tolist(), "imag": response.response.imag.tolist(),
                "std": np.sqrt(response.variance).tolist(), "unit": response.unit}


Characterisation = StaticTest | RingDown | StepResponse | DynamicTest


def characterise(kind: str, record: Record, *, force_constant: float | None = None,
                 axis: str | None = None) -> Characterisation:
    """Analyse the record of one of `EXPERIMENTS`; `force_constant` (N per unit) is for static.

    Raises
    ------
    IdentificationError
        If the kind is unknown or the record does not hold what it needs.
    """
    if kind not in EXPERIMENTS:
        raise IdentificationError(f"{kind} is no way to characterise a stage; known: "
                                  f"{', '.join(EXPERIMENTS)}")
    data = record.axis(axis)
    if kind == "static":
        if force_constant is None:
            raise IdentificationError("a static test needs the force constant, N per volt: name "
                                      "a model that has it")
        return static_test(data.input, data.position, record.sample_period, force_constant)
    if kind == "decay":
        return ring_down(data.position, record.sample_period, input_=data.input)
    if kind == "step":
        return step_response(data.input, data.position, record.sample_period)
    measured = (_stepped_sine(record, data, axis) if kind == "stepped_sine" else
                frequency_response(data.input, data.position, record.sample_period,
                                   input_unit=data.input_unit, output_unit=data.position_unit))
    likely = fit_transfer_function(measured)
    if likely.misfit > ANOTHER_MODE:
        second = fit_transfer_function(measured, modes=2)
        likely = second if second.ok and second.misfit < SECOND_HELPS * likely.misfit else likely
    return DynamicTest(measured, fit_constrained(measured), likely)


def _stepped_sine(record: Record, data: AxisRecord, axis: str | None) -> FrequencyResponse:
    name = axis if axis is not None else next(iter(record.axes))
    segments = segments_in(record.provenance.parameters, name)
    if segments[-1][2] > len(record):
        raise IdentificationError(f"{record.provenance.source}: the record ends at sample "
                                  f"{len(record)}, before the last frequency was measured")
    return stepped_sine_response(data.input, data.position, record.sample_period, segments,
                                 input_unit=data.input_unit, output_unit=data.position_unit)
