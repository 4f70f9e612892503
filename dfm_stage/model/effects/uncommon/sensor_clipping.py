"""Clipping of the sensor: beyond its range the reading stays at the limit.

    y = min(max(x, centre - limit), centre + limit)

Source: Webster and Eren, Measurement, Instrumentation, and Sensors Handbook (2014), ch. 1.
"""

from __future__ import annotations

import numpy as np

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
    return min(max(x, p[1] - p[0]), p[1] + p[0]) - x


class SensorClipping(Effect):
    """Its limit is tried at the largest readings, and at quantiles of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Limits that a growing share of the readings exceeds."""
        off = np.concatenate([np.abs(r.position - np.mean(r.position)) for r in at.runs])
        tried = np.unique(np.quantile(off, 1.0 - SHARES))
        return [{"limit": float(limit), "centre": 0.0} for limit in tried if limit > 0.0]


SHARES = np.concatenate(([0.0], np.geomspace(1e-4, 0.5, 24)))
"""Shares of the readings that a limit may cut."""


EFFECT = SensorClipping(
    name="sensor_clipping",
    meaning="the sensor's range ends before the motion",
    equation="y = min(max(x, centre - limit), centre + limit)",
    source="Webster and Eren, Measurement, Instrumentation, and Sensors Handbook (2014), ch. 1",
    parameters=(
        Parameter("limit", 1e-3, "m", "half the sensor's range", 1e-12, 1e3),
        Parameter("centre", 0.0, "m", "middle of the sensor's range", -1e3, 1e3),
    ),
    priors={"limit": Prior(1e-5, 1e-2), "centre": Prior(-1e-4, 1e-4, log=False)},
    side="sensor",
    parity="odd",
    memory=False,
    shown_by="motion beyond the sensor's range, at least 5 % of the time",
    optional=("centre",),
    refinements=("centre",),
    searched=True,
    classes=(Equivalence(("sensor_clipping", "end_stop"), "motion that stays at its end for long",
                         "the motion after the end: a stop throws the stage back"),),
    sense=sense,
)
