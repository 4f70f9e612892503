from __future__ import annotations

import ast
from pathlib import Path

import pytest

from dfm_stage.decisions import TABLE, DecisionError, decision
from dfm_stage.diagnosis.decision_table import PLACES, markdown


@pytest.fixture(autouse=True)
def _nothing_stays():
    before = dict(TABLE)
    yield
    TABLE.clear()
    TABLE.update(before)


def test_a_decision_is_the_number_itself_and_stands_in_the_table():
    assert decision("LEAST", 3, "1", meaning="what is least", set_on="a derivation") == 3
    assert (TABLE["LEAST"].value, TABLE["LEAST"].set_on) == (3, "a derivation")
    assert "| `MARGIN` | 16 | chi-square |" in markdown()


def test_one_name_is_one_number():
    decision("LEAST", 3, "1", meaning="what is least", set_on="a derivation")
    with pytest.raises(DecisionError, match="LEAST"):
        decision("LEAST", 4, "1", meaning="what is least", set_on="a derivation")


@pytest.mark.parametrize("missing", ["meaning", "set_on"])
def test_a_number_without_a_reason_is_refused(missing):
    with pytest.raises(DecisionError, match="LEAST"):
        decision("LEAST", 3, "1", **{"meaning": "what is least", "set_on": "x", missing: ""})


def test_every_decision_is_the_constant_of_its_name():
    found = {name: value for place in PLACES for name, value in vars(place).items()}
    for each in TABLE.values():
        assert found[each.name] == each.value


ROOT = Path(__file__).parents[2]
PLAIN = {0, 1, 2, 0.5, 1e-300}
"""Numbers that decide nothing: none, one, both, a half, and what keeps a division from zero."""


def bare_numbers(source: str) -> list[tuple[int, float]]:
    """Line and value of every number in a comparison, but for plain ones, indices and powers."""
    found = []
    for compare in (n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Compare)):
        skipped = {id(c) for n in ast.walk(compare) for c in (
            ast.walk(n.slice) if isinstance(n, ast.Subscript) else
            ast.walk(n.right) if isinstance(n, ast.BinOp) and isinstance(n.op, ast.Pow) else ())}
        found += [(n.lineno, n.value) for n in ast.walk(compare)
                  if isinstance(n, ast.Constant) and type(n.value) in (int, float)
                  and n.value not in PLAIN and id(n) not in skipped]
    return found


@pytest.mark.parametrize(("source", "values"), [
    ("ratio > 3.0", [3.0]), ("size < 1.05 * floor", [1.05]), ("size < max(4, floor)", [4]),
    ("a < LIMIT", []), ("a > 0.0 and len(b) == 2", []), ("np.sum(r[:, 3] ** 4) < LIMIT", [])])
def test_bare_numbers_are_found_in(source, values):
    assert [value for _, value in bare_numbers(source)] == values


def test_no_bare_number_decides():
    files = {str(path.relative_to(ROOT / "dfm_stage")): bare_numbers(path.read_text("utf-8"))
             for part in ("diagnosis", "identification")
             for path in sorted((ROOT / "dfm_stage" / part).glob("*.py"))}
    bare = {name: numbers for name, numbers in files.items() if numbers}
    assert bare == {}, "give each a name, a meaning and a reason in decisions.py"


def test_the_page_holds_the_table():
    page = (ROOT / "docs" / "decisions.md").read_text(encoding="utf-8")
    assert markdown() in page, (
        "write what python -m dfm_stage.diagnosis.decision_table prints into docs/decisions.md")
