"""Pre-sliding friction (LuGre): contacts that deflect like bristles before they slide.

    z' = x' - stiffness |x'| z / g(x')
    g  = force (1 + (breakaway_ratio - 1) exp(-(x'/stribeck_velocity)^2))
    F  = -(stiffness z + damping z')

The model's viscous term is the base parameter damping. With breakaway_ratio 1 and damping 0 it
is Dahl's model, and for stiffness towards infinity Coulomb friction.
Source: Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Autom. Control 40 (1995) 419;
Dahl, Aerospace Corp. TOR-0158 (1968).
"""


from __future__ import annotations

import math
from collections.abc import Mapping

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
    """z (m) after a motion by dx in one direction while the speed goes from v0 to v1.

    Exact where g is constant: z relaxes over the distance g / stiffness. With the Stribeck term
    the end point g / stiffness is taken to move linearly with the exponent.
    """
    if dx == 0.0:
        return z
    sign = 1.0 if dx > 0.0 else -1.0
    if p[2] == 1.0:
        end = sign * p[0] / p[1]
        return end + (z - end) * math.exp(-abs(dx) * p[1] / p[0])
    before = p[0] * (1.0 + (p[2] - 1.0) * math.exp(-(v0 / p[3]) ** 2))
    after = p[0] * (1.0 + (p[2] - 1.0) * math.exp(-(v1 / p[3]) ** 2))
    decay = abs(dx) * p[1] * 0.5 * (1.0 / before + 1.0 / after)
    lost = -math.expm1(-decay)
    first, last = sign * before / p[1], sign * after / p[1]
    return last + (z - first) * (1.0 - lost) - (last - first) * lost / decay


def bristle_force(z: float, v: float, p: Values) -> float:
    """N"""
    if p[4] == 0.0:
        return -p[1] * z
    g = p[0] * (1.0 + (p[2] - 1.0) * math.exp(-(v / p[3]) ** 2))
    return -(p[1] * z + p[4] * (v - p[1] * abs(v) * z / g))


def _forward(values: Array) -> Array:
    force, stiffness = values
    return np.array([force, force / stiffness])


def _backward(fitted: Array) -> Array:
    force, distance = fitted
    return np.array([force, force / distance])


def _as_hysteresis(friction: Mapping[str, float]) -> Parameters:
    """The loop that friction without Stribeck term and damping is (Dahl's model)."""
    return {"stiffness": friction["stiffness"], "shape": 1.0, "exponent": 1.0,
            "yield_displacement": friction["force"] / friction["stiffness"]}


class PreslidingFriction(Effect):
    """Begins at pre-sliding distances below and around the size of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Bristles that bend by a hundredth of the motion up to all of it."""
        force = SMALL * at.force
        return [{"force": force, "stiffness": force / (share * at.motion),
                 "breakaway_ratio": 1.0, "stribeck_velocity": 0.2 * at.speed, "damping": 0.0}
                for share in (0.01, 0.03, 0.1, 0.3, 1.0)]

    def without_meaning(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Those of the Stribeck term where the breakaway force is that of sliding, or fades before
        anything moves."""
        off = values["breakaway_ratio"] < NO_HIGHER or values["stribeck_velocity"] < SLOWEST
        return ("breakaway_ratio", "stribeck_velocity") if off else ()


NO_HIGHER = 1.0 + 1e-9
"""Breakaway ratio below which nothing but rounding tells the breakaway force from sliding."""
SLOWEST = 1e-8
"""Stribeck velocity (m/s) below which nothing in a record is slow enough to feel its term."""


EFFECT = PreslidingFriction(
    name="presliding_friction",
    meaning="friction whose contacts deflect elastically before they slide",
    equation="z' = x' - stiffness |x'| z / g(x');  F = -(stiffness z + damping z')",
    source="Canudas de Wit et al., IEEE Trans. Autom. Control 40 (1995) 419",
    parameters=(
        Parameter("force", 0.02, "N", "friction force in sliding", 1e-12, 1e6),
        Parameter("stiffness", 2e4, "N/m", "stiffness of the bristles", 1e-3, 1e12),
        Parameter("breakaway_ratio", 1.0, "", "breakaway over sliding force", 1.0, 10.0),
        Parameter("stribeck_velocity", 1e-3, "m/s", "speed at which the extra force fades",
                  1e-9, 1e3),
        Parameter("damping", 0.0, "N s/m", "damping of the bristles", 0.0, 1e9),
    ),
    priors={"force": Prior(1e-4, 1.0), "stiffness": Prior(1e2, 1e7),
            "breakaway_ratio": Prior(1.0, 2.0, log=False),
            "stribeck_velocity": Prior(1e-4, 1e-2), "damping": Prior(0.1, 1e3)},
    side="mechanical",
    parity="odd",
    memory=True,
    shown_by="motion smaller than and comparable with the pre-sliding distance, and reversals",
    optional=("breakaway_ratio", "stribeck_velocity", "damping"),
    classes=(
        Equivalence(("presliding_friction", "coulomb_friction"),
                    "motion far beyond the pre-sliding distance",
                    "sub-micrometre motion around rest, slow reversals"),
        Equivalence(("presliding_friction", "hysteresis"),
                    "one amplitude, breakaway_ratio near 1",
                    "several amplitudes down to the pre-sliding distance"),
        Equivalence(("presliding_friction", "stiffness"), "motion that never breaks away",
                    "motion beyond the pre-sliding distance"),
    ),
    fit=Reparametrisation((".force", ".stiffness"), (".force", ".distance"),
                          _forward, _backward),
    advance=advance,
    bristle_force=bristle_force,
    size=("force", "stiffness", "damping"),
    distance="distance",
    freed_last={"breakaway_ratio": 1.1, "stribeck_velocity": None, "damping": None},
    twins={"hysteresis": _as_hysteresis},
)
