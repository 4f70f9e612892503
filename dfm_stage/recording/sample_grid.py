"""The samples of one axis in a bag, in the order of their numbers, and what belongs to each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.bag import Topic
from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.record import FloatArray, Ints
from dfm_stage.recording.time_base import longest_stretch, round_off

_WRAP = 1 << 32
_LARGEST_JUMP = 1_000_000       # a larger step in the numbers is a restart, not a loss
_NOMINAL_SHARE = 0.01           # stamps may differ by this share from the period that was set
_JITTER_SHARE = 0.05
_CLOCK_STEP_NS = 10**9          # time that passes between two samples and is no stall


@dataclass(frozen=True)
class SampleGrid:
    """Samples 0 .. count - 1 of an axis.

    Attributes
    ----------
    first_seq : number that the first sample has in the bag
    rows : (count,) row of each sample in the measurement topic, -1 where it is missing
    stamps_ns : (count,) when each was taken, as stamped; missing ones in between
    steady_ns : (count,) the same without the steps of a clock that was set meanwhile
    period_s : sample period
    log_window_ns : earliest and latest log time of the measurements
    notes : what was found on the way
    """

    first_seq: int
    rows: Ints
    stamps_ns: Ints
    steady_ns: Ints
    period_s: float
    log_window_ns: tuple[int, int]
    notes: list[str] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of samples, missing ones included."""
        return len(self.rows)

    def index_of(self, seq: NDArray[np.uint32]) -> Ints:
        """Return the sample that each number means; outside 0 .. count - 1 for others."""
        ahead = (seq.astype(np.int64) - self.first_seq) % _WRAP
        return np.where(ahead >= _WRAP // 2, ahead - _WRAP, ahead)


def sample_grid(measurement: Topic, nominal_s: float | None, given_s: float | None) -> SampleGrid:
    """Order the measurements of an axis by their numbers.

    Parameters
    ----------
    nominal_s : float or None
        The period that the run was set to, used if the stamps agree with it.
    given_s : float or None
        The period to use in any case.

    Raises
    ------
    RecordError
        If there are fewer than 3 measurements.
    """
    notes: list[str] = []
    name = measurement.name
    seq = measurement["seq"].astype(np.int64)
    if len(seq) < 3:
        raise RecordError(f"{name} holds {len(seq)} messages; a record needs at least 3")
    rows = np.arange(len(seq))
    step = np.diff(seq)
    seq = seq + np.concatenate(([0], np.cumsum(np.where(step < -_WRAP // 2, _WRAP, 0))))
    step = np.diff(seq)
    if (step == 0).any():
        notes.append(f"{name}: {int((step == 0).sum())} samples came twice; the first was used")
        keep = np.concatenate(([True], step != 0))
        seq, rows = seq[keep], rows[keep]
        step = np.diff(seq)
    restarts = np.flatnonzero((step < 0) | (step > _LARGEST_JUMP))
    if len(restarts):
        first, last = longest_stretch(len(seq), restarts)
        notes.append(f"{name}: the sample numbers start anew {len(restarts)} times (the encoder "
                     f"driver was restarted); the longest part was kept, {last - first} of "
                     f"{len(seq)} samples")
        seq, rows = seq[first:last], rows[first:last]
    index = seq - seq[0]
    place = np.full(int(index[-1]) + 1, -1, np.int64)
    place[index] = rows
    stamps = measurement["header.stamp"][rows]
    steady = _without_clock_steps(index, stamps, name, notes)
    log = measurement.log_time_ns[rows]
    return SampleGrid(int(seq[0] % _WRAP), place, _fill_missing_stamps(index, stamps),
                      _fill_missing_stamps(index, steady),
                      _period(index, steady, nominal_s, given_s, name, notes),
                      (int(log.min()), int(log.max())), notes)


def _fill_missing_stamps(index: Ints, stamps: Ints) -> Ints:
    """Put stamps in between where samples are missing."""
    between = np.interp(np.arange(index[-1] + 1), index, stamps - stamps[0])
    return np.asarray(np.round(between).astype(np.int64) + stamps[0], np.int64)


def _without_clock_steps(index: Ints, stamps: Ints, name: str, notes: list[str]) -> Ints:
    advance, samples = np.diff(stamps), np.diff(index)
    excess = advance - np.round(float(np.median(advance / samples)) * samples).astype(np.int64)
    step = np.where((advance < 0) | (excess > _CLOCK_STEP_NS), excess, 0)
    places = np.flatnonzero(step)
    if not len(places):
        return stamps
    notes.append(f"{name}: the clock was set {len(places)} times while recording, first by "
                 f"{step[places[0]] * 1e-9:.3g} s; samples were taken by their numbers")
    return np.asarray(stamps - np.concatenate(([0], np.cumsum(step))), np.int64)


def _period(index: Ints, stamps: Ints, nominal_s: float | None, given_s: float | None, name: str,
            notes: list[str]) -> float:
    slope = float(np.polyfit(index, (stamps - stamps[0]) * 1e-9, 1)[0])
    period = estimate = round_off(slope, slope / len(index))
    if given_s is not None:
        period = given_s
    elif nominal_s is not None and abs(estimate - nominal_s) <= _NOMINAL_SHARE * nominal_s:
        period = nominal_s
    elif nominal_s is not None:
        notes.append(f"{name}: the stamps show a period of {estimate:.6g} s, the run was set to "
                     f"{nominal_s:.6g} s; that of the stamps was used")
    if not period > 0:
        raise RecordError(f"{name}: time does not advance; give the sample period")
    return period


def jitter_note(grid: SampleGrid, position: FloatArray, unit: str, name: str) -> list[str]:
    """Say how unevenly the samples were taken and what that is worth; nothing if it is little."""
    deviation = (grid.steady_ns - grid.steady_ns[0]) * 1e-9
    deviation -= grid.period_s * np.arange(grid.count)
    deviation -= np.median(deviation)
    deviation = deviation[grid.rows >= 0]
    rms = float(np.sqrt(np.mean(deviation**2)))
    if rms <= _JITTER_SHARE * grid.period_s:
        return []
    known = position[grid.rows >= 0]
    velocity = float(np.sqrt(np.mean(np.diff(known)**2))) / grid.period_s if len(known) > 1 else 0
    return [(f"{name}: the stamps wander by {rms:.3g} s rms around even steps of "
             f"{grid.period_s:.6g} s; samples were taken as even by their numbers, which is worth "
             f"at most {rms * velocity:.2g} {unit} rms if the sampling itself was that uneven")]


def on_grid(grid: SampleGrid, index: Ints, values: FloatArray) -> FloatArray:
    """Return one value for each sample, NaN where there is none; the last of several counts."""
    result = np.full(grid.count, np.nan)
    inside = (index >= 0) & (index < grid.count)
    result[index[inside]] = values[inside]
    return result


@dataclass(frozen=True)
class AppliedInput:
    """The input of each sample, (count,), NaN where unknown; `answers` is the message's sample."""

    values: FloatArray
    answers: Ints
    in_window: NDArray[np.bool_]
    notes: Sequence[str]


def applied_input(grid: SampleGrid, topic: Topic) -> AppliedInput:
    """Return what was applied in answer to each sample.

    A message acts from the sample it answers; one that comes more than a period late, or answers
    nothing new (an output switched off in between), from the sample during which it was sent.
    Until the next message the output stands, unless messages in between are missing.
    """
    notes = []
    low, high = grid.log_window_ns
    margin = 1_000_000_000
    window = (topic.log_time_ns >= low - margin) & (topic.log_time_ns <= high + margin)
    answers = grid.index_of(topic["measurement_seq"])
    index, sent = answers[window].copy(), topic["header.stamp"][window]
    seq, voltage = topic["seq"][window].astype(np.int64), topic["voltage"][window]
    inside = (index >= 0) & (index < grid.count)
    if not inside.any():
        return AppliedInput(np.full(grid.count, np.nan), answers, window,
                            [f"{topic.name}: no message answers a measurement in the bag"])
    period_ns = grid.period_s * 1e9
    delay = sent - grid.stamps_ns[np.clip(index, 0, grid.count - 1)]
    usual = float(np.median(delay[inside]))
    if not -0.1 * period_ns <= usual <= period_ns:
        notes.append(f"{topic.name}: its stamps are {usual * 1e-9:.4g} s away from those of the "
                     f"measurements; the clocks differ, or every answer is late")
        sent, delay = sent - round(usual), delay - usual
    repeated = np.concatenate(([False], index[1:] <= np.maximum.accumulate(index)[:-1]))
    moved = repeated | ~inside | (delay > period_ns)
    index[moved] = np.searchsorted(np.maximum.accumulate(grid.stamps_ns), sent[moved],
                                   side="right") - 1
    late = int((inside & ~repeated & (delay > period_ns)).sum())
    if late:
        notes.append(f"{topic.name}: {late} answers came more than a period late and were put "
                     f"where they acted")
    values = np.full(grid.count, np.nan)
    usable = (index >= 0) & (index < grid.count)
    order = np.argsort(index[usable], kind="stable")
    values[index[usable][order]] = voltage[usable][order]
    held = _hold(values, index, np.flatnonzero(np.diff(seq) != 1), topic.name, notes)
    return AppliedInput(held, answers, window, notes)


def _hold(values: FloatArray, index: Ints, lost: Ints, name: str,
          notes: list[str]) -> FloatArray:
    """Let each value stand until the next one, except across messages that are missing."""
    fresh = ~np.isnan(values)
    known = np.flatnonzero(fresh)
    if not len(known):
        return values
    held = values[np.maximum.accumulate(np.where(fresh, np.arange(len(values)), 0))]
    held[known[-1] + 1:] = np.nan
    for k in lost:
        unknown = np.arange(max(index[k] + 1, 0), min(index[k + 1], len(values)))
        held[unknown[~fresh[unknown]]] = np.nan
    stood = int((~np.isnan(held) & ~fresh).sum())
    if stood:
        notes.append(f"{name}: {stood} samples had no answer; the output before them stood")
    gone = int(np.isnan(held[known[0]:known[-1] + 1]).sum())
    if gone:
        notes.append(f"{name}: messages are missing; the input of {gone} samples is not known")
    return held
