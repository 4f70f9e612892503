"""A case on disk: records and model for everybody, the label in a folder of its own."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Protocol

import numpy as np


class Numbered(Protocol):
    """A specification."""

    @property
    def index(self) -> int:
        """Its place in the plan."""
        ...


class Shown(Protocol):
    """What a case of any corpus has."""

    @property
    def spec(self) -> Numbered:
        """What it is about."""
        ...

    @property
    def records(self) -> list[dict[str, Any]]:
        """Columns of the runs to fit."""
        ...

    @property
    def holdout(self) -> list[dict[str, Any]]:
        """Columns of the runs to predict."""
        ...

    @property
    def model(self) -> dict[str, Any]:
        """What its user believes."""
        ...

    @property
    def label(self) -> dict[str, Any]:
        """The truth, for nobody who answers."""
        ...


def write_whole(path: Path, text: str) -> None:
    """Write a file so that it appears complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    temporary.write_text(text, "utf-8")
    temporary.replace(path)


def write_case(case: Shown, folder: Path, labels: Path) -> Path:
    """Write `run_N.csv`, `holdout_N.csv` and `model.yaml` under `folder`, the label under
    `labels`; return the case's folder."""
    name = f"case_{case.spec.index:05d}"
    for kind, runs in (("run", case.records), ("holdout", case.holdout)):
        for i, run in enumerate(runs):
            write_whole(folder / name / f"{kind}_{i}.csv", _csv(run))
    # JSON is YAML
    write_whole(folder / name / "model.yaml", json.dumps(case.model, indent=1) + "\n")
    write_label(case, labels)
    return folder / name


def write_label(case: Shown, labels: Path) -> None:
    """Write the label, and what the library must do without, into the folder of labels."""
    write_whole(labels / f"case_{case.spec.index:05d}.json",
                json.dumps(case.label, indent=1) + "\n")


def _csv(run: dict[str, Any]) -> str:
    columns = dict(run)
    if "other_input_v" in columns:
        columns = {COLUMNS.get(name, name): values for name, values in columns.items()}
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns)] + [",".join(f"{v:.12g}" for v in row) for row in rows]
    return "\n".join(lines) + "\n"


COLUMNS = {"input_v": "x_input_v", "position_m": "x_position_m", "current_a": "x_current_a",
           "reference_m": "x_reference_m", "other_input_v": "y_input_v",
           "other_position_m": "y_position_m"}
