"""Second vibration mode, in parallel with the first.

    q1'' + (damping/mass) q1' + (stiffness/mass) q1 = F / mass
    q2'' + 2 zeta w q2' + w^2 q2                    = F / mass,     w = 2 pi frequency
    x = (1 - share) q1 + share q2

`share` is the second mode's part of the sum of modal residues, so that x/F = (1/mass) *
[(1 - share)/(s^2 + ...) + share/(s^2 + ...)] and mass stays the mass that is felt at high
frequency. F is the sum of all forces at the driven point, those of nonlinear effects included:
sensor, actuator and nonlinear forces are taken at one point, so a share between 0 and 1 is
passive. A negative share is a mode that moves the sensor against the actuator.
Source: Gawronski, Advanced Structural Dynamics and Active Control of Structures (2004), sec. 2.2;
Preumont, Vibration Control of Active Structures (2011), ch. 2.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.effect import Effect, Prior, Values
from dfm_stage.model.parameter import Parameter

Array = NDArray[np.float64]


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Rows 0, 1 and 3 are position, velocity and force input."""
    share, w = p[0], 2.0 * math.pi * p[1]
    a[first, first + 1] = 1.0
    a[first + 1, first] = -w * w
    a[first + 1, first + 1] = -2.0 * p[2] * w
    rows[0, 0] = rows[1, 1] = 1.0 - share
    rows[0, first] = rows[1, first + 1] = share
    rows[3, first + 1] = rows[3, 1]


EFFECT = Effect(
    name="second_mode",
    meaning="a second resonance of the structure that actuator and encoder take part in",
    equation="x = (1 - share) q1 + share q2;  q2'' + 2 zeta w q2' + w^2 q2 = F/mass",
    source="Gawronski, Advanced Structural Dynamics (2004), sec. 2.2",
    parameters=(
        Parameter("share", 0.05, "", "part of the sum of modal residues", -10.0, 0.999),
        Parameter("frequency", 20.0, "Hz", "undamped frequency of the mode", 1e-3, 1e6),
        Parameter("damping_ratio", 0.01, "", "damping ratio of the mode", 0.0, 10.0),
    ),
    priors={"share": Prior(1e-4, 0.5), "frequency": Prior(1.0, 400.0),
            "damping_ratio": Prior(1e-3, 0.2)},
    side="mechanical",
    parity="linear",
    memory=False,
    shown_by="a multisine or chirp across the mode's frequency",
    states=(".position", ".velocity"),
    stage="modes",
    stamp=stamp,
)
