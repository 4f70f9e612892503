"""Force constant that droops with the square of position: a coil leaving the magnet's field.

    F = force_constant (1 - droop x^2) e     (with the slope: 1 + slope x - droop x^2)

Source: Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014),
ch. 5.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N beyond that of a constant force constant"""
    return -p[0] * x * x * actuator


EFFECT = Effect(
    name="force_constant_droop",
    meaning="the actuator weakens towards the ends of its travel",
    equation="F = force_constant (1 - droop x^2) e",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 5",
    parameters=(Parameter("droop", 0.0, "1/m^2", "relative loss per square metre",
                          -1e15, 1e15),),
    priors={"droop": Prior(1e2, 1e6)},
    side="actuator",
    parity="odd",
    memory=False,
    shown_by="large motion at several amplitudes; the resonance barely moves",
    classes=(Equivalence(("force_constant_droop", "cubic_stiffness"),
                         "quasi-static motion only",
                         "a multisine around the resonance, or a ring-down"),),
    force=force,
)
