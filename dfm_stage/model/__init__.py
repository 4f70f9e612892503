"""The model of a stage as data, its effects, and the compiled simulator.

Simulator and Plant are loaded on first use, so that reading a model does not wait for numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dfm_stage.model.description import AxisModel, EffectUse, Model
from dfm_stage.model.document import (
    load_model,
    model_from_dict,
    model_text,
    parse_model,
    save_model,
)
from dfm_stage.model.effect import Effect, Equivalence, Prior, Reparametrisation
from dfm_stage.model.parameter import (
    BASE_PARAMETERS,
    ModelError,
    Parameter,
    ParameterError,
    SimulationError,
)
from dfm_stage.model.registry import EFFECTS

if TYPE_CHECKING:
    from dfm_stage.model.plant import CoupledPlant, Plant, Sample
    from dfm_stage.model.simulator import SimulationResult, Simulator

__all__ = [
    "BASE_PARAMETERS", "EFFECTS", "AxisModel", "CoupledPlant", "Effect", "EffectUse",
    "Equivalence", "Model", "ModelError", "Parameter", "ParameterError", "Plant", "Prior",
    "Reparametrisation", "Sample", "SimulationError", "SimulationResult", "Simulator",
    "load_model", "model_from_dict", "model_text", "parse_model", "save_model",
]

_LAZY = {"CoupledPlant": "plant", "Plant": "plant", "Sample": "plant", "Simulator": "simulator",
         "SimulationResult": "simulator"}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module
        return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
