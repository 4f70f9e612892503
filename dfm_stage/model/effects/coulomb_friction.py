"""Coulomb friction: a constant force against the motion, and sticking.

    F = -force sgn(x')              while the stage moves
    F = -(all other forces)         while it sticks, as long as |F| <= force

Set-valued: the simulator locates each reversal and each breakaway inside the sample. Friction
that differs with direction is this effect together with force_offset, exactly.
Source: Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994) 1083; Acary and
Brogliato, Numerical Methods for Nonsmooth Dynamical Systems (2008), ch. 1.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Equivalence, Parameter, Prior

EFFECT = Effect(
    name="coulomb_friction",
    meaning="dry friction: a constant force against the motion, and sticking",
    equation="F = -force sgn(x'); at rest any |F| <= force that keeps it there",
    source="Armstrong-Helouvry et al., Automatica 30 (1994) 1083",
    parameters=(Parameter("force", 0.0, "N", "friction force", 0.0, 1e6),),
    priors={"force": Prior(1e-4, 1.0)},
    side="mechanical",
    parity="odd",
    memory=False,
    shown_by="small and large amplitudes, and reversals at low speed",
    classes=(Equivalence(("coulomb_friction", "presliding_friction"),
                         "motion far beyond the pre-sliding distance",
                         "sub-micrometre motion around rest, slow reversals"),),
    adds_to="dry_friction",
    brakes=0,
)
