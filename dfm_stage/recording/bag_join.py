"""Two fields of any bag become a record: rates joined on one even grid.

The output makes the grid: its samples are moved to even times at its own rate. The input is put
on it as what acted: of an input that stands until its next message, each period gets the mean, so
that its impulse stays what it was.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dfm_stage.recording.arrivals import counted
from dfm_stage.recording.bag import Bag
from dfm_stage.recording.bag_fields import FieldPath
from dfm_stage.recording.bag_record import kept_samples
from dfm_stage.recording.bag_signal import Signal, choose_clocks, signal_of, stamps_of
from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.record import AxisRecord, FloatArray, Ints, Provenance, Record
from dfm_stage.recording.table import DEFAULT_AXIS, Options
from dfm_stage.recording.time_base import fit_even, interpolate, mean_held, without_repeats
from dfm_stage.recording.units import measured

_FEWEST = 6
"""Values of a field: the error of a cubic is judged by the quintic of six."""
_EVEN_SHARE = 0.5
"""Of a period that half of the steps may be off where a timer sends the messages."""
_BRIDGED = 3.5
"""Periods from one message to the next that are bridged: up to two missing, and jitter."""


@dataclass(frozen=True)
class Samples:
    """A signal whose messages are sent by a timer.

    `index` (n,) are the numbers of the samples from 0, `time` (n,) s when each was taken: as its
    stamp says, or evenly where that is closer to the truth. `period` is that of the timer.
    """

    signal: Signal
    values: FloatArray
    rows: Ints
    index: Ints
    time: FloatArray
    start: float
    period: float
    even: bool


def joined_record(bag: Bag, options: Options) -> Record:
    """Return the record of the fields `options.input` and `options.output` of a bag.

    Raises
    ------
    RecordError, NotInBagError
        If a field is not there or there is no usable record in them.
    """
    if options.input is None or options.output is None:
        raise RecordError("name both the input and the output field, or neither", bag.path)
    notes = [*map(str, bag.losses)]
    with in_file(bag.path), np.errstate(over="ignore", invalid="ignore"):
        paths = {"input": FieldPath.parse(options.input),
                 "output": FieldPath.parse(options.output)}
        for path in paths.values():
            if path.topic in bag.left_out:
                raise RecordError(f"{path.topic}: {bag.left_out[path.topic]}")
        clocks = choose_clocks(bag, paths, options, notes)
        origin = int(stamps_of(bag, paths["output"], clocks["output"], options)[0])
        u, y = (signal_of(bag, paths[role], role, clocks[role], origin, options, notes)
                for role in ("input", "output"))
        samples = _samples(y, options.sample_period is not None, notes)
        period = samples.period
        if y.stamped and options.sample_period is not None:
            period = options.sample_period
        count = int((samples.time[-1] - samples.start) / period + 1e-6) + 1
        grid = np.asarray(samples.start + period * np.arange(count), np.float64)
        output = _through(samples, grid, period, notes)
        drive = _drive(u, samples, grid, period, options, notes)
        keep = kept_samples(np.isfinite(output) & np.isfinite(drive), period, options.gaps, notes)
    start = origin + round(1e9 * float(grid[keep.start]))
    period = options.sample_period or period
    unit, what = measured(y.unit)
    axis = AxisRecord(drive[keep], output[keep], u.unit, unit, measures=what,
                      input_hold=options.input_hold, input_shift=options.input_shift)
    return Record(period * np.arange(keep.stop - keep.start), period,
                  {options.axis or DEFAULT_AXIS: axis},
                  Provenance(str(bag.path), "bag", "", start), notes)


def _samples(signal: Signal, period_known: bool, notes: list[str]) -> Samples:
    """Number the messages of a signal and say when each sample was taken.

    Stamps of sampling are believed. Those of a transport only count the samples: these were taken
    evenly, and came late by different amounts.

    Raises
    ------
    RecordError
        If there are too few, or no timer sends them.
    """
    time, places = signal.time, np.arange(len(signal.time))
    own: list[str] = []
    if signal.stamped:
        time, places, own = without_repeats(time, places, signal.where)
    if len(time) < _FEWEST:
        raise RecordError(f"{signal.path} has only {len(time)} values; a record needs at least "
                          f"{_FEWEST}")
    index = counted(time)
    steps = np.diff(time) / np.diff(index)
    usual = float(np.median(steps))
    uneven = not np.median(np.abs(steps - np.mean(steps))) < _EVEN_SHARE * usual
    if uneven and not period_known:
        raise RecordError(f"{signal.path} comes in steps from {steps.min():.3g} to "
                          f"{steps.max():.3g} s by {signal.clock_words}, so there is no sample "
                          f"period; choose other times (--time), or give the sample period")
    notes += own
    values, rows = signal.values[places], signal.rows[places]
    base = fit_even(time, places, index, [])
    even = np.asarray(base.start + base.period * index, np.float64)
    off = time - even
    text = f"{signal.path}: {1 / base.period:.6g} Hz by {signal.clock_words}"
    if base.jitter is not None:
        text += (f", which wander by {np.sqrt(np.mean(off**2)):.3g} s rms, "
                 f"{np.abs(off).max():.3g} s at most")
    if base.jitter is not None and not signal.stamped:
        speed = float(np.sqrt(np.mean(np.diff(values)**2))) / base.period
        text += (f"; samples were taken as even, which is worth at most "
                 f"{np.sqrt(np.mean(off**2)) * speed:.2g} {signal.unit} rms if the sampling "
                 f"itself was that uneven")
    notes.append(text)
    notes += base.notes if base.jitter is None else []
    missing = int(index[-1]) + 1 - len(index)
    if missing:
        first = np.flatnonzero(np.diff(index) > 1)
        notes.append(f"{missing} messages seem to be missing in {len(first)} places, first before "
                     f"{signal.where(int(rows[first[0] + 1]))} ({time[first[0] + 1]:.6g} s)")
    exact = signal.stamped and base.jitter is not None
    return Samples(signal, values, rows, index, time if exact else even, base.start, base.period,
                   not exact)


def _through(samples: Samples, grid: FloatArray, period: float, notes: list[str]) -> FloatArray:
    """Return what a smooth signal was at the times of `grid`; NaN where too much is missing."""
    nodes, targets = ((time - samples.start) / samples.period for time in (samples.time, grid))
    after = np.clip(np.searchsorted(nodes, targets - 1e-9), 1, len(nodes) - 1)
    gap = nodes[after] - nodes[after - 1]
    away = np.minimum(np.abs(nodes[after] - targets), np.abs(targets - nodes[after - 1]))
    here = away < 1e-9
    bridged = (gap > 1.5) & (gap <= _BRIDGED) & ~here   # half a period of jitter is no gap
    cubic = interpolate(nodes, samples.values, targets, 4)
    error = cubic - interpolate(nodes, samples.values, targets, 6)
    cubic[(gap > _BRIDGED) & ~here] = np.nan
    path, unit = samples.signal.path, samples.signal.unit
    if not samples.even or period != samples.period or bridged.any():
        known = np.isfinite(cubic)
        notes.append(f"{path} was moved to even times by a cubic; estimated error "
                     f"{np.sqrt(np.mean(error[known]**2)):.3g} {unit} rms, "
                     f"{np.abs(error[known]).max(initial=0.0):.3g} {unit} at most")
    if bridged.any():
        notes.append(f"{path}: {int(bridged.sum())} samples lie in gaps of up to {_BRIDGED:g} "
                     f"periods and were filled in; estimated error "
                     f"{np.sqrt(np.mean(error[bridged]**2)):.3g} {unit} rms")
    return cubic


def _drive(u: Signal, y: Samples, grid: FloatArray, period: float, options: Options,
           notes: list[str]) -> FloatArray:
    """Return the input at the samples of `grid`; NaN where it is not known.

    An input that is sent unevenly, for instance when it changes, has no gaps: its last message
    stands.
    """
    beside = u.path.topic == y.signal.path.topic
    own: list[str] = []
    try:
        samples = _samples(u, options.sample_period is not None and beside, own)
    except RecordError:
        if beside or len(u.time) < 1:
            raise
        keep = np.flatnonzero(np.diff(u.time, append=np.inf) > 0)    # the last of one time
        time, values, usual = u.time[keep], u.values[keep], 0.0
        notes.append(f"{u.path} comes unevenly by {u.clock_words}; each message stands until the "
                     f"next, however late that is")
        missing = np.zeros(0, np.int64)
    else:
        notes += own if not beside else []
        time, values, usual = samples.time, samples.values, samples.period
        missing = np.flatnonzero(np.diff(time) > _BRIDGED * usual)
    held = options.input_hold in (None, "zero") or len(time) < _FEWEST
    if beside and samples.even and period == samples.period and held:
        return _standing(samples, grid, period)
    if held:
        drive, within = mean_held(time, values, float(grid[0]), period, len(grid))
        how = "the last message stands until the next and each period has the mean"
    else:
        nodes, targets = (time - grid[0]) / period, np.arange(len(grid), dtype=np.float64)
        drive = interpolate(nodes, values, targets, 4)
        within = drive - interpolate(nodes, values, targets, 6)
        how = "a cubic goes through the messages"
    end = float(time[-1]) + (usual if held else 0.0)
    tail = period if held else 0.0
    # an input beside the output begins and ends with it
    slack = period if beside else 1e-6 * period
    unknown = (grid < time[0] - slack) | (grid + tail > end + slack)
    for k in missing:
        unknown |= (grid + tail > time[k] + usual) & (grid < time[k + 1])
    drive[unknown] = np.nan
    if unknown.all():
        raise RecordError(f"{u.path} and {y.signal.path} were not recorded at the same time by "
                          f"{u.clock_words} and {y.signal.clock_words}")
    notes.append(_joined_note(u, y, grid[~unknown], time, how, within[~unknown]))
    return drive


def _standing(samples: Samples, grid: FloatArray, period: float) -> FloatArray:
    """Return an input beside an even output; across a short gap it stands."""
    index = np.round((samples.time - grid[0]) / period).astype(np.int64)
    inside = (index >= 0) & (index < len(grid))
    index, values = index[inside], samples.values[inside]
    drive = np.full(len(grid), np.nan)
    drive[index] = values
    for k in np.flatnonzero(np.diff(index) > 1):
        if index[k + 1] - index[k] <= _BRIDGED:
            drive[index[k] + 1:index[k + 1]] = values[k]
    return drive


def _joined_note(u: Signal, y: Samples, grid: FloatArray, time: FloatArray, how: str,
                 within: FloatArray) -> str:
    places = np.searchsorted(time, grid)
    away = np.minimum(np.abs(grid - time[np.clip(places - 1, 0, len(time) - 1)]),
                      np.abs(time[np.clip(places, 0, len(time) - 1)] - grid))
    return (f"{u.path} was put on the samples of {y.signal.path}: the nearest message is "
            f"{np.sqrt(np.mean(away**2)):.3g} s away rms, {away.max():.3g} s at most; {how}, "
            f"estimated error {np.sqrt(np.mean(within**2)):.3g} {u.unit} rms")
