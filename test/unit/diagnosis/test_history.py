"""Many diagnoses together: dates, lines over time beside scipy's, and records that stand out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import linregress, t

from dfm_stage.diagnosis.history import MONTH_S, Answer, history

START_S = 1.75e9


def _answer(name: str, stiffness: float, recorded_s: float | None = None, written_s: float = 0.0,
            verdict: str = "named", force: float | None = 0.02) -> Answer:
    effects: list[dict[str, Any]] = [] if force is None else [
        {"name": "coulomb_friction", "parameters": {"force": {
            "value": force, "unit": "N", "ci95": [force - 1e-4, force + 1e-4]}}}]
    return Answer(name, {
        "verdict": verdict, "effects": effects, "base": {"stiffness": {
            "value": stiffness, "unit": "N/m", "ci95": [stiffness - 0.5, stiffness + 0.5]}}},
        recorded_s, written_s)


def _months(count: int, fall: float, seed: int = 2) -> list[Answer]:
    """Stiffness that falls from 650 N/m by so much a month, with 0.3 N/m of scatter."""
    rng = np.random.default_rng(seed)
    months = np.sort(rng.uniform(0.0, 12.0, count))
    return [_answer(f"run{k}", 650.0 - fall * m + 0.3 * rng.standard_normal(),
                    START_S + m * MONTH_S, force=0.02 + 1e-4 * rng.standard_normal())
            for k, m in enumerate(months)]


def _stiffness(found):
    return next(c for c in found.changes if c.parameter == "stiffness")


def test_a_fall_is_told_with_the_interval_that_linregress_gives():
    answers = _months(40, 5.2)
    found = history(answers[::-1])
    change = _stiffness(found)
    months = np.array([a.recorded_s for a in answers]) / MONTH_S
    line = linregress(months, [a.parameters["stiffness"].value for a in answers])
    half = t.ppf(0.975, 38) * line.stderr
    assert (found.dated_by, found.per) == ("recording", "month")
    assert [a.name for a in found.answers] == [a.name for a in answers]     # in order of time
    assert change.slope.value == pytest.approx(line.slope, rel=1e-9)
    assert change.slope.half_width == pytest.approx(half, rel=1e-9)
    assert change.slope.covers(-5.2)
    assert change.real
    mean = np.mean([a.parameters["stiffness"].value for a in answers])
    assert change.words == (f"stiffness falls by {-100 * line.slope / mean:.4f} ± "
                            f"{100 * half / mean:.4f} % a month")
    at = np.array([0.0, 4.0, 11.0])
    kept = months - months[0]
    exact = t.ppf(0.975, 38) * line.stderr * np.sqrt(
        (at - kept.mean()) ** 2 + np.mean((kept - kept.mean()) ** 2))
    np.testing.assert_allclose(change.half_band(at), exact, rtol=1e-9)
    force = next(c for c in found.changes if c.parameter == "coulomb_friction.force")
    assert not force.real
    assert force.words.startswith("coulomb friction: force shows no clear change (")
    assert (found.verdicts, found.effects) == ({"named": 40}, {"coulomb_friction": 40})


def test_records_that_stand_out_are_named_and_do_not_bend_the_line():
    answers = _months(40, 5.2)
    spoilt = [_answer(a.name, 700.0 if k in (38, 39) else a.parameters["stiffness"].value,
                      a.recorded_s) for k, a in enumerate(answers)]
    change = _stiffness(history(spoilt))
    rest = [a for k, a in enumerate(answers) if k not in (38, 39)]
    line = linregress([a.recorded_s / MONTH_S for a in rest],
                      [a.parameters["stiffness"].value for a in rest])
    assert change.outlying == (38, 39)
    assert change.slope.value == pytest.approx(line.slope, rel=1e-9)
    assert change.words.endswith("2 of 40 records stand out: run38, run39")


def test_nothing_is_told_of_scatter_more_often_than_promised():
    found = [history(_months(12, 0.0, seed)) for seed in range(200)]
    assert sum(any(c.real for c in each.changes) for each in found) <= 20     # 10 expected
    assert sum(bool(c.outlying) for each in found for c in each.changes) <= 12    # 4 expected


def test_records_without_a_complete_model_are_left_out_of_lines():
    answers = [*_months(8, 5.0), _answer("odd", 900.0, START_S, verdict="unknown", force=None)]
    found = history(answers)
    assert "odd" not in _stiffness(found).names
    assert found.verdicts == {"named": 8, "unknown": 1}


@pytest.mark.parametrize(("apart_s", "dated_by", "per"), [
    (0.01, "order", "record"), (3600.0, "file", "hour"), (5 * 86400.0, "file", "day"),
    (40 * 86400.0, "file", "month")])
def test_dates_of_files_count_unless_they_were_copied(apart_s, dated_by, per):
    found = history([_answer(f"run{k}", 650.0 - k, written_s=START_S + k * apart_s)
                     for k in range(6)])
    assert (found.dated_by, found.per) == (dated_by, per)
    assert _stiffness(found).slope.value < 0.0


@pytest.mark.parametrize("count", [0, 1, 3])
def test_few_records_have_no_line(count):
    found = history(_months(count, 5.0))
    assert len(found.answers) == count
    assert found.changes == ()
