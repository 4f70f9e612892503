"""Load-dependent friction: dry friction that grows with the force that the actuator transmits.

    F = -force (1 + |actuator|/load) sgn(x')  moving; at rest any |F| up to that

`force` is the friction without load, and `load` the actuator's force at which it has doubled. The
simulator locates each reversal and breakaway inside the sample. With a load far beyond the
actuator's forces it is Coulomb friction.
Source: Dohring, Lee and Newman, IEEE Int. Conf. Robotics and Automation (1993) 555; Hamon, Gautier
and Garrec, IEEE/RSJ Int. Conf. Intelligent Robots and Systems (2010) 6187.
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


def friction(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return p[0] * (1.0 + abs(actuator) / p[1])


def _forward(values: Array) -> Array:
    friction, load = values
    return np.array([friction / load, load])


def _backward(fitted: Array) -> Array:
    coefficient, load = fitted
    return np.array([coefficient * load, load])


class LoadDependentFriction(Effect):
    """Begins at loads of the size of the actuator's force."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small force."""
        return [{"force": SMALL * at.force, "load": share * at.force}
                for share in (0.03, 0.3, 1.0, 3.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """With a larger load the friction is always the same."""
        return -math.inf, LARGEST * at.force if parameter == "load" else math.inf


LARGEST = 20.0
"""Load over the actuator's RMS force beyond which its peaks change the friction by less than a
tenth or so."""


EFFECT = LoadDependentFriction(
    name="load_dependent_friction",
    meaning="dry friction that grows with the actuator's force",
    equation="F = -force (1 + |actuator|/load) sgn(x'); at rest any |F| up to that",
    source="Dohring et al., IEEE Int. Conf. Robotics and Automation (1993) 555",
    parameters=(
        Parameter("force", 0.0, "N", "friction without load", 0.0, 1e6),
        Parameter("load", 1.0, "N", "actuator's force at which it has doubled", 1e-9, 1e9),
    ),
    priors={"force": Prior(1e-4, 1.0), "load": Prior(1e-2, 10.0)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="large and small forces of the actuator at like speeds",
    classes=(
        Equivalence(("load_dependent_friction", "coulomb_friction"), "forces much smaller than "
                    "load", "larger forces of the actuator"),
        Equivalence(("load_dependent_friction", "position_dependent_friction"), "motion well "
                    "below the resonance, where the force follows the position",
                    "motion around the resonance"),
    ),
    fit=Reparametrisation((".force", ".load"), (".coefficient", ".load"), _forward, _backward),
    friction=friction,
)
