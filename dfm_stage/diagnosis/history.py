"""Many diagnoses of one stage: how often each answer came, and how parameters change over time.

A line is fitted by ordinary least squares, with Student's interval for its slope. A record stands
out where its externally studentised residual is beyond Bonferroni's limit (Cook and Weisberg,
Residuals and Influence in Regression, 1982, sec. 2.2.2); it is left out of the line.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.stats import t as student

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    CHANGE_LEVEL,
    COPIED_S,
    FEWEST_IN_TIME,
    OUTLYING_LEVEL,
    OUTLYING_SHARE,
)
from dfm_stage.diagnosis.verdict import Kind
from dfm_stage.quantity import Quantity, display_unit

DatedBy = Literal["recording", "file", "order"]
TRUSTED: tuple[Kind, ...] = ("none", "retune", "named", "ambiguous")
"""Verdicts with a model that explains its record: the parameters of others are not compared."""
HOUR_S, DAY_S = 3600.0, 86400.0
MONTH_S = 365.25 / 12.0 * DAY_S
STEPS: tuple[tuple[float, float, str], ...] = (
    (2.0 * DAY_S, HOUR_S, "hour"), (2.0 * MONTH_S, DAY_S, "day"), (np.inf, MONTH_S, "month"))
"""Up to which span (s) a change is told in which unit of time."""


@dataclass(frozen=True)
class Answer:
    """One record's diagnosis: `name` is its folder, `content` its diagnosis.json; `recorded_s` and
    `written_s` are the times (s since the epoch) at which the record and its file were made."""

    name: str
    content: Mapping[str, Any]
    recorded_s: float | None
    written_s: float

    @property
    def verdict(self) -> Kind:
        """The verdict."""
        verdict: Kind = self.content["verdict"]
        return verdict

    @property
    def effects(self) -> dict[str, Mapping[str, Any]]:
        """Name -> what was found of each effect."""
        return {each["name"]: each for each in self.content["effects"]}

    @property
    def parameters(self) -> dict[str, Quantity]:
        """Base parameters, and those of effects as `effect.parameter`, with their intervals."""
        found = {**self.content["base"], **{
            f"{name}.{p}": q for name, each in self.effects.items()
            for p, q in each["parameters"].items()}}
        return {name: Quantity(q["value"], q["unit"], _interval(q["ci95"]))
                for name, q in found.items()}


def _interval(given: Sequence[float | None] | None) -> tuple[float, float] | None:
    if given is None or given[0] is None or given[1] is None:
        return None
    return given[0], given[1]


@dataclass(frozen=True)
class Change:
    """How a parameter changes: `values` (n,) of the records `names` at `times` (n,), in units of
    `per` since the first of all records, and the line through those that do not stand out.

    `slope` and its 95 % interval are in the parameter's unit by `per`; `level` is the line's value
    in the middle. `real` says that the slope is not chance.
    """

    parameter: str
    unit: str
    per: str
    names: tuple[str, ...]
    times: Array
    values: Sequence[Quantity]
    outlying: tuple[int, ...]
    slope: Quantity
    offset: float
    level: float
    spread: float
    real: bool

    def at(self, times: Array) -> Array:
        """The line's values at some times."""
        return np.asarray(self.offset + self.slope.value * times)

    def half_band(self, times: Array) -> Array:
        """Half the width of the line's 95 % interval at some times."""
        kept = np.delete(self.times, self.outlying)
        factor = float(student.ppf(0.975, kept.size - 2))
        power = float(np.sum((kept - np.mean(kept)) ** 2))
        of_mean = self.slope.half_width / factor * np.sqrt(power / kept.size)
        return np.asarray(np.hypot(factor * of_mean,
                                   self.slope.half_width * (times - np.mean(kept))))

    @property
    def words(self) -> str:
        """The change in one sentence."""
        size, half, unit = abs(self.slope.value), self.slope.half_width, self.unit
        if abs(self.level) > self.spread:
            size, half, unit = 100.0 * size / abs(self.level), 100.0 * half / abs(self.level), "%"
        factor, unit = display_unit((size, half), unit)
        digits = 1 if half == 0.0 else max(1 - math.floor(math.log10(factor * half)), 0)
        told = f"{factor * size:.{digits}f} ± {factor * half:.{digits}f} {unit}"
        name = self.parameter.replace("_", " ").replace(".", ": ")
        grows = (self.slope.value > 0.0) == (self.level > 0.0)
        each = "an hour" if self.per == "hour" else f"a {self.per}"
        said = f"{name} {'rises' if grows else 'falls'} by {told} {each}" if self.real else \
            f"{name} shows no clear change ({'+' if grows else '−'}{told} {each})"
        if self.outlying:
            said += (f"; {len(self.outlying)} of {len(self.names)} records stand"
                     f"{'s' if len(self.outlying) == 1 else ''} out: "
                     + ", ".join(self.names[k] for k in self.outlying))
        return said

    def to_dict(self) -> dict[str, Any]:
        """As summary.json keeps it."""
        return {"parameter": self.parameter, "unit": self.unit, "records": len(self.names),
                "slope": {**self.slope.to_dict(), "unit": f"{self.unit}/{self.per}"},
                "level": self.level, "real": self.real,
                "stand_out": [self.names[k] for k in self.outlying], "words": self.words}


