"""From the time stamps of a table to an even time base, and what it costs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.record import FloatArray, Ints

EVEN_SHARE = 1e-3           # deviations below this share of a period do not count
SCATTER_SHARE = 0.1         # with more gaps than this share of the rows there is no sample period
MAX_JITTER_SHARE = 0.5
_PHASE_SAMPLES = 10
_LONGEST_GAP = 1e9          # samples
_LONGEST_MASK = 100         # times the samples there are
_MANY = 5
_PAST = 4                   # samples of the past in a regression
_THROUGH = 8                # samples that an interpolation goes through
_AT_ONCE = 100_000          # samples that are interpolated together
_FEWEST = 100               # samples from which times are judged by the motion
_EARLIEST = 0.01            # share of the samples that may seem earlier than the timer

Where = Callable[[int], str]


@dataclass(frozen=True)
class TimeBase:
    """An even time base: rows `rows` of the table are samples `index` on it.

    `jitter` (s) holds how much later each row was taken than its sample, None where the stamps
    are even or merely rounded. `input_late` says whether the input was set so much later, too.
    """

    start: float
    period: float
    rows: Ints
    index: Ints
    jitter: FloatArray | None = None
    notes: list[str] = field(default_factory=list)
    input_late: bool = True

    @property
    def length(self) -> int:
        """Samples from the first to the last."""
        return int(self.index[-1]) + 1

    @property
    def time(self) -> FloatArray:
        """The samples' times (length,), s."""
        return np.asarray(self.start + self.period * np.arange(self.length), np.float64)


def find_time_base(time: FloatArray, rows: Ints, where: Where,
                   gaps: str = "longest") -> TimeBase:
    """Return the even time base of the usable rows of a table.

    Parameters
    ----------
    time : (n,) float
        Their time stamps in s, finite.
    rows : (n,) int
        Their numbers in the table, ascending.
    where : callable
        Says where a row stands ("line 17").
    gaps : str
        `longest`: keep the longest stretch without a gap. `mask`: keep all, `index` has holes.

    Raises
    ------
    RecordError
        If there are too few rows, time runs backwards or stands still, or no period can be seen.
    """
    if len(time) < 3:
        raise RecordError(f"only {len(time)} usable rows; a record needs at least 3")
    time, rows, notes = without_repeats(time, rows, where)
    steps = np.diff(time)
    advance = _advance(time)
    after = np.flatnonzero(advance > 1)
    if len(after) > SCATTER_SHARE * len(steps):
        raise RecordError(
            f"time advances in steps from {steps.min():.3g} to {steps.max():.3g} s, so there is "
            f"no sample period; resample the data evenly, or give the sample period if the time "
            f"column is wrong")
    if len(after):
        notes.append(_gap_note(time, steps, rows, after, advance, where))
    if gaps == "mask" and advance.sum() > _LONGEST_MASK * len(time):
        raise RecordError("the gaps are far longer than the record; cut the file, or keep the "
                          "longest stretch (gaps='longest')")
    if len(after) and gaps == "longest":
        first, last = kept_stretch(rows, after, where, notes)
        time, rows, advance = time[first:last], rows[first:last], advance[first:last - 1]
        if len(time) < 3:
            raise RecordError("no stretch without a gap has 3 samples or more")
    return fit_even(time, rows, np.concatenate(([0], np.cumsum(advance))), notes)


def _advance(time: FloatArray) -> Ints:
    """Return how many samples each row is further than the one before it, (n - 1,).

    Where steps are uneven, a running average of the phase tells a late sample from a lost one:
    after a late one the next are on time again, after a lost one all come later.
    """
    steps = np.diff(time)
    period = float(np.median(steps))
    advance = np.ones(len(steps), np.int64)
    if not (np.abs(steps - period) > 0.5 * period).any():
        return advance
    first = min(_PHASE_SAMPLES, len(time))
    phase = float(np.median(time[:first] - period * np.arange(first)))
    for k, stamp in enumerate(time[1:].tolist()):
        ahead = max(round(min((stamp - phase) / period, _LONGEST_GAP)), 1)
        if ahead > 1:
            near = (time[k + 1:k + 1 + _PHASE_SAMPLES] - phase) / period
            least = float((near - np.arange(len(near))).min())
            ahead = max(round(min(least, _LONGEST_GAP)), 1)
        advance[k] = ahead
        phase += ahead * period
        phase += (stamp - phase) / _PHASE_SAMPLES
    return advance


def longest_stretch(count: int, after: Ints) -> tuple[int, int]:
    """Return (first, one past the last) of the longest stretch when it breaks behind `after`."""
    edges = np.concatenate(([0], after + 1, [count]))
    best = int(np.argmax(np.diff(edges)))
    return int(edges[best]), int(edges[best + 1])


