"""Backlash: the link that holds the stage has play, and takes hold beyond half a gap.

    F = -stiffness (x - centre - min(max(x - centre, -gap/2), gap/2))

Within the gap the link gives no force. The stage's own stiffness stands beside it; a stage held by
the link alone has none. Two elastic stops, one on each side, are the same law. Where the motion
meets one end of the play only, it is a one-sided cable, or a stop. Play between a
drive with a mass of its own and its load is not this: the model has one driven point.
Source: Nordin and Gutman, Automatica 38 (2002) 1633 (dead-zone model).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from dfm_stage.model.effect import (
    SMALL,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    off, half = x - p[2], 0.5 * p[1]
    return -p[0] * (off - min(max(off, -half), half))


class Backlash(Effect):
    """Begins at gaps of the size of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small stiffness behind gaps that are crossed often and seldom."""
        return [{"stiffness": 10.0 * SMALL * at.stiffness, "gap": share * at.motion, "centre": 0.0}
                for share in (0.2, 0.5, 1.0, 1.6, 2.5, 4.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """A gap nearly as wide as the travel is met on one side, by a stop; what is stiffer than
        a link are stops, and what is much softer holds nothing."""
        return {"gap": (-math.inf, WIDEST * at.travel),
                "stiffness": (SOFTEST * at.stiffness, STIFFEST * at.stiffness)}.get(
            parameter, (-math.inf, math.inf))


WIDEST = 0.8
"""Gap over the travel."""
SOFTEST, STIFFEST = 1e-3, 10.0
"""Stiffness of the link over that of the stage: a softer one is told from a cubic spring by
nothing but the noise."""


def _nearer_end(values: Mapping[str, float]) -> float:
    """The end of the play that lies nearer to x = 0: the one that is met first."""
    half = 0.5 * values["gap"]
    return min(values["centre"] + half, values["centre"] - half, key=abs)


def _as_cable(values: Mapping[str, float]) -> Parameters:
    """The link, of which only one end is met."""
    end = _nearer_end(values)
    side = 1.0 if end > values["centre"] else -1.0
    return {"stiffness": side * values["stiffness"], "slack": end}


def _as_stop(values: Mapping[str, float]) -> Parameters:
    """The stops, of which only one is met."""
    return {"stiffness": values["stiffness"], "position": _nearer_end(values), "dissipation": 0.0}


EFFECT = Backlash(
    name="backlash",
    meaning="the link that holds the stage has play, or an elastic stop stands on each side",
    equation="F = -stiffness (x - centre - min(max(x - centre, -gap/2), gap/2))",
    source="Nordin and Gutman, Automatica 38 (2002) 1633",
    parameters=(
        Parameter("stiffness", 0.0, "N/m", "stiffness of the link", 0.0, 1e12),
        Parameter("gap", 1e-4, "m", "width of the play", 0.0, 1e3),
        Parameter("centre", 0.0, "m", "middle of the play", -1e3, 1e3),
    ),
    priors={"stiffness": Prior(1.0, 1e4), "gap": Prior(1e-5, 1e-3),
            "centre": Prior(-1e-4, 1e-4, log=False)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="motion within the gap and far beyond it",
    optional=("centre",),
    refinements=("centre",),
    classes=(Equivalence(("backlash", "cubic_stiffness"), "one amplitude",
                         "amplitudes from within the gap to far beyond it"),
             Equivalence(("backlash", "stiffness"), "motion far beyond the gap",
                         "motion about as large as the gap")),
    twins={"one_sided_cable": _as_cable, "end_stop": _as_stop},
    force=force,
)
