"""The comparison on a directly simulated stage, made once for all tests of the paper."""

from __future__ import annotations

from pathlib import Path

import pytest

from dfm_stage.model import load_model
from dfm_stage.paper.stage import DirectStage
from dfm_stage.paper.workflow import NAMES, Models, compare
from dfm_stage.trajectory import load_experiment

FOLDER = Path(__file__).parents[3] / "config" / "experiments"


@pytest.fixture(scope="session")
def experiments():
    return {name: load_experiment(FOLDER / f"{name}.yaml") for name in NAMES}


@pytest.fixture(scope="session")
def models():
    return Models(load_model("paper_stage"), load_model("paper_two_mode"),
                  load_model("xy_stage"))


@pytest.fixture(scope="session")
def comparison(experiments, models):
    return compare(DirectStage(), models, experiments, elements=16)


@pytest.fixture(scope="session")
def rows(comparison):
    return {row.id: row for row in comparison.rows}
