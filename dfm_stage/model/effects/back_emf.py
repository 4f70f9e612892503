"""Back-EMF: the moving coil induces a voltage against the drive.

    (L/R) e' = a - constant x' - e,        F = force_constant e

With the drive e in volts (R times the current) the resistance cancels for L = 0: the effect is
then a viscous damping of force_constant * constant. It has no meaning with drive: current.
Source: Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014), ch. 5.
"""

from __future__ import annotations

from dfm_stage.model.effect import (
    SMALL,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
)


class BackEmf(Effect):
    """Shows beside free damping only where the current was recorded."""

    def hidden_because(self, at: Conditions) -> str | None:
        """Without a current record it is damping."""
        if at.drive_kind == "current":
            return "has no meaning with drive: current"
        if not any(r.current is not None for r in at.runs):
            return "without a current record it is viscous damping: retuned"
        return None

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small part of the voltage."""
        return [{"constant": SMALL * at.drive / at.speed}] if at.drive > 0.0 else []


EFFECT = BackEmf(
    name="back_emf",
    meaning="motion induces a voltage that brakes a coil driven by voltage",
    equation="(L/R) e' = a - constant x' - e",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 5",
    parameters=(Parameter("constant", 0.0, "V s/m", "voltage per speed", 0.0, 1e6),),
    priors={"constant": Prior(1e-2, 1e2)},
    side="actuator",
    parity="linear",
    memory=False,
    shown_by="a current record beside the voltage, near the resonance",
    classes=(Equivalence(("back_emf", "damping"), "voltage drive without a current record",
                         "a current record, or a ring-down with the coil open and shorted"),),
    adds_to="back_emf",
)
