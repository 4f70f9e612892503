"""Numbers at the ends of types in a goal: one line, and no signal."""

from __future__ import annotations

from typing import Any

import pytest

from dfm_stage.errors import DfmError
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import load_experiment

PERIOD_S = 1e-3


def goal(**signal: Any) -> dict[str, Any]:
    return {"name": "a", "mode": "pid", "duration_s": 1.0, "axes": {"x": {"reference": signal}}}


@pytest.mark.parametrize(("signal", "words"), [
    ({"kind": "raster", "line_time_s": 1e308}, "has more than 20000000 samples"),
    ({"kind": "chirp", "period_s": 2e6}, "has more than 20000000 samples"),
    ({"kind": "multisine", "period_s": 1e300}, "has more than 20000000 samples"),
    ({"kind": "steps", "delay_s": 1e300}, "has more than 20000000 samples"),
    ({"kind": "hold", "position_m": 10**400}, "must be finite"),
])
def test_they_are_refused(signal: dict[str, Any], words: str) -> None:
    with pytest.raises(DfmError, match=words):
        load_experiment(goal(**signal)).reference("x", PERIOD_S)


@pytest.mark.parametrize("name", ["a" * 5000, "é" * 300])
def test_a_name_that_no_file_can_have(name: str) -> None:
    with pytest.raises(DfmError, match="there is no experiment"):
        find_experiment(name)
