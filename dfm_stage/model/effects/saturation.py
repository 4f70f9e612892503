"""Saturation of the command by the amplifier's limit.

    s = min(max(u, -limit), limit)        u: the delayed command, V or A

Acts before the amplifier's lag, so a held command stays held and the limit is exact.
Source: Khalil, Nonlinear Systems, 3rd ed., sec. 1.2.7.
"""

from __future__ import annotations

import numpy as np

from dfm_stage.model.effect import Conditions, Effect, Parameter, Parameters, Prior


class Saturation(Effect):
    """Its limit is tried at quantiles of the command."""

    def hidden_because(self, at: Conditions) -> str | None:
        """A command that never changes meets no limit."""
        return "the input is constant" if all(np.ptp(r.input) == 0.0 for r in at.runs) else None

    def starts(self, at: Conditions) -> list[Parameters]:
        """Limits that a growing share of the commands exceeds, and some just below the largest."""
        commands = np.sort(np.concatenate([np.abs(r.input) for r in at.runs]))
        largest = float(commands[-1])
        limits: list[float] = []
        for share in SHARES:
            limit = float(commands[int((1.0 - share) * (commands.size - 1))])
            if 0.0 < limit < largest and (not limits or limit < APART * limits[-1]):
                limits.append(limit)
        return [{"limit": v} for v in (*limits, *(largest * (1.0 - c) for c in BELOW)) if v > 0.0]


SHARES = np.geomspace(1e-4, 0.5, 24)
"""Shares of the commands that a limit may cut."""
APART = 0.999
"""Limits closer than this cut the same."""
BELOW = (1e-3, 3e-3, 1e-2, 2e-2)
"""Distances from the largest command, for limits that cut only its peaks."""


EFFECT = Saturation(
    name="saturation",
    meaning="the amplifier cannot give more than a limit",
    equation="s = min(max(u, -limit), limit)",
    source="Khalil, Nonlinear Systems (2002), sec. 1.2.7",
    parameters=(Parameter("limit", 1.0, "V or A", "largest command that passes", 1e-9, 1e6),),
    priors={"limit": Prior(0.05, 20.0)},
    side="actuator",
    parity="odd",
    memory=False,
    shown_by="commands beyond the limit, at least 5 % of the time",
    adds_to="command_limit",
    searched=True,
)
