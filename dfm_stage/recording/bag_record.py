"""From the topics of a bag to a record.

Samples are told apart by their numbers, not by when they arrived: sample k of an axis is the
measurement with `seq` k, and the input that belongs to it is what the amplifier applied in answer
(`measurement_seq`), or the command where no amplifier was recorded. Between two messages of the
amplifier its output stands; a sample without an answer therefore keeps the voltage before it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.bag import (
    MODEL_ATTACHMENT,
    PARAMETERS_ATTACHMENT,
    VERSIONS_ATTACHMENT,
    Bag,
    Topic,
)
from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.record import AxisRecord, FloatArray, Provenance, Record
from dfm_stage.recording.sample_grid import (
    SampleGrid,
    applied_input,
    jitter_note,
    on_grid,
    sample_grid,
)
from dfm_stage.recording.time_base import longest_stretch

_MEASUREMENT = "measurement"
_FLAGS = {2: "beyond the travel limit", 4: "after lost samples", 8: "implausible"}


@dataclass
class _Axis:
    """One axis on its own grid, before the axes are brought together."""

    name: str
    grid: SampleGrid
    arrays: dict[str, FloatArray]
    input_unit: str
    notes: list[str] = field(default_factory=list)


def topics_of(axis: str | None) -> list[str]:
    """Return the patterns of the topics that a record of that axis, or of all, is made from."""
    names = (_MEASUREMENT, "amplifier", "command", "reference", "excitation", "plant")
    return [f"*/{axis}/{name}" if axis else f"*/{name}" for name in names]


def bag_record(bag: Bag, axis: str | None = None, sample_period: float | None = None,
               gaps: str = "longest") -> Record:
    """Return the record in a bag; parameters as those of `read_record`.

    Raises
    ------
    RecordError
        If there is no measurement or nothing that says what was applied.
    """
    run = _Run(bag)
    found = _measurements(bag)
    if axis is not None:
        if axis not in found:
            raise RecordError(f"has no axis {axis}; there are "
                              f"{', '.join(found) or 'none'}", bag.path)
        found = {axis: found[axis]}
    if not found:
        raise RecordError("holds no measurement topic of an axis, only "
                          f"{', '.join(bag) or 'nothing'}", bag.path)
    with in_file(bag.path):
        axes = [_read_axis(bag, name, topic, run, sample_period) for name, topic in found.items()]
        return _on_one_time_base(bag, run, axes, gaps)


def _measurements(bag: Bag) -> dict[str, str]:
    """Return the measurement topic of each axis by the axis name, the shortest that is unique."""
    topics = [name for name, topic in bag.items() if name.rpartition("/")[2] == _MEASUREMENT
              and "measurement" in topic.type_name.lower() and topic.message_count]
    parts = {name: name.strip("/").split("/")[:-1] or ["x"] for name in topics}
    short = [part[-1] for part in parts.values()]
    return {("/".join(part) if short.count(part[-1]) > 1 else part[-1]): name
            for name, part in parts.items()}


class _Run:
    """What the bag says about the run as a whole."""

    def __init__(self, bag: Bag) -> None:
        self.notes: list[str] = []
        self.texts = {name: data.decode("utf-8", "replace")
                      for name, data in bag.attachments.items()}
        self.model, self.parameters, self.versions = map(
            self._tree, (MODEL_ATTACHMENT, PARAMETERS_ATTACHMENT, VERSIONS_ATTACHMENT))
        for name, node in self.parameters.items():
            run = node.get("run") if isinstance(node, Mapping) else None
            if isinstance(run, Mapping) and run.get("success") is False:
                self.notes.append(f"{name}: {run.get('experiment')} ended without success: "
                                  f"{run.get('message')}")

    def _tree(self, name: str) -> dict[str, Any]:
        from dfm_stage.yaml_text import YamlError, load_yaml

        try:
            tree = load_yaml(self.texts[name]) if self.texts.get(name) else {}
        except YamlError:
            tree = None
        if not isinstance(tree, dict):
            self.notes.append(f"{name} in the bag cannot be read")
            return {}
        return tree

    @property
    def period_s(self) -> float | None:
        """The sample period the run was set to, if the bag says one."""
        said = {self.model.get("sample_period")}
        said |= {node["parameters"].get("sample_period_s") for node in self.parameters.values()
                 if isinstance(node, Mapping) and isinstance(node.get("parameters"), Mapping)}
        numbers = {float(value) for value in said
                   if isinstance(value, (int, float)) and value > 0}
        return numbers.pop() if len(numbers) == 1 else None

    def input_unit(self, axis: str) -> str:
        """V, or A if the model of the run has a current drive."""
        axes = self.model.get("axes")
        part = axes.get(axis, {}) if isinstance(axes, dict) else self.model
        for place in (part, part.get("base") if isinstance(part, dict) else None, self.model):
            if isinstance(place, dict) and place.get("drive") == "current":
                return "A"
        return "V"


def _read_axis(bag: Bag, name: str, topic_name: str, run: _Run,
               sample_period: float | None) -> _Axis:
    measurement = bag[topic_name]
    prefix = topic_name[:-len(_MEASUREMENT)]
    grid = sample_grid(measurement, run.period_s, sample_period)
    notes = list(grid.notes)
    arrays = {"position": on_grid(grid, np.flatnonzero(grid.rows >= 0),
                                  measurement["position"][grid.rows[grid.rows >= 0]])}
    notes += jitter_note(grid, arrays["position"], "m", topic_name)
    if "flags" in measurement:
        flags = measurement["flags"][grid.rows[grid.rows >= 0]]
        notes += [f"{topic_name}: {int((flags & bit > 0).sum())} samples are flagged {meaning}"
                  for bit, meaning in _FLAGS.items() if (flags & bit).any()]
    source = next((bag[prefix + part] for part in ("amplifier", "command")
                   if prefix + part in bag and bag[prefix + part].message_count), None)
    if source is None:
        raise RecordError(f"{topic_name} has neither {prefix}amplifier nor {prefix}command beside "
                          f"it, so the input is not known; record those topics too")
    applied = applied_input(grid, source)
    notes += applied.notes
    arrays["input"] = applied.values
    if source.name.endswith("amplifier"):
        arrays["current"] = on_grid(grid, applied.answers[applied.in_window],
                                    source["current"][applied.in_window])
        off = int((~source["enabled"][applied.in_window]).sum())
        faults = int((source["faults"][applied.in_window] > 0).sum())
        notes += [f"{source.name}: {what}" for count, what in (
            (off, f"the output was off in {off} messages"),
            (faults, f"{faults} messages report faults")) if count]
    else:
        notes.append(f"{prefix}amplifier was not recorded; the command is taken as the input")
    arrays |= _other_arrays(bag, prefix, grid, source)
    return _Axis(name, grid, arrays, run.input_unit(name), notes)


def _other_arrays(bag: Bag, prefix: str, grid: SampleGrid, source: Topic) -> dict[str, FloatArray]:
    """Return what else belongs to samples by their number."""
    wanted: dict[str, tuple[str, dict[str, str]]] = {
        "reference": ("seq", {"position": "reference", "velocity": "reference_velocity",
                              "acceleration": "reference_acceleration"}),
        "excitation": ("seq", {"voltage": "excitation"}),
        "plant": ("seq", {"position": "plant_position", "velocity": "plant_velocity",
                          "force": "plant_force", "current": "plant_current"}),
        "command": ("measurement_seq", {"voltage": "command"})}
    arrays: dict[str, FloatArray] = {}
    for part, (key, columns) in wanted.items():
        topic = bag.get(prefix + part)
        if topic is None or not topic.message_count or topic is source:
            continue
        low, high = grid.log_window_ns
        near = (topic.log_time_ns >= low - 10**9) & (topic.log_time_ns <= high + 10**9)
        index = grid.index_of(topic[key][near])
        arrays |= {name: on_grid(grid, index, topic[column][near])
                   for column, name in columns.items() if column in topic}
    return arrays


def _on_one_time_base(bag: Bag, run: _Run, axes: list[_Axis], gaps: str) -> Record:
    """Bring the axes onto one time base and cut it to where everything is known."""
    warnings = [*map(str, bag.losses), *run.notes, *(note for axis in axes for note in axis.notes)]
    period, origin = axes[0].grid.period_s, int(axes[0].grid.stamps_ns[0])
    shifts = []
    for axis in axes:
        if abs(axis.grid.period_s - period) > 1e-4 * period:
            raise RecordError(f"axes {axes[0].name} and {axis.name} have different periods "
                              f"({period:.6g} and {axis.grid.period_s:.6g} s); read one of them")
        even = axis.grid.steady_ns - origin - np.arange(axis.grid.count) * period * 1e9
        offset = float(np.median(even)) * 1e-9 / period
        shifts.append(round(offset))
        apart = offset - round(offset)
        if abs(apart) > 0.1:
            warnings.append(f"axis {axis.name} is sampled {apart * period:.3g} s away from axis "
                            f"{axes[0].name}; both are put on the same samples")
    start = max(shifts)
    stop = min(shift + axis.grid.count for shift, axis in zip(shifts, axes, strict=True))
    if stop - start < 3:
        raise RecordError(f"the axes {', '.join(axis.name for axis in axes)} were not recorded at "
                          f"the same time; read one of them")
    cut = [{name: array[start - shift:stop - shift] for name, array in axis.arrays.items()}
           for shift, axis in zip(shifts, axes, strict=True)]
    valid = np.all([np.isfinite(part["position"]) & np.isfinite(part["input"]) for part in cut],
                   axis=0)
    keep = kept_samples(valid, period, gaps, warnings)
    result = {axis.name: _axis_record({name: array[keep] for name, array in part.items()},
                                      axis, warnings)
              for axis, part in zip(axes, cut, strict=True)}
    first = start + keep.start - shifts[0]
    return Record(
        period * np.arange(keep.stop - keep.start), period, result,
        Provenance(str(bag.path), "bag", "", int(axes[0].grid.stamps_ns[first]),
                   run.texts.get(MODEL_ATTACHMENT), run.parameters,
                   {str(key): str(value) for key, value in run.versions.items()}),
        warnings)


def kept_samples(valid: NDArray[np.bool_], period: float, gaps: str, warnings: list[str]) -> slice:
    """Return the samples to keep: what is known at both ends, and without a gap unless masked."""
    known = np.flatnonzero(valid)
    if len(known) < 3:
        raise RecordError("fewer than 3 samples have both a position and an input")
    first, last = int(known[0]), int(known[-1]) + 1
    tail = len(valid) - last
    warnings += [f"the {which} {count} samples ({count * period:.4g} s) have no input {when} and "
                 "were left out" for which, count, when, least in (
                     ("first", first, "yet", 0), ("last", tail, "any more", 2)) if count > least]
    after = np.flatnonzero(np.diff(known) > 1)
    if len(after):
        places = ", ".join(f"{(known[k] + 1 - first) * period:.6g} s "
                           f"({known[k + 1] - known[k] - 1})" for k in after[:5])
        warnings.append(f"{last - first - len(known)} samples are missing in {len(after)} gaps, "
                        f"at {places}{' ...' if len(after) > 5 else ''}")
        if gaps == "longest":
            begin, end = longest_stretch(len(known), after)
            warnings.append(f"the longest stretch without a gap was kept: {end - begin} of "
                            f"{last - first} samples")
            first, last = int(known[begin]), int(known[end - 1]) + 1
            if last - first < 3:
                raise RecordError("no stretch without a gap has 3 samples or more")
    return slice(first, last)


def _axis_record(part: dict[str, FloatArray], axis: _Axis, warnings: list[str]) -> AxisRecord:
    part = {name: array for name, array in part.items() if not np.isnan(array).all()}
    missing = {name: int(np.isnan(part[name]).sum()) for name in ("current", "reference")
               if name in part}
    warnings += [f"axis {axis.name}: {count} samples have no {name}"
                 for name, count in missing.items() if count]
    return AxisRecord(part.pop("input"), part.pop("position"), axis.input_unit, "m",
                      part.pop("current", None), part.pop("reference", None), part)
