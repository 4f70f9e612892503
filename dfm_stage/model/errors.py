"""The errors of the model package."""

from __future__ import annotations

from dfm_stage.errors import DfmError


class ModelError(DfmError):
    """A model is malformed: an unknown name, a value out of range, a part that is missing."""


class SimulationError(DfmError):
    """A simulation cannot be done as asked, or did not arrive at an answer."""
