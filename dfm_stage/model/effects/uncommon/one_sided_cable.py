"""One-sided cable: a spring that only pulls, and is slack on the other side.

    F = -stiffness max(x - slack, 0)        for a stiffness above zero
    F = |stiffness| max(slack - x, 0)       below zero

The sign of the stiffness is the side on which the cable pulls back. The two sides differ by a
spring, so a fit that frees the stage's stiffness passes smoothly from one to the other.
Source: Shaw and Holmes, J. Sound Vib. 90 (1983) 129 (piecewise linear oscillator); Irvine, Cable
Structures (1981), ch. 1.
"""

from __future__ import annotations

import math

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
    if p[0] >= 0.0:
        return -p[0] * max(x - p[1], 0.0)
    return -p[0] * max(p[1] - x, 0.0)


class OneSidedCable(Effect):
    """Begins at slack over the whole of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small stiffness; its sign comes out of the fit."""
        return [{"stiffness": 10.0 * SMALL * at.stiffness, "slack": share * at.motion}
                for share in (-1.5, -0.7, -0.3, 0.0, 0.3, 0.7, 1.5)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """What is stiffer is a stop."""
        stiffest = STIFFEST * at.stiffness if parameter == "stiffness" else math.inf
        return -stiffest, stiffest


STIFFEST = 3.0
"""Stiffness of a cable over that of the stage."""


EFFECT = OneSidedCable(
    name="one_sided_cable",
    meaning="a cable pulls on one side and is slack on the other",
    equation="F = -stiffness max(x - slack, 0); for a stiffness below zero |stiffness| "
    "max(slack - x, 0)",
    source="Shaw and Holmes, J. Sound Vib. 90 (1983) 129",
    parameters=(
        Parameter("stiffness", 0.0, "N/m", "stiffness; its sign is the side", -1e9, 1e9),
        Parameter("slack", 0.0, "m", "position at which the cable is just straight", -1e3, 1e3),
    ),
    priors={"stiffness": Prior(1.0, 1e3), "slack": Prior(-1e-3, 1e-3, log=False)},
    side="mechanical",
    parity="even",
    memory=False,
    shown_by="motion on both sides of rest, at several amplitudes",
    classes=(
        Equivalence(("one_sided_cable", "quadratic_stiffness"), "one amplitude",
                    "several amplitudes: the cable's force is a kink, not a parabola"),
        Equivalence(("one_sided_cable", "end_stop"), "a cable nearly as stiff as the stage",
                    "by convention a stop is three times as stiff as the stage"),
        Equivalence(("one_sided_cable", "stiffness"), "motion on one side of slack only",
                    "motion on both sides"),
    ),
    force=force,
)
