"""A column that numbers the samples of a table: what is missing and what came twice."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from dfm_stage.recording.errors import RecordError
from dfm_stage.recording.record import FloatArray, Ints
from dfm_stage.recording.time_base import TimeBase, Where, kept_stretch

NUMBERS = ("seq", "sequence", "sample", "sample_number", "counter")
"""Columns (in any case) that number the samples."""
_COUNTER_BITS = (8, 16, 32)     # of counters that begin anew
_SHOWN_SHARE = 0.5              # of a period: a time step off by less shows the missing samples


@dataclass(frozen=True)
class Numbered:
    """`rows` are those of the given rows to keep; `numbers` count their samples from 0."""

    rows: Ints
    numbers: Ints
    notes: list[str] = field(default_factory=list)


def sample_numbers(column: FloatArray, name: str, table_rows: Ints, where: Where) -> Numbered:
    """Return which rows are samples of their own, and how far apart they are.

    A column that does not count up by one, apart from what is missing or came twice, does not
    number samples; then every row is the next sample, as without the column.

    Parameters
    ----------
    column : (n,) float
        The numbers, of the rows `table_rows` of the table.
    where : callable
        Says where a row stands ("line 17").
    """
    every = np.arange(len(column))
    plain = Numbered(every, table_rows)
    if len(column) < 3 or not np.array_equal(column, np.round(column)):
        return plain
    steps = np.diff(column).astype(np.int64)
    if (steps < 0).any():
        size = next((1 << bits for bits in _COUNTER_BITS if column.max() < 1 << bits), 0)
        if column.min() < 0 or not size:
            return plain
        steps %= size
        if (steps > size // 2).any():
            return replace(plain, notes=[f"column {name} counts backwards and was not used"])
    if np.median(steps) != 1:
        return plain
    notes = []
    twice = np.flatnonzero(steps == 0)
    if len(twice):
        notes.append(f"{where(int(table_rows[twice[0] + 1]))}: {name} {column[twice[0]]:.0f} "
                     f"comes twice{_more(len(twice))}; repeated rows were left out")
    keep = np.concatenate(([True], steps != 0))
    return Numbered(np.flatnonzero(keep), np.concatenate(([0], np.cumsum(steps)))[keep], notes)


def missing_note(numbers: Ints, name: str, rows: Ints, where: Where) -> list[str]:
    """Say how many samples are missing by their numbers, and where; nothing if none is."""
    apart = np.diff(numbers)
    gaps = np.flatnonzero(apart > 1)
    if not len(gaps):
        return []
    return [(f"{int((apart[gaps] - 1).sum())} samples are missing by column {name}, before "
             f"{where(int(rows[gaps[0] + 1]))}{_more(len(gaps))}")]


def _more(count: int) -> str:
    return f" and {count - 1} more places" if count > 1 else ""


def regenerated_period(time: FloatArray, numbers: Ints) -> float | None:
    """Return the period of a time column that was made up from the row number, in s.

    None where the times show what is missing themselves, or nothing is.
    """
    apart = np.diff(numbers)
    gaps = apart > 1
    if not gaps.any() or gaps.all():
        return None
    steps = np.diff(time)
    period = float(np.median(steps[~gaps]))
    unseen = steps[gaps] < (apart[gaps] - _SHOWN_SHARE) * period
    return period if period > 0 and unseen.any() else None


def by_number(numbers: Ints, rows: Ints, period: float, gaps: str, where: Where,
              notes: list[str]) -> TimeBase:
    """Return the time base of rows whose samples are a period apart by their numbers.

    Raises
    ------
    RecordError
        If no stretch without a gap has 3 samples.
    """
    if gaps == "longest":
        after = np.flatnonzero(np.diff(numbers) > 1)
        first, last = kept_stretch(rows, after, where, notes)
        rows, numbers = rows[first:last], numbers[first:last]
        if len(rows) < 3:
            raise RecordError("no stretch without a gap has 3 samples or more")
    return TimeBase(float(numbers[0]) * period, period, rows, numbers - numbers[0], None, notes)
