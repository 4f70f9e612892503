"""One measured record diagnosed as the command line does, its files and its answer kept."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from benchmarks.measured.columns import Columns
from benchmarks.measured.records import MeasuredRecord
from benchmarks.measured.sources import READERS, write_csv
from dfm_stage.model import Model, load_model

LONGEST_S = 1800
"""Wall time (s) after which a diagnosis counts as failed: far above the promised 60 s."""


@dataclass(frozen=True)
class Trial:
    """What was put in, and what came out: `answer` is diagnosis.json, empty where the command
    failed, which `complaint` then tells."""

    record: MeasuredRecord
    folder: Path
    parts: dict[str, Columns]
    answer: dict[str, Any]
    complaint: str
    seconds: float

    @property
    def model(self) -> Model:
        """The extended model."""
        return load_model(self.folder / "diagnosed" / "model.yaml")


def arguments(record: MeasuredRecord) -> list[str]:
    """The arguments of `diagnose`, in the folder that holds the files."""
    held = [word for part in record.hold for word in ("--holdout", f"{part}.csv")]
    return [*(f"{part}.csv" for part in record.fit), *held, "--model", "model.yaml",
            "--out", "diagnosed", *record.options]


def prepare(record: MeasuredRecord, source: Path, folder: Path) -> dict[str, Columns]:
    """Write the parts of a record as CSV, and the model that a user would start from."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = READERS[record.name](source)
    for name, columns in parts.items():
        write_csv(folder / f"{name}.csv", columns)
    if record.model_file:
        (folder / "model.yaml").write_text((source / record.model_file).read_text("utf-8"),
                                           "utf-8")
    else:
        with (folder / "model.yaml").open("w", encoding="utf-8") as file:
            YAML().dump({"dfm_model": 1, "name": record.name, **record.model}, file)
    return parts


def run(record: MeasuredRecord, source: Path, folder: Path) -> Trial:
    """Diagnose one record with the settings untouched, in a process of its own.

    `seconds` is processor time, one thread for the linear algebra.
    """
    parts = prepare(record, source, folder)
    answer_file = folder / "diagnosed" / "diagnosis.json"
    answer_file.unlink(missing_ok=True)
    before = _children_s()
    try:
        done = subprocess.run(
            [sys.executable, "-m", "dfm_stage", "diagnose", *arguments(record), "--no-report"],
            cwd=folder, capture_output=True, text=True, timeout=LONGEST_S, check=False,
            env={**os.environ, "PYTHONPATH": _search_path()})
        complaint = "" if done.returncode == 0 else (done.stderr.strip() or "failed")
    except subprocess.TimeoutExpired:
        complaint = f"no answer within {LONGEST_S} s"
    seconds = _children_s() - before
    answer = json.loads(answer_file.read_text("utf-8")) if answer_file.exists() else {}
    return Trial(record, folder, parts, answer, "" if answer else complaint.splitlines()[-1],
                 seconds)


def _search_path() -> str:
    """This checkout first, also where the process starts in another folder."""
    here = str(Path(__file__).resolve().parents[2])
    return os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH", ""))))


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
