"""Parts of a record, and a record at another period."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.record import AxisRecord, FloatArray, Record
from dfm_stage.recording.time_base import interpolate, longest_stretch, mean_held

SAME_SHARE = 1e-6
"""Two periods that differ by no more are the same (identification asks for this)."""
CLOCK_SHARE = 1e-4
"""What the clocks of a logger and of a stage may differ by: two quartz oscillators, 50 ppm each.
All times are then off by as much, which is less than interpolation would cost."""
NEAR_SHARE = 0.05
"""A period further from the wanted one is a choice, not an inaccuracy."""
FEWEST_SAMPLES = 3
FILLED = 2
"""Samples in a row that are filled in: a cubic across three steps still follows the motion."""
_HELD = ("input", "excitation", "command")


def part(record: Record, first: int, last: int, words: str) -> Record:
    """Return the samples from `first` up to, not including, `last`; the warnings say so.

    Raises
    ------
    RecordError
        If fewer than 3 samples are in it; `words` say what was asked for.
    """
    count, source = len(record), record.provenance.source
    if first < 0 or first >= count or min(last, count) - first < FEWEST_SAMPLES:
        raise RecordError(f"{words} leaves {max(min(last, count) - max(first, 0), 0)} of {count} "
                          f"samples ({record.duration:.6g} s); choose a part of at least "
                          f"{FEWEST_SAMPLES}", source)
    beyond = " (the record ends before)" if last > count else ""
    last = min(last, count)
    cut = record.slice(first, last)
    return replace(cut, warnings=[*record.warnings, (
        f"{words}: samples {first} to {last - 1} of {count} were used{beyond}")])


def without_gaps(record: Record) -> Record:
    """Return the longest part in which the input and the output of all axes are known.

    Raises
    ------
    RecordError
        If it has fewer than 3 samples.
    """
    known = np.flatnonzero(np.all([np.isfinite(each.input) & np.isfinite(each.position)
                                   for each in record.axes.values()], axis=0))
    after = np.flatnonzero(np.diff(known) > 1)
    begin, end = longest_stretch(len(known), after)
    if end - begin < FEWEST_SAMPLES:
        raise RecordError("no stretch without a gap has 3 samples or more",
                          record.provenance.source)
    if end - begin == len(record):
        return record
    first, last = int(known[begin]), int(known[end - 1]) + 1
    return replace(record.slice(first, last), warnings=[*record.warnings, (
        f"the longest stretch without a gap was kept: {last - first} of {len(record)} samples")])


def filled(record: Record) -> Record:
    """Return a record whose short gaps, of up to FILLED samples in a row, are filled in.

    Outputs go through the cubic of the four nearest known samples; the error is judged by the
    quintic of six. An input that stands between samples, or
    of which that is not known, keeps its last value; its error is at most the step to the next.
    """
    axes, notes = {}, []
    for name, axis in record.axes.items():
        label = f"axis {name}: " if len(record.axes) > 1 else ""
        held = axis.input_hold in (None, "zero")
        found = {key: _without_short_gaps(values, held and key in _HELD)
                 for key, values in axis.arrays().items()}
        _, many, error = found["position"]
        _, inputs, step = found["input"]
        if many or inputs:
            notes.append(f"{label}{max(many, inputs)} samples in gaps of up to {FILLED} were "
                         f"filled in; estimated error of the output {error:.3g} "
                         f"{axis.output_unit} rms, of the input {step:.3g} {axis.input_unit} rms "
                         f"at most")
        arrays = {key: values for key, (values, _, _) in found.items()}
        extra = {key: arrays.pop(key) for key in axis.extra}
        axes[name] = replace(axis, **arrays, extra=extra)  # type: ignore[arg-type]
    return replace(record, axes=axes, warnings=[*record.warnings, *notes])


def _without_short_gaps(values: FloatArray, stands: bool) -> tuple[FloatArray, int, float]:
    """Return (the values with short gaps filled, how many were, RMS of the estimated error)."""
    missing = ~np.isfinite(values)
    known = np.flatnonzero(~missing)
    if len(known) < 6 or not missing.any():
        return values, 0, 0.0
    places = np.flatnonzero(missing)
    after = np.searchsorted(known, places)
    inside = (after > 0) & (after < len(known))
    places, after = places[inside], after[inside]
    short = known[after] - known[after - 1] <= FILLED + 1
    places, after = places[short], after[short]
    if not len(places):
        return values, 0, 0.0
    result = values.copy()
    if stands:
        result[places] = values[known[after - 1]]
        error = values[known[after]] - values[known[after - 1]]
    else:
        nodes = known.astype(np.float64)
        result[places] = interpolate(nodes, values[known], places.astype(np.float64), 4)
        error = result[places] - interpolate(nodes, values[known], places.astype(np.float64), 6)
    return result, len(places), float(np.sqrt(np.mean(error**2)))


def split(record: Record, share: float) -> tuple[Record, Record]:
    """Return the first `share` of a record, and the rest.

    Raises
    ------
    RecordError
        If the share is not between 0 and 1, or one part has fewer than 3 samples.
    """
    if not 0.0 < share < 1.0:
        raise RecordError(f"a split of {share:g} is impossible; give the share to fit, between 0 "
                          f"and 1")
    at = round(share * len(record))
    words = f"split at {share:g}"
    return part(record, 0, at, words), part(record, at, len(record), words)


def at_period(record: Record, period: float) -> Record:
    """Return a record as if sampled every `period` s, where it nearly is; `warnings` say how.

    The clocks of two machines differ a little: up to CLOCK_SHARE the samples are taken as they
    are. Up to NEAR_SHARE outputs go through a cubic of the four nearest samples, the error judged
    by the quintic of six. An input that stands between samples, or of which that is not known,
    gets its mean over each new period; one said to do otherwise goes through the cubic.

    Raises
    ------
    RecordError
        If the periods are further apart.
    """
    share = record.sample_period / period - 1.0
    if abs(share) <= SAME_SHARE:
        return record
    if abs(share) <= CLOCK_SHARE:
        time = record.time[0] + period * np.arange(len(record))
        return replace(record, time=np.asarray(time, np.float64), sample_period=period, warnings=[
            *record.warnings, (
                f"sampled every {record.sample_period:.9g} s and taken as every {period:.9g} s: "
                f"all times are off by {share * 1e6:.2g} ppm")])
    if abs(share) > NEAR_SHARE:
        raise RecordError(
            f"sampled every {record.sample_period:g} s, not {period:g} s; set sample_period: "
            f"{record.sample_period:g} in the model, or resample the record (up to "
            f"{100 * NEAR_SHARE:g} % it is done here)", record.provenance.source)
    # one period less than fits: the last input stands for a period of its own
    count = int((len(record) - 1) * record.sample_period / period + 1e-9) + 1
    axes, notes = {}, []
    for name, axis in record.axes.items():
        axes[name], errors = _resampled(axis, record.sample_period, period, count)
        label = f"axis {name}: " if len(record.axes) > 1 else ""
        notes.append(f"{label}resampled from every {record.sample_period:.9g} s to every "
                     f"{period:.9g} s; estimated error of the output {errors[0]:.3g} "
                     f"{axis.output_unit} rms, of the input {errors[1]:.3g} {axis.input_unit} rms")
    time = record.time[0] + period * np.arange(count)
    return Record(np.asarray(time, np.float64), period, axes, record.provenance,
                  [*record.warnings, *notes])


def shared_period(records: Sequence[Record], wanted: float) -> float:
    """Return the period (s) at which to fit: the `wanted` one, or that of the records, where they
    share one that is near it. A model steps by any period; resampling has an error."""
    period = records[0].sample_period
    shared = all(abs(r.sample_period / period - 1.0) <= CLOCK_SHARE for r in records)
    near = CLOCK_SHARE < abs(period / wanted - 1.0) <= NEAR_SHARE
    return period if shared and near else wanted


def _resampled(axis: AxisRecord, old: float, new: float,
               count: int) -> tuple[AxisRecord, tuple[float, float]]:
    """Return the axis and the RMS of the estimated errors of output and input."""
    held = axis.input_hold in (None, "zero")
    found, errors = {}, {}
    for name, values in axis.arrays().items():
        if held and name in _HELD:
            times = np.asarray(old * np.arange(len(values)), np.float64)
            found[name], error = mean_held(times, values, 0.0, new, count)
        else:
            found[name], error = _through(values, new / old, count)
        errors[name] = float(np.sqrt(np.mean(error**2)))
    extra = {name: found.pop(name) for name in axis.extra}
    return (replace(axis, **found, extra=extra),  # type: ignore[arg-type]
            (errors["position"], errors["input"]))


def _through(values: FloatArray, ratio: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the values every `ratio` samples, and by how much a higher order differs."""
    nodes = np.arange(len(values), dtype=np.float64)
    targets = np.asarray(ratio * np.arange(count), np.float64)
    if len(values) < 6:
        return np.interp(targets, nodes, values), np.zeros(count)
    cubic = interpolate(nodes, values, targets, 4)
    return cubic, np.asarray(cubic - interpolate(nodes, values, targets, 6))
