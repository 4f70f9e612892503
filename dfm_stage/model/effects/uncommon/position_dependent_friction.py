"""Position-dependent friction: dry friction that grows towards the ends of the travel.

    F = -force (1 + ((x - centre)/length)^2) sgn(x')  moving; at rest any |F| up to that

At `length` from the centre the friction is twice that at the centre. The simulator locates each
reversal and breakaway inside the sample. With a length far beyond the travel it is Coulomb
friction.
Source: Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 4.
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


def friction(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    off = (x - p[2]) / p[1]
    return p[0] * (1.0 + off * off)


class PositionDependentFriction(Effect):
    """Begins at lengths of the size of the motion, with the centre at rest or at either end."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small force."""
        return [{"force": SMALL * at.force, "length": length * at.motion,
                 "centre": centre * at.motion}
                for length in (0.3, 1.0, 2.5) for centre in (0.0, -2.0, 2.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """With a longer length the friction is the same everywhere."""
        if parameter == "centre":
            return -FARTHEST * at.travel, FARTHEST * at.travel
        return -math.inf, FARTHEST * at.travel if parameter == "length" else math.inf


FARTHEST = 2.0
"""Length and distance of the centre over the travel: at the ends of the travel the friction is
then 6 % larger."""


EFFECT = PositionDependentFriction(
    name="position_dependent_friction",
    meaning="dry friction that grows towards the ends of the travel",
    equation="F = -force (1 + ((x - centre)/length)^2) sgn(x'); at rest any |F| up to that",
    source="Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 4",
    parameters=(
        Parameter("force", 0.0, "N", "friction at the centre", 0.0, 1e6),
        Parameter("length", 1e-3, "m", "distance at which the friction has doubled", 1e-9, 1e3),
        Parameter("centre", 0.0, "m", "where the friction is least", -1e3, 1e3),
    ),
    priors={"force": Prior(1e-4, 1.0), "length": Prior(1e-4, 1e-2),
            "centre": Prior(-1e-3, 1e-3, log=False)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="slow motion over all of the travel, at several amplitudes",
    optional=("centre",),
    refinements=("centre",),
    classes=(
        Equivalence(("position_dependent_friction", "coulomb_friction"), "motion much smaller "
                    "than length", "motion over all of the travel"),
        Equivalence(("position_dependent_friction", "load_dependent_friction"), "motion well "
                    "below the resonance, where the force follows the position",
                    "motion around the resonance"),
    ),
    friction=friction,
)
