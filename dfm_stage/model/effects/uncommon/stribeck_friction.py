"""Stribeck friction: dry friction that falls from a breakaway to a sliding force.

    F = -force (ratio + (1 - ratio) exp(-(|x'| / stribeck_velocity) ^ exponent)) sgn(x')  moving
    F = -(all other forces)                at rest, as long as |F| <= force

Viscous friction is the base parameter damping. The simulator locates each reversal and breakaway
inside the sample. A ratio of one is Coulomb friction.
Source: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994) 1083, sec. 2; Bo and
Pavelescu, Wear 82 (1982) 277.
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
    speed = abs(v) / p[2]
    fallen = speed * speed if p[3] == 2.0 else speed**p[3]
    return p[0] * (p[1] + (1.0 - p[1]) * math.exp(-fallen))


class StribeckFriction(Effect):
    """Begins at Stribeck velocities below the speed of the record."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small force that falls to half."""
        return [{"force": SMALL * at.force, "sliding_ratio": 0.5, "exponent": 2.0,
                 "stribeck_velocity": share * at.speed} for share in (0.05, 0.2, 0.6, 1.5)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """With a slighter fall, or a fall beyond all speeds, it is Coulomb friction; one that is
        over before the stage moves cannot be seen."""
        return {"sliding_ratio": (-math.inf, LEAST_FALL),
                "stribeck_velocity": (SLOWEST * at.speed, FASTEST * at.speed)}.get(
                    parameter, (-math.inf, math.inf))


LEAST_FALL = 0.95
"""Ratio of the forces above which it is Coulomb friction."""
SLOWEST, FASTEST = 0.01, 5.0
"""Stribeck velocities that show, over the RMS speed."""


EFFECT = StribeckFriction(
    name="stribeck_friction",
    meaning="dry friction that falls as the stage gets faster",
    equation="F = -force (ratio + (1 - ratio) exp(-(|x'| / stribeck_velocity) ^ exponent)) sgn(x')"
    "; at rest any |F| <= force that keeps it there",
    source="Armstrong-Helouvry et al., Automatica 30 (1994) 1083, sec. 2",
    parameters=(
        Parameter("force", 0.0, "N", "breakaway force", 0.0, 1e6),
        Parameter("sliding_ratio", 0.6, "", "sliding over breakaway force", 0.0, 1.0),
        Parameter("stribeck_velocity", 1e-3, "m/s", "speed over which the force falls", 1e-9,
                  1e3),
        Parameter("exponent", 2.0, "", "shape of the fall", 0.2, 4.0),
    ),
    priors={"force": Prior(1e-4, 1.0), "sliding_ratio": Prior(0.3, 0.9, log=False),
            "stribeck_velocity": Prior(1e-4, 1e-1), "exponent": Prior(0.5, 2.5, log=False)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="speeds below and above the Stribeck velocity, and reversals",
    optional=("exponent",),
    refinements=("exponent",),
    classes=(
        Equivalence(("stribeck_friction", "coulomb_friction"),
                    "speeds far above stribeck_velocity, or far below",
                    "speeds around stribeck_velocity"),
        Equivalence(("stribeck_friction", "presliding_friction"),
                    "motion far beyond the pre-sliding distance",
                    "sub-micrometre motion around rest, slow reversals"),
    ),
    friction=friction,
)
