"""Direction-dependent friction: more viscous friction one way than the other.

    F = -difference |x'|

The base damping is the mean of the two directions, which have damping + difference and
damping - difference. Dry friction that differs with the direction is coulomb_friction together
with force_offset, exactly.
Source: Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 4; Janot, Gautier and
Brunot, EMPS benchmark (2019).
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior, Values


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return -p[0] * abs(v)


EFFECT = Effect(
    name="directional_friction",
    meaning="viscous friction differs between the directions",
    equation="F = -difference |x'|",
    source="Armstrong-Helouvry, Control of Machines with Friction (1991), ch. 4",
    parameters=(Parameter("difference", 0.0, "N s/m", "half the difference of the dampings",
                          -1e9, 1e9),),
    priors={"difference": Prior(1e-2, 1e2)},
    side="mechanical",
    parity="even",
    memory=False,
    shown_by="resonant motion at several amplitudes",
    classes=(Equivalence(("directional_friction", "force_offset"),
                         "one amplitude of a single sine",
                         "the same sine at another amplitude, or a broad band"),),
    force=force,
)
