"""Two fields of any bag become a record: times chosen, rates joined on one even grid.

The output makes the grid: its samples are moved to even times at its own rate. The input is put
on it as what acted: of an input that stands until its next message, each period gets the mean, so
that its impulse stays what it was.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.arrivals import counted
from dfm_stage.recording.bag import Bag, Topic
from dfm_stage.recording.bag_fields import FieldPath, field_values
from dfm_stage.recording.bag_record import kept_samples
from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.record import AxisRecord, FloatArray, Ints, Provenance, Record
from dfm_stage.recording.table import DEFAULT_AXIS, Options
from dfm_stage.recording.time_base import (
    TimeBase,
    find_time_base,
    interpolate,
    mean_held,
    resample,
)
from dfm_stage.recording.units import Unit, measured, suffix_of, unit_of

CLOCKS = ("header", "publish", "arrival")
"""Times of a message: as its header says, when it was sent, when it was recorded."""
_FEWEST = 3
_EVEN_SHARE = 0.5   # of a period that half the steps may be off where a timer sends messages
_APART_S = 1.0      # header and arrival of one topic that differ by more are on different clocks
_ANY = r"\w+/msg/\w+"
_REP_103 = (
    ("sensor_msgs/msg/JointState", "position", "rad"),
    ("sensor_msgs/msg/JointState", "velocity", "rad/s"),
    ("sensor_msgs/msg/JointState", "effort", "N m"),
    (_ANY, r"(.*\.)?force\.[xyz]", "N"), (_ANY, r"(.*\.)?torque\.[xyz]", "N m"),
    (_ANY, r"(.*\.)?linear\.[xyz]", "m/s"),
    (_ANY, r"(.*\.)?(angular|angular_velocity)\.[xyz]", "rad/s"),
    (_ANY, r"(.*\.)?linear_acceleration\.[xyz]", "m/s^2"),
    (_ANY, r"(.*\.)?(position|translation)\.[xyz]", "m"),
    (_ANY, r"(.*\.)?voltage", "V"), (_ANY, r"(.*\.)?current", "A"))
"""Units of common messages: (type, field, unit)."""


@dataclass(frozen=True)
class Signal:
    """One field over time, in SI where its unit is known.

    `time` (n,) s since the origin; `rows` (n,) are the messages; `stamped` says that the times
    are those of sampling and not of a transport, which comes late by different amounts.
    """

    path: FieldPath
    rows: Ints
    time: FloatArray
    values: FloatArray
    unit: str
    clock: str
    stamped: bool

    def where(self, row: int) -> str:
        """Return where a value stands, as the user counts."""
        return f"{self.path.topic}, message {row}"


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
        clocks = _clocks(bag, paths, options, notes)
        origin = int(_stamps(bag, paths["output"], clocks["output"], options)[0])
        u, y = (_signal(bag, paths[role], role, clocks[role], origin, options, notes)
                for role in ("input", "output"))
        base = _even(y, options.gaps, options.sample_period, notes)
        position, error = resample(y.values[base.rows], base)
        if base.jitter is not None:
            notes.append(f"{y.path} was moved to even times; estimated error {error:.3g} "
                         f"{y.unit} rms")
        if u.path.topic == y.path.topic and np.array_equal(u.rows, y.rows):
            drive = _beside(u, base, options)
        else:
            drive = _joined(u, y, base, options, notes)
        output = np.full(base.length, np.nan)
        output[base.index] = position
        keep = kept_samples(np.isfinite(output) & np.isfinite(drive), base.period, options.gaps,
                            notes)
    period = options.sample_period or base.period
    unit, what = measured(y.unit)
    axis = AxisRecord(drive[keep], output[keep], u.unit, unit, measures=what,
                      input_hold=options.input_hold, input_shift=options.input_shift)
    start = origin + round(1e9 * (base.start + keep.start * base.period))
    return Record(period * np.arange(keep.stop - keep.start), period,
                  {options.axis or DEFAULT_AXIS: axis},
                  Provenance(str(bag.path), "bag", "", start), notes)


def _header(topic: Topic) -> str | None:
    """The column with the stamp of the header, or of the message itself."""
    return next((name for name in ("header.stamp", "stamp") if name in topic.time_columns), None)


def _clocks(bag: Bag, paths: dict[str, FieldPath], options: Options,
            notes: list[str]) -> dict[str, str]:
    """Choose the clock of each field: the one asked for, else stamps where there are any."""
    if options.time is not None and options.time not in CLOCKS:
        if {path.topic for path in paths.values()} != {FieldPath.parse(options.time).topic}:
            raise RecordError(f"the time {options.time} is not in the topic of both input and "
                              f"output; choose one of {', '.join(CLOCKS)}")
        return dict.fromkeys(paths, options.time)
    chosen = {role: options.time or _usual_clock(bag[path.topic])
              for role, path in paths.items()}
    for role, path in paths.items():
        if chosen[role] == "header" and _header(bag[path.topic]) is None:
            raise RecordError(f"{path.topic}: {bag[path.topic].type_name} has no header; choose "
                              f"--time arrival or publish")
    if len(set(chosen.values())) > 1:
        late = [_late_s(bag[path.topic]) for role, path in paths.items()
                if chosen[role] == "header"]
        if max(map(abs, late)) > _APART_S:
            notes.append(f"header stamps are {max(late, key=abs):.4g} s away from arrival, and "
                         f"one topic has none; arrival was used for both")
            return dict.fromkeys(paths, "arrival")
        notes.append("only one topic has header stamps; the transport of the other counts as "
                     "delay (--time arrival or publish takes both alike)")
    return chosen


def _usual_clock(topic: Topic) -> str:
    header = _header(topic)
    if header is not None and (topic[header] > 0).all():
        return "header"
    return "publish" if (topic.publish_time_ns > 0).all() else "arrival"


def _late_s(topic: Topic) -> float:
    return float(np.median(topic.log_time_ns - topic[_header(topic) or ""])) * 1e-9


def _stamps(bag: Bag, path: FieldPath, clock: str, options: Options) -> NDArray[np.int64]:
    """Return the times of all messages of a topic, (N,) ns."""
    topic = bag[path.topic]
    if not topic.message_count:
        raise RecordError(f"{path.topic} holds no messages")
    if clock == "header":
        return np.asarray(topic[_header(topic) or ""], np.int64)
    if clock in CLOCKS:
        return topic.publish_time_ns if clock == "publish" else topic.log_time_ns
    field = FieldPath.parse(clock)
    if field.column in topic.time_columns and not field.indices:
        return np.asarray(topic[field.column], np.int64)
    rows, values = field_values(topic, field)
    if len(rows) < topic.message_count:
        raise RecordError(f"{field}: {topic.message_count - len(rows)} messages have no such time")
    return np.asarray(np.round(values * 1e9 * _time_unit(field, options)), np.int64)


def _time_unit(field: FieldPath, options: Options) -> float:
    unit = unit_of(options.time_unit) if options.time_unit else suffix_of(field.column)[1]
    if unit is None or unit.base != "s":
        raise RecordError(f"{field}: its unit of time is not known; say --time-unit s, ms, us or "
                          f"ns")
    return unit.factor


def _signal(bag: Bag, path: FieldPath, role: str, clock: str, origin: int, options: Options,
            notes: list[str]) -> Signal:
    topic = bag[path.topic]
    rows, values = field_values(topic, path)
    lacking = topic.message_count - len(rows)
    good = np.isfinite(values)
    if lacking or not good.all():
        notes.append(f"{path}: {lacking + int((~good).sum())} of {topic.message_count} messages "
                     f"hold no value and were left out")
    rows, values = rows[good], values[good]
    ahead = _stamps(bag, path, clock, options)[rows] - origin
    time = np.asarray(ahead * 1e-9, np.float64)
    if clock in ("publish", "arrival"):
        order = np.argsort(time, kind="stable")
        rows, values, time = rows[order], values[order], time[order]
    unit = _unit(topic, path, role, options, notes)
    return Signal(path, rows, time, values * unit.factor, unit.base, clock,
                  clock not in ("publish", "arrival"))


def _unit(topic: Topic, path: FieldPath, role: str, options: Options, notes: list[str]) -> Unit:
    """The unit: as given, as the field's name says, as REP 103 has it, or V and m."""
    given = options.input_unit if role == "input" else options.output_unit
    of_input = role == "input"
    if given:
        return unit_of(given, of_input=of_input) or Unit(given)
    named = suffix_of(path.column.rpartition(".")[2], of_input=of_input)[1]
    if named:
        return named
    usual = next((unit for type_name, field, unit in _REP_103
                  if re.fullmatch(type_name, topic.type_name)
                  and re.fullmatch(field, path.column)), None)
    unit = usual or ("V" if of_input else
                     "m/s" if path.column.rpartition(".")[2] == "velocity" else "m")
    notes.append(f"{path} was taken as {unit}{', as REP 103 has it' if usual else ''} (say "
                 f"--{role}-unit)")
    return Unit(unit)


