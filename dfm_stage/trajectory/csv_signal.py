"""A signal from a CSV file: positions joined smoothly, voltages held from row to row."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.parameter import Option, Parameter
from dfm_stage.trajectory.kind import Movement, Timing, Values

TIME = "time_s"
_UNITS = {"m": {"_m": 1.0, "_mm": 1e-3, "_um": 1e-6, "_nm": 1e-9}, "v": {"_v": 1.0, "_mv": 1e-3}}
_LARGEST = 256 * 2**20
CSV_OPTIONS = (
    Option("file", "", "CSV file; a relative path starts at the experiment's folder"),
    Option("column", "", "column to take; empty = the only one beside time_s"),
    Option("repeat", False, "start over at the end instead of staying there"),
)


def csv_parameters(what: str) -> tuple[Parameter, ...]:
    """Return the parameter table of a signal from a file."""
    return (Parameter("delay_s", 0.0, "s", "time before the first row", 0.0),
            Parameter("scale", 1.0, "", f"factor on every {what}", -1e9, 1e9))


def csv_movement(values: Values, timing: Timing) -> Movement:
    """Return position, velocity, acceleration, where the rows are (N,), period and start.

    Between the rows runs the spline of fifth degree that starts and ends at rest without
    acceleration, so that jerk is bounded; before and after, the first and the last row are held.
    """
    from scipy.interpolate import make_interp_spline

    t, x = _read(values, "m")
    if t.size < 6:
        raise values.error("file", f"{values.word('file')} has {t.size} rows; a smooth movement "
                                   "needs at least 6")
    ends = [(1, 0.0), (2, 0.0)]
    spline = make_interp_spline(t - t[0], x * values.number("scale"), k=5, bc_type=(ends, ends))
    length = float(t[-1] - t[0])
    first = values.samples(values.number("delay_s"), "delay_s", timing)
    index = np.arange(timing.count)
    since = (index - first) * timing.sample_period_s
    period = 0
    if values.flag("repeat"):
        if abs(x[-1] - x[0]) > 1e-9:
            raise values.error("repeat", "repeat needs the last row where the first is: "
                                         f"{x[0]:g} m, not {x[-1]:g} m")
        period = values.samples(length, "file", timing)
        since = np.where(since > 0.0, np.fmod(since, length), since)
    inside = np.clip(since, 0.0, length)
    moving = (since > 0.0) & (since < length)
    end = timing.count if period else first + math.ceil(length / timing.sample_period_s - 1e-9)
    return (np.asarray(spline(inside)), np.where(moving, spline(inside, 1), 0.0),
            np.where(moving, spline(inside, 2), 0.0), (index >= first) & (index < end), period,
            first)


def csv_voltage(values: Values, timing: Timing) -> tuple[Array, int]:
    """Return the voltage (N,) and its period; each row is held to the next, zero outside."""
    t, volts = _read(values, "v")
    step = float(np.median(np.diff(t))) if t.size > 1 else timing.sample_period_s
    length = float(t[-1] - t[0]) + step
    since = (np.arange(timing.count) * timing.sample_period_s - values.number("delay_s")
             + 1e-6 * timing.sample_period_s)
    period = 0
    if values.flag("repeat"):
        period = values.samples(length, "file", timing)
        since = np.where(since > 0.0, np.fmod(since, length), since)
    row = np.searchsorted(t - t[0], since, side="right") - 1
    return np.where((row >= 0) & (since < length),
                    volts[np.clip(row, 0, t.size - 1)] * values.number("scale"), 0.0), period


def _read(values: Values, kind: str) -> tuple[Array, Array]:
    """Return time, s, and value, m or V, of the rows."""
    name = values.word("file")
    if not name:
        raise values.error("file", "csv needs the setting file")
    try:
        if Path(name).stat().st_size > _LARGEST:
            raise values.error("file", f"{name} is larger than {_LARGEST >> 20} MiB; resample it")
        with Path(name).open(newline="", encoding="utf-8-sig") as file:
            head, *rows = [row for row in csv.reader(file) if row and not row[0].startswith("#")]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        why = getattr(error, "strerror", None) or "it is not CSV text"
        raise values.error("file", f"cannot read {name}: {why}") from None
    except ValueError:
        raise values.error("file", f"{name} is empty") from None
    head = [each.strip() for each in head]
    column, factor = _column(values, head, kind, name)
    table = _numbers(values, rows, (head.index(TIME), column), name)
    t = table[:, 0]
    if np.any(np.diff(t) <= 0.0):
        at = int(np.argmax(np.diff(t) <= 0.0)) + 3
        raise values.error("file", f"{name}:{at}: {TIME} must rise from row to row")
    return t, np.asarray(table[:, 1] * factor)


def _column(values: Values, head: list[str], kind: str, name: str) -> tuple[int, float]:
    if TIME not in head:
        raise values.error("file", f"{name}:1: there is no column {TIME}; the columns are "
                                   f"{', '.join(head)}")
    wanted = values.word("column")
    usable = [each for each in head if each.lower().endswith(tuple(_UNITS[kind]))]
    if not wanted:
        if len(usable) != 1:
            raise values.error("column", f"{name}:1: which column? give the setting column, one "
                               f"whose name ends in {' or '.join(_UNITS[kind])}; there are "
                               f"{', '.join(head)}")
        wanted = usable[0]
    if wanted not in usable:
        raise values.error("column", f"{name}:1: there is no column {wanted!r} whose name ends in "
                                     f"{' or '.join(_UNITS[kind])}")
    ending = max((end for end in _UNITS[kind] if wanted.lower().endswith(end)), key=len)
    return head.index(wanted), _UNITS[kind][ending]


def _numbers(values: Values, rows: list[list[str]], columns: tuple[int, int],
             name: str) -> Array:
    out = np.empty((len(rows), 2))
    if not rows:
        raise values.error("file", f"{name} has no rows below its first")
    for k, row in enumerate(rows):
        try:
            out[k] = [float(row[column]) for column in columns]
        except (ValueError, IndexError):
            out[k] = math.nan
        if not np.all(np.isfinite(out[k])):
            raise values.error("file", f"{name}:{k + 2}: not a row of finite numbers")
    return out
