"""What answers to measured-like cases are worth."""

import json
from pathlib import Path

import pytest

from benchmarks.blind.measured import (
    MeasuredJob,
    convention_by_library,
    read_measured,
    read_timing,
    timing_rates,
)
from benchmarks.blind.measured_scoring import (
    UNCOMMON,
    judge_measured,
    judge_timing,
    measured_figures,
    measured_report,
)
from benchmarks.corpus.measured import MeasuredSpec

HELD = {"input_hold": "zero", "input_shift_samples": 0.0, "late_samples": 0.1,
        "must_be_found": True, "hold_must_be_found": True}
FRICTION = ["coulomb_friction", "hysteresis", "presliding_friction"]


def label(group: str = "remainder", **changed: object) -> dict:
    return {"index": 1, "seed": 2, "group": group, "effect": "coulomb_friction", "kind": "cogging",
            "share": 0.1, "right": FRICTION, "allowed": [*FRICTION, "creep"],
            "expected": ["named", "partial"], "conventions": [HELD],
            "true_effects": {"coulomb_friction": {"force": 2.0}}} | changed


def answer(verdict: str, *names: str, **more: object) -> dict:
    effects = [{"name": name, "class": [name], "parameters": {
        "force": {"value": 1.0, "unit": "N", "ci95": [0.9, 1.1]}}} for name in names]
    return {"schema": 1, "verdict": verdict, "effects": effects, **more}


@pytest.mark.parametrize(("said", "right", "wrong"), [
    (answer("named", "coulomb_friction"), True, False),
    (answer("partial", "hysteresis"), True, False),
    (answer("named", "coulomb_friction", "creep"), True, False),
    (answer("named", "coulomb_friction", "second_mode"), False, True),
    (answer("partial", "cubic_stiffness"), False, True),
    (answer("ambiguous", "presliding_friction"), True, False),
    (answer("ambiguous", "cubic_stiffness"), False, False),
    (answer("unknown"), False, False),
    ({"error": "TimeoutError: no answer"}, False, False)])
def test_a_remainder_is_named_in_its_class(said: dict, right: bool, wrong: bool) -> None:
    score = judge_measured(label(), said)
    assert (score.right, score.wrong_name) == (right, wrong)


@pytest.mark.parametrize(("said", "right", "wrong"), [
    (answer("unknown"), True, False),
    (answer("partial", "creep"), True, False),
    (answer("named", "creep"), False, True),
    (answer("partial", "second_mode"), False, True),
    (answer("ambiguous", "second_mode"), False, True),
    (answer("none"), False, False)])
def test_an_outsider_has_relatives_and_no_name(said: dict, right: bool, wrong: bool) -> None:
    score = judge_measured(label("outsider", effect="", right=[], allowed=["creep"],
                                 expected=["unknown", "partial"]), said)
    assert (score.right, score.wrong_name) == (right, wrong)


@pytest.mark.parametrize(("said", "right", "wrong"), [
    (answer("named", "cogging"), True, False),
    (answer("partial", "cogging"), True, False),
    (answer("named", "creep"), False, True),
    (answer("unknown"), False, False)])
def test_an_uncommon_effect_has_a_name(said: dict, right: bool, wrong: bool) -> None:
    score = judge_measured(label("outsider", effect="", right=["cogging"], allowed=["cogging"]),
                           said)
    assert (score.group, score.right, score.wrong_name) == (UNCOMMON, right, wrong)


@pytest.mark.parametrize(("said", "right", "wrong"), [
    (answer("none"), True, False),
    (answer("named", "periodic_disturbance"), True, False),
    (answer("ambiguous", "creep"), False, True),
    (answer("retune"), False, False)])
def test_a_nuisance_is_no_effect(said: dict, right: bool, wrong: bool) -> None:
    score = judge_measured(label("nuisance", effect="", right=[], expected=["none"],
                                 allowed=["periodic_disturbance"]), said)
    assert (score.right, score.wrong_name) == (right, wrong)


