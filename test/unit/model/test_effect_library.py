"""What every effect must say about itself; that a new one is one file shows docs/add_effect.md."""

from __future__ import annotations

import ast
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dfm_stage.model
from dfm_stage.model import BASE_PARAMETERS, EFFECTS, Model, ModelError, Simulator
from dfm_stage.model.effect_table import effect_table
from dfm_stage.model.registry import ALL, UNCOMMON, library_of

NAMES = [
    "cubic_stiffness", "quadratic_stiffness", "coulomb_friction", "presliding_friction",
    "hysteresis", "quadratic_damping", "force_offset", "amplifier_bandwidth", "transport_delay",
    "saturation", "back_emf", "coil_inductance", "force_constant_slope", "force_constant_droop",
    "second_mode", "cross_axis_coupling", "encoder_quantization", "encoder_periodic_error",
    "creep", "thermal_drift", "periodic_disturbance", "eddy_current_damping",
]
EVERY = sorted(library_of([ALL]))
BASE = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "coil_resistance": 8.0}
ROOT = Path(dfm_stage.model.__file__).parents[2]


def test_the_table_in_docs_is_what_the_registry_says() -> None:
    written = ROOT / "docs" / "effects.md"
    if not written.exists():
        pytest.skip("the package is installed without its docs")
    assert written.read_text() == effect_table(), (
        "run python -m dfm_stage.model.effect_table > docs/effects.md")


def test_library_is_complete() -> None:
    assert set(NAMES) == set(EFFECTS) == set(library_of())


def test_uncommon_effects_are_known_and_not_listed() -> None:
    assert all(name in EFFECTS and EFFECTS.get(name).name == name for name in UNCOMMON)
    assert not set(UNCOMMON) & set(EFFECTS)
    assert library_of(["gravity", ALL]) == list(dict.fromkeys(["gravity", *EFFECTS, *UNCOMMON]))
    assert library_of(["creep", "gravity"]) == ["creep", "gravity"]
    with pytest.raises(ModelError, match="did you mean gravity"):
        Model("m", 1e-3, BASE).with_effect("gravitiy", {})


def test_uncommon_effects_are_loaded_when_they_are_asked_for() -> None:
    code = """
import sys
from dfm_stage.model import EFFECTS, load_model
there = {m for m in sys.modules if m.startswith("dfm_stage.model.effects.uncommon.")}
assert "gravity" in EFFECTS and not there, there
assert EFFECTS["gravity"].name == "gravity"
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


@pytest.mark.parametrize("name", EVERY)
def test_effect_describes_itself(name: str) -> None:
    effect = EFFECTS[name]
    assert effect.name == name
    assert effect.meaning
    assert effect.source
    assert effect.shown_by
    folder = Path(dfm_stage.model.__file__).parent / "effects"
    module = folder / ("uncommon" if name in UNCOMMON else "") / f"{name}.py"
    assert "Source:" in (ast.get_docstring(ast.parse(module.read_text())) or "")
    assert set(effect.priors) == {p.name for p in effect.parameters}
    for parameter in effect.parameters:
        prior = effect.priors[parameter.name]
        assert parameter.low <= prior.low < prior.high <= parameter.high
        assert prior.low > 0.0 or not prior.log
        assert parameter.low <= parameter.default <= parameter.high
    known = {*EVERY, *(p.name for p in BASE_PARAMETERS)}
    for equivalence in effect.classes:
        assert name in equivalence.members
        assert set(equivalence.members) <= known
        assert equivalence.on
        assert equivalence.split_by


@pytest.mark.parametrize("name", [n for n in EVERY if EFFECTS[n].fit is not None])
def test_coordinates_for_fitting_are_one_to_one(name: str) -> None:
    effect = EFFECTS[name]
    assert effect.coordinates is not None
    model = Model("m", 1e-3, {**BASE, "force_constant": 1.3}).with_effect(
        name, {p.name: max(p.default, 0.3 * math.sqrt(abs(effect.priors[p.name].high)), p.low)
               for p in effect.parameters})
    values = np.array([model.parameters()[address] for address in effect.coordinates.names])
    fitted = effect.coordinates.forward(values)
    assert len(fitted) == len(effect.coordinates.fitted)
    np.testing.assert_allclose(effect.coordinates.backward(fitted), values, rtol=1e-9)


@pytest.mark.parametrize("name", [n for n in EVERY if EFFECTS[n].twins])
def test_twins_are_given_parameters_that_they_have(name: str) -> None:
    effect = EFFECTS[name]
    for twin, parameters in effect.twins.items():
        given = parameters({n: prior.typical for n, prior in effect.priors.items()})
        assert set(given) <= set(EFFECTS[twin].defaults)
        assert Model("m", 1e-3, BASE).with_effect(twin, {**EFFECTS[twin].defaults, **given})


@pytest.mark.parametrize(("centre", "inside"), [(2e-4, (-1e-3, 6.9e-4)), (-2e-4, (-6.9e-4, 1e-3))])
def test_play_that_is_met_at_one_end_is_a_cable_and_a_stop(centre, inside) -> None:
    play = {"stiffness": 5.0, "gap": 1e-3, "centre": centre}
    force, twins = EFFECTS["backlash"].force, EFFECTS["backlash"].twins
    for x in np.linspace(*inside, 40):
        expected = force(x, 0.01, 0.0, tuple(play.values()))
        for twin in ("one_sided_cable", "end_stop"):
            given = {**EFFECTS[twin].defaults, **twins[twin](play)}
            assert EFFECTS[twin].force(x, 0.01, 0.0, tuple(given.values())) == pytest.approx(
                expected, abs=1e-15)


def test_a_brake_faster_than_its_critical_speed_is_a_friction_that_falls() -> None:
    """Both have their largest force, and a part 1 / e of it at the same higher speed."""
    brake, stribeck = EFFECTS["eddy_current_damping"], EFFECTS["stribeck_friction"]
    values = {"damping": 3.0, "critical_velocity": 0.2}
    given = {**stribeck.defaults, **brake.twins["stribeck_friction"](values)}
    speeds = np.linspace(1e-3, 4.0, 4000)
    forces = np.array([-brake.force(0.0, v, 0.0, (3.0, 0.2)) for v in speeds])
    frictions = np.array([stribeck.friction(0.0, v, 0.0, tuple(given.values())) for v in speeds])
    assert frictions[0] == pytest.approx(np.max(forces), rel=1e-3)
    fallen = np.flatnonzero(forces > np.max(forces) / math.e)[-1]
    assert frictions[fallen] == pytest.approx(np.max(forces) / math.e, rel=1e-2)


@pytest.mark.parametrize("name", EVERY)
def test_effect_runs_within_its_priors_and_changes_something(name: str) -> None:
    """In the middle of its prior each effect is seen in a large fast record."""
    effect = EFFECTS[name]
    plain = Model("m", 1e-3, BASE)
    values = {key: math.sqrt(prior.low * prior.high) if prior.log else prior.high
              for key, prior in effect.priors.items()}
    model = plain.with_effect(name, values)
    inputs = 2.0 * np.sin(2 * np.pi * np.cumsum(np.linspace(1, 30, 800)) * 1e-3)
    other = 1e-3 * np.sin(np.arange(800) * 0.02)
    more = {"other": other} if name == "cross_axis_coupling" else {}
    changed = Simulator(model).run(inputs, **more).output
    assert np.all(np.isfinite(changed))
    assert np.max(np.abs(changed - Simulator(plain).run(inputs).output)) > 1e-9
