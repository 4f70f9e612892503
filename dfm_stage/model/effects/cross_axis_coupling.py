"""Cross-axis coupling: the neighbouring axis is seen in this one.

    y = x + ratio other                 misaligned scale or guide
    F = -stiffness other                off-diagonal element of the stiffness matrix

Quasi-statically a stiffness s does what a ratio of -s / (stiffness of the axis) does; above the
resonance only the ratio remains.
Source: Awtar, Synthesis and Analysis of Parallel Kinematic XY Flexure Mechanisms (2004), ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dfm_stage.model.effect import (
    SMALL,
    Array,
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
    return p[0] * other


def other_force(p: Values) -> float:
    """N/m"""
    return -p[1]


class CrossAxisCoupling(Effect):
    """Has two sizes, of the reading and of the force, that are told apart by frequency."""

    def hidden_because(self, at: Conditions) -> str | None:
        """It needs the neighbour's position."""
        return None if all(r.other is not None for r in at.runs) else \
            "the neighbouring axis was not recorded"

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small part of the motion."""
        other = max(float(np.std(r.other)) for r in at.runs if r.other is not None)
        return [{"ratio": SMALL * at.motion / max(other, 1e-12), "stiffness": 0.0}]

    def directions(self, parameters: Parameters, at: Conditions) -> list[Parameters]:
        """Each size alone."""
        return [parameters, {"ratio": 0.0, "stiffness": SMALL * at.stiffness}]

    def combined(self, directions: Sequence[Parameters], multiples: Array) -> Parameters:
        """The sum of both."""
        if multiples.size == 1:
            return super().combined(directions, multiples)
        return {n: sum(float(m) * d[n] for m, d in zip(multiples, directions, strict=True))
                for n in directions[0]}


EFFECT = CrossAxisCoupling(
    name="cross_axis_coupling",
    meaning="motion of the neighbouring axis shows up in this one",
    equation="y = x + ratio other;  F = -stiffness other",
    source="Awtar, Parallel Kinematic XY Flexure Mechanisms (2004), ch. 2",
    parameters=(
        Parameter("ratio", 0.0, "", "metres read per metre of the other axis", -10.0, 10.0),
        Parameter("stiffness", 0.0, "N/m", "off-diagonal stiffness", -1e12, 1e12),
    ),
    priors={"ratio": Prior(-0.05, 0.05, log=False), "stiffness": Prior(-50.0, 50.0, log=False)},
    side="sensor",
    parity="linear",
    memory=False,
    shown_by="motion of the other axis, not correlated with this one's",
    optional=("stiffness",),
    size=("ratio", "stiffness"),
    classes=(Equivalence(("cross_axis_coupling", "second_mode"),
                         "the other axis not recorded",
                         "a record of both axes with one driven at a time"),),
    sense=sense,
    other_force=other_force,
)
