"""The wide corpus: its plan, what is declared of kin, its labels, and how answers are judged."""

import hashlib
import json
from collections import Counter
from dataclasses import astuple

import numpy as np
import pytest

from benchmarks.blind import trial
from benchmarks.blind.scoring import judge
from benchmarks.blind.trial import Job, add_rivals
from benchmarks.blind.wide_rates import by_effect, effect_rows, misses, rate_rows, summary
from benchmarks.corpus import case_plan, make_case
from benchmarks.corpus.case import make_truth
from benchmarks.corpus.plan import EFFECTS, CaseSpec
from benchmarks.corpus.rivals import DISTANCE, separability
from benchmarks.corpus.uncommon import PARAMETERS, UNCOMMON
from benchmarks.corpus.wide import WideSpec, wide_plan
from benchmarks.corpus.wide.kin import (
    IN_PART,
    NO_ORDER,
    SAME_ON,
    can_pair,
    left_out_with,
    relatives,
    rivals_of,
)
from benchmarks.corpus.wide.plan import BLOCK, STAGE
from dfm_stage.model import EFFECTS as LIBRARY
from dfm_stage.model.registry import UNCOMMON as LIBRARY_S

PLANNED = "ffa4da612de40c808b917ab1f331bef3d3d770da6031722c08d5e5eacf6eef92"


def test_the_numbers_of_the_common_corpus_are_the_cases_that_they_were() -> None:
    plan = case_plan(2140, 20261121)
    assert hashlib.sha256(json.dumps([astuple(s) for s in plan]).encode()).hexdigest() == PLANNED


@pytest.mark.parametrize(("spec", "motion", "stiffness"), [
    (CaseSpec(3, 5, "none"), 1.1528619647971669e-4, 1361.4317289516712),
    (CaseSpec(4, 5, "effect", ("coulomb_friction",), 10.0), 8.897004006519064e-5,
     25125.2461815246)])
def test_the_records_of_the_common_corpus_are_what_they_were(spec, motion, stiffness) -> None:
    case = make_case(spec, 300)
    assert np.std(case.records[0]["position_m"]) == pytest.approx(motion, rel=1e-7)
    assert case.model["base"]["stiffness"] == pytest.approx(stiffness, rel=1e-12)


def test_the_effects_and_parameters_are_those_of_the_library() -> None:
    assert sorted(UNCOMMON) == LIBRARY_S
    for name, own in PARAMETERS.items():
        assert own == tuple(p.name for p in LIBRARY[name].parameters), name


def test_what_the_documents_call_the_same_is_declared() -> None:
    effects = {*EFFECTS, *UNCOMMON}
    classes = [set(each.members) & effects for name in effects for each in LIBRARY[name].classes]
    for name in UNCOMMON:
        said = set().union(*(each for each in classes if name in each))
        more = {"coil_inductance"} if name == "sensor_lag" else set()  # of the lags' class
        assert said - {name} | more == SAME_ON[name], name
    assert set(IN_PART) == set(SAME_ON)
    for name in UNCOMMON:
        assert IN_PART[name] <= effects - SAME_ON[name] - {name}, name


def test_what_a_convention_parts_is_no_rival_and_is_left_out_together() -> None:
    assert rivals_of("cogging") == {"encoder_periodic_error"}
    assert left_out_with("cogging") == {"cogging", "gravity"}
    assert relatives("gravity") == {"cubic_stiffness"}
    assert left_out_with("dead_zone") == {"dead_zone"}


def test_the_plan_has_each_effect_in_each_stage() -> None:
    plan = wide_plan(3 * BLOCK, 1)
    assert wide_plan(50, 1) == plan[:50]
    assert [spec.index for spec in plan] == list(range(len(plan)))
    for first, kind, size in ((0, "effect", 10.0), (1, "left_out", 10.0), (2, "pair", 10.0),
                              (3, "effect", 3.0)):
        part = plan[first * STAGE:(first + 1) * STAGE]
        assert {(s.kind, s.severity) for s in part} == {(kind, size)}
        assert {s.effects[0] for s in part} == set(UNCOMMON)
    assert Counter(s.kind for s in plan)["none"] == 30
    for spec in plan:
        if spec.kind == "pair":
            assert spec.effects[1] in EFFECTS
            assert can_pair(*spec.effects)
    assert not can_pair("gravity", "cubic_stiffness")
    assert not any(can_pair(b, a) for first, second in NO_ORDER for a in first for b in second)


def test_random_numbers_are_its_own() -> None:
    common = make_case(CaseSpec(3, 5, "none"), 300)
    wide = make_case(WideSpec(3, 5, "none"), 300)
    assert common.label["noise"] != wide.label["noise"]


@pytest.mark.parametrize("name", ["cogging", "sensor_lag", "dead_zone"])
def test_labels_of_what_is_left_out(name: str) -> None:
    case = make_case(WideSpec(1, 8, "left_out", (name,), 10.0), 300)
    assert set(case.remove) == left_out_with(name)
    assert case.label["relatives"] == sorted(relatives(name))
    assert not set(case.label["relatives"]) & set(case.remove)
    assert case.label["severities"][name] == pytest.approx(10.0, rel=0.03)
    assert name not in json.dumps(case.model)


