"""Coil inductance: the current lags behind the voltage.

    (inductance/R) e' = a - back_emf x' - e

Needs coil_resistance in base.
Source: Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014), ch. 5.
"""

from __future__ import annotations

from dfm_stage.model.effect import Conditions, Effect, Equivalence, Parameter, Parameters, Prior


class CoilInductance(Effect):
    """Begins at shares of the sample period; needs a voltage drive and a resistance."""

    def hidden_because(self, at: Conditions) -> str | None:
        """Without voltage drive or resistance there is no lag."""
        if at.drive_kind == "current":
            return "has no meaning with drive: current"
        if at.base.get("coil_resistance", 0.0) <= 0.0:
            return "needs coil_resistance in base"
        return None

    def starts(self, at: Conditions) -> list[Parameters]:
        """L / R from a tenth to three sample periods."""
        resistance = at.base["coil_resistance"]
        return [{"inductance": resistance * at.sample_period * f}
                for f in (0.1, 0.3, 1.0, 3.0)]


EFFECT = CoilInductance(
    name="coil_inductance",
    meaning="the coil's current lags behind its voltage",
    equation="(inductance/R) e' = a - back_emf x' - e",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 5",
    parameters=(Parameter("inductance", 0.0, "H", "inductance of the coil", 0.0, 1e3),),
    priors={"inductance": Prior(1e-5, 1e-1)},
    side="actuator",
    parity="linear",
    memory=False,
    shown_by="excitation up to R / (2 pi inductance), or a current record",
    classes=(
        Equivalence(("coil_inductance", "amplifier_bandwidth"),
                    "no current record, or back-EMF small",
                    "the voltage at the coil beside the command"),
        Equivalence(("coil_inductance", "transport_delay"),
                    "a band well below R / (2 pi inductance)",
                    "excitation to higher frequencies"),
    ),
    adds_to="coil_inductance",
    late="coil",
)
