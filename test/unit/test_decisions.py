from __future__ import annotations

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
    assert "| `LEAST` | 3 | 1 | what is least | a derivation |\n" in markdown()


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
