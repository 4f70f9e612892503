"""Tables (CSV, npz, mat) become records: which column is what, in which unit, and is it sound."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.record import AxisRecord, FloatArray, Ints, Provenance, Record
from dfm_stage.recording.sample_numbers import (
    NUMBERS,
    by_number,
    missing_note,
    regenerated_period,
    sample_numbers,
)
from dfm_stage.recording.time_base import (
    TimeBase,
    average_held,
    find_time_base,
    read_stamps,
    resample,
)
from dfm_stage.recording.units import Unit, measured, suffix_of, unit_of

DEFAULT_AXIS = "x"
NO_INPUT = "none"
"""In the place of an input's column: nothing drove the stage."""
_QUANTITY = re.compile(r"(?:(?P<axis>\w+)_)?(?P<quantity>input|position|velocity|acceleration|"
                       r"current|reference)", re.IGNORECASE)
_KINDS = {"position": "a position", "input": "an input"}
_OUTPUTS = ("position", "velocity", "acceleration")
_SHOWN = 8


class Table(Protocol):
    """Named columns of equal length that are read when asked for."""

    path: Path
    kind: str
    names: Sequence[str]
    sample_period: float | None
    warnings: list[str]

    def columns(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """Return those columns, NaN where a cell is empty; raises RecordError."""

    def where(self, row: int) -> str:
        """Return where a row stands, as the user counts ("line 17")."""


@dataclass(frozen=True)
class Options:
    """What `read_record` was told about a table; None where it was told nothing."""

    axis: str | None = None
    time: str | None = None
    input: str | None = None
    output: str | None = None
    time_unit: str | None = None
    input_unit: str | None = None
    output_unit: str | None = None
    sample_period: float | None = None
    gaps: str = "longest"
    input_hold: str | None = None
    input_shift: float | None = None

    @property
    def names_columns(self) -> bool:
        """Whether columns are named explicitly."""
        return self.input is not None or self.output is not None


@dataclass(frozen=True)
class _Source:
    column: str
    unit: Unit


@dataclass
class _Choice:
    """Which column is what: time, and for each axis its quantities."""

    time: _Source | None
    axes: dict[str, dict[str, _Source]]
    notes: list[str] = field(default_factory=list)
    number: str | None = None

    def used(self) -> list[str]:
        """Return the names of all columns that are needed."""
        names = [source.column for axis in self.axes.values() for source in axis.values()]
        first = [] if self.time is None else [self.time.column]
        return list(dict.fromkeys([*first, *([self.number] if self.number else []), *names]))


class _Undriven:
    """A table with an input of zeros for each axis, in the place of those that it has; `output` is
    the column of the output, where it was named."""

    def __init__(self, table: Table, output: str | None) -> None:
        self._table = table
        self.path, self.kind, self.warnings = table.path, table.kind, table.warnings
        self.sample_period = table.sample_period
        kinds = {name: _QUANTITY.fullmatch(suffix_of(name, of_input=True)[0])
                 for name in table.names}
        axes = dict.fromkeys(kind["axis"] for kind in kinds.values()
                             if kind is not None and kind["quantity"].lower() in _OUTPUTS)
        self.inputs = ["(no input)"] if output is not None else [
            f"{axis}_input_v" if axis else "input_v" for axis in axes]
        self.names: Sequence[str] = [*(
            name for name, kind in kinds.items() if name == output or kind is None
            or kind["quantity"].lower() != "input"), *self.inputs]

    def columns(self, names: Sequence[str]) -> dict[str, FloatArray]:
        """As in `Table`."""
        found = self._table.columns([name for name in names if name not in self.inputs])
        zeros = np.zeros(len(next(iter(found.values()))))
        return {**found, **{name: zeros for name in names if name in self.inputs}}

    def where(self, row: int) -> str:
        """As in `Table`."""
        return self._table.where(row)


def table_record(table: Table, options: Options, fingerprint: str = "") -> Record:
    """Return the record in a table.

    Raises
    ------
    RecordError
        If columns are missing or their content cannot be a record.
    """
    if options.input == NO_INPUT and NO_INPUT not in table.names:
        table = undriven = _Undriven(table, options.output)
        named = options.output is not None
        options = replace(options, input=undriven.inputs[0] if named else None,
                          input_unit=options.input_unit or ("V" if named else None))
    with in_file(table.path), np.errstate(over="ignore", invalid="ignore"):
        return _record(table, options, fingerprint)


def _record(table: Table, options: Options, fingerprint: str) -> Record:
    choice = _choose(table, options)
    choice.number = next((name for name in table.names if name.lower() in NUMBERS
                          and name not in choice.used()), None)
    columns = table.columns(choice.used())
    warnings = [*table.warnings, *choice.notes]
    usable = np.ones(len(next(iter(columns.values()))), np.bool_)
    for name in [source.column for axis in choice.axes.values()
                 for quantity, source in axis.items() if quantity in ("input", "position")] + (
                     [choice.time.column] if choice.time else []):
        bad = np.flatnonzero(~np.isfinite(columns[name]))
        if len(bad):
            more = f" and {len(bad) - 1} more rows" if len(bad) > 1 else ""
            warnings.append(f"{table.where(int(bad[0]))}{more}: {name} is empty or not finite; "
                            f"those samples count as missing")
            usable[bad] = False
    base = _time_base(table, choice, columns, np.flatnonzero(usable), options)
    base = read_stamps(base, [(columns[axis["input"].column][base.rows],
                               columns[axis["position"].column][base.rows])
                              for axis in choice.axes.values()],
                       options.input_hold in (None, "zero"))
    label = "axis {}, " if len(choice.axes) > 1 else ""
    axes = {name: _axis(label.format(name), sources, columns, base, warnings, options)
            for name, sources in choice.axes.items()}
    warnings += base.notes
    unused = [name for name in table.names if name and name not in choice.used()]
    if unused and not options.names_columns:
        shown = ", ".join(unused[:_SHOWN]) + (" ..." if len(unused) > _SHOWN else "")
        warnings.append(f"columns not used: {shown}")
    return Record(base.time, base.period, axes,
                  Provenance(str(table.path), table.kind, fingerprint), warnings)


def _choose(table: Table, options: Options) -> _Choice:
    notes: list[str] = []
    time = None
    if options.sample_period is None:
        time = _time_column(table, options, notes)
    elif options.time is not None:
        raise RecordError("both a time column and a sample period were given; give one of them")
    if options.names_columns:
        if options.input is None or options.output is None:
            raise RecordError("name both the input and the output column, or neither")
        axis = {"input": _named(table, options.input, options.input_unit, "V", "input", notes),
                "position": _named(table, options.output, options.output_unit, "m", "output",
                                   notes)}
        return _Choice(time, {options.axis or DEFAULT_AXIS: axis}, notes)
    found: dict[str, dict[str, _Source]] = {}
    for name in table.names:
        rest, unit = suffix_of(name)
        match = _QUANTITY.fullmatch(rest)
        if rest == name or (match and match["quantity"].lower() == "input"):
            rest, unit = suffix_of(name, of_input=True)
            match = _QUANTITY.fullmatch(rest)
        if match is None or unit is None:
            continue
        quantity, axis_name = match["quantity"].lower(), match["axis"] or DEFAULT_AXIS
        if quantity in _OUTPUTS and measured(unit.base)[1] != quantity:
            continue
        if quantity in found.setdefault(axis_name, {}):
            raise RecordError(f"there are two columns for {quantity} of axis {axis_name}, one of "
                              f"them {name}; remove one")
        found[axis_name][quantity] = _Source(name, unit)
    for axis_name, parts in found.items():
        _choose_output(axis_name, parts, options, notes)
    complete = {name: parts for name, parts in found.items()
                if {"input", "position"} <= set(parts)}
    notes += [f"axis {name} was left out: it has no column with " + " and ".join(
        _KINDS[part] for part in ("input", "position") if part not in parts)
        for name, parts in found.items() if name not in complete]
    if not complete:
        raise RecordError(
            f"no input and position columns among {_list(table.names)}; name them like "
            f"time_s,input_v,position_m, or say which they are with the options for time, input "
            f"and output (--time, --input, --output); where nothing drove the stage, give "
            f"--input {NO_INPUT}")
    if options.axis is not None:
        if options.axis not in complete:
            raise RecordError(f"has no axis {options.axis}; choose one of {', '.join(complete)}")
        complete = {options.axis: complete[options.axis]}
    return _Choice(time, complete, notes)


def _choose_output(axis: str, parts: dict[str, _Source], options: Options,
                   notes: list[str]) -> None:
    """Make the position, else the velocity, else the acceleration the output, under `position`;
    units that were given take the place of those in the names."""
    first = next((name for name in _OUTPUTS if name in parts), None)
    if first is not None:
        parts["position"] = output = parts.pop(first)
        for name in _OUTPUTS[1:]:
            other = parts.get(name)
            if other and (name != "velocity" or first != "position"
                          or measured(other.unit.base)[0] != output.unit.base):
                del parts[name]
                notes.append(f"axis {axis}: {other.column} was not used beside {output.column}")
    for name, given in (("input", options.input_unit), ("position", options.output_unit)):
        if given and name in parts:
            parts[name] = _Source(parts[name].column, _unit(given, of_input=name == "input"))


def _time_column(table: Table, options: Options, notes: list[str]) -> _Source | None:
    if options.time is not None:
        return _named(table, options.time, options.time_unit, "s", "time", notes)
    for name in table.names:
        rest, unit = suffix_of(name)
        if rest.lower() == "time" and unit is not None and unit.base == "s":
            return _Source(name, _unit(options.time_unit) if options.time_unit else unit)
    if table.sample_period is not None:
        notes.append(f"there is no time column; the sample period in the file, "
                     f"{table.sample_period:.9g} s, was used")
        return None
    raise RecordError(f"no time column among {_list(table.names)}; name it time_s (or time_ms), "
                      f"say which it is (--time), or give the sample period (--sample-period)")


def _named(table: Table, name: str, unit: str | None, default: str, role: str,
           notes: list[str]) -> _Source:
    if name not in table.names:
        raise RecordError(f"no column {name!r} for the {role}; there are {_list(table.names)}")
    of_input = role == "input"
    found = _unit(unit, of_input) if unit else suffix_of(name, of_input=of_input)[1]
    if found is None:
        notes.append(f"the unit of column {name} is not stated; it was taken as {default} (say "
                     f"--{role}-unit)")
        found = Unit(default)
    if role == "time" and found.base != "s":
        raise RecordError(f"column {name}: {unit or found.base} is no unit of time; use s, ms, us "
                          f"or ns")
    return _Source(name, found)


def _unit(name: str, of_input: bool = False) -> Unit:
    """Return the unit of that name; one that is not known is carried as it is."""
    return unit_of(name, of_input=of_input) or Unit(name)


def _list(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_SHOWN])
    return f"the columns {shown}{' ...' if len(names) > _SHOWN else ''}" if shown else "no columns"


