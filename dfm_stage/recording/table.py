"""Tables (CSV, npz, mat) become records: which column is what, in which unit, and is it sound."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from dfm_stage.recording.errors import RecordError, in_file
from dfm_stage.recording.record import AxisRecord, FloatArray, Ints, Provenance, Record
from dfm_stage.recording.time_base import (
    TimeBase,
    average_held,
    find_time_base,
    kept_stretch,
    resample,
)

DEFAULT_AXIS = "x"
_QUANTITY = re.compile(r"(?:(?P<axis>\w+)_)?(?P<quantity>input|position|current|reference)")
_KINDS = {"position": "a position", "input": "an input", "current": "a current (A)",
          "reference": "a reference"}
_SHOWN = 8


@dataclass(frozen=True)
class Unit:
    """`factor` times a value in this unit is the value in `base`; other units are carried."""

    base: str
    factor: float = 1.0


def _scaled(base: str, **names: float) -> dict[str, Unit]:
    return {name: Unit(base, factor) for name, factor in names.items()}


UNITS: dict[str, Unit] = {
    **_scaled("s", s=1.0, sec=1.0, ms=1e-3, us=1e-6, ns=1e-9),
    **_scaled("m", m=1.0, cm=1e-2, mm=1e-3, um=1e-6, nm=1e-9, pm=1e-12),
    **_scaled("V", v=1.0, kv=1e3, mv=1e-3, uv=1e-6),
    **_scaled("A", a=1.0, ma=1e-3, ua=1e-6),
    **{name: Unit(name) for name in ("rad", "mrad", "urad", "deg", "arcsec", "counts")},
}
CASED = {"N": Unit("N"), "mN": Unit("N", 1e-3), "Nm": Unit("N m")}


def unit_of(name: str) -> Unit | None:
    """Return the unit of that name (`um`, `μm`, `mV`, ...), None if it is not known."""
    plain = name.strip().replace("µ", "u").replace("μ", "u")
    return CASED.get(plain) or UNITS.get(plain.lower())


def suffix_of(column: str) -> tuple[str, Unit | None]:
    """Split a column name into (rest, unit): `x_position_um` or `position [um]`."""
    bracket = re.fullmatch(r"(.*?)\s*[\[(]([^\])]+)[\])]\s*", column)
    rest, _, suffix = column.rpartition("_")
    if bracket:
        rest, suffix = bracket[1], bracket[2]
    unit = unit_of(suffix) if rest else None
    return (rest.strip(), unit) if unit else (column.strip(), None)


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


def columns_of(record: Record) -> dict[str, FloatArray]:
    """Return a record as the columns that `read_record` understands, by name.

    `time_s`, and for each axis `input_v`, `position_m`, `current_a`, `reference_m` as far as there
    are, prefixed by the axis name where there are several axes.
    """
    columns: dict[str, FloatArray] = {"time_s": record.time}
    for name, axis in record.axes.items():
        prefix = f"{name}_" if len(record.axes) > 1 else ""
        position_unit = axis.position_unit.lower()
        columns[f"{prefix}input_{axis.input_unit.lower()}"] = axis.input
        columns[f"{prefix}position_{position_unit}"] = axis.position
        if axis.current is not None:
            columns[f"{prefix}current_a"] = axis.current
        if axis.reference is not None:
            columns[f"{prefix}reference_{position_unit}"] = axis.reference
    return columns


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

    def used(self) -> list[str]:
        names = [source.column for axis in self.axes.values() for source in axis.values()]
        return names if self.time is None else [self.time.column, *names]


def table_record(table: Table, options: Options, fingerprint: str = "") -> Record:
    """Return the record in a table.

    Raises
    ------
    RecordError
        If columns are missing or their content cannot be a record.
    """
    with in_file(table.path), np.errstate(over="ignore", invalid="ignore"):
        return _record(table, options, fingerprint)


def _record(table: Table, options: Options, fingerprint: str) -> Record:
    choice = _choose(table, options)
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
    axes = {name: _axis(name, sources, columns, base, warnings, len(choice.axes) > 1)
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
        if match is None or unit is None:
            continue
        quantity, axis_name = match["quantity"], match["axis"] or DEFAULT_AXIS
        given = {"input": options.input_unit, "position": options.output_unit}.get(quantity)
        if quantity in found.setdefault(axis_name, {}):
            raise RecordError(f"there are two columns for {quantity} of axis {axis_name}, one of "
                              f"them {name}; remove one")
        found[axis_name][quantity] = _Source(name, _unit(given) if given else unit)
    complete = {name: parts for name, parts in found.items()
                if {"input", "position"} <= set(parts)}
    notes += [f"axis {name} was left out: it has no column with " + " and ".join(
        _KINDS[part] for part in ("input", "position") if part not in parts)
        for name, parts in found.items() if name not in complete]
    if not complete:
        raise RecordError(
            f"no input and position columns among {_list(table.names)}; name them like "
            f"time_s,input_v,position_m, or say which they are with the options for time, input "
            f"and output (--time, --input, --output)")
    if options.axis is not None:
        if options.axis not in complete:
            raise RecordError(f"has no axis {options.axis}; choose one of {', '.join(complete)}")
        complete = {options.axis: complete[options.axis]}
    return _Choice(time, complete, notes)


def _time_column(table: Table, options: Options, notes: list[str]) -> _Source | None:
    if options.time is not None:
        return _named(table, options.time, options.time_unit, "s", "time", notes)
    for name in table.names:
        rest, unit = suffix_of(name)
        if rest == "time" and unit is not None and unit.base == "s":
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
    found = _unit(unit) if unit else suffix_of(name)[1]
    if found is None:
        notes.append(f"the unit of column {name} is not stated; it was taken as {default} (say "
                     f"--{role}-unit)")
        found = Unit(default)
    if role == "time" and found.base != "s":
        raise RecordError(f"column {name}: {unit or found.base} is no unit of time; use s, ms, us "
                          f"or ns")
    return _Source(name, found)


def _unit(name: str) -> Unit:
    """Return the unit of that name; one that is not known is carried as it is."""
    return unit_of(name) or Unit(name)


def _list(names: Sequence[str]) -> str:
    shown = ", ".join(names[:_SHOWN])
    return f"the columns {shown}{' ...' if len(names) > _SHOWN else ''}" if shown else "no columns"


def _time_base(table: Table, choice: _Choice, columns: Mapping[str, FloatArray],
               rows: Ints, options: Options) -> TimeBase:
    if choice.time is not None:
        time = columns[choice.time.column][rows] * choice.time.unit.factor
        return find_time_base(time, rows, table.where, options.gaps)
    period = options.sample_period or table.sample_period or 0.0
    if not (np.isfinite(period) and period > 0):
        raise RecordError(f"a sample period of {period:g} s is impossible; give seconds above 0")
    if len(rows) < 3:
        raise RecordError(f"only {len(rows)} usable rows; a record needs at least 3")
    return _by_row(rows, period, options.gaps, table.where)


def _by_row(rows: Ints, period: float, gaps: str,
            where: Callable[[int], str]) -> TimeBase:
    """Return the time base of rows that are a period apart each."""
    notes: list[str] = []
    if gaps == "longest":
        first, last = kept_stretch(rows, np.flatnonzero(np.diff(rows) > 1), where, notes)
        rows = rows[first:last]
    return TimeBase(float(rows[0]) * period, period, rows, rows - rows[0], None, notes)


def _axis(name: str, sources: Mapping[str, _Source], columns: Mapping[str, FloatArray],
          base: TimeBase, warnings: list[str], several: bool) -> AxisRecord:
    parts: dict[str, FloatArray] = {}
    for quantity, source in sources.items():
        values, error = columns[source.column][base.rows] * source.unit.factor, 0.0
        if quantity == "input":
            values = average_held(values, base)
        else:
            values, error = resample(values, base)
        if base.jitter is not None and quantity == "position":
            label = f"axis {name}, " if several else ""
            warnings.append(f"{label}position was moved to even time stamps; estimated error "
                            f"{error:.3g} {source.unit.base} rms")
        missing = int(np.isnan(values).sum()) if quantity in ("current", "reference") else 0
        if missing == len(values):
            continue
        if missing:
            warnings.append(f"{source.column} has {missing} samples without a value")
        parts[quantity] = np.full(base.length, np.nan)
        parts[quantity][base.index] = values
    return AxisRecord(parts["input"], parts["position"], sources["input"].unit.base,
                      sources["position"].unit.base, parts.get("current"), parts.get("reference"))
