"""How well a model explains records: against the noise floor, on unseen data, by tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dfm_stage.identification.decisions import FEWEST_HELD_OUT, MOVES
from dfm_stage.identification.frequency_response import FrequencyResponse
from dfm_stage.identification.model_fit import ModelFit, evaluate, fit_model
from dfm_stage.identification.residuals import (
    LineResidual,
    ResidualTest,
    input_correlation,
    line_residuals,
    noise_floor_from_periods,
    whiteness,
)
from dfm_stage.identification.result import SegmentFit
from dfm_stage.identification.source import Source

LEAD_IN = 200
"""Samples simulated but not compared where a record is cut: the delay and the lag fill up."""


@dataclass(frozen=True)
class NoiseFloor:
    """RMS that no model can explain, and where that is known from: periods or innovations."""

    rms: float
    known_from: str


@dataclass(frozen=True)
class Evaluation:
    """How well a model explains one record: `source` says which samples, `fitted` whether the
    model had seen them."""

    source: str
    fit: SegmentFit
    floor: NoiseFloor

    @property
    def fit_percent(self) -> float | None:
        """The figure of fit, None where the stage rests and there is nothing but noise to fit."""
        moving = float(np.std(self.fit.measured)) > MOVES * self.floor.rms
        return self.fit.fit_percent if moving else None

    def to_dict(self, unit: str) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"source": self.source, "rms": self.fit.rms, "noise_floor": self.floor.rms,
                "noise_floor_from": self.floor.known_from, "unit": unit,
                "fit_percent": self.fit_percent}


def judged(name: str, fit: SegmentFit, period: int | None) -> Evaluation:
    """Set a fit beside the noise floor: what does not repeat, or else the innovations."""
    floor = noise_floor_from_periods(fit.residual, period) if period else None
    if floor is not None:
        return Evaluation(name, fit, NoiseFloor(floor, "periods"))
    rms = float(np.sqrt(np.mean(fit.innovations**2)))
    return Evaluation(name, fit, NoiseFloor(rms, "innovations"))


def residual_tests(source: Source, fit: SegmentFit, response: FrequencyResponse | None,
                   period: int | None) -> tuple[tuple[ResidualTest, ...], LineResidual | None]:
    """Test what was left over of one record; by line where it is periodic."""
    lost = fit.skip + fit.noise.order
    tests = (whiteness(fit.innovations, fitted=fit.noise.order),
             input_correlation(fit.innovations, source.axis.input[lost:]))
    if response is None or period is None:
        return tests, None
    return tests, line_residuals(fit.residual, period, response.lines, source.sample_period)


def hold_out(sources: Sequence[Source], holdout: Sequence[Source], fit: ModelFit,
             names: Sequence[str], noise: str, period: int | None) -> tuple[Evaluation, ...]:
    """Predict records that were not fitted, or the last quarter of the first one."""
    if holdout:
        return tuple(judged(s.name, evaluate(fit.model, s.run(), noise=noise), s.period)
                     for s in holdout)
    whole = sources[0].run()
    cut = 3 * whole.input.size // 4
    if whole.input.size - cut < FEWEST_HELD_OUT:
        return ()
    early = whole.sliced(slice(0, cut))
    before = min(cut, LEAD_IN)
    late = replace(whole.sliced(slice(cut - before, None)), skip=before)
    part = fit_model(fit.model, [early, *(s.run() for s in sources[1:])], names, noise=noise)
    if not part.estimate.ok:
        return ()
    predicted = evaluate(part.model, late, noise=noise)
    return (judged(f"{whole.name}, last quarter, fitted without it", predicted, period),)
