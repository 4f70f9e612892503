"""What the commands that take records ask about them: names, units, parts, conventions."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Sequence

from dfm_stage.cli.command import Group, option
from dfm_stage.errors import DfmError
from dfm_stage.recording import (
    Record,
    at_period,
    filled,
    part,
    read_record,
    split,
    without_gaps,
)
from dfm_stage.recording.record import HOLDS

COLUMNS: Group = ("CSV files with other column names, bags of other nodes", (
    option("--time", metavar="COLUMN",
           help="column of the time; of a bag: header, publish, arrival or a field"),
    option("--input", metavar="COLUMN",
           help="column of the input, or none in a table where nothing drove the stage; of a bag: "
           "a field, as /joint_states.effort[0]"),
    option("--output", metavar="COLUMN", help="column of the output, likewise"),
    *(option(f"--{name}-unit", metavar="UNIT", help=f"such as {unit}, if its name has none")
      for name, unit in (("time", "ms"), ("input", "V"), ("output", "um"))),
    option("--sample-period", type=float, metavar="SECONDS", help="in place of a time column")))
RANGE: Group = ("which part of each record", (
    option("--from", dest="from_s", type=float, metavar="SECONDS",
           help="begin so long after the record began"),
    option("--to", dest="to_s", type=float, metavar="SECONDS",
           help="end so long after the record began"),
    option("--rows", metavar="A:B", help="samples A to B, without B, counted from 0; A or B may "
           "be left out"),
    option("--gaps", choices=("longest", "fill"), default="longest",
           help="where samples are missing, keep the longest stretch, or first fill in up to two "
           "in a row (default: %(default)s)")))
SPLIT = option("--split", type=float, metavar="SHARE",
               help="fit this first share of each record and hold out the rest, as 0.75")
CONVENTION: Group = ("when the input acts", (
    option("--input-hold", choices=("auto", *HOLDS), default="auto",
           help="between samples the input keeps its value (zero), changes linearly (first) or is "
           "band-limited (default: found from the record)"),
    option("--input-shift", default="auto", metavar="SAMPLES",
           help="the input acts so many samples later than its column says; below 0: earlier "
           "(default: found from the record)")))
RECORDS: tuple[Group, ...] = (COLUMNS, RANGE, CONVENTION)
"""What `read_with` needs to know."""


def read_with(options: argparse.Namespace, path: str, axis: str | None = None,
              period: float | None = None) -> Record:
    """Read a record, or the part of it that is asked for, by the options of `RECORDS`.

    With a `period` (s) the record is brought to it, where it nearly has it.

    Raises
    ------
    DfmError
        If it cannot be read, or has no such part or period.
    """
    cuts = any(each is not None for each in (options.from_s, options.to_s, options.rows))
    record = read_record(path, axis=axis, time=options.time, input=options.input,
                         output=options.output, time_unit=options.time_unit,
                         input_unit=options.input_unit, output_unit=options.output_unit,
                         sample_period=options.sample_period,
                         gaps="mask" if cuts else options.gaps,
                         input_hold=None if options.input_hold == "auto" else options.input_hold,
                         input_shift=_shift(options.input_shift))
    if cuts:
        # what is missing elsewhere must not move or shorten the part
        record = _part(options, record)
        record = without_gaps(filled(record) if options.gaps == "fill" else record)
    return record if period is None else at_period(record, period)


def divided(options: argparse.Namespace, fitted: Sequence[Record], held: Sequence[Record]
            ) -> tuple[list[Record], list[Record]]:
    """Return the records to fit and those to hold out; `--split` makes the latter of the former.

    Raises
    ------
    DfmError
        If there are both a split and records to hold out, or a part would be empty.
    """
    if options.split is None:
        return [*fitted], [*held]
    if held:
        raise DfmError("--split and --holdout both say what is held out; give one of them")
    parts = [split(record, options.split) for record in fitted]
    return [first for first, _ in parts], [rest for _, rest in parts]


def held_names(options: argparse.Namespace, fitted: Sequence[str], held: Sequence[str]
               ) -> list[str]:
    """Return the names of the records that are held out."""
    return [*held] if options.split is None else [f"{name} (rest)" for name in fitted]


def as_words(options: argparse.Namespace, *groups: Group) -> list[str]:
    """Return options of these groups as they were given, for another command."""
    words = []
    for _, entries in groups:
        for flags, settings in entries:
            name = settings.get("dest") or flags[0].removeprefix("--").replace("-", "_")
            value = getattr(options, name)
            if value is not None and value != settings.get("default"):
                words += [f"{flags[0]}={value}"]
    return words


def _part(options: argparse.Namespace, record: Record) -> Record:
    count, period = len(record), record.sample_period
    if options.rows is not None:
        if options.from_s is not None or options.to_s is not None:
            raise DfmError("--rows and --from or --to both choose a part; give one of them")
        first, last = _rows(options.rows, count)
        return part(record, first, last, f"--rows {options.rows}")
    begin = 0.0 if options.from_s is None else options.from_s
    end = math.inf if options.to_s is None else options.to_s
    words = " ".join(f"--{name} {value:g}" for name, value in (
        ("from", options.from_s), ("to", options.to_s)) if value is not None)
    if not 0.0 <= begin < end:
        raise DfmError(f"{words}: there is no such part; give seconds since the record began, the "
                       "first below the second")
    # a sample belongs to the part whose beginning it stands at; stamps have rounding errors
    first = math.ceil(begin / period - 1e-6)
    return part(record, first, count if math.isinf(end) else math.ceil(end / period - 1e-6), words)


def _rows(text: str, count: int) -> tuple[int, int]:
    first, colon, last = text.partition(":")
    with contextlib.suppress(ValueError):
        begin, end = int(first or 0), int(last) if last.strip() else count
        if colon and 0 <= begin < end:
            return begin, end
    raise DfmError(f"--rows {text}: give A:B, samples counted from 0, A below B")


def _shift(text: str) -> float | None:
    if text == "auto":
        return None
    with contextlib.suppress(ValueError):
        if math.isfinite(shift := float(text)):
            return shift
    raise DfmError(f"--input-shift {text}: give a number of samples, or auto")
