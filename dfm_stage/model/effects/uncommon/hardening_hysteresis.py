"""Hardening hysteresis: a Bouc-Wen loop that gets stiffer along the path and never saturates.

    w' = (x'/distance) (1 + |w| (1 + shape - shape sgn(x' w)))
    F  = -stiffness distance w

On the way out the slope is 1 + |w|, on the way back 1 + (1 + 2 shape) |w|: with a shape above zero
a loop is open and loses energy. In Bouc and Wen's words this is gamma + delta < 0 with an exponent
of one; the effect `hysteresis` has gamma + delta > 0. It is rate-independent, so w is a function
of the path, in closed form.
Source: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; Ikhouane, Manosa and Rodellar, Automatica 43
(2007) 1; Noel and Schoukens, Hysteretic benchmark with a dynamic nonlinearity (2016).
"""

from __future__ import annotations

import math

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
    Reparametrisation,
    Values,
)


def advance(z: float, dx: float, v0: float, v1: float, p: Values) -> float:
    """w after a motion by dx in one direction, exact; far out it grows exponentially."""
    sign = 1.0 if dx > 0.0 else -1.0
    w, path, steep = sign * z, abs(dx) / p[1], 1.0 + 2.0 * p[2]
    if w < 0.0:
        to_zero = math.log1p(-steep * w) / steep
        if path <= to_zero:
            shrunk = math.expm1(-steep * path)
            return sign * (w + (w - 1.0 / steep) * shrunk)
        path -= to_zero
        w = 0.0
    return sign * (w + (1.0 + w) * math.expm1(path))


def bristle_force(z: float, v: float, p: Values) -> float:
    """N"""
    return -p[0] * p[1] * z


def _forward(values: Array) -> Array:
    k, stiffness, distance = values
    return np.array([k + stiffness, stiffness / distance, distance])


def _backward(fitted: Array) -> Array:
    total, growth, distance = fitted
    return np.array([total - growth * distance, growth * distance, distance])


class HardeningHysteresis(Effect):
    """Begins at distances around the size of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Loops that harden much and little over the motion."""
        return [{"stiffness": SMALL * at.force / at.motion, "distance": share * at.motion,
                 "shape": 1.5} for share in (0.7, 1.5, 4.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Over a longer distance nothing hardens; over a part of the motion it grows without
        bounds."""
        return {"distance": (SHORTEST * at.motion, LONGEST * at.travel),
                "shape": (-math.inf, ROUNDEST)}.get(parameter, (-math.inf, math.inf))


SHORTEST, LONGEST = 0.1, 5.0
"""Distances over the RMS motion, and over the travel."""
ROUNDEST = 50.0
"""Shape beyond which only the way back bends."""


EFFECT = HardeningHysteresis(
    name="hardening_hysteresis",
    meaning="the restoring force depends on the path and hardens along it",
    equation="w' = (x'/distance) (1 + |w| (1 + shape - shape sgn(x' w)));  "
    "F = -stiffness distance w",
    source="Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; Ikhouane et al., Automatica 43 (2007) 1",
    parameters=(
        Parameter("stiffness", 50.0, "N/m", "stiffness of the loop at w = 0", 0.0, 1e12),
        Parameter("distance", 1e-3, "m", "distance over which the loop hardens", 1e-12, 1e3),
        Parameter("shape", 1.0, "", "0: no loss; above: the loop opens", 0.0, 1e3),
    ),
    priors={"stiffness": Prior(0.1, 1e4), "distance": Prior(1e-2, 1.0),
            "shape": Prior(0.5, 5.0)},
    side="mechanical",
    parity="odd",
    memory=True,
    shown_by="slow loops at several amplitudes",
    optional=("shape",),
    classes=(
        Equivalence(("hardening_hysteresis", "hysteresis"), "motion far below distance",
                    "motion up to distance: one loop hardens, the other saturates"),
        Equivalence(("hardening_hysteresis", "stiffness"), "motion far below distance",
                    "motion up to distance"),
    ),
    fit=Reparametrisation(("stiffness", ".stiffness", ".distance"),
                          (".total_stiffness", ".growth", ".distance"), _forward, _backward),
    advance=advance,
    bristle_force=bristle_force,
)
