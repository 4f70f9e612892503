"""Cubic stiffness: a spring that hardens (k3 > 0) or softens (k3 < 0) with deflection.

    F = -k3 x^3

In a flexure it comes from the stretching of the leaves (hardening) or from axial load
(softening). A static offset makes it look quadratic as well; force_offset brings that.
Source: Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 4; Kerschen et al., Mech. Syst.
Signal Process. 20 (2006) 505.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * x * x * x


EFFECT = Effect(
    name="cubic_stiffness",
    meaning="the spring hardens or softens with deflection",
    equation="F = -k3 x^3",
    source="Nayfeh and Mook, Nonlinear Oscillations (1979), ch. 4",
    parameters=(Parameter("k3", 0.0, "N/m^3", "hardening above zero", -1e18, 1e18),),
    priors={"k3": Prior(1e4, 1e9)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="amplitudes that differ by a factor of two or more, near the resonance",
    classes=(Equivalence(("cubic_stiffness", "stiffness"), "one amplitude of a single sine",
                         "the same sine at another amplitude"),),
    force=force,
)
