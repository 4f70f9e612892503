"""What was observed in one run: what went in, what came out, and what is known of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    DIED_OUT,
    FITTED_SHARE,
    LEAD_IN,
    LEAD_IN_PART,
    SHORTEST,
    SHORTEST_PERIOD,
    SHORTEST_WINDOW,
    WINDOWS,
)
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.spectra import denoised
from dfm_stage.identification.convention import Convention, agreed, find_convention
from dfm_stage.identification.decisions import SAME_PERIOD
from dfm_stage.identification.input_unit import input_mismatch
from dfm_stage.identification.lost_samples import find_lost, put_in
from dfm_stage.identification.motion import ORDER
from dfm_stage.identification.periods import Periodicity, find_period
from dfm_stage.identification.run import Run
from dfm_stage.model import Model
from dfm_stage.recording import Record


@dataclass(frozen=True, kw_only=True)
class Observation(Run):
    """A run with what the diagnosis knows of it besides.

    `output` (N,) is in `unit`; `other` has its noise filtered out. `reference` (N,) is what the
    stage was to follow, where recorded. `start_s` is the time of the first sample since the record
    began, `lost_s` are times at which the logger had dropped samples, which were put in. `of` is
    the name of the long record of which the run is a stretch, in `part_of_record`; `samples` is
    the size of the record of which it is a part, 0 of a whole one.
    """

    unit: str = "m"
    reference: Array | None = None
    periodicity: Periodicity | None = None
    skip: int = LEAD_IN
    start_s: float = 0.0
    lost_s: tuple[float, ...] = ()
    of: str = ""
    part_of_record: int = 0
    samples: int = 0

    @property
    def record(self) -> str:
        """The name of the record that it is, or that it is a part of."""
        return self.of or self.name

    @property
    def record_size(self) -> int:
        """Samples of the record that it is, or that it is a part of."""
        return self.samples or self.input.size

    def simulated_position(self, residual: Array) -> Array:
        """The position (N - skip,) that a simulation gave which left `residual` of the output; the
        one made from the output where that is none."""
        return self.position[self.skip:] - (residual if self.order == 0 else 0.0)

    @property
    def time(self) -> Array:
        """Seconds (N,) since the record began."""
        return np.asarray(self.start_s + self.sample_period * np.arange(self.input.size))

    def part(self, start: int, stop: int, lead: int = LEAD_IN) -> Observation:
        """Return samples `start` to `stop`, simulated from `lead` samples before."""
        first = max(0, start - lead)
        cut = slice(first, stop)
        found = self.periodicity
        if found is not None:
            begin = max(found.start - first, 0)
            count = (stop - first - begin) // found.period
            found = Periodicity(found.period, begin, count) if count >= 2 else None
        return replace(
            self.sliced(cut),
            reference=None if self.reference is None else self.reference[cut],
            samples=self.record_size, periodicity=found,
            skip=max(start - first, lead_in(stop - first)),
            start_s=self.start_s + first * self.sample_period)


def lead_in(size: int) -> int:
    """Samples at the beginning of a record of `size` samples that are simulated, not compared."""
    return min(LEAD_IN, int(LEAD_IN_PART * size))


def observe(record: Record, model: Model, axis: str | None = None,
            name: str | None = None, known: Convention | None = None) -> Observation:
    """Return one axis of a record, with the position of the neighbour that acts on it.

    The convention of the input is found, unless it is `known`.

    Raises
    ------
    DiagnosisError
        If the record does not suit the model, is too short or holds values that are not finite.
    """
    chosen = axis_name(record, axis)
    data = record.axis(chosen)
    called = name or record.provenance.source
    if abs(record.sample_period / model.sample_period - 1.0) > SAME_PERIOD:
        raise DiagnosisError(f"{called}: sampled every {record.sample_period:g} s, but the model "
                             f"steps by {model.sample_period:g} s; resample the record or set "
                             "sample_period in the model")
    if len(record) < SHORTEST:
        raise DiagnosisError(f"{called}: {len(record)} samples are too few for a diagnosis; "
                             f"record at least {SHORTEST}")
    unit = data.position_unit
    if unit != model.position_unit:
        raise DiagnosisError(f"{called}: the output is in {unit}, the model in "
                             f"{model.position_unit}; give --output-unit or set position_unit "
                             "in the model")
    mismatch = input_mismatch(model, data.input_unit) if np.any(data.input) else None
    if mismatch:
        raise DiagnosisError(f"{called}: {mismatch}")
    for what, signal in (("input", data.input), ("output", data.position)):
        bad = np.flatnonzero(~np.isfinite(signal))
        if bad.size:
            raise DiagnosisError(f"{called}: the {what} is not a number at "
                                 f"{record.time[bad[0]]:g} s; cut or repair the record")
    others = [a for n, a in record.axes.items() if n != chosen]
    other = _usable(others[0].position if len(others) == 1 and others[0].measures == "position"
                    else None)
    quiet = None if other is None else denoised(other)
    applied, output = np.asarray(data.input, float), np.asarray(data.position, float)
    lost = find_lost(applied, output) if data.measures == "position" else []

    def whole(signal: Array | None) -> Array | None:
        return None if signal is None else put_in(signal, lost)

    applied = put_in(applied, lost, [loss.input for loss in lost])
    output = put_in(output, lost, [loss.output for loss in lost])
    found = known or find_convention(applied, output, ORDER[data.measures], hold=data.input_hold,
                                     shift=data.input_shift)
    return Observation(called, applied, output, record.sample_period, unit=data.output_unit,
                       current=whole(_usable(data.current)), other=whole(quiet),
                       reference=whole(_usable(data.reference)),
                       periodicity=_periodicity(whole(data.extra.get("excitation")), applied),
                       measures=data.measures, velocity=whole(
                           _usable(data.velocity) if data.measures == "position" else None),
                       skip=lead_in(output.size), lost_s=tuple(
                           float(record.time[loss.at]) for loss in lost for _ in loss.input)
                       ).by(found)


def alike(runs: Sequence[Observation], late: float = 0.0) -> list[Observation]:
    """The runs with what they say together of their inputs to a stage that is known to be `late`
    (samples), and with a measured velocity beside the position only where all of them have one.

    Raises
    ------
    DiagnosisError
        If one measures a position and another a velocity or an acceleration.
    """
    for run in runs:
        if run.measures != runs[0].measures:
            raise DiagnosisError(f"{run.name}: the output is a {run.measures}, that of "
                                 f"{runs[0].name} a {runs[0].measures}; use records of one kind")
    known = [each.behind(late) for each in agreed([each.convention for each in runs])]
    told = [run if run.convention is convention else run.by(convention)
            for run, convention in zip(runs, known, strict=True)]
    if all(run.velocity is not None for run in told):
        return told
    return [replace(run, velocity=None) for run in told]


def axis_name(record: Record, axis: str | None) -> str:
    """The axis that is meant where none, or one, is named."""
    if axis is not None:
        record.axis(axis)
        return axis
    if len(record.axes) == 1 or "x" in record.axes:
        return "x" if "x" in record.axes else next(iter(record.axes))
    raise DiagnosisError(f"{record.provenance.source}: has the axes {', '.join(record.axes)}; "
                         "choose one with --axis")


def _usable(signal: Array | None) -> Array | None:
    if signal is None or not np.all(np.isfinite(signal)) or np.ptp(signal) == 0.0:
        return None
    return np.asarray(signal, dtype=float)


def _periodicity(excitation: Array | None, applied: Array) -> Periodicity | None:
    for signal in (applied, excitation):
        if signal is not None and np.ptp(signal) > 0.0:
            found = find_period(signal, tolerance=1e-6)
            if found is not None and found.period >= SHORTEST_PERIOD:
                return found
    return None


def split_by_time(runs: Sequence[Observation],
                  share: float = FITTED_SHARE) -> tuple[list[Observation], list[Observation]]:
    """Return parts of each run to fit and the rest to predict.

    The last part is held out; of a motion that has died out by then, an early part that still
    moves, with what comes before and after it fitted as two runs.
    """
    early, late = [], []
    for run in runs:
        size = run.input.size
        cut = int(share * size)
        if _dies_out(run.output, cut):
            first = max(size // 10, min(100, size // 4))
            second = max(3 * size // 10, first + size // 5)
            early += [replace(run.part(run.skip, first), name=f"{run.name}, beginning"),
                      replace(run.part(second, size), name=f"{run.name}, end")]
            late.append(replace(run.part(first, second), name=f"{run.name}, between"))
        else:
            early.append(run.part(run.skip, cut))
            late.append(replace(run.part(cut, size, lead=400),
                                name=f"{run.name}, last {100 - round(100 * share)} %"))
    return early, late


def in_windows(run: Observation) -> Observation:
    """The run with a state that starts anew in each of about WINDOWS windows."""
    return replace(run, window=max(run.input.size // WINDOWS, SHORTEST_WINDOW))


def _dies_out(output: Array, cut: int) -> bool:
    """Whether the part from `cut` on has hardly any of the motion's power."""
    centred = output - np.median(output[cut:])
    return float(np.mean(centred[cut:] ** 2)) < DIED_OUT * float(np.mean(centred**2))
