"""Quadratic damping: drag of the air that is moved or squeezed out.

    F = -coefficient |x'| x'

Source: Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 3.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * abs(v) * v


EFFECT = Effect(
    name="quadratic_damping",
    meaning="drag that grows with the square of the speed",
    equation="F = -coefficient |x'| x'",
    source="Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 3",
    parameters=(Parameter("coefficient", 0.0, "N s^2/m^2", "drag coefficient", 0.0, 1e9),),
    priors={"coefficient": Prior(1e-2, 1e4)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="resonant motion or ring-down over a range of amplitudes",
    classes=(Equivalence(("quadratic_damping", "damping"), "one amplitude of a single sine",
                         "a ring-down, or the same sine at another amplitude"),),
    force=force,
    brakes=2,
)
