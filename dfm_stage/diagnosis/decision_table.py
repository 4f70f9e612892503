"""The table of decisions in docs/decisions.md: `python -m dfm_stage.diagnosis.decision_table`."""

from __future__ import annotations

import re

from dfm_stage.decisions import TABLE, Decision
from dfm_stage.diagnosis import decisions as of_diagnosis
from dfm_stage.diagnosis import search_decisions as of_search
from dfm_stage.identification import decisions as of_identification

PLACES = (of_identification, of_diagnosis, of_search)
"""Modules that hold nothing but decisions."""


UNDOCUMENTED = re.compile(r"not documented; kept from [^;(]*(\(\d{4}-\d\d-\d\d\))?(; )?")
"""Origins that say no more than which commit a number comes from; the files have them in full."""


def _origin(d: Decision) -> str:
    """What a number was set on; a dash where that was not written down."""
    return UNDOCUMENTED.sub("", d.set_on) or "–"


def markdown() -> str:
    """Every decision in a line of its own, in the order of their files."""
    lines = ["| name | value | unit | meaning | set on |", "|---|---|---|---|---|"]
    lines += [f"| `{d.name}` | {d.value:g} | {d.unit} | {d.meaning} | {_origin(d)} |"
              for place in PLACES for d in map(TABLE.get, vars(place)) if d is not None]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(markdown(), end="")
