"""Cases as the library's records and models: the corpus itself does not know the library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.corpus.case import Case
from dfm_stage.model import Model, model_from_dict
from dfm_stage.recording import AxisRecord, Provenance, Record


def model_of(case: Case) -> Model:
    """The model the user believes in."""
    return model_from_dict(case.model)


def records_of(case: Case, kind: str) -> list[Record]:
    """The case's records ("run") or held-out records ("holdout")."""
    runs = case.records if kind == "run" else case.holdout
    return [record_of(run, f"{kind}_{i}", case.sample_period) for i, run in enumerate(runs)]


def record_of(run: Mapping[str, Any], name: str, sample_period: float) -> Record:
    """One record from its columns."""
    axes = {"x": AxisRecord(run["input_v"], run["position_m"], current=run.get("current_a"),
                            reference=run.get("reference_m"))}
    if "other_position_m" in run:
        axes["y"] = AxisRecord(run["other_input_v"], run["other_position_m"])
    return Record(run["time_s"], sample_period, axes, Provenance(f"{name}.csv", "csv"))