def kept_stretch(rows: Ints, after: Ints, where: Where, notes: list[str]) -> tuple[int, int]:
    """Return the `longest_stretch` of rows, and note which that is where there are gaps."""
    first, last = longest_stretch(len(rows), after)
    if len(after):
        notes.append(f"the longest stretch without a gap was kept: {last - first} of {len(rows)} "
                     f"samples, {where(int(rows[first]))} to {where(int(rows[last - 1]))}")
    return first, last


def without_repeats(time: FloatArray, rows: Ints,
                    where: Where) -> tuple[FloatArray, Ints, list[str]]:
    """Leave out rows that repeat a time; (times, rows, notes).

    Raises
    ------
    RecordError
        If time runs backwards, or stands still in many places.
    """
    steps = np.diff(time)
    back = np.flatnonzero(steps < 0)
    if len(back):
        k = int(back[0])
        raise RecordError(
            f"{where(int(rows[k + 1]))}: time goes back from {time[k]:.9g} to {time[k + 1]:.9g} s"
            f"{_and_more(len(back))}; sort the rows, or cut the file where a new run starts")
    same = np.flatnonzero(steps == 0)
    if not len(same):
        return time, rows, []
    if len(same) > SCATTER_SHARE * len(steps):
        raise RecordError(
            f"{where(int(rows[same[0] + 1]))}: time stands still in {len(same)} rows; write the "
            f"time with more digits, or give the sample period instead")
    keep = np.concatenate(([True], steps != 0))
    note = (f"{where(int(rows[same[0] + 1]))}: repeats the time {time[same[0]]:.9g} s"
            f"{_and_more(len(same))}; repeated rows were left out")
    return time[keep], rows[keep], [note]


def _and_more(count: int) -> str:
    return f" (and {count - 1} more)" if count > 1 else ""


def _gap_note(time: FloatArray, steps: FloatArray, rows: Ints,
              after: Ints, advance: Ints, where: Where) -> str:
    missing = int(np.sum(advance[after] - 1))
    places = [f"{where(int(rows[k + 1]))} ({steps[k]:.4g} s at {time[k]:.6g} s)"
              for k in after[:_MANY]]
    more = f" and {len(after) - _MANY} more" if len(after) > _MANY else ""
    return f"{missing} samples are missing before {', '.join(places)}{more}"


def fit_even(time: FloatArray, rows: Ints, index: Ints, notes: list[str]) -> TimeBase:
    """Return the even time base of rows whose samples are numbered: `index` (n,) from 0."""
    slope, start = np.polyfit(index, time - time[0], 1)
    deviation = time - time[0] - (start + slope * index)
    worst = float(np.abs(deviation).max())
    start, resolution = float(time[0] + start), _resolution(time)
    if worst <= EVEN_SHARE * slope or worst <= 0.51 * resolution:
        if worst > 0.01 * slope:
            notes.append(f"time is rounded to {resolution:.3g} s; the samples were taken as even, "
                         f"{slope:.9g} s apart")
        return TimeBase(round_off(start, slope), round_off(float(slope), slope / len(time)),
                        rows, index, None, notes)
    rms = float(np.sqrt(np.mean(deviation**2)))
    if worst > MAX_JITTER_SHARE * slope:
        notes.append(f"some time stamps are off by more than half a period ({worst:.3g} s)")
    notes.append(f"time stamps jitter by {rms:.3g} s rms, {worst:.3g} s at most, around a period "
                 f"of {slope:.9g} s")
    return TimeBase(start, float(slope), rows, index, deviation, notes)


def round_off(value: float, scale: float) -> float:
    """Drop the digits of `value` that are below 1e-9 of `scale`: rounding errors."""
    digits = int(np.ceil(9 - np.log10(abs(scale)))) if scale else 12
    return round(value, digits)


def _resolution(time: FloatArray) -> float:
    """Return the decimal step that all stamps are multiples of, 0 if there is none."""
    for digits in range(13):
        scaled = time * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() < 1e-3 + 4e-16 * np.abs(scaled).max():
            return float(10.0**-digits)
    return 0.0


def resample(values: FloatArray, base: TimeBase) -> tuple[FloatArray, float]:
    """Move smooth samples from where they were taken to the even time base.

    Through each _THROUGH neighbours goes a polynomial. Its error is judged by what two more would
    change.

    Returns
    -------
    (values (n,), RMS of the estimated error in the unit of the values)
    """
    if base.jitter is None or len(values) < _THROUGH + 2:
        return values, 0.0
    nodes = base.index + base.jitter / base.period
    targets = base.index.astype(np.float64)
    found = interpolate(nodes, values, targets, _THROUGH)
    more = interpolate(nodes, values, targets, _THROUGH + 2)
    return found, float(np.sqrt(np.mean((found - more)**2)))


def interpolate(nodes: FloatArray, values: FloatArray, targets: FloatArray,
                count: int) -> FloatArray:
    """Lagrange interpolation through the `count` nodes around each target."""
    return np.concatenate([_interpolated(nodes, values, targets[at:at + _AT_ONCE], count)
                           for at in range(0, max(len(targets), 1), _AT_ONCE)])