def _even(signal: Signal, gaps: str, given: float | None, notes: list[str]) -> TimeBase:
    """Return the even times of the samples of a signal.

    Stamps of sampling are believed. Those of a transport only count the samples: these were taken
    evenly, and came late by different amounts. With the sample period `given` that is not asked.
    """
    if signal.stamped:
        base = find_time_base(signal.time, signal.rows, signal.where, gaps)
        # the rows of a time base are places in the signal from here on
        base = replace(base, rows=np.searchsorted(signal.rows, base.rows))
        notes += base.notes
        notes.append(f"{signal.path}: {_rate(1 / base.period)} by {_clock_words(signal.clock)}")
        return base
    return _by_order(signal, given, notes)


def _rate(hertz: float) -> str:
    return f"{hertz:.6g} Hz"


def _clock_words(clock: str) -> str:
    return f"{clock} times" if clock in CLOCKS else clock


def _by_order(signal: Signal, given: float | None, notes: list[str]) -> TimeBase:
    time = signal.time
    if len(time) < _FEWEST:
        raise RecordError(f"{signal.path} has only {len(time)} values; a record needs at least "
                          f"{_FEWEST}")
    index = counted(time)
    steps = np.diff(time) / np.diff(index)
    period = float(np.median(steps))
    if given is None and not np.median(np.abs(steps - np.mean(steps))) < _EVEN_SHARE * period:
        raise RecordError(f"{signal.path} comes in steps from {steps.min():.3g} to "
                          f"{steps.max():.3g} s by {_clock_words(signal.clock)}, so there is no "
                          f"sample period; choose --time header, or give the sample period")
    slope, start = np.polyfit(index, time, 1)
    if not slope > 0:
        raise RecordError(f"{signal.path}: time does not advance by {_clock_words(signal.clock)}")
    off = time - start - slope * index
    lost = int(index[-1]) + 1 - len(index)
    rms = float(np.sqrt(np.mean(off**2)))
    speed = float(np.sqrt(np.mean(np.diff(signal.values)**2))) / slope
    notes.append(
        f"{signal.path}: {_rate(1 / slope)} by {_clock_words(signal.clock)}, which wander by "
        f"{rms:.3g} s rms, {np.abs(off).max():.3g} s at most; samples were taken as even, which "
        f"is worth at most {rms * speed:.2g} {signal.unit} rms if the sampling itself was that "
        f"uneven")
    if lost:
        notes.append(f"{signal.path}: {lost} messages seem to be missing")
    return TimeBase(float(start), float(slope), np.arange(len(time)), index)


