"""Creep: part of the stiffness relaxes slowly (a Maxwell element beside the spring).

    F = -stiffness (x - z),        time_constant z' = x - z

Right after a step the stage has the base stiffness plus this one; after several time constants
the base stiffness alone.
Source: Flugge, Viscoelasticity (1975), ch. 1 (standard linear solid); Jung and Gweon, Rev. Sci.
Instrum. 71 (2000) 1896 for creep in positioning stages.
"""

from __future__ import annotations

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


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 0 is the position, row 3 the force input."""
    n = a.shape[0]
    for j in range(n):
        a[first, j] = rows[0, j] / p[1]
    a[first, first] -= 1.0 / p[1]
    for i in range(n):
        for j in range(n):
            a[i, j] -= rows[3, i] * p[0] * rows[0, j]
        a[i, first] += rows[3, i] * p[0]


def _forward(values: Array) -> Array:
    k, stiffness, time_constant = values
    return np.array([k + stiffness, stiffness / time_constant, time_constant])


def _backward(fitted: Array) -> Array:
    total, rate, time_constant = fitted
    return np.array([total - rate * time_constant, rate * time_constant, time_constant])


class Creep(Effect):
    """Begins at time constants from some samples to twice the record."""

    def hidden_because(self, at: Conditions) -> str | None:
        """It is a part of a stiffness: of a body without one it would be the spring itself."""
        return None if at.base.get("stiffness", 0.0) else "base has no stiffness that could relax"

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small part of the stiffness, at time constants over decades."""
        return [{"stiffness": 0.1 * SMALL * at.stiffness, "time_constant": float(tau)}
                for tau in np.geomspace(0.02, 2.0 * at.duration, 12)]


EFFECT = Creep(
    name="creep",
    meaning="the stage goes on moving slowly after a step: part of the stiffness relaxes",
    equation="F = -stiffness (x - z);  time_constant z' = x - z",
    source="Flugge, Viscoelasticity (1975), ch. 1",
    parameters=(
        Parameter("stiffness", 0.0, "N/m", "stiffness that relaxes", 0.0, 1e12),
        Parameter("time_constant", 1.0, "s", "time of relaxation", 1e-6, 1e9),
    ),
    priors={"stiffness": Prior(0.1, 1e3), "time_constant": Prior(0.05, 1e3)},
    side="mechanical",
    parity="linear",
    memory=True,
    shown_by="steps held for several time constants, or frequencies down to 1 / time_constant",
    classes=(
        Equivalence(("creep", "stiffness"), "frequencies far above 1 / time_constant",
                    "a step held for a long time"),
        Equivalence(("creep", "damping"), "time_constant far below the period of the motion",
                    "higher frequencies"),
        Equivalence(("creep", "thermal_drift"), "one step only", "steps in both directions"),
    ),
    fit=Reparametrisation(("stiffness", ".stiffness", ".time_constant"),
                          (".unrelaxed_stiffness", ".rate", ".time_constant"),
                          _forward, _backward),
    states=(".",),
    stamp=stamp,
)
