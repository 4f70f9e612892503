"""Gravity of a pendulum: the weight pulls back with the sine of the angle.

    F = -weight sin(x/length + tilt)

x is the way along the arc. At small angles it is a spring of weight/length that softens with the
cube of the angle.
Source: Nayfeh and Mook, Nonlinear Oscillations (1979), sec. 2.1.
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


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * math.sin(x / p[1] + p[2])


def _forward(values: Array) -> Array:
    k, weight, length = values
    return np.array([k + weight / length, weight / length**3, length])


def _backward(fitted: Array) -> Array:
    total, softening, length = fitted
    return np.array([total - softening * length**2, softening * length**3, length])


def _of_stiffness(stiffness: float, values: Mapping[str, float]) -> Parameters:
    return {"weight": stiffness * values["length"]}


class Gravity(Effect):
    """Begins at lengths of the size of the travel; at the angle itself where that is measured."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Swings of one and a half radians to four."""
        low, high = self.search_range("length", at)
        lengths = [share * at.travel for share in (0.12, 0.2, 0.35)]
        if at.angular and low < 1.0 < high:
            lengths.append(1.0)
        return [{"weight": SMALL * at.force, "length": length, "tilt": 0.0}
                for length in sorted(lengths)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """A longer pendulum is a softening cubic spring; a shorter one turns over and over."""
        if parameter != "length":
            return -math.inf, math.inf
        return SHORTEST * at.travel, LONGEST * at.travel


SHORTEST = 0.25 / math.pi
"""Length over the travel: two turns over the travel."""
LONGEST = 0.5
"""Length over the travel beyond which the swing is less than a radian to either side: a softening
spring of third order."""


EFFECT = Gravity(
    name="gravity",
    meaning="a weight swings: it pulls back with the sine of the angle",
    equation="F = -weight sin(x/length + tilt)",
    source="Nayfeh and Mook, Nonlinear Oscillations (1979), sec. 2.1",
    parameters=(
        Parameter("weight", 0.0, "N", "weight", 0.0, 1e9),
        Parameter("length", 1.0, "m", "length of the pendulum, per radian of its angle", 1e-9,
                  1e6),
        Parameter("tilt", 0.0, "rad", "angle at x = 0", -10.0, 10.0),
    ),
    priors={"weight": Prior(1e-2, 1e2), "length": Prior(1e-3, 1.0),
            "tilt": Prior(-0.3, 0.3, log=False)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="swings of more than a radian, at several amplitudes",
    optional=("tilt",),
    refinements=("tilt",),
    classes=(
        Equivalence(("gravity", "cubic_stiffness"), "swings of less than a radian",
                    "larger swings"),
        Equivalence(("gravity", "cogging"), "less than two turns: both are a sine",
                    "more turns"),
        Equivalence(("gravity", "stiffness"), "swings of a few degrees", "larger swings"),
    ),
    fit=Reparametrisation(("stiffness", ".weight", ".length"),
                          (".total_stiffness", ".softening", ".length"), _forward, _backward),
    replaces=("stiffness", _of_stiffness),
    force=force,
)
