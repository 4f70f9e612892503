"""Quadratic stiffness: a spring that is stiffer on one side than on the other.

    F = -k2 x^2

Source: Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 2; it shifts the mean position and
gives even harmonics.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * x * x


EFFECT = Effect(
    name="quadratic_stiffness",
    meaning="the spring is stiffer on one side",
    equation="F = -k2 x^2",
    source="Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 2",
    parameters=(Parameter("k2", 0.0, "N/m^2", "stiffer at positive x above zero", -1e15, 1e15),),
    priors={"k2": Prior(1e2, 1e7)},
    side="mechanical",
    parity="even",
    memory=False,
    shown_by="large motion on both sides of rest, above the resonance too",
    classes=(Equivalence(("quadratic_stiffness", "force_constant_slope"),
                         "motion well below the resonance only",
                         "a multisine that reaches above the resonance"),),
    force=force,
)
