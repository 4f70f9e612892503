"""The linear part of a model as control sees it: checked, sampled, and its highest mode.

`LinearPart` and `Sampled` are the model's own (`dfm_stage.model.linear`): modes, damping,
back-EMF, coil, lags, creep and whatever an effect adds to the linear part is in them, nonlinear
forces are not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from dfm_stage.control.errors import ControlError
from dfm_stage.model import Model
from dfm_stage.model.linear import LinearPart, Sampled, linear_part

__all__ = ["LinearStage", "Sampled", "command_limit", "highest_mode", "linear_stage",
           "sample_model", "sample_stage"]
LinearStage = LinearPart


def linear_stage(model: Model) -> LinearStage:
    """Return the linear part of a one-axis model to design on.

    Raises
    ------
    ControlError
        If mass or force_constant is not above zero, or the model has several axes.
    """
    if model.axes:
        raise ControlError(f"model {model.name} has the axes {', '.join(model.axes)}; design on "
                           "model.axis(name)")
    _check(model.base)
    return linear_part(model)


def _check(base: Mapping[str, float]) -> None:
    for name in ("mass", "force_constant"):
        if not base.get(name, 0.0) > 0.0:
            raise ControlError(f"the model's base needs {name} above zero to design on it")


def sample_stage(base: Mapping[str, float], sample_period_s: float) -> Sampled:
    """Return the base model of a model.yaml, sampled with a zero-order hold.

    Raises
    ------
    ControlError
        If mass or force_constant is missing or not above zero.
    """
    _check(base)
    return sample_model(Model("stage", sample_period_s, {"damping": 0.0, **base}))


def sample_model(model: Model, sample_period_s: float | None = None) -> Sampled:
    """Return the linear part of a one-axis model, sampled; by default with its own period.

    Raises
    ------
    ControlError
        As `linear_stage`.
    """
    return linear_stage(model).sampled(sample_period_s or model.sample_period)


def command_limit(model: Model, output_limit_v: float) -> float:
    """Return the largest command that has an effect: the limit, or the model's own."""
    return min(output_limit_v, model.effective_base()["command_limit"])


def highest_mode(model: Model) -> tuple[float, float]:
    """Return frequency (Hz) and damping ratio of the fastest vibration of a one-axis model.

    Raises
    ------
    ControlError
        As `linear_stage`, or if nothing in it vibrates.
    """
    stage = linear_stage(model)
    poles = np.linalg.eigvals(stage.a[:stage.motion, :stage.motion])
    fastest = max(poles[poles.imag > 0.0], key=abs, default=None)
    if fastest is None:
        raise ControlError(f"model {model.name} has no mode: it has no spring, or one so damped "
                           "that nothing vibrates")
    return float(abs(fastest)) / (2.0 * math.pi), max(0.0, float(-fastest.real / abs(fastest)))
