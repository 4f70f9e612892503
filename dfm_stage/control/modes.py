"""The mode of a model that a notch or a shaper is for."""

from __future__ import annotations

import math

from dfm_stage.control.errors import ControlError
from dfm_stage.model import Model


def highest_mode(model: Model) -> tuple[float, float]:
    """Return frequency (Hz) and damping ratio of a model's second mode, else of its first.

    Raises
    ------
    ControlError
        If it has neither a second mode nor a spring.
    """
    mode = model.effect("second_mode")
    if mode:
        return mode.parameters["frequency"], mode.parameters["damping_ratio"]
    m, k = model.base["mass"], model.base.get("stiffness", 0.0)
    if not k > 0.0:
        raise ControlError(f"model {model.name} has no mode: neither a second_mode nor a spring")
    w = math.sqrt(k / m)
    return w / (2.0 * math.pi), min(0.99, 0.5 * model.base.get("damping", 0.0) / (m * w))
