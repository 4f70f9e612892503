"""Dead zone of the amplifier: small commands give nothing.

    s = u - min(max(u, -width), width)        u: the command, V or A

It acts before the amplifier's lag, so a held command stays held and the dead zone is exact.
Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities
(1996), ch. 2.
"""

from __future__ import annotations

import numpy as np

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

ONE_SIZE = 0.25
"""Spread of the commands' sizes over their mean below which they have one size. It is 0.48 of a
sine, 0.76 of noise, and 0.1 of a relay of which one sample in 30 lies between its two values."""


def added(u: float, t: float, p: Values) -> float:
    """V or A"""
    return -min(max(u, -p[0]), p[0])


class DeadZone(Effect):
    """Begins at a small part of the command."""

    def hidden_because(self, at: Conditions) -> str | None:
        """A relay knows one size of command, and a dead zone is another gain there."""
        sizes = np.concatenate([np.abs(run.input) for run in at.runs]) if at.runs else np.ones(0)
        one = sizes.size > 0 and float(np.std(sizes)) < ONE_SIZE * float(np.mean(sizes))
        return "every command has one size: a force constant does the same" if one else None

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
