"""The tables in the docs are those of the answers that are kept."""

from pathlib import Path

import pytest

from benchmarks.blind.published import (
    MISSES,
    archives,
    by_severity,
    kept_scores,
    measured_rates,
    misses,
    rates,
)
from benchmarks.diagnose import SEED

DOCS = Path(__file__).resolve().parents[3] / "docs"


@pytest.fixture(scope="module")
def scores():
    return {archive.name: kept_scores(archive) for archive in archives()}


def test_the_rates_in_the_docs_are_those_of_the_kept_answers(scores):
    text = (DOCS / "benchmarks_diagnosis.md").read_text("utf-8")
    assert len(scores) == 2
    assert str(SEED) in next(iter(scores))
    for found in scores.values():
        for row in rates(found):
            assert row in text


def test_the_shares_by_severity_are_those_of_the_kept_answers(scores):
    text = (DOCS / "benchmarks_diagnosis.md").read_text("utf-8")
    for row in by_severity([s for found in scores.values() for s in found]):
        assert row in text


def test_the_rates_of_cases_that_look_like_measurements_are_those_kept():
    text = (DOCS / "benchmarks_diagnosis.md").read_text("utf-8")
    assert "\n".join(measured_rates()) in text


def test_the_list_of_misses_is_that_of_the_kept_answers(scores):
    seeds = {name.split(".")[0].removeprefix("seed_"): found for name, found in scores.items()}
    assert MISSES.read_text("utf-8") == misses(seeds), (
        "run ./run exec python -m benchmarks.blind.published")


def test_every_kept_answer_has_its_label_and_belongs_to_its_seed(scores):
    for found in scores.values():
        indices = [s.index for s in found]
        assert len(set(indices)) == len(indices)


def test_cases_without_an_answer_took_too_long_but_for_one_that_the_docs_tell_of(scores):
    other = [s.index for found in scores.values() for s in found
             if s.verdict == "error" and "Timeout" not in s.notes[0]]
    assert other == [2012]
