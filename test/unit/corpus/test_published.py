"""The tables in the docs are those of the kept counts, and the counts are whole."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from benchmarks import formulas_found, versions
from benchmarks.blind import published, wide_rates
from benchmarks.blind.measured_scoring import MeasuredScore
from benchmarks.blind.published import by_severity, kept, kept_misses, measured_rates, rates
from benchmarks.blind.wide_rates import rate_rows
from benchmarks.corpus import case_plan
from benchmarks.diagnose import SEED

PAGE = Path(__file__).resolve().parents[3] / "docs" / "benchmarks_diagnosis.md"
CASES = 2140
ALL_BELOW = {"20261121": 644, "2006629740": 573}
"""Of the numbers from here on, severities below 3 and effects left out were not run."""


@pytest.fixture(scope="module")
def counts():
    return kept()


def test_the_rates_in_the_docs_are_those_of_the_kept_counts(counts):
    text = PAGE.read_text("utf-8")
    assert len(counts) == 2
    assert next(iter(counts)) == str(SEED)
    for of_seed in counts.values():
        assert "\n".join(rates(of_seed)) in text


def test_the_shares_by_severity_are_those_of_the_kept_counts(counts):
    assert "\n".join(by_severity(list(counts.values()))) in PAGE.read_text("utf-8")


def test_the_rates_of_cases_that_look_like_measurements_are_those_kept():
    assert "\n".join(measured_rates()) in PAGE.read_text("utf-8")


def test_the_rates_of_uncommon_effects_are_those_kept():
    assert "\n".join(rate_rows(wide_rates.kept()["figures"])) in PAGE.read_text("utf-8")


def test_the_comparison_of_two_versions_in_the_docs_is_that_kept():
    text, found = PAGE.read_text("utf-8"), versions.kept()
    times, _, differences = "\n".join(versions.tables(found)).partition("\n\n")
    assert times in text
    assert differences in text
    assert f"{found['cases'] - len(found['differences'])} answers are the same" in text


def answer(index: int, verdict: str, *effects: list[str], seconds: float = 1.0) -> dict[str, Any]:
    return {"commit": "abc", "seed": 1, "index": index, "truth": ["creep"], "verdict": verdict,
            "effects": [[kin[0], kin] for kin in effects], "seconds": seconds}


def test_versions_differ_where_a_verdict_a_name_or_a_class_does():
    old = [answer(0, "named", ["creep"]), answer(1, "named", ["creep"]), answer(2, "none"),
           answer(3, "named", ["creep"], seconds=3.0)]
    new = [answer(0, "named", ["creep"], seconds=2.0), answer(1, "ambiguous", ["creep", "drift"]),
           answer(2, "retune"), answer(3, "named", ["creep"])]
    found = versions.compared(old, new)
    assert [each["case"] for each in found["differences"]] == [1, 2]
    assert found["differences"][0]["after"] == "`ambiguous`: creep (or drift)"
    assert (found["before"]["sum_s"], found["before"]["longest_s"]) == (6.0, 3.0)
    with pytest.raises(ValueError, match="same cases"):
        versions.compared(old, new[:3])


def test_a_run_of_measured_like_cases_is_kept_with_its_wrong_answers(monkeypatch, tmp_path):
    kept_at = {"MEASURED": tmp_path / "rates.json", "MEASURED_MISSES": tmp_path / "misses.csv"}
    for name, path in kept_at.items():
        monkeypatch.setattr(published, name, path)
    scores = [MeasuredScore(1, "remainder", "creep beside cogging", 0.1, "unknown", False, False,
                            False),
              MeasuredScore(2, "remainder", "creep beside cogging", 0.1, "named hysteresis",
                            False, False, True),
              MeasuredScore(3, "remainder", "creep beside cogging", 0.1, "named creep", True,
                            True, False)]
    monkeypatch.setattr(published, "read_measured", lambda _: scores)
    published.keep_measured(tmp_path / "seed_7")
    rates_of = json.loads(kept_at["MEASURED"].read_text("utf-8"))
    values = {each["key"]: each["value"] for each in rates_of["figures"]}
    assert (rates_of["seed"], rates_of["cases"]) == (7, 3)
    assert values["measured.remainder_right_percent"] == pytest.approx(100 / 3, abs=1e-3)
    assert "measured.outsider_wrong_percent" not in values
    assert kept_at["MEASURED_MISSES"].read_text("utf-8").splitlines() == [
        "group,case,kind,answer,wrong_name", "remainder,1,creep beside cogging,unknown,",
        "remainder,2,creep beside cogging,named hysteresis,yes"]


def test_the_table_of_formulas_that_are_found_is_that_of_the_kept_run():
    seed, results = formulas_found.kept()
    text = PAGE.read_text("utf-8")
    assert "\n".join(formulas_found.rows(results)) in text
    assert f"--seed {seed} " in text
    kinds = Counter(r.kind for r in results)
    assert kinds == {kind: 60 if kind == "grammar" else 20 for kind in formulas_found.KINDS}


def test_a_formula_counts_where_it_predicts_and_its_form_where_the_dictionary_has_it():
    def result(formula, terms, expected, over_floor):
        return formulas_found.Result("cogging", "", expected, 10.0, "unknown", formula, terms,
                                     over_floor, 9.0, 2.0)

    row = formulas_found.rows([
        result("-f * a", ["a"], ["a"], 1.5), result("-f * b", ["b"], ["a"], 1.0),
        result("-f * b", ["b"], [], 1.0), result("-f * a", ["a"], ["a"], 1.6),
        result("", [], ["a"], 1.2)])[2]
    assert row == "| cogging | 5 | 4 | 3 (60 %; 23 to 88) | 1 of 2 | 2.0 (2.0) |"


def test_every_case_of_the_plan_is_counted_once(counts):
    for seed, of_seed in counts.items():
        plan = [spec for spec in case_plan(CASES, int(seed)) if spec.index < ALL_BELOW[seed]
                or not (spec.kind == "left_out" or 0.0 < spec.severity < 3.0)]
        kinds = Counter(spec.kind for spec in plan)
        cases = {key: of_seed["rates"][key][1] for key in of_seed["rates"]}
        assert of_seed["cases"] == len(plan)
        assert (cases["false_name"], cases["trap_name"], cases["retune"]) == (
            kinds["none"], kinds["trap"], kinds["retune"])
        effects = Counter((spec.effects[0], f"{spec.severity:g}") for spec in plan
                          if spec.kind == "effect")
        assert effects == {(name, size): three[2] for name, row in of_seed["by_severity"].items()
                           for size, three in row.items()}


def test_the_list_of_misses_is_as_long_as_the_counts_say(counts):
    for seed, of_seed in counts.items():
        listed = Counter()
        for row in kept_misses():
            if row["seed"] == seed:
                listed[_kind(row["case"])] += int(row["times"])
        for key in ("exact", "retune", "pair", "unknown"):
            hits, cases = of_seed["rates"][key]
            assert listed[key] == cases - hits, key


def _kind(case: str) -> str:
    if case.startswith("without "):
        return "unknown"
    if case in ("retune", "none") or case.startswith("trap "):
        return case
    return "pair" if "+" in case else "exact"


def test_cases_without_an_answer_took_too_long_but_for_one_that_the_docs_tell_of(counts):
    other = [case for of_seed in counts.values() for case, reason in of_seed["unanswered"].items()
             if "Timeout" not in reason]
    assert other == ["2012"]


LABEL = {"kind": "effect", "trap": "", "expected": ["named"], "effects": ["creep"],
         "class": ["creep"], "severity": 10.0, "true_effects": {"creep": {"share": 0.1}},
         "true_base": {}, "noise": 1e-7}
RIGHT = {"verdict": "named", "gap": {"held_out": {"after": 1.1e-7}}, "rejected": [], "effects": [
    {"name": "creep", "class": ["creep"], "parameters": {"share": {"ci95": [0.05, 0.2]}}}]}
ANSWERS = (RIGHT, RIGHT, {"verdict": "unknown", "effects": []}, {"error": "TimeoutError: late"})


def test_answers_in_a_folder_become_counts_and_misses(tmp_path: Path, monkeypatch):
    """Four cases of one effect: two named, one called unknown, one without an answer."""
    bench, home = tmp_path / "bench" / "seed_7", tmp_path / "kept"
    for index, answer in enumerate(ANSWERS):
        for kind, content in (("answers", {"answer": answer, "seconds": 1.0 + index}),
                              ("labels", {**LABEL, "index": index})):
            (bench / kind).mkdir(parents=True, exist_ok=True)
            (bench / kind / f"case_{index:05d}.json").write_text(json.dumps(content))
    home.mkdir()
    monkeypatch.setattr(published, "KEPT", home)
    monkeypatch.setattr(published, "MISSES", home / "misses.csv")
    (home / "misses.csv").write_text("seed,case,severity,answer,times\n6,creep,3,none,2\n")
    published.keep(tmp_path / "bench")
    counts = published.kept()["7"]
    assert counts["rates"]["exact"] == [2, 4]
    assert counts["rates"]["covered"] == [2, 2]
    assert counts["by_severity"] == {"creep": {"10": [2, 2, 4]}}
    assert counts["unanswered"] == {"3": "TimeoutError: late"}
    assert counts["seconds"]["sum"] == 10
    assert "| one effect at severity 3 or 10: exact name | 50.0 % **missed** | 2 of 4 |" in \
        published.rates(counts)[2]
    assert (home / "misses.csv").read_text() == (
        "seed,case,severity,answer,times\n6,creep,3,none,2\n"
        "7,creep,10,error TimeoutError: late,1\n7,creep,10,unknown,1\n")
