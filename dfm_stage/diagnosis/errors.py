"""Errors of the diagnosis: data or a request that cannot be used, never a verdict."""

from __future__ import annotations

from dfm_stage.errors import DfmError


class DiagnosisError(DfmError):
    """The records, the model or the request cannot be used; the message says what to change."""