@pytest.mark.slow
def test_the_generator_finds_what_is_the_same() -> None:
    # a lag of the reading is one of the amplifier; a pendulum above the noise is no cubic spring
    truth = next(t for t in (make_truth(WideSpec(i, 8, "effect", ("sensor_lag",), 10.0), 3000)
                             for i in range(9)) if t.setup.stage.current_noise is None)
    assert separability(truth).distance < DISTANCE
    clear = make_truth(WideSpec(1, 8, "effect", ("gravity",), 10.0), 3000)
    assert separability(clear).distance > DISTANCE


def test_the_generator_compares_rivals_of_a_lag_with_a_record_of_the_current() -> None:
    truth = next(t for t in (make_truth(WideSpec(i, 8, "effect", ("sensor_lag",), 10.0), 1000)
                             for i in range(60)) if t.setup.stage.current_noise is not None)
    found = separability(truth)
    assert found.rival is not None
    assert found.distance >= 0.0


def label(kind: str, **more) -> dict:
    return {"index": 1, "kind": kind, "trap": "", "expected": ["unknown", "partial"],
            "effects": ["one_sided_cable"], "class": [], "severity": 10.0, "true_effects": {},
            "true_base": {}, "noise": 1e-7, **more}


def told(verdict: str, *names: str, group=()) -> dict:
    return {"verdict": verdict, "gap": {}, "effects": [
        {"name": n, "class": list(group) or [n], "parameters": {}} for n in names]}


@pytest.mark.parametrize(("answer", "exact", "wrong"), [
    (told("unknown"), True, False), (told("partial", "quadratic_stiffness"), True, False),
    (told("partial", "creep"), False, True),
    (told("partial", "quadratic_stiffness", "creep"), False, True),
    (told("named", "quadratic_stiffness"), False, True),
    (told("ambiguous", "quadratic_stiffness", group=("quadratic_stiffness", "backlash")), False,
     False),
    (told("ambiguous", "quadratic_stiffness", group=("quadratic_stiffness", "creep")), False,
     True),
    (told("none"), False, False), ({"error": "late"}, False, False)])
def test_left_out_is_unknown_or_partly_a_relative(answer, exact: bool, wrong: bool) -> None:
    left = label("left_out", relatives=["backlash", "quadratic_stiffness"])
    score = judge(left, answer)
    assert (score.exact, score.spurious, score.counted) == (exact, wrong, True)
    assert not judge({**left, "separable": False}, answer).counted


def test_figures_rows_and_misses() -> None:
    single = label("effect", expected=["named"])
    single["class"] = ["end_stop", "one_sided_cable", "quadratic_stiffness"]
    scores = [judge(single, told("named", "one_sided_cable"), 3.0),
              judge(single, told("ambiguous", "one_sided_cable",
                                 group=("end_stop", "one_sided_cable")), 70.0),
              judge(single, told("named", "creep"), 5.0),
              judge({**single, "separable": False}, told("unknown"), 5.0),
              judge(label("left_out", relatives=[]), told("named", "creep"), 5.0)]
    found = summary(7, scores)
    values = {each["key"]: each["value"] for each in found["figures"]}
    assert values["diagnose.exact_percent.wide"] == pytest.approx(33.333)
    assert values["diagnose.class_percent.wide"] == 50.0  # of all, equivalents or not
    assert values["diagnose.class_size.wide"] == 1.5
    assert values["diagnose.confident_wrong_percent.wide"] == 100.0
    assert values["diagnose.case_seconds.wide"] == 5.0
    assert values["diagnose.longest_case_seconds.wide"] == 70.0
    assert by_effect(scores) == {"one_sided_cable": {"effect_10": [1, 4], "left_out": [0, 1]}}
    assert effect_rows(found["by_effect"])[2] == "| `one_sided_cable` | 1 of 4 |  |  | 0 of 1 |"
    assert "| class size | 1.50 **missed** | at most 1.3 |" in "\n".join(
        rate_rows(found["figures"]))
    assert len(misses(scores).splitlines()) == 5


def test_what_rivals_say_is_added_to_a_label_once(tmp_path, monkeypatch) -> None:
    job = Job(WideSpec(5, 3, "effect", ("dead_zone",), 10.0), tmp_path, rivals=False)
    job.label_path.parent.mkdir()
    job.label_path.write_text(json.dumps(label("effect")))
    asked = []
    monkeypatch.setattr(trial, "make_truth", asked.append)
    monkeypatch.setattr(trial, "told_apart", lambda truth, label: {"separable": False})
    assert add_rivals(job) == add_rivals(job) == job.answer_path
    assert json.loads(job.label_path.read_text()) == {**label("effect"), "separable": False}
    assert asked == [job.spec]
