"""Dead zone of the amplifier: small commands give nothing.

    s = u - min(max(u, -width), width)        u: the command, V or A

It acts before the amplifier's lag, so a held command stays held and the dead zone is exact.
Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities
(1996), ch. 2.
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
    Values,
)


def added(u: float, t: float, p: Values) -> float:
    """V or A"""
    return -min(max(u, -p[0]), p[0])


class DeadZone(Effect):
    """Begins at a small part of the command."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """Narrow zones take the same from every command."""
        return [{"width": 10.0 * SMALL * at.drive}] if at.drive > 0.0 else []


EFFECT = DeadZone(
    name="dead_zone",
    meaning="the amplifier gives nothing for small commands",
    equation="s = u - min(max(u, -width), width)",
    source="Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor "
    "Nonlinearities (1996), ch. 2",
    parameters=(Parameter("width", 0.0, "V or A", "largest command that gives nothing", 0.0,
                          1e6),),
    priors={"width": Prior(1e-3, 1.0)},
    side="actuator",
    parity="odd",
    memory=False,
    shown_by="small and large commands: the gain grows with the amplitude",
    classes=(Equivalence(("dead_zone", "force_constant"), "one amplitude of a single sine",
                         "the same sine at another amplitude"),),
    added=added,
)
