"""The tables in docs/ name every parameter with the default in force."""

from __future__ import annotations

import re
from pathlib import Path

from dfm_stage.control import (
    GUARD_PARAMETERS,
    LQR_PARAMETERS,
    PID_PARAMETERS,
    TUNING_PARAMETERS,
)
from dfm_stage.trajectory import EXCITATION_KINDS, REFERENCE_KINDS

DOCS = Path(__file__).parents[3] / "docs"


def test_every_parameter_of_the_laws_is_in_a_table() -> None:
    text = (DOCS / "control.md").read_text(encoding="utf-8")
    for p in (*PID_PARAMETERS, *LQR_PARAMETERS, *GUARD_PARAMETERS, *TUNING_PARAMETERS):
        assert f"| `{p.name}` | {p.default:g} | {p.unit} | {p.description} |" in text


def test_every_setting_of_every_kind_is_in_the_tables() -> None:
    text = (DOCS / "trajectories.md").read_text(encoding="utf-8")
    parts = text.split("## Excitation kinds")
    for part, kinds in zip(parts, (REFERENCE_KINDS, EXCITATION_KINDS), strict=True):
        for kind in kinds.values():
            section = part.split(f"`{kind.name}`: {kind.description}")[1].split("\n`")[0]
            names = re.findall(r"^\| `(\w+)` \| ", section, re.MULTILINE)
            assert names == [p.name for p in (*kind.parameters, *kind.options)]
            for p in kind.parameters:
                assert f"| `{p.name}` | {p.default:g} | {p.unit} |" in section
