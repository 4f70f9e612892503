"""What `import dfm_stage` gives, and that it costs nothing until it is used."""

from __future__ import annotations

import ast
import doctest
import inspect
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dfm_stage
from dfm_stage.cli.example import SHAKE, SWEEP, example_record

ROOT = Path(__file__).parents[2]
HEAVY = {"numpy", "scipy", "numba", "matplotlib", "ruamel"}


def modules_after(code: str) -> set[str]:
    """Names of the top-level modules that a process has loaded."""
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"], cwd=ROOT,
        capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.split()}


def test_importing_loads_nothing_else() -> None:
    assert not modules_after("import dfm_stage") & HEAVY
    assert not modules_after("from dfm_stage import Model") & {"numba", "scipy", "matplotlib"}


@pytest.mark.parametrize("name", dfm_stage.__all__)
def test_every_public_name_is_there_and_documented(name: str) -> None:
    found = getattr(dfm_stage, name)
    assert inspect.getdoc(found)
    assert name in dir(dfm_stage)


def test_type_checkers_are_told_the_same_names() -> None:
    stub = ast.parse((ROOT / "dfm_stage" / "__init__.pyi").read_text("utf-8"))
    told = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom)
            for alias in node.names}
    assert told == set(dfm_stage.__all__)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'diagnoze'"):
        _ = dfm_stage.diagnoze


def test_the_example_of_the_package_runs() -> None:
    assert doctest.testmod(dfm_stage).failed == 0
    assert doctest.testmod(dfm_stage).attempted == 3


def test_records_go_straight_into_identification_and_simulation() -> None:
    shake, sweep = example_record(SHAKE, 1), example_record(SWEEP, 2)
    given = dfm_stage.load_model("paper_stage")
    found = dfm_stage.identify([shake], holdout=[sweep], model=given)
    linear = dfm_stage.simulate(given, sweep)
    assert isinstance(linear, dfm_stage.Simulation)
    assert np.shape(linear.simulated) == (len(sweep),)
    assert dfm_stage.simulate(found.model, sweep).rms < 0.5 * linear.rms
    true = given.with_effect("cubic_stiffness", {"k3": 5e6})
    assert dfm_stage.simulate(true, sweep).rms < 0.02 * linear.rms