def _beside(u: Signal, base: TimeBase, options: Options) -> FloatArray:
    """The input of the messages that hold the output, too."""
    drive = np.full(base.length, np.nan)
    values = u.values[base.rows]
    if base.jitter is None:
        drive[base.index] = values
    elif options.input_hold in (None, "zero"):
        edges = base.start + base.period * base.index + base.jitter
        drive[base.index] = mean_held(edges, values, base.start, base.period,
                                      base.length)[0][base.index]
    else:
        drive[base.index] = resample(values, base)[0]
    return drive


def _joined(u: Signal, y: Signal, base: TimeBase, options: Options,
            notes: list[str]) -> FloatArray:
    """The input of other messages, at the samples of `base`; NaN where it is not known."""
    messages, time, period, after = _message_times(u, notes)
    if len(time) < _FEWEST:
        raise RecordError(f"{u.path} has only {len(time)} values; a record needs at least "
                          f"{_FEWEST}")
    values = u.values[messages]
    grid = base.time
    held = options.input_hold in (None, "zero")
    if held:
        drive, within = mean_held(time, values, base.start, base.period, base.length)
        how = "the last message stands until the next and each period has the mean"
    else:
        nodes = (time - base.start) / base.period
        targets = np.arange(base.length, dtype=np.float64)
        drive = interpolate(nodes, values, targets, 4)
        within = drive - interpolate(nodes, values, targets, 6)
        how = "a cubic goes through the messages"
    end = time[-1] + (period if held else 0.0)
    unknown = (grid < time[0]) | (grid + (base.period if held else 0.0) > end + 1e-6 * period)
    for k in after:     # messages are missing behind these
        unknown |= (grid + base.period > time[k] + period) & (grid < time[k + 1])
    drive[unknown] = np.nan
    nearest = np.abs(grid[:, None] - time[np.clip(
        np.searchsorted(time, grid)[:, None] + [-1, 0], 0, len(time) - 1)]).min(axis=1)[~unknown]
    if not len(nearest):
        raise RecordError(f"{u.path} and {y.path} were not recorded at the same time by "
                          f"{_clock_words(u.clock)} and {_clock_words(y.clock)}")
    error = float(np.sqrt(np.mean(within[~unknown]**2)))
    notes.append(
        f"{u.path} was put on the samples of {y.path}: the nearest message is "
        f"{np.sqrt(np.mean(nearest**2)):.3g} s away rms, {nearest.max():.3g} s at most; {how}, "
        f"estimated error {error:.3g} {u.unit} rms")
    return drive


def _message_times(u: Signal, notes: list[str]) -> tuple[Ints, FloatArray, float, Ints]:
    """Return (places in the signal, their times, the period, behind which some are missing).

    An input that is sent unevenly, for instance when it changes, has no gaps: its last message
    stands.
    """
    own: list[str] = []
    try:
        base = _even(u, "mask", None, own)
    except RecordError:
        keep = np.flatnonzero(np.diff(u.time, append=np.inf) > 0)    # the last of one time
        time = u.time[keep]
        period = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
        notes.append(f"{u.path} comes unevenly by {_clock_words(u.clock)}, every {period:.4g} s "
                     f"in the median; each message stands until the next, however late that is")
        return keep, time, period, np.zeros(0, np.int64)
    notes += own
    late = 0.0 if base.jitter is None else base.jitter
    time = np.asarray(base.start + base.period * base.index + late, np.float64)
    return base.rows, time, base.period, np.flatnonzero(np.diff(base.index) > 1)

