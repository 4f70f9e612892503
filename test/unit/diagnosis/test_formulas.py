"""Formulas of a user's in diagnosis and estimation. The records with a cable are DOP853's."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import truth

from dfm_stage.cli import diagnose as command
from dfm_stage.identification import Run, fit_model
from dfm_stage.model import EFFECTS, Model, Simulator, load_model, save_model

HERE = Path(__file__).parent


def _loaded(name: str, path: Path) -> object:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.path.insert(0, str(HERE.parent / "model"))
    spec.loader.exec_module(module)
    sys.path.pop(0)
    return module


formulas = _loaded("model_formulas", HERE.parent / "model" / "test_formula.py")
CABLE = """\
effects:
  - name: cable
    force: "-k * max(x - x0, 0)"
    parameters:
      k: {value: 0, unit: N/m, range: [0, 1e4]}
      x0: {value: 0, unit: m, range: [-0.01, 0.01]}
"""
K, X0 = truth.CABLE


def test_a_cable_is_named_by_its_formula_and_the_model_stands_alone(tmp_path, capsys) -> None:
    rng = np.random.default_rng(5)
    for name, feed in (("train", 2.0 * truth.multisine(31)[:5000]),
                       ("held", 2.0 * truth.scan()[:5000])):
        x = truth.pulled(feed) + 5e-8 * rng.standard_normal(feed.size)
        table = np.column_stack((truth.PERIOD * np.arange(feed.size), feed, x))
        np.savetxt(tmp_path / f"{name}.csv", table, "%.10g", ",",
                   header="time_s,input_v,position_m", comments="")
    save_model(truth.believed(), tmp_path / "believed.yaml")
    (tmp_path / "cable.yaml").write_text(CABLE, encoding="utf-8")
    library = list(EFFECTS)
    assert command.main([
        str(tmp_path / "train.csv"), "--holdout", str(tmp_path / "held.csv"), "--model",
        str(tmp_path / "believed.yaml"), "--effect", str(tmp_path / "cable.yaml"), "--library",
        "cubic_stiffness,quadratic_stiffness,coulomb_friction,quadratic_damping,cable",
        "--out", str(tmp_path / "out"), "--no-report"]) == 0
    assert list(EFFECTS) == library
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text("utf-8"))
    assert (said["verdict"], [e["name"] for e in said["effects"]]) == ("named", ["cable"])
    own = said["effects"][0]["parameters"]
    assert own["k"]["value"] == pytest.approx(K, rel=0.02)
    assert own["x0"]["value"] == pytest.approx(X0, abs=1e-5)
    assert own["k"]["unit"] == "N/m"

    text = (tmp_path / "out" / "model.yaml").read_text("utf-8")
    assert "-k * max(x - x0, 0)" in text
    found = load_model(tmp_path / "out" / "model.yaml")
    feed = truth.scan()[:5000]
    expected = truth.pulled(feed)
    moved = Simulator(found).run(feed).position
    assert np.std(moved - expected) < 0.01 * np.std(expected)
    save_model(found, tmp_path / "again.yaml")
    assert np.array_equal(Simulator(load_model(tmp_path / "again.yaml")).run(feed).position, moved)
    capsys.readouterr()
    (tmp_path / "cable.yaml").write_text(CABLE.replace("x - x0", "x - y0"), encoding="utf-8")
    assert command.main([str(tmp_path / "train.csv"), "--model", str(tmp_path / "believed.yaml"),
                         "--effect", str(tmp_path / "cable.yaml")]) == 2
    said = capsys.readouterr().err
    assert "cable.yaml: cable: force: column 14: y0 is not known" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize("name", [n for n in formulas.AS_FORMULAS if n != "periodic_disturbance"])
def test_a_formula_is_estimated_as_the_effect_of_the_library_that_it_is(name: str) -> None:
    """The same start, the same record: the same estimates to 1e-6. (The phase of a vibration is
    estimated anew in each run by an effect of the library, which a formula does not do.)"""
    values, entry, same = formulas.AS_FORMULAS[name]
    feed = formulas.INPUT
    base = {**formulas.BASE, "encoder_zero": 0.0}
    library = Model("m", formulas.H, base).with_effect(name, values)
    noise = 1e-8 * np.random.default_rng(3).standard_normal(feed.size)
    measured = Simulator(library).run(feed).output + noise
    run = [Run("run", feed, measured, formulas.H)]
    off = {n: v * 1.01 for n, v in values.items()}
    mine = Model("m", formulas.H, base, effects=(formulas.use(entry),)).with_parameters(
        {f"mine.{own}": off[its] for own, its in same.items()})
    expected = fit_model(Model("m", formulas.H, base).with_effect(name, off), run,
                         [f"{name}.{its}" for its in same.values()], noise="white").model
    found = fit_model(mine, run, [f"mine.{own}" for own in same], noise="white").model
    for own, its in same.items():
        assert found.parameters()[f"mine.{own}"] == pytest.approx(
            expected.parameters()[f"{name}.{its}"], rel=1e-6)
