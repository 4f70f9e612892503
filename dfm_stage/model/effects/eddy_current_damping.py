"""Eddy-current braking: damping that fades above a critical speed.

    F = -damping x' / (1 + (x' / critical_velocity)^2)

Viscous far below the critical speed, where the field of the eddy currents is small; the force is
largest, damping critical_velocity / 2, at the critical speed.
Source: Wouterse, IEE Proc. B 138 (1991) 153; Smythe, Trans. AIEE 61 (1942) 681.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from dfm_stage.model.effect import (
    SMALL,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    ratio = v / p[1]
    return -p[0] * v / (1.0 + ratio * ratio)


def _as_friction(brake: Mapping[str, float]) -> Parameters:
    """The friction that falls from the largest force of the brake to a part 1 / e at the same
    speed: there 2 r / (1 + r^2) = 1 / e, r the ratio to the critical speed."""
    return {"force": 0.5 * brake["damping"] * brake["critical_velocity"], "sliding_ratio": 0.0,
            "stribeck_velocity": brake["critical_velocity"] * (
                math.e + math.sqrt(math.e**2 - 1.0))}


SLOWEST_BRAKE = 0.1
"""m/s. After Wouterse, the critical speed is 2 resistivity / (mu_0 thickness) sqrt(gap / pole).
That is 0.17 m/s for 50 mm of copper and a gap of a tenth of the pole, more for thinner plates."""


def _doubt(values: Mapping[str, float]) -> str | None:
    """A critical speed that takes more metal than a stage has room for."""
    if values["critical_velocity"] >= SLOWEST_BRAKE:
        return None
    return (f"no brake of usual size has its largest force below {SLOWEST_BRAKE:g} m/s; dry "
            "friction that comes in gradually looks the same")


class EddyCurrentDamping(Effect):
    """Begins at critical speeds around those of the record."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """From well below the RMS speed to well above it."""
        return [{"damping": SMALL * at.force / at.speed,
                 "critical_velocity": share * at.speed} for share in (0.2, 0.6, 1.5, 4.0)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """With a lower critical speed the rise of the force is over while the motion turns round:
        what shows is a dry friction that falls with speed."""
        return SLOWEST * at.speed if parameter == "critical_velocity" else -math.inf, math.inf


SLOWEST = 0.1
"""Critical speed over the RMS speed."""


EFFECT = EddyCurrentDamping(
    name="eddy_current_damping",
    meaning="eddy currents brake the motion, the less the faster it is",
    equation="F = -damping x' / (1 + (x' / critical_velocity)^2)",
    source="Wouterse, IEE Proc. B 138 (1991) 153",
    parameters=(
        Parameter("damping", 0.0, "N s/m", "damping at low speed", 0.0, 1e9),
        Parameter("critical_velocity", 1.0, "m/s", "speed of the largest force", 1e-9, 1e6),
    ),
    priors={"damping": Prior(1e-2, 1e2), "critical_velocity": Prior(1e-3, 10.0)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="resonant motion over a range of speeds up to the critical one",
    optional=("critical_velocity",),
    classes=(Equivalence(("eddy_current_damping", "damping"),
                         "speeds far below critical_velocity",
                         "speeds near critical_velocity"),
             Equivalence(("eddy_current_damping", "stribeck_friction"),
                         "motion much faster than critical_velocity",
                         "speeds up to critical_velocity, and standstill")),
    force=force,
    twins={"stribeck_friction": _as_friction},
    # it takes a magnet that moves along a conductor, near the critical speed
    gives_way_to=("coulomb_friction", "presliding_friction", "stribeck_friction"),
    doubt=_doubt,
)
