"""Saturation of the command by the amplifier's limit.

    s = min(max(u, -limit), limit)        u: the delayed command, V or A

Acts before the amplifier's lag, so a held command stays held and the limit is exact.
Source: Khalil, Nonlinear Systems, 3rd ed., sec. 1.2.7.
"""

from __future__ import annotations

from dfm_stage.model.effect import Effect, Prior
from dfm_stage.model.parameter import Parameter

EFFECT = Effect(
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
)
