"""Diagnosis: which effect a model lacks, shown on data it was not fitted to."""

from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import Comparison
from dfm_stage.diagnosis.remainder import Description, Finding
from dfm_stage.diagnosis.result import Diagnosis, Gap, NamedEffect, Rejected
from dfm_stage.diagnosis.workflow import diagnose

__all__ = ["Comparison", "Description", "Diagnosis", "DiagnosisError", "Finding", "Gap",
           "NamedEffect", "Rejected", "diagnose"]
