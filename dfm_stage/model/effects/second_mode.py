"""Second vibration mode, in parallel with the first.

    q1'' + (damping/mass) q1' + (stiffness/mass) q1 = F / mass
    q2'' + 2 zeta w q2' + w^2 q2                    = F / mass,     w = 2 pi frequency
    x = (1 - share) q1 + share q2

`share` is the second mode's part of the sum of modal residues, so that x/F = (1/mass) *
[(1 - share)/(s^2 + ...) + share/(s^2 + ...)] and mass stays the mass that is felt at high
frequency. F is the sum of all forces at the driven point, those of nonlinear effects included:
sensor, actuator and nonlinear forces are taken at one point, so a share between 0 and 1 is
passive. A negative share is a mode that moves the sensor against the actuator; far below
zero the residues cancel: the sensor is on a second mass, and the force on the first.

Where the damping is not proportional (a dashpot between two masses), the modes are complex: the
points of a mode do not move in step, and the residues get a velocity term, t = share tan(phase)/w,

    x = (1 - share - t d) q1 + t q1' + share q2 - t q2',    d = 2 zeta w - damping/mass

so that x/F = (1/mass) [(1 - share - t d + t s)/(s^2 + ...) + (share - t s)/(s^2 + ...)], where t d
keeps the mass that is felt at high frequency. With the phase the sum of two modes is exact for
any two masses, springs and dashpots.
Source: Gawronski, Advanced Structural Dynamics and Active Control of Structures (2004), sec. 2.2;
Preumont, Vibration Control of Active Structures (2011), ch. 2; complex modes: Ewins, Modal
Testing (2000), ch. 2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dfm_stage.model.effect import (
    Array,
    Conditions,
    Effect,
    Parameter,
    Parameters,
    Prior,
    Reparametrisation,
    Values,
)


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Rows 0, 1 and 3 are position, velocity and force input."""
    share, w = p[0], 2.0 * math.pi * p[1]
    stiffness, damping, t = w * w, 2.0 * p[2] * w, share * math.tan(p[3]) / w
    a[first, first + 1] = 1.0
    a[first + 1, first], a[first + 1, first + 1] = -stiffness, -damping
    rows[0, 0], rows[0, 1] = 1.0 - share - t * (damping + a[1, 1]), t
    rows[0, first], rows[0, first + 1] = share, -t
    rows[1, 0], rows[1, 1] = t * a[1, 0], 1.0 - share - t * damping
    rows[1, first], rows[1, first + 1] = t * stiffness, share + t * damping
    rows[3, first + 1] = rows[3, 1]


def _forward(values: Array) -> Array:
    gain, share = values
    return np.array([gain * (1.0 - share), share / (1.0 - share)])


def _backward(fitted: Array) -> Array:
    first, ratio = fitted
    ratio = max(ratio, LEAST_RATIO)
    return np.array([first * (1.0 + ratio), ratio / (1.0 + ratio)])


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
        """Beyond half of the motion it is not nearly linear in the share."""
        found = super().combined(directions, multiples)
        return {**found, "share": min(max(found["share"], -LARGEST_SHARE), LARGEST_SHARE)}

    def is_linear(self, values: Mapping[str, float]) -> bool:
        """Whether it is of a smaller part than half."""
        return abs(values["share"]) < LARGEST_SHARE

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Beyond MOST_DAMPED there is no resonance, but creep or a lag; with MOST_SHARE there is
        no first mode."""
        return (LEAST_RATIO if parameter == "residue_ratio" else -math.inf,
                {"damping_ratio": MOST_DAMPED, "share": MOST_SHARE}.get(parameter, math.inf))


LEAST_SHARE = -1e6
"""Share at which the residues add up to a millionth of each: none, as far as a record shows."""
LEAST_RATIO = LEAST_SHARE / (1.0 - LEAST_SHARE)
SMALL_SHARE, LARGEST_SHARE = 1e-4, 0.5
"""Share that is small, and the largest in which the response is nearly linear."""
MOST_SHARE = 0.999
"""Share up to which the other mode, the base's own, takes part."""
MOST_DAMPED = 0.5
"""Damping ratio up to which a mode is a resonance."""


def _as_mount(values: Mapping[str, float]) -> Parameters:
    """The mount of a sensor that acts back on nothing: a mode with a share far below zero."""
    return {n: values[n] for n in ("frequency", "damping_ratio")}


EFFECT = SecondMode(
    name="second_mode",
    meaning="a second resonance of the structure that actuator and encoder take part in",
    equation="x = (1 - share - t d) q1 + t q1' + share q2 - t q2';  "
    "q2'' + 2 zeta w q2' + w^2 q2 = F/mass;  t = share tan(phase)/w, d = 2 zeta w - damping/mass",
    source="Gawronski, Advanced Structural Dynamics (2004), sec. 2.2; "
    "Ewins, Modal Testing (2000), ch. 2",
    parameters=(
        Parameter("share", 0.05, "", "part of the sum of modal residues", LEAST_SHARE, MOST_SHARE),
        Parameter("frequency", 20.0, "Hz", "undamped frequency of the mode", 1e-3, 1e6),
        Parameter("damping_ratio", 0.01, "", "damping ratio of the mode", 0.0, 10.0),
        Parameter("phase", 0.0, "rad", "by which the mode is out of step at the sensor; "
                  "0: proportional damping", -1.5, 1.5),
    ),
    priors={"share": Prior(1e-4, 0.5), "frequency": Prior(1.0, 400.0),
            "damping_ratio": Prior(1e-3, 0.2), "phase": Prior(-0.5, 0.5, log=False)},
    side="mechanical",
    parity="linear",
    memory=False,
    shown_by="a multisine or chirp across the mode's frequency; a ring-down, but for the share",
    optional=("phase",),
    refinements=("phase",),
    by_input=("share", "phase"),
    states=(".position", ".velocity"),
    stage="modes",
    fit=Reparametrisation(("force_constant", ".share"), (".first_residue", ".residue_ratio"),
                          _forward, _backward),
    twins={"sensor_mount": _as_mount},
    stamp=stamp,
)
