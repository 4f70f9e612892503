"""Scoring of answers, the rates made of them, and the runner with a stub for the diagnosis."""

import json
import math
from operator import attrgetter

import numpy as np
import pytest

from benchmarks.blind import trial
from benchmarks.blind.baselines import pysindy_answer, stepwise_answer
from benchmarks.blind.rates import accuracy, beside, confusion, figures_of, limits, report
from benchmarks.blind.scoring import detection_limit, judge, wilson
from benchmarks.blind.trial import Job, run_case
from benchmarks.corpus import case_plan, make_case
from benchmarks.corpus.case import NoUsableDrawError
from benchmarks.corpus.plan import CaseSpec
from benchmarks.diagnose import read_scores, run_all


def label(kind="effect", effects=("coulomb_friction",), expected=("named",), group=(), **more):
    return {"index": 1, "kind": kind, "trap": "", "expected": list(expected),
            "effects": list(effects), "class": list(group), "severity": 10.0,
            "true_effects": {"coulomb_friction": {"force": 0.02}}, "true_base": {},
            "noise": 1e-7, **more}


def named(*names, held_out=1.05e-7, **more):
    return {"verdict": "named", "gap": {"held_out": {"after": held_out}}, "rejected": [],
            "effects": [{"name": n, "class": [n], "parameters": {}} for n in names], **more}


CLASS = ("coulomb_friction", "hysteresis", "presliding_friction")


@pytest.mark.parametrize(("answer", "exact", "right"), [
    (named("coulomb_friction"), True, True),
    (named("hysteresis"), False, True),
    (named("creep"), False, False),
    (named("coulomb_friction", "creep"), False, False),
    (named("coulomb_friction", "hysteresis"), False, False),
    ({"verdict": "ambiguous", "effects": [{"name": "hysteresis", "class": list(CLASS)}]},
     False, True),
    ({"verdict": "ambiguous", "effects": [{"name": "hysteresis", "class": [
        "hysteresis", "presliding_friction"]}]}, False, False),
    ({"verdict": "unknown", "effects": []}, False, False),
    ({"verdict": "none", "effects": []}, False, False),
    ({"error": "it broke"}, False, False),
])
def test_single_effects(answer, exact: bool, right: bool) -> None:
    score = judge(label(group=CLASS), answer)
    assert (score.exact, score.right_class, score.counted) == (exact, right, True)


def test_what_data_cannot_separate_is_not_counted() -> None:
    assert not judge(label(separable=False), named("hysteresis")).counted
    offset = label(effects=("force_offset",), expected=("ambiguous",),
                   group=("force_offset", "encoder_zero"))
    group = {"name": "force_offset", "class": ["force_offset", "encoder_zero"]}
    good = judge(offset, {"verdict": "ambiguous", "effects": [group]})
    assert good.exact
    assert not good.counted
    assert not judge(offset, named("creep")).right_class


@pytest.mark.parametrize(("kind", "expected", "answer", "exact", "false_name"), [
    ("none", ["none"], {"verdict": "none"}, True, False),
    ("none", ["none"], {"verdict": "retune"}, False, False),
    ("none", ["none"], {"verdict": "unknown"}, False, False),
    ("none", ["none"], named("creep"), False, True),
    ("none", ["none"], {"verdict": "ambiguous", "effects": [{"name": "creep"}]}, False, True),
    ("retune", ["retune"], {"verdict": "retune"}, True, False),
    ("retune", ["retune"], named("creep"), False, True),
    ("trap", ["none", "not_excited"], {"verdict": "not_excited"}, True, False),
])
def test_nothing_missing(kind, expected, answer, exact, false_name) -> None:
    score = judge(label(kind=kind, effects=(), expected=expected), answer)
    assert (score.exact, score.false_name) == (exact, false_name)


def test_pairs_and_a_spurious_third() -> None:
    pair = label(kind="pair", effects=("creep", "saturation"))
    assert judge(pair, named("saturation", "creep")).exact
    assert not judge(pair, named("creep")).exact
    third = judge(pair, named("saturation", "creep", "second_mode"))
    assert third.exact
    assert third.spurious
    assert judge(pair, named("creep", "second_mode")).spurious


def test_left_out_counts_where_no_stand_in_reaches_the_floor() -> None:
    left = label(kind="left_out", expected=("unknown",))
    unknown = {"verdict": "unknown", "rejected": [{"name": "creep", "held_out_rms": 3e-7}]}
    assert judge(left, unknown).exact
    assert judge(left, unknown).counted
    near = {"verdict": "unknown", "rejected": [{"name": "creep", "held_out_rms": 1.04e-7}]}
    assert not judge(left, near).counted
    assert not judge(left, named("creep", held_out=1.01e-7)).counted
    wrong = judge(left, named("creep", held_out=2e-7))
    assert wrong.counted
    assert wrong.spurious


def test_intervals_and_what_is_left_on_held_out_data() -> None:
    answer = named("coulomb_friction", held_out=1.1e-7)
    answer["effects"][0]["parameters"] = {"force": {"value": 0.0201, "ci95": [0.019, 0.0205]}}
    score = judge(label(), answer)
    assert score.covered == (True,)
    assert score.held_out_over_floor == pytest.approx(1.1)
    answer["effects"][0]["parameters"]["force"]["ci95"] = [0.0201, 0.0205]
    assert judge(label(), answer).covered == (False,)
    turned = label(effects=("periodic_disturbance",),
                   true_effects={"periodic_disturbance": {"phase": -3.0}})
    answer = named("periodic_disturbance")
    answer["effects"][0]["parameters"] = {"phase": {"ci95": [3.2, 3.3]}}
    assert judge(turned, answer).covered == (True,)


