"""dfm_stage: simulation, identification, control and diagnosis of a flexure scanning stage.

The public interface is what this module and the packages name in `__all__`. Names here are loaded
on first use, so that importing the package costs nothing.

>>> import dfm_stage
>>> model = dfm_stage.load_model("paper_stage")
>>> model.base["mass"]
1.082
"""

from __future__ import annotations

import os
from typing import Any

__version__ = "0.2.0"
__all__ = ["Check", "DfmError", "Diagnosis", "Identification", "Model", "Record", "Simulation",
           "Simulator", "check", "diagnose", "identify", "load_model", "read_record", "save_model",
           "simulate"]

# Matrices here are small: threads of the linear algebra that wait for each other cost more than
# they give, on a busy machine thirty times more. Whoever has set these keeps them.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

_HOME = {       # types stand in __init__.pyi, so that no part is imported here
    "Check": "comparison", "Simulation": "comparison", "check": "comparison",
    "simulate": "comparison",
    "Diagnosis": "diagnosis", "diagnose": "diagnosis",
    "DfmError": "errors",
    "Identification": "identification", "identify": "identification",
    "Model": "model", "Simulator": "model", "load_model": "model", "save_model": "model",
    "Record": "recording", "read_record": "recording",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    found = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
