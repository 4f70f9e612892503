"""Errors of identification: unusable data or an impossible request, never a failed fit."""

from __future__ import annotations

from dfm_stage.errors import DfmError


class IdentificationError(DfmError):
    """The record or the request cannot be used; the message says why and what to change."""
