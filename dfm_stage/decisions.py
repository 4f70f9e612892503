"""Numbers that decide an answer: each defined once, with its meaning and what it was set on.

    MARGIN = decision("MARGIN", 16.0, "chi-square", meaning="...", set_on="...")

They stand in identification/decisions.py, diagnosis/decisions.py and
diagnosis/search_decisions.py; docs/decisions.md shows them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

from dfm_stage.errors import DfmError

Number = TypeVar("Number", int, float)


class DecisionError(DfmError):
    """A decision is defined twice, or without a unit, a meaning or a reason."""


@dataclass(frozen=True)
class Decision:
    """One number that decides: `meaning` in one sentence, `set_on` what it was derived from or
    calibrated on."""

    name: str
    value: float
    unit: str
    meaning: str
    set_on: str


TABLE: dict[str, Decision] = {}
"""All decisions by name, in the order of their definition."""


def decision(name: str, value: Number, unit: str, *, meaning: str, set_on: str) -> Number:
    """Enter a number into the table and return it.

    Parameters
    ----------
    name : the constant that it is assigned to; one name stands for one number everywhere.
    unit : "1" for a plain ratio or count.

    Raises
    ------
    DecisionError
        If the name is taken, or unit, meaning or reason are missing.
    """
    entry = Decision(name, value, unit, meaning, set_on)
    if TABLE.setdefault(name, entry) != entry:
        raise DecisionError(f"decision {name}: defined twice; one name is one number")
    if not (unit and meaning and set_on):
        raise DecisionError(f"decision {name}: needs a unit, a meaning and what it was set on")
    return value
