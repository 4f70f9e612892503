"""Absorber: a small mass on a spring and a damper rides on the stage.

    F = stiffness ((z - x) + 2 damping_ratio / w (z' - x')),      w = 2 pi frequency
    z'' = -w^2 (z - x) - 2 damping_ratio w (z' - x')

The mass that rides is stiffness / w^2.
Source: Den Hartog, Mechanical Vibrations (1956), ch. 3.
"""

from __future__ import annotations

import math

from dfm_stage.arrays import Array
from dfm_stage.model.effect import Effect, Prior, Values
from dfm_stage.model.parameter import Parameter


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Rows 0, 1 and 3 are position, velocity and force input."""
    w, n = 2.0 * math.pi * p[1], a.shape[0]
    spring, damper = w * w, 2.0 * p[2] * w
    for j in range(n):
        a[first + 1, j] += spring * rows[0, j] + damper * rows[1, j]
    a[first, first + 1] += 1.0
    a[first + 1, first] -= spring
    a[first + 1, first + 1] -= damper
    for i in range(n):
        for j in range(n):
            a[i, j] -= rows[3, i] * p[0] * (rows[0, j] + damper / spring * rows[1, j])
        a[i, first] += rows[3, i] * p[0]
        a[i, first + 1] += rows[3, i] * p[0] * damper / spring


EFFECT = Effect(
    name="absorber",
    meaning="a small mass rides on the stage",
    equation="z'' = -w^2 (z - x) - 2 zeta w (z' - x');  F = -(stiffness / w^2) z''",
    source="Den Hartog, Mechanical Vibrations (1956), ch. 3",
    parameters=(Parameter("stiffness", 0.0, "N/m", "of its spring", 0.0, 1e9),
                Parameter("frequency", 20.0, "Hz", "of the mass on its spring", 0.1, 1e4),
                Parameter("damping_ratio", 0.1, "", "of the mass on its spring", 1e-4, 10.0)),
    priors={"stiffness": Prior(1.0, 1e4), "frequency": Prior(5.0, 80.0),
            "damping_ratio": Prior(0.02, 0.5)},
    side="mechanical",
    parity="linear",
    memory=True,
    shown_by="frequencies around its own",
    states=(".position", ".velocity"),
    stamp=stamp,
)
