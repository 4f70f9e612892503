"""The error a tuned controller makes on the node graph, beside the one its model predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.control import Tuned, law_of, run_on_model
from dfm_stage.errors import DfmError
from dfm_stage.model import Model
from dfm_stage.recording import Record
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import load_experiment

_SETTLED_S = 1.0


@dataclass(frozen=True)
class Tracking:
    """Errors r - y as measured, m, where it counts after the first second: RMS and peak."""

    experiment: str
    predicted_rms_m: float
    predicted_peak_m: float
    achieved_rms_m: float
    achieved_peak_m: float

    def __str__(self) -> str:
        return (f"{self.experiment} on the graph: {self.achieved_rms_m * 1e9:.4g} nm RMS, "
                f"{self.achieved_peak_m * 1e9:.4g} nm peak (predicted on the model: "
                f"{self.predicted_rms_m * 1e9:.4g} and {self.predicted_peak_m * 1e9:.4g} nm)")

    def plain(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"experiment": self.experiment, "unit": "m",
                "predicted": {"rms": self.predicted_rms_m, "peak": self.predicted_peak_m},
                "achieved": {"rms": self.achieved_rms_m, "peak": self.achieved_peak_m}}


def as_experiment(name: str, mode: str, file: Path, axes: tuple[str, ...]) -> dict[str, Any]:
    """Return the named experiment with the tuned parameters in place of its own.

    Raises
    ------
    DfmError
        If there is no such experiment or it moves none of the axes.
    """
    found = load_experiment(find_experiment(name))
    given = {axis: {"reference": dict(spec.reference)} if spec.reference else {}
             for axis, spec in found.axes.items() if axis in axes}
    if not any(given.values()):
        raise DfmError(f"{found.name}: gives no reference for axis {', '.join(axes)}")
    return {"name": found.name, "mode": mode, "duration_s": found.duration_s,
            "seed": found.seed,
            "axes": {axis: given.get(axis, {}) for axis in axes},
            "controller": str(file.absolute())}


def compare(record: Record, axis: str, experiment: Mapping[str, Any], model: Model,
            tuned: Tuned) -> Tracking:
    """Return achieved and predicted errors of one axis.

    Raises
    ------
    DfmError
        If the record lacks the axis or its reference.
    """
    measured = record.axes.get(axis)
    if measured is None or measured.reference is None:
        raise DfmError(f"the bag has no reference of axis {axis}")
    reference = load_experiment(experiment).reference(axis, model.sample_period)
    counts = reference.steady & (reference.time_s >= _SETTLED_S)
    n = min(counts.size, measured.position.size)
    counts = counts[:n]
    achieved = (measured.reference - measured.position)[:n][counts]
    law, effects = law_of(tuned.parameters, model)
    true = run_on_model(model, law, reference.position, reference.velocity,
                        reference.acceleration, forward=effects,
                        inverse="inverse_model" in tuned.generator)
    # The encoder's noise is in what is measured, so it is in what is predicted.
    noise = np.random.default_rng(1).normal(0.0, model.base.get("noise", 0.0), n)
    predicted = (reference.position[:n] - true[:n] - noise)[counts]
    if not achieved.size:
        raise DfmError(f"{experiment['name']}: is over before {_SETTLED_S:g} s; take a longer one")
    return Tracking(str(experiment["name"]), *_rms_and_peak(predicted), *_rms_and_peak(achieved))


def _rms_and_peak(values: Array) -> tuple[float, float]:
    return float(np.sqrt(np.mean(values**2))), float(np.max(np.abs(values)))