def test_wilson_and_detection_limit() -> None:
    from scipy.stats import binomtest

    for hits, count in ((0, 300), (3, 300), (19, 20), (20, 20)):
        expected = binomtest(hits, count).proportion_ci(method="wilson")
        assert wilson(hits, count) == pytest.approx((100 * expected.low, 100 * expected.high))
    assert detection_limit({0.1: 0.0, 1.0: 1.0}) == pytest.approx(math.sqrt(0.1))
    assert detection_limit({0.1: 0.0, 0.3: 0.2, 1.0: 0.1, 3.0: 0.9}) == pytest.approx(
        3.0 ** 0.46666666666666, rel=0.01)
    assert detection_limit({0.1: 0.0, 10.0: 0.4}) is None


def test_figures_have_the_keys_and_bars_of_the_issue() -> None:
    scores = [judge(label(group=CLASS), named("coulomb_friction"), 3.0) for _ in range(19)]
    scores += [judge(label(group=CLASS), named("creep"), 5.0)]
    scores += [judge(label(kind="none", effects=(), expected=["none"]), {"verdict": "none"}, 1.0)]
    found = {figure.key: figure for figure in figures_of(scores, ".fresh")}
    assert {f"diagnose.{name}.fresh" for name in (
        "exact_percent", "class_percent", "false_name_percent", "retune_percent", "pair_percent",
        "spurious_third_percent", "unknown_percent", "confident_wrong_percent",
        "held_out_over_floor", "interval_coverage_percent", "case_seconds")} <= set(found)
    exact = found["diagnose.exact_percent.fresh"]
    assert exact.value == 95.0
    assert exact.met
    assert "19 of 20" in exact.how
    assert "Wilson 76.4 to 99.1" in exact.how
    assert not found["diagnose.class_percent.fresh"].met
    assert found["diagnose.pair_percent.fresh"].met is None
    assert found["diagnose.case_seconds.fresh"].value == 3.0
    both = beside(accuracy(scores), {"other": scores})
    assert both[0].peer_value == 95.0
    text = report(scores, {"other": scores})
    assert "case     1  coulomb_friction" in text
    assert confusion(scores)["coulomb_friction"]["creep"] == 1
    assert limits(scores)["coulomb_friction"]["shares"] == {10.0: 0.95}


def test_answers_are_kept_as_they_come_and_resumed(tmp_path) -> None:
    spec = CaseSpec(5, 3, "none")
    asked = []

    def stub(case):
        asked.append(case)
        return {"verdict": "none", "effects": []}

    job = Job(spec, tmp_path, baselines=False)
    path = run_case(job, stub)
    before = path.read_bytes()
    assert run_case(job, stub) == path
    assert len(asked) == 1
    assert path.read_bytes() == before
    assert "expected" not in before.decode()
    assert not hasattr(asked[0].records[0], "label")
    assert [score.exact for score in read_scores([path])] == [True]
    run_case(Job(spec, tmp_path, baselines=False, resume=False), stub)
    assert len(asked) == 2
    assert not list(tmp_path.rglob("*.tmp"))


def test_a_failing_answer_is_a_wrong_one(tmp_path) -> None:
    def broken(case):
        raise RuntimeError("no luck")

    path = run_case(Job(CaseSpec(5, 3, "none"), tmp_path, baselines=False), broken)
    assert json.loads(path.read_text())["answer"] == {"error": "RuntimeError: no luck"}
    score = read_scores([path])[0]
    assert score.verdict == "error"
    assert not score.exact
    run_case(Job(CaseSpec(5, 3, "none"), tmp_path, baselines=False),
             lambda case: {"verdict": "none", "effects": []})
    assert read_scores([path])[0].exact


def test_a_case_that_cannot_be_made_is_left_out(tmp_path, monkeypatch, capsys) -> None:
    def none(spec):
        raise NoUsableDrawError("case 6: no scale gives a severity of 10")

    monkeypatch.setattr(trial, "make_truth", none)
    path = run_case(Job(CaseSpec(6, 3, "effect", ("slew_limit",), 10.0), tmp_path))
    assert not path.exists()
    assert capsys.readouterr().err == "left out: case 6: no scale gives a severity of 10\n"
    job = Job(CaseSpec(6, 3, "effect", ("slew_limit",), 10.0), tmp_path)
    assert run_all([job], 1, attrgetter("answer_path")) == []


def test_baselines_name_what_a_term_can_say() -> None:
    spec = next(s for s in case_plan(107, 7)
                if s.effects == ("quadratic_damping",) and s.severity == 10.0)
    case = make_case(spec, 12_000)
    for baseline in (stepwise_answer, pysindy_answer):
        if baseline is pysindy_answer:
            pytest.importorskip("pysindy")
        answer = baseline(case)
        assert answer["verdict"] == "named"
        assert "quadratic_damping" in [e["name"] for e in answer["effects"]]
    nothing = make_case(CaseSpec(2, 1, "none"), 12_000)
    assert stepwise_answer(nothing)["verdict"] == "none"
    assert np.isfinite(nothing.records[0]["position_m"]).all()
