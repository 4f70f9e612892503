"""How large a parameter is: its value, or where that is zero a typical one."""

from __future__ import annotations

import math

from dfm_stage.model.description import Model
from dfm_stage.model.registry import EFFECTS

SOFTEST = 1e-3
"""Stiffness (N/m) with which the size of a damping is estimated where there is no spring."""
SMALL_MOTION, SMALL_READING = 1e-4, 1e-6
"""Sizes (m, m/s) of an initial state, and of an encoder's zero (m)."""
SLIGHT = 0.02
"""Twice a damping ratio that is slight."""


def typical_size(model: Model, address: str) -> float:
    """The size of a parameter of `model`, in its unit; never zero.

    Its value; where that is zero, of an effect's parameter the middle of its usual range, of a
    base parameter what changes the motion within a sample or a radian per second.
    """
    value, typical = abs(model.parameters().get(address, 0.0)), _typical(model, address)
    return value if value > NEGLIGIBLE * typical else typical


NEGLIGIBLE = 1e-9
"""Share of its typical size below which a value is a zero that a search left at its bound."""


def _typical(model: Model, address: str) -> float:
    mass, period = model.base["mass"], model.sample_period
    rate = math.sqrt(max(model.base.get("stiffness", 0.0) / mass, 1.0))
    if address.startswith("initial."):
        lagged = address in ("initial.amplifier", "initial.coil")
        return 1.0 if lagged else SMALL_MOTION * (rate if address.endswith("velocity") else 1.0)
    natural = {"amplifier_time_constant": period, "delay": period, "stiffness": mass,
               "encoder_zero": SMALL_READING,
               "damping": SLIGHT * math.sqrt(mass * max(model.base.get("stiffness", 0.0),
                                                        SOFTEST))}
    if address in natural:
        return natural[address]
    head, _, own = address.partition(".")
    prior = EFFECTS[head].priors.get(own) if head in EFFECTS else None
    return abs(prior.typical) if prior is not None else 1.0