def said(hold: str, value: float, estimated: bool = True) -> dict:
    return {"input_hold": hold, "estimated": estimated,
            "input_shift_samples": {"value": value, "ci95": [value, value]}}


@pytest.mark.parametrize(("truth", "told", "found", "vain"), [
    (HELD, said("zero", 0.0), True, False),
    (HELD, said("band_limited", 0.0), False, True),
    (HELD, said("zero", -0.3), False, True),
    (HELD, {}, True, False),
    ({**HELD, "input_hold": "band_limited"}, said("band_limited", 0.05), True, False),
    ({**HELD, "input_hold": "band_limited"}, said("zero", -0.5), False, False),
    ({**HELD, "input_hold": "band_limited", "hold_must_be_found": False}, said("zero", -0.5),
     True, False),
    ({**HELD, "input_hold": "band_limited"}, {}, False, False),
    ({**HELD, "input_shift_samples": -1.0}, said("zero", -0.95), True, False),
    ({**HELD, "input_shift_samples": -1.0}, said("zero", -0.5), False, False),
    ({**HELD, "input_shift_samples": 2.0}, said("zero", 0.0), True, False)])
def test_timing(truth: dict, told: dict, found: bool, vain: bool) -> None:
    assert judge_timing(truth, told) == (found, vain)


def test_conventions_of_schema_1_are_not_found_and_nothing_was_corrected() -> None:
    score = judge_measured(label(conventions=[HELD, {**HELD, "must_be_found": False}]),
                           answer("unknown"))
    assert (score.found, score.untold, score.corrected) == ((False,), (True,), (False, False))


def test_intervals_are_judged_by_the_pseudo_true_value() -> None:
    score = judge_measured(label(share=0.01), answer("partial", "coulomb_friction"),
                           pseudo={"force": 1.05})
    assert (score.held, score.physical) == ((True,), (False,))
    beside = judge_measured(label(), answer("partial", "coulomb_friction"), pseudo={"force": 3.0})
    assert (beside.held, beside.physical) == ((False,), ())


def test_kept_answers_make_figures(tmp_path: Path) -> None:
    for index, verdict in enumerate(("partial", "unknown")):
        job = MeasuredJob(MeasuredSpec(index, 2, "remainder"), tmp_path)
        for path, content in ((job.label_path, label(index=index)), (
                job.answer_path, {"answer": answer(verdict, "coulomb_friction"), "seconds": 2.0})):
            path.parent.mkdir(exist_ok=True)
            path.write_text(json.dumps(content))
    scores = read_measured(tmp_path)
    figures = {f.key: f for f in measured_figures(scores)}
    assert figures["measured.remainder_right_percent"].value == 50.0
    assert figures["measured.remainder_right_percent"].met is False
    assert figures["measured.remainder_wrong_percent"].met is True
    assert figures["measured.outsider_wrong_percent"].bar is None
    assert figures["measured.no_answer_percent"].value == 0.0
    assert "10 %: right 1 of 2" in measured_report(scores)


def test_timing_rates_ask_for_every_record_and_show_no_truth() -> None:
    seen = []

    def find(columns: dict, period: float, base: dict) -> dict:
        seen.append(set(columns))
        assert columns["time_s"][1] == pytest.approx(period)
        return {}

    rates = timing_rates(4, 7, find)
    figures = {f.key: f for f in measured_figures([], rates)}
    assert figures["measured.record_false_timing_percent"].value == 0.0
    assert figures["measured.record_convention_found_percent"].how.startswith(
        f"{rates['found'][0]} of {rates['found'][1]} ")
    assert rates["held"] == (0, 4)
    assert rates["found"][1] + rates["untold"][1] == 4
    assert all(names <= {"time_s", "input_v", "position_m", "reference_m"} for names in seen)


def test_the_library_answers_for_a_record_alone(tmp_path: Path) -> None:
    rates = timing_rates(2, 7, convention_by_library)
    assert rates["held"] == (0, 2)
    assert read_timing(tmp_path) == {}
    (tmp_path / "timing.json").write_text(json.dumps(rates))
    assert read_timing(tmp_path)["held"] == [0, 2]
