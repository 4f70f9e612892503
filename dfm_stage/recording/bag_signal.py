"""One field of a bag over time: the clock of its times, its unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.recording.bag import Bag, Topic
from dfm_stage.recording.bag_fields import FieldPath, field_values
from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.record import FloatArray, Ints
from dfm_stage.recording.table import Options
from dfm_stage.recording.units import Unit, suffix_of, unit_of

CLOCKS = ("header", "publish", "arrival")
"""Times of a message: as its header says, when it was sent, when it was recorded."""
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

    @property
    def clock_words(self) -> str:
        """Whose times these are."""
        return f"{self.clock} times" if self.clock in CLOCKS else self.clock

    def where(self, row: int) -> str:
        """Return where a value stands, as the user counts."""
        return f"{self.path.topic}, message {row}"


def _header(topic: Topic) -> str | None:
    """The column with the stamp of the header, or of the message itself."""
    return next((name for name in ("header.stamp", "stamp") if name in topic.time_columns), None)


def choose_clocks(bag: Bag, paths: dict[str, FieldPath], options: Options,
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


def stamps_of(bag: Bag, path: FieldPath, clock: str, options: Options) -> NDArray[np.int64]:
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


def signal_of(bag: Bag, path: FieldPath, role: str, clock: str, origin: int, options: Options,
            notes: list[str]) -> Signal:
    topic = bag[path.topic]
    rows, values = field_values(topic, path)
    lacking = topic.message_count - len(rows)
    good = np.isfinite(values)
    if lacking or not good.all():
        notes.append(f"{path}: {lacking + int((~good).sum())} of {topic.message_count} messages "
                     f"hold no value and were left out")
    rows, values = rows[good], values[good]
    ahead = stamps_of(bag, path, clock, options)[rows] - origin
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
