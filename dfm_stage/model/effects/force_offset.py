"""Force offset: a constant force, such as weight, a cable, or a coil's zero error.

    F = force

On a linear spring it only shifts the rest position, as an encoder's zero does; with a nonlinear
spring or friction it is felt. Together with coulomb_friction it is friction that differs with
direction.
Source: Slocum, Precision Machine Design (1992).
"""

from __future__ import annotations

from dfm_stage.model.effect import Conditions, Effect, Equivalence, Parameter, Prior


class ForceOffset(Effect):
    """On a linear spring it is told from the encoder's zero only where that is known."""

    def hidden_because(self, at: Conditions) -> str | None:
        """An unknown zero of the encoder does the same, but not where a body without a spring
        starts anew in every window, nor where no position was measured."""
        no_zero = at.base.get("stiffness", 0.0) and any(run.order for run in at.runs)
        return None if "encoder_zero" in at.base or at.windowed or no_zero else \
            "without a trusted encoder_zero it is an offset of the encoder"


EFFECT = ForceOffset(
    name="force_offset",
    meaning="a constant force acts on the stage",
    equation="F = force",
    source="Slocum, Precision Machine Design (1992)",
    parameters=(Parameter("force", 0.0, "N", "towards positive x", -1e6, 1e6),),
    priors={"force": Prior(-1.0, 1.0, log=False)},
    side="mechanical",
    parity="even",
    memory=False,
    shown_by="a trusted encoder_zero, or a nonlinear spring and large motion",
    classes=(Equivalence(("force_offset", "encoder_zero"),
                         "a linear spring and no trusted encoder_zero",
                         "referencing the encoder at the spring's rest position"),),
    adds_to="constant_force",
)
