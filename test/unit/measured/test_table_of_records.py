"""The table of measured records is whole, and its answers are ones that a diagnosis can give."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.measured.records import load_records
from benchmarks.measured.sources import READERS
from dfm_stage.model import load_model
from dfm_stage.model.registry import ALL, library_of

TABLE = load_records()
VERDICTS = {"none", "retune", "named", "partial", "ambiguous", "unknown", "not_excited"}


def test_every_record_has_a_reader_and_no_reader_is_left_over():
    assert set(TABLE) == set(READERS)


def test_more_than_four_records_were_used_to_set_no_rule():
    assert sum(not record.development for record in TABLE.values()) >= 4


@pytest.mark.parametrize("record", TABLE.values(), ids=lambda record: record.name)
def test_expected_answers_can_be_given(record):
    expected = record.expected
    assert set(expected.verdicts) <= VERDICTS
    assert expected.allowed <= set(library_of([ALL]))
    assert all(set(group) <= expected.allowed for group in expected.required)
    assert expected.why
    assert record.published
    assert record.licence


@pytest.mark.parametrize("record", [r for r in TABLE.values() if not r.model_file],
                         ids=lambda record: record.name)
def test_starting_models_are_models(record, tmp_path: Path):
    from ruamel.yaml import YAML

    with (tmp_path / "model.yaml").open("w") as file:
        YAML().dump({"dfm_model": 1, "name": record.name, **record.model}, file)
    assert load_model(tmp_path / "model.yaml").base["mass"] > 0.0


def test_a_record_is_found_only_where_all_of_its_files_are(tmp_path: Path):
    record = TABLE["emps"]
    folder = tmp_path / "emps"
    folder.mkdir()
    (folder / "train.npz").touch()
    assert record.where([tmp_path]) is None
    (folder / "holdout.npz").touch()
    assert record.where([tmp_path / "elsewhere", tmp_path]) == folder


def test_a_file_may_have_another_name_in_the_readers_copy(tmp_path):
    record = load_records()["torque_pendulum"]
    assert record.where([tmp_path]) is None
    assert "data_measured.csv as sac.csv" in record.how_to_get
    (tmp_path / "torque_pendulum").mkdir()
    for name in ("energy_shaping.csv", "sac.csv"):
        (tmp_path / "torque_pendulum" / name).touch()
    assert record.where([tmp_path]) == tmp_path / "torque_pendulum"
