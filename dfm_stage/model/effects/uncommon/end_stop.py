"""End stop: a one-sided stiff contact, which loses energy in each impact.

    F = -stiffness d max(1 + dissipation d', 0) outward,    d = depth of contact > 0

d = x - position for a position above zero, position - x below: the sign of the position is the
side. The contact never pulls. A dissipation c gives a coefficient of restitution of about
1 - 2/3 c v for impacts at a low speed v.
Source: Hunt and Crossley, J. Appl. Mech. 42 (1975) 440, with an exponent of one.
"""

from __future__ import annotations

import math

import numpy as np

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
    side = 1.0 if p[1] >= 0.0 else -1.0
    depth = side * (x - p[1])
    if depth <= 0.0:
        return 0.0
    return -side * p[0] * depth * max(1.0 + p[2] * side * v, 0.0)


class EndStop(Effect):
    """Begins at contacts near either end of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Soft ones, to which the response is linear; the fit makes them stiff."""
        moved = np.concatenate([r.position - np.mean(r.position) for r in at.runs])
        return [{"stiffness": 10.0 * SMALL * at.stiffness, "position": share * float(end),
                 "dissipation": 0.0}
                for end in (np.max(moved), np.min(moved)) for share in (0.5, 0.7, 0.85, 0.95)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """What is softer is a cable or a spring."""
        return (SOFTEST * at.stiffness if parameter == "stiffness" else -math.inf), math.inf


SOFTEST = 3.0
"""Stiffness of a stop over that of the stage."""


EFFECT = EndStop(
    name="end_stop",
    meaning="the stage runs against a stop",
    equation="F = -stiffness d max(1 + dissipation d', 0) outward, d = depth of contact > 0",
    source="Hunt and Crossley, J. Appl. Mech. 42 (1975) 440",
    parameters=(
        Parameter("stiffness", 1e4, "N/m", "stiffness of the contact", 0.0, 1e12),
        Parameter("position", 1e-3, "m", "where the contact begins; its sign is the side", -1e3,
                  1e3),
        Parameter("dissipation", 0.0, "s/m", "damping force per force of contact and speed", 0.0,
                  1e6),
    ),
    priors={"stiffness": Prior(1e3, 1e6), "position": Prior(1e-4, 1e-2),
            "dissipation": Prior(0.1, 10.0)},
    side="mechanical",
    parity="both",
    memory=False,
    shown_by="motion up to the stop and motion that does not reach it",
    optional=("dissipation",),
    refinements=("dissipation",),
    classes=(
        Equivalence(("end_stop", "one_sided_cable"), "a contact hardly stiffer than the stage",
                    "motion deep into the contact; by convention a stop is three times as stiff "
                    "as the stage"),
        Equivalence(("end_stop", "quadratic_stiffness"), "motion that hardly reaches the stop",
                    "larger motion"),
    ),
    force=force,
)
