"""Force constant that changes linearly with position: a coil off the magnet's centre.

    F = force_constant (1 + slope x) e     (with the droop: 1 + slope x - droop x^2)

Source: Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014),
ch. 5.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N beyond that of a constant force constant"""
    return p[0] * x * actuator


EFFECT = Effect(
    name="force_constant_slope",
    meaning="the actuator is stronger on one side of its travel",
    equation="F = force_constant (1 + slope x) e",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 5",
    parameters=(Parameter("slope", 0.0, "1/m", "relative change per metre", -1e9, 1e9),),
    priors={"slope": Prior(-100.0, 100.0, log=False)},
    side="actuator",
    parity="even",
    memory=False,
    shown_by="large motion, excited above the resonance too",
    classes=(Equivalence(("force_constant_slope", "quadratic_stiffness"),
                         "motion well below the resonance only",
                         "a multisine that reaches above the resonance, or a ring-down"),),
    force=force,
)
