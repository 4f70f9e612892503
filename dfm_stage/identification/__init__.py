"""Identification: frequency response, transfer function, output error, residual tests.

Names are loaded on first use: who needs one estimator does not wait for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dfm_stage.identification.frequency_response import (  # not late: its module has its name
    Distortion,
    FrequencyResponse,
    frequency_response,
)

if TYPE_CHECKING:
    from dfm_stage.identification.errors import IdentificationError
    from dfm_stage.identification.identifiability import BlindDirection, Identifiability
    from dfm_stage.identification.model_fit import (
        ModelFit,
        default_free,
        evaluate,
        fit_model,
        linear_plant,
    )
    from dfm_stage.identification.noise import NoiseModel, fit_noise
    from dfm_stage.identification.output_error import estimate
    from dfm_stage.identification.plant import LinearPlant, Mode
    from dfm_stage.identification.problem import Problem, Unknown
    from dfm_stage.identification.quantity import Quantity
    from dfm_stage.identification.residuals import (
        ResidualTest,
        input_correlation,
        line_residuals,
        whiteness,
    )
    from dfm_stage.identification.result import Estimate, SegmentFit
    from dfm_stage.identification.run import Run
    from dfm_stage.identification.source import Source
    from dfm_stage.identification.transfer_function import (
        TransferFunctionFit,
        fit_transfer_function,
    )
    from dfm_stage.identification.workflow import Identification, identify

__all__ = [
    "BlindDirection", "Distortion", "Estimate", "FrequencyResponse", "Identifiability",
    "Identification", "IdentificationError", "LinearPlant", "Mode", "ModelFit", "NoiseModel",
    "Problem", "Quantity", "ResidualTest", "Run", "SegmentFit", "Source",
    "TransferFunctionFit", "Unknown", "default_free", "estimate", "evaluate", "fit_model",
    "fit_noise", "fit_transfer_function", "frequency_response", "identify", "input_correlation",
    "line_residuals", "linear_plant", "whiteness",
]

_NAMES = {
    "errors": ("IdentificationError",),
    "identifiability": ("BlindDirection", "Identifiability"),
    "model_fit": ("ModelFit", "default_free", "evaluate", "fit_model", "linear_plant"),
    "noise": ("NoiseModel", "fit_noise"),
    "output_error": ("estimate",),
    "plant": ("LinearPlant", "Mode"),
    "problem": ("Problem", "Unknown"),
    "quantity": ("Quantity",),
    "residuals": ("ResidualTest", "input_correlation", "line_residuals", "whiteness"),
    "result": ("Estimate", "SegmentFit"),
    "run": ("Run",),
    "source": ("Source",),
    "transfer_function": ("TransferFunctionFit", "fit_transfer_function"),
    "workflow": ("Identification", "identify"),
}
_LAZY = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
