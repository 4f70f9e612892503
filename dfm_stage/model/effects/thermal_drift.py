"""Thermal drift: the reading moves with time, whatever the stage does.

    y = x + rate (1 - exp(-decay t)) / decay,      y = x + rate t for decay = 0

t counts from the first sample; the drift ends at rate / decay.
Source: Slocum, Precision Machine Design (1992); Incropera, Fundamentals of Heat and
Mass Transfer, sec. 5.1 (lumped capacitance).
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import (
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def sense(x: float, t: float, other: float, p: Values) -> float:
    """m"""
    if p[1] == 0.0:
        return p[0] * t
    return -p[0] * math.expm1(-p[1] * t) / p[1]


class ThermalDrift(Effect):
    """Begins at a drift as large as the noise."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Drifts that last, and some that die out within the record."""
        return [{"rate": at.noise / at.duration, "decay": d / at.duration}
                for d in (0.0, 1.0, 3.0, 8.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """A drift that ends within a fifteenth of the record is a step at its beginning."""
        return -math.inf, FASTEST / at.duration if parameter == "decay" else math.inf


FASTEST = 15.0
"""Largest decay, over the rate of one record."""


EFFECT = ThermalDrift(
    name="thermal_drift",
    meaning="the reading drifts with time",
    equation="y = x + rate (1 - exp(-decay t)) / decay",
    source="Slocum, Precision Machine Design (1992)",
    parameters=(
        Parameter("rate", 0.0, "m/s", "drift at the beginning", -1.0, 1.0),
        Parameter("decay", 0.0, "1/s", "rate at which the drift dies out", 0.0, 1e3),
    ),
    priors={"rate": Prior(-1e-6, 1e-6, log=False), "decay": Prior(1e-4, 1.0)},
    side="sensor",
    parity="none",
    memory=True,
    shown_by="a record as long as the drift, with the same motion at its beginning and end",
    optional=("decay",),
    classes=(Equivalence(("thermal_drift", "creep"), "one step only",
                         "steps in both directions"),),
    sense=sense,
    per_run=(".rate",),
)