def _interpolated(nodes: FloatArray, values: FloatArray, targets: FloatArray,
                  count: int) -> FloatArray:
    first = np.clip(np.searchsorted(nodes, targets) - count // 2, 0, len(nodes) - count)
    around = first[:, None] + np.arange(count)
    x, y = nodes[around] - targets[:, None], values[around]
    apart = x[:, :, None] - x[:, None, :] + np.eye(count)
    factors = np.where(np.eye(count, dtype=bool), 1.0, -x[:, None, :] / apart)
    return np.asarray(np.sum(np.prod(factors, axis=2) * y, axis=1))


def read_stamps(base: TimeBase, axes: Sequence[tuple[FloatArray, FloatArray]],
                held: bool) -> TimeBase:
    """Return what stamps that jitter tell, by input and position (n,) of all `axes`.

    Either a timer samples, and only the stamps are late; or the samples are late, and so is the
    input, as of a loop that wakes late; or the samples are late, and a timer sets the input. The
    last is looked for where the input is `held`.
    """
    if base.jitter is None or len(base.index) < _FEWEST:
        return base
    if _sampled_evenly([position for _, position in axes], base):
        note = "the position is smoother as even samples: the stamps tell the period only"
        return replace(base, jitter=None, notes=[*base.notes, note])
    if not held or np.any(np.diff(base.index) != 1):
        return base
    earliest = float(np.quantile(base.jitter, _EARLIEST))
    timer = replace(base, start=base.start + earliest, jitter=base.jitter - earliest,
                    input_late=False)
    left = [sum(math.log(_unforeseen(resample(position, each)[0], average_held(feed, each)))
                for feed, position in axes) for each in (base, timer)]
    if left[0] <= left[1]:
        return base
    note = "the motion says that the input changes at even times: only the samples are late"
    return replace(timer, notes=[*base.notes, note])


def _sampled_evenly(positions: Sequence[FloatArray], base: TimeBase) -> bool:
    """Whether the samples were taken evenly.

    A motion is smooth, and every error of its times makes it rougher: fourth differences are
    compared, as they stand and moved to where the stamps put them. That alone makes white noise
    smoother.
    """
    noise = np.random.default_rng(0).standard_normal(len(base.index))
    return sum(_rougher_moved(values, base) - _rougher_moved(noise, base)
               for values in positions) > 0.0


def _rougher_moved(values: FloatArray, base: TimeBase) -> float:
    """Logarithm of the power of fourth differences, moved over as it stands."""
    even, moved = (max(float(np.mean(np.diff(x, 4)**2)), 1e-300)
                   for x in (values, resample(values, base)[0]))
    return math.log(moved / even)


def _unforeseen(position: FloatArray, feed: FloatArray) -> float:
    """RMS that a regression on the last samples of both leaves of the position."""
    n = len(position)
    y, u = position - position.mean(), feed - feed.mean()
    past = np.column_stack([x[_PAST - k:n - k] for x in (y, u) for k in range(1, _PAST + 1)])
    past /= np.maximum(np.sqrt(np.mean(past**2, axis=0)), 1e-300)
    found = np.linalg.lstsq(past, y[_PAST:], rcond=None)[0]
    return max(float(np.sqrt(np.mean((y[_PAST:] - past @ found)**2))), 1e-300)


def average_held(values: FloatArray, base: TimeBase) -> FloatArray:
    """Average an input that is held from one stamp to the next over each even period.

    The integral of the input, its impulse on the stage, stays what it was.
    """
    if base.jitter is None or not base.input_late:
        return values
    edges = base.start + base.period * base.index + base.jitter
    return mean_held(edges, values, base.start, base.period, base.length)[0][base.index]


def mean_held(edges: FloatArray, values: FloatArray, start: float, period: float,
              count: int) -> tuple[FloatArray, FloatArray]:
    """Average a signal whose `values` (n,) stand from each of the times `edges` (n,) on.

    Returns
    -------
    (its mean over each of `count` periods from `start` on, the RMS of what is left in each)
    """
    even = start + period * np.arange(count + 1)

    def mean(of: FloatArray) -> FloatArray:
        impulse = np.concatenate(([0.0], np.cumsum(of[:-1] * np.diff(edges))))
        total = np.interp(even, edges, impulse)
        before, after = even < edges[0], even > edges[-1]
        total[before] = (even[before] - edges[0]) * of[0]
        total[after] = impulse[-1] + (even[after] - edges[-1]) * of[-1]
        return np.asarray(np.diff(total) / period, np.float64)

    middle = float(np.mean(values))     # squares of what is left, not of an offset
    means = mean(values)
    spread = mean((values - middle)**2) - (means - middle)**2
    return means, np.sqrt(np.maximum(spread, 0.0))