@dataclass(frozen=True)
class History:
    """What many diagnoses say together; `times` (n,) are in units of `per` since the first."""

    answers: tuple[Answer, ...]
    dated_by: DatedBy
    per: str
    times: Array
    changes: tuple[Change, ...]

    @property
    def verdicts(self) -> dict[str, int]:
        """Verdict -> how many, the most frequent first."""
        return dict(Counter(a.verdict for a in self.answers).most_common())

    @property
    def effects(self) -> dict[str, int]:
        """Effect -> in how many records it was found, the most frequent first."""
        return dict(Counter(n for a in self.answers for n in a.effects).most_common())


def history(answers: Sequence[Answer]) -> History:
    """Put diagnoses in order of time, and find what changes.

    The time is that of the recording where all say it, else that of the files, unless these were
    copied in a go: then the order in which they were given.
    """
    recorded = [a.recorded_s for a in answers if a.recorded_s is not None]
    written = [a.written_s for a in answers]
    dated_by: DatedBy = "order"
    dates = [float(k) for k in range(len(answers))]
    if answers and len(recorded) == len(answers):
        dated_by, dates = "recording", recorded
    elif answers and max(written) - min(written) > COPIED_S * len(answers):
        dated_by, dates = "file", written
    order = np.argsort(dates, kind="stable")
    times, per = np.asarray(dates, float)[order] - min(dates, default=0.0), "record"
    if dated_by != "order":
        _, step, per = next(each for each in STEPS if times[-1] <= each[0])
        times = times / step
    sorted_ = tuple(answers[k] for k in order)
    return History(sorted_, dated_by, per, times, _changes(sorted_, times, per))


def _changes(answers: Sequence[Answer], times: Array, per: str) -> tuple[Change, ...]:
    """Those that are real first, the clearest first."""
    kept = [k for k, a in enumerate(answers) if a.verdict in TRUSTED]
    values = {k: answers[k].parameters for k in kept}
    names = dict.fromkeys(name for found in values.values() for name in found)
    places = {name: [k for k in kept if name in values[k]] for name in names}
    told = {name: where for name, where in places.items()
            if len(where) >= FEWEST_IN_TIME and np.ptp(times[where]) > 0.0}
    found = [_change(name, [answers[k].name for k in where], times[where],
                     [values[k][name] for k in where], per, len(told))
             for name, where in told.items()]
    return tuple(sorted(found, key=lambda c: (not c.real, -_clear(c))))


def _clear(change: Change) -> float:
    return abs(change.slope.value) / max(change.slope.half_width, 1e-300)


def _change(name: str, records: Sequence[str], times: Array, values: Sequence[Quantity],
            per: str, tests: int) -> Change:
    y = np.array([q.value for q in values])
    kept = _inlying(times, y)
    slope, offset, error = _line(times[kept], y[kept])
    dof = int(np.sum(kept)) - 2
    half = float(student.ppf(0.975, dof)) * error
    chance = 2.0 * float(student.sf(abs(slope) / max(error, 1e-300), dof))
    unit = values[0].unit
    return Change(name, unit, per, tuple(records), times, tuple(values),
                  tuple(np.flatnonzero(~kept).tolist()),
                  Quantity(slope, f"{unit}/{per}", (slope - half, slope + half)), offset,
                  float(np.mean(y[kept])), float(np.std(y[kept])),
                  chance < CHANGE_LEVEL / tests)


def _line(x: Array, y: Array) -> tuple[float, float, float]:
    """Slope, value at 0, and the slope's standard error, by least squares."""
    across = x - np.mean(x)
    power = float(across @ across)
    slope = float(across @ y) / power
    left = y - np.mean(y) - slope * across
    error = np.sqrt(float(left @ left) / (x.size - 2) / power)
    return slope, float(np.mean(y) - slope * np.mean(x)), float(error)


def _inlying(x: Array, y: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Which values (n,) a line explains: one that stands out is left out, the worst first."""
    kept = np.ones(x.size, bool)
    while np.sum(~kept) < OUTLYING_SHARE * x.size and np.sum(kept) > FEWEST_IN_TIME:
        size = int(np.sum(kept))
        across = x[kept] - np.mean(x[kept])
        slope, offset, _ = _line(x[kept], y[kept])
        left = y[kept] - offset - slope * x[kept]
        lever = 1.0 - 1.0 / size - across**2 / max(float(across @ across), 1e-300)
        # the spread without the value itself
        rest = (float(left @ left) - left**2 / np.maximum(lever, 1e-12)) / (size - 3)
        ratio = np.abs(left) / np.sqrt(np.maximum(rest * lever, 1e-300))
        worst = int(np.argmax(ratio))
        limit = float(student.ppf(1.0 - OUTLYING_LEVEL / (2 * size), size - 3))
        if ratio[worst] < limit or abs(left[worst]) < ROUNDING * float(np.max(np.abs(y))):
            break
        kept[np.flatnonzero(kept)[worst]] = False
    return kept


ROUNDING = 1e-12
"""Residual over the values that is rounding."""
