"""A model beside records: its response, how much it misses, and whether it still holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.fit import system_of
from dfm_stage.diagnosis.observation import observe
from dfm_stage.errors import DfmError
from dfm_stage.identification.output_error import estimate
from dfm_stage.model import Model
from dfm_stage.recording import Record

FACTOR = 1.5
"""A gap so many times the stored one says that the model no longer holds. Records of one stage in
good order differ by some per cent in noise; an effect that grew by half is worth a look."""


class ComparisonError(DfmError):
    """A model cannot be set beside a record, or not be judged by it."""


@dataclass(frozen=True)
class Simulation:
    """The response of a model to the input of one record; arrays (N,), in `unit`.

    Figures leave out the first `skipped` samples, from which the state was found or in which what
    acted before the record dies out.
    """

    record: str
    model: str
    time: Array
    measured: Array
    simulated: Array
    measures: str
    unit: str
    skipped: int

    @cached_property
    def residual(self) -> Array:
        """Measured minus simulated, (N - skipped,)."""
        return (self.measured - self.simulated)[self.skipped:]

    @property
    def rms(self) -> float:
        """RMS of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def fit_percent(self) -> float | None:
        """`100 (1 - |residual| / |measured - mean|)` (Ljung, System Identification, 1999); None of
        what does not move."""
        measured = self.measured[self.skipped:]
        spread = float(np.linalg.norm(measured - measured.mean()))
        return 100.0 * (1.0 - float(np.linalg.norm(self.residual)) / spread) if spread else None

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"rms": self.rms, "unit": self.unit, "fit_percent": self.fit_percent,
                "samples": int(self.measured.size), "skipped": self.skipped}


@dataclass(frozen=True)
class Check:
    """Whether a model still explains its machine: its largest gap, and the gap allowed."""

    simulations: tuple[Simulation, ...]
    stored: float
    factor: float

    @property
    def worst(self) -> Simulation:
        """The response for the record with the largest gap."""
        return max(self.simulations, key=lambda each: each.rms)

    @property
    def holds(self) -> bool:
        """True if no gap exceeds the stored gap times the factor."""
        return self.worst.rms <= self.factor * self.stored

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"schema": 1, "holds": self.holds, "gap": self.worst.rms, "stored": self.stored,
                "unit": self.worst.unit, "ratio": self.worst.rms / self.stored,
                "factor": self.factor,
                "records": [{"record": s.record, **s.to_dict()} for s in self.simulations]}


def simulate(model: Model, record: Record, *, axis: str | None = None,
             initial: int | None = None, name: str | None = None) -> Simulation:
    """Simulate a model on the input of a record and set the response beside what was measured.

    Parameters
    ----------
    model
        Of one axis, or of several with `axis` naming one.
    initial
        Find state and offset from so many first samples, which the figures then leave out. By
        default they are fitted to the whole record, as `diagnose` does.
    name
        Of the record, by default its source.

    Raises
    ------
    ComparisonError, DiagnosisError, IdentificationError, ModelError, RecordError
        If the record does not suit the model, or the model cannot be simulated on it.
    """
    one = model.axis(model.usual_axis(axis))
    run = replace(observe(record, one, axis, name), current=None, velocity=None)
    first = run
    if initial is not None:
        if not 0 < initial < run.input.size:
            raise ComparisonError(f"{run.name}: no state can be found from the first {initial} of "
                                  f"{run.input.size} samples; give fewer than there are")
        first = replace(run.sliced(slice(0, initial)), skip=0)
    part = system_of(one, [first], ())
    found = estimate(part, noise="white")
    if found.status == "failed":
        raise ComparisonError(f"{run.name}: {found.message}")
    whole = system_of(one, [replace(run, skip=0)], ())
    start = whole.started(part.locals_of(found.values))
    simulated = whole.signals(0, start[None, :])[0][0]
    return _finite(Simulation(run.name, model.name, run.time, run.output, simulated, run.measures,
                              run.unit, run.skip if initial is None else initial))


def _finite(found: Simulation) -> Simulation:
    if not np.all(np.isfinite(found.simulated)):
        raise ComparisonError(f"{found.record}: model {found.model} escapes to infinity on it")
    return found


def pooled(found: Sequence[Simulation]) -> dict[str, Any]:
    """The figures of `Simulation.to_dict` over several records; the fit is their mean."""
    shares = [each.fit_percent for each in found if each.fit_percent is not None]
    residual = np.concatenate([each.residual for each in found])
    return {"rms": float(np.sqrt(np.mean(residual**2))), "unit": found[0].unit,
            "fit_percent": float(np.mean(shares)) if shares else None,
            "samples": sum(each.measured.size for each in found),
            "skipped": sum(each.skipped for each in found)}


def check(model: Model, records: Sequence[Record], *, axis: str | None = None,
          gap: float | None = None, factor: float = FACTOR,
          names: Sequence[str | None] = ()) -> Check:
    """Judge whether a model still explains its machine.

    Parameters
    ----------
    gap
        RMS to compare with, by default the held-out one that `identify` or `diagnose` stored with
        the model.
    factor
        How many times that RMS is allowed.

    Raises
    ------
    ComparisonError
        If no gap is stored, or one in another unit.
    """
    labels = [*names, *[None] * (len(records) - len(names))]
    found = tuple(simulate(model, record, axis=axis, name=label)
                  for record, label in zip(records, labels, strict=True))
    return Check(found, _stored(model, found[0].unit) if gap is None else gap, factor)


def _stored(model: Model, unit: str) -> float:
    kept = (model.origin or {}).get("gap")
    if not isinstance(kept, Mapping) or not kept.get("rms"):
        raise ComparisonError(f"model {model.name}: no gap is stored with it; give one with "
                              "--gap, or make the model again with identify or diagnose")
    if kept.get("unit") != unit:
        raise ComparisonError(f"model {model.name}: its gap is stored in {kept.get('unit')}, the "
                              f"record is in {unit}; give one with --gap")
    return float(kept["rms"])


def with_gap(model: Model, rms: float, unit: str) -> Model:
    """Store a held-out gap with a model, for `check`."""
    return replace(model, origin={**(model.origin or {}), "gap": {"rms": rms, "unit": unit}})


__all__ = ["Check", "ComparisonError", "Simulation", "check", "pooled", "simulate",
           "with_gap"]
