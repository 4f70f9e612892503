"""Hysteresis (Bouc-Wen, normalised): a loop between force and position that needs no speed.

    w' = (x'/yield_displacement) (1 - |w|^exponent (shape sgn(x' w) + 1 - shape))
    F  = -stiffness yield_displacement w

|w| <= 1. For small motion it is a spring of `stiffness`, for large motion a constant force. It is
rate-independent, so w is a function of the path, and the simulator moves it along the path.
Source: Bouc (1967); Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249; normalised form of Ikhouane and
Rodellar, Systems with Hysteresis (2007), ch. 2.
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

LONGEST = 0.05
"""Step along the path, in yield displacements; where the path is steep, in yields gained."""
NEAR_END = 1e-3
"""Distance from saturation within which the path is a closed form, good to its cube."""


def advance(z: float, dx: float, v0: float, v1: float, p: Values) -> float:
    """w after a motion by dx in one direction; exact for the exponents 1 and 2.

    Of other exponents by Taylor series of the fourth order, one power a step, by Runge-Kutta near
    w = 0, where they are not smooth, and in closed form next to saturation. A state that is not
    finite any more ends in NaN.
    """
    if dx == 0.0:
        return z
    sign = 1.0 if dx > 0.0 else -1.0
    w, path = sign * z, abs(dx) / p[1]
    bend = 2.0 * p[2] - 1.0
    if p[3] == 1.0:
        if w < 0.0:
            to_zero = -w if bend < 1e-9 else math.log1p(-bend * w) / bend
            if path < to_zero:
                if bend >= 1e-9:
                    grown = math.exp(-bend * path)
                    return sign * (w * grown + (1.0 - grown) / bend)
                return sign * (w + path)
            path -= to_zero
            w = 0.0
        return sign * (1.0 + (w - 1.0) * math.exp(-path))
    if p[3] == 2.0:
        if w < 0.0:
            root = math.sqrt(bend)
            to_zero = -w if root < 1e-5 else math.atan(-root * w) / root
            if path < to_zero:
                if root < 1e-5:
                    return sign * (w + path)
                return sign * math.tan(root * (path - to_zero)) / root
            path -= to_zero
            w = 0.0
        gained = math.tanh(path)
        return sign * (w + gained) / (1.0 + w * gained)
    while path > 0.0:
        if not w <= 1.0 - NEAR_END:
            bent = 0.5 * (p[3] - 1.0)
            left = (1.0 - w) / (1.0 - bent * (1.0 - w)) * math.exp(-p[3] * path)
            return sign * (1.0 - left / (1.0 + bent * left))
        step = min(path, LONGEST if w > 0.0 or bend < 1.0 else LONGEST / bend)
        path -= step
        a = 1.0 - abs(w)**p[3] if w > 0.0 else 1.0 + bend * abs(w)**p[3]
        if abs(w) > 4.0 * p[3] * step:
            d1 = p[3] * (a - 1.0) / w
            d2 = (p[3] - 1.0) * d1 / w
            d3 = (p[3] - 2.0) * d2 / w
            b = d1 * a
            c = d2 * a * a + d1 * b
            d = d3 * a**3 + 4.0 * d2 * a * b + d1 * d1 * b
            w += step * (a + step / 2.0 * (b + step / 3.0 * (c + step / 4.0 * d)))
            continue
        y = w + 0.5 * step * a
        b = 1.0 - abs(y)**p[3] if y > 0.0 else 1.0 + bend * abs(y)**p[3]
        y = w + 0.5 * step * b
        c = 1.0 - abs(y)**p[3] if y > 0.0 else 1.0 + bend * abs(y)**p[3]
        y = w + step * c
        d = 1.0 - abs(y)**p[3] if y > 0.0 else 1.0 + bend * abs(y)**p[3]
        w += step / 6.0 * (a + 2.0 * (b + c) + d)
    return sign * w


def bristle_force(z: float, v: float, p: Values) -> float:
    """N"""
    return -p[0] * p[1] * z


def _forward(values: Array) -> Array:
    stiffness, distance = values
    return np.array([stiffness * distance, distance])


def _backward(fitted: Array) -> Array:
    force, distance = fitted
    return np.array([force / distance, distance])


def _as_friction(loop: Mapping[str, float]) -> Parameters:
    """Dahl's friction, which the loop of shape 1 and exponent 1 is: F' = k (x' - |x'| F / F0)."""
    return {"force": loop["stiffness"] * loop["yield_displacement"],
            "stiffness": loop["stiffness"]}


class Hysteresis(Effect):
    """Begins at yield displacements around the size of the motion."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Loops that saturate early and late in the motion."""
        return [{"stiffness": SMALL * at.force / (share * at.motion),
                 "yield_displacement": share * at.motion, "shape": 0.6, "exponent": 1.0}
                for share in (0.05, 0.15, 0.5, 1.5)]


EFFECT = Hysteresis(
    name="hysteresis",
    meaning="the restoring force depends on the path: a loop that survives at zero speed",
    equation="w' = (x'/yield) (1 - |w|^n (shape sgn(x' w) + 1 - shape));  F = -stiffness yield w",
    source="Ikhouane and Rodellar, Systems with Hysteresis (2007), ch. 2",
    parameters=(
        Parameter("stiffness", 50.0, "N/m", "stiffness of the loop at a reversal", 0.0, 1e12),
        Parameter("yield_displacement", 1e-4, "m", "distance over which the loop saturates",
                  1e-12, 1e3),
        Parameter("shape", 0.5, "", "0.5: straight unloading; above: slimmer", 0.5, 5.0),
        Parameter("exponent", 1.0, "", "sharpness of the knee", 1.0, 20.0),
    ),
    priors={"stiffness": Prior(0.1, 1e4), "yield_displacement": Prior(1e-6, 1e-2),
            "shape": Prior(0.5, 1.0, log=False), "exponent": Prior(1.0, 3.0, log=False)},
    side="mechanical",
    parity="odd",
    memory=True,
    shown_by="slow loops at several amplitudes",
    optional=("shape", "exponent"),
    classes=(
        Equivalence(("hysteresis", "presliding_friction"),
                    "one amplitude, exponent 1, no Stribeck term",
                    "several amplitudes; a large one shows whether the loop's width saturates"),
        Equivalence(("hysteresis", "stiffness"), "motion far below yield_displacement",
                    "motion beyond yield_displacement"),
    ),
    fit=Reparametrisation((".stiffness", ".yield_displacement"),
                          (".force", ".yield_displacement"),
                          _forward, _backward),
    advance=advance,
    bristle_force=bristle_force,
    distance="yield_displacement",
    freed_last={"exponent": 1.2},
    twins={"presliding_friction": _as_friction},
)
