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
from collections.abc import Sequence

import numpy as np

from dfm_stage.model.effect import Array, Conditions, Effect, Parameter, Parameters, Prior, Values


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Rows 0, 1 and 3 are position, velocity and force input."""
    share, w = p[0], 2.0 * math.pi * p[1]
    a[first, first + 1] = 1.0
    a[first + 1, first] = -w * w
    a[first + 1, first + 1] = -2.0 * p[2] * w
    rows[0, 0] = rows[1, 1] = 1.0 - share
    rows[0, first] = rows[1, first + 1] = share
    rows[3, first + 1] = rows[3, 1]


class SecondMode(Effect):
    """Looked for on a dense grid of frequencies, and sharp at the residual's own lines."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A grid is coarser than a sharp resonance, hence the lines of the residual as well."""
        grid = np.geomspace(max(0.5, 4.0 / at.duration), 0.45 / at.sample_period, 60)
        tried = [(f, zeta) for f in grid for zeta in (0.01, 0.04)]
        tried += [(f, zeta) for f in at.frequencies for zeta in (0.003, 0.01)]
        return [{"share": SMALL_SHARE, "frequency": float(f), "damping_ratio": zeta}
                for f, zeta in tried]

    def combined(self, directions: Sequence[Parameters], multiples: Array) -> Parameters:
        """Beyond half of the motion the response is not nearly linear in the share."""
        found = super().combined(directions, multiples)
        return {**found, "share": min(max(found["share"], -LARGEST_SHARE), LARGEST_SHARE)}

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Beyond MOST_DAMPED there is no resonance, but creep or a lag."""
        return -math.inf, MOST_DAMPED if parameter == "damping_ratio" else math.inf


SMALL_SHARE, LARGEST_SHARE = 1e-4, 0.5
"""Share that is small, and the largest from which a search begins."""
MOST_DAMPED = 0.5
"""Damping ratio up to which a mode is a resonance."""


EFFECT = SecondMode(
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
