"""Stiffness that drifts with time, as a flexure warms up or fatigues.

    F = -rate t x

t counts from the first sample; the base stiffness is that at t = 0.
Source: Slocum, Precision Machine Design (1992), ch. 8 (modulus over temperature); Worden and
Tomlinson, Nonlinearity in Structural Dynamics (2001), ch. 1 for systems that vary with time.
"""

from __future__ import annotations

from dfm_stage.model.effect import (
    SMALL,
    Array,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def flow(t: float, x: float, v: float, u: float, i: float, z: Array, rate: Array,
         p: Values) -> float:
    """N"""
    return -p[0] * t * x


class StiffnessDrift(Effect):
    """Begins at a small change over the record."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Of the stiffness."""
        return [{"rate": SMALL * at.stiffness / at.duration}]


EFFECT = StiffnessDrift(
    name="stiffness_drift",
    meaning="the stiffness drifts with time",
    equation="F = -rate t x",
    source="Slocum, Precision Machine Design (1992), ch. 8",
    parameters=(Parameter("rate", 0.0, "N/(m s)", "change of the stiffness in a second", -1e12,
                          1e12),),
    priors={"rate": Prior(1e-3, 1e1)},
    side="mechanical",
    parity="linear",
    memory=True,
    shown_by="a record as long as the drift, with the same motion at its beginning and end",
    classes=(Equivalence(("stiffness_drift", "stiffness"), "records much shorter than the drift",
                         "a long record"),
             Equivalence(("stiffness_drift", "coil_heating"), "motion well below the resonance "
                         "only", "motion around the resonance, whose frequency drifts or does "
                         "not")),
    flow=flow,
)
