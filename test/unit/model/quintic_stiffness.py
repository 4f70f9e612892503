"""Quintic stiffness, an effect outside the package: F = -k5 x^5."""


from __future__ import annotations

from dfm_stage.model.effect import Effect, Prior, Values
from dfm_stage.model.parameter import Parameter


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * x**5


EFFECT = Effect(
    name="quintic_stiffness", meaning="the spring hardens late", equation="F = -k5 x^5",
    source="Nayfeh and Mook (1979), ch. 4",
    parameters=(Parameter("k5", 0.0, "N/m^5", "hardening above zero", -1e24, 1e24),),
    priors={"k5": Prior(1e9, 1e14)}, side="mechanical", parity="odd", memory=False,
    shown_by="amplitudes that differ", force=force)
