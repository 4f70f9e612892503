"""How large a parameter is: its value, or where that is zero a typical one."""

from __future__ import annotations

import math

from dfm_stage.model import EFFECTS, Model

SOFTEST = 1e-3
"""Stiffness (N/m) with which the size of a damping is estimated where there is no spring."""
SLIGHT = 0.02
"""Twice a damping ratio that is slight."""


def typical_size(model: Model, address: str) -> float:
    """The size of a parameter of `model`, in its unit; never zero.

    Where the value is zero: of an effect's parameter the middle of its usual range, of a base
    parameter what changes the motion within a sample or a radian per second.
    """
    value = abs(model.parameters().get(address, 0.0))
    if value > 0.0:
        return value
    mass, period = model.base["mass"], model.sample_period
    natural = {"amplifier_time_constant": period, "delay": period, "stiffness": mass,
               "damping": SLIGHT * math.sqrt(mass * max(model.base.get("stiffness", 0.0),
                                                        SOFTEST))}
    if address in natural:
        return natural[address]
    head, _, own = address.partition(".")
    prior = EFFECTS[head].priors.get(own) if head in EFFECTS else None
    return abs(prior.typical) if prior is not None else 1.0