def _time_base(table: Table, choice: _Choice, columns: Mapping[str, FloatArray],
               rows: Ints, options: Options) -> TimeBase:
    time, numbers, notes = None, rows, []
    if choice.time is not None:
        time = columns[choice.time.column][rows] * choice.time.unit.factor
    if choice.number is not None:
        counted = sample_numbers(columns[choice.number][rows], choice.number, rows, table.where)
        notes += counted.notes
        rows, numbers = rows[counted.rows], counted.numbers
        time = None if time is None else time[counted.rows]
    if len(rows) < 3:
        raise RecordError(f"only {len(rows)} usable rows; a record needs at least 3")
    if time is not None:
        regenerated = None if choice.number is None else regenerated_period(time, numbers)
        if regenerated is None:
            base = find_time_base(time, rows, table.where, options.gaps)
            return replace(base, notes=[*notes, *base.notes])
        notes.append(f"the time column does not show the samples that are missing; samples were "
                     f"taken as {regenerated:.9g} s apart by {choice.number}")
        period = regenerated
    else:
        period = options.sample_period or table.sample_period or 0.0
    if not (np.isfinite(period) and period > 0):
        raise RecordError(f"a sample period of {period:g} s is impossible; give seconds above 0")
    if choice.number is not None:
        notes += missing_note(numbers, choice.number, rows, table.where)
    return by_number(numbers, rows, period, options.gaps, table.where, notes)


def _axis(label: str, sources: Mapping[str, _Source], columns: Mapping[str, FloatArray],
          base: TimeBase, warnings: list[str], options: Options) -> AxisRecord:
    parts: dict[str, FloatArray] = {}
    unit, what = measured(sources["position"].unit.base)
    for quantity, source in sources.items():
        values, error = columns[source.column][base.rows] * source.unit.factor, 0.0
        if quantity == "input" and options.input_hold in (None, "zero"):
            values = average_held(values, base)
        else:
            values, error = resample(values, base)
        if base.jitter is not None and quantity == "position":
            warnings.append(f"{label}{what} was moved to even time stamps; estimated error "
                            f"{error:.3g} {source.unit.base} rms")
        missing = int(np.isnan(values).sum()) if quantity not in ("input", "position") else 0
        if missing == len(values):
            continue
        if missing:
            warnings.append(f"{source.column} has {missing} samples without a value")
        parts[quantity] = np.full(base.length, np.nan)
        parts[quantity][base.index] = values
    return AxisRecord(parts["input"], parts["position"], sources["input"].unit.base, unit,
                      parts.get("current"), parts.get("reference"),
                      velocity=parts.get("velocity"), measures=what,
                      input_hold=options.input_hold, input_shift=options.input_shift)
