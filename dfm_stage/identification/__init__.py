"""Identification: frequency response, transfer function, output error, residual tests."""

from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.frequency_response import (
    Distortion,
    FrequencyResponse,
    frequency_response,
)
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
