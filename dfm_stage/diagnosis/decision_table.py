"""The table of decisions in docs/decisions.md: `python -m dfm_stage.diagnosis.decision_table`."""

from __future__ import annotations

from dfm_stage.decisions import TABLE
from dfm_stage.diagnosis import decisions as of_diagnosis
from dfm_stage.identification import decisions as of_identification

PLACES = (of_identification, of_diagnosis)
"""Modules that hold nothing but decisions."""


def markdown() -> str:
    """Every decision in a line of its own, in the order of their files."""
    lines = ["| name | value | unit | meaning | set on |", "|---|---|---|---|---|"]
    lines += [f"| `{d.name}` | {d.value:g} | {d.unit} | {d.meaning} | {d.set_on} |"
              for place in PLACES for d in map(TABLE.get, vars(place)) if d is not None]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
