"""The balance of energy of free swings, against equations that are integrated here."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import braked, diagnose
from dfm_stage.diagnosis.evidence import Braking
from dfm_stage.diagnosis.free_swing import braking, swings
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.registry import library_of
from dfm_stage.recording import AxisRecord, Provenance, Record

LIBRARY = library_of(None)
PERIOD, NATURAL = 0.01, 2.0 * math.pi   # 100 Hz, swings of one second


def swing(seed, *, start=1.2, seconds=40.0, noise=3e-4, spring=np.sin, **brakes):
    """A pendulum of inertia 1 that is let go, in readings of 100 Hz; `brakes` are viscous, dry,
    square and by_position."""
    b = {"viscous": 0.0, "dry": 0.0, "square": 0.0, "by_position": 0.0, **brakes}

    def motion(_, state):
        x, v = state
        brake = b["viscous"] + b["square"] * abs(v) + b["by_position"] * x * x
        return v, -NATURAL**2 * spring(x) - brake * v - b["dry"] * math.tanh(v / 1e-3)

    time = PERIOD * np.arange(round(seconds / PERIOD))
    found = solve_ivp(motion, (0.0, seconds), (start, 0.0), t_eval=time, rtol=1e-8, atol=1e-9,
                      max_step=0.02)
    x = found.y[0] + noise * np.random.default_rng(seed).standard_normal(time.size)
    return Observation(f"swing {seed}", np.zeros(time.size), x, PERIOD)


def softening(wrong=1.0):
    """The model that a diagnosis finds of a pendulum: a spring and its cubic term."""
    model = Model("m", PERIOD, {"mass": 1.0, "damping": 0.01, "stiffness": wrong * NATURAL**2})
    return model.with_effect("cubic_stiffness", {"k3": -NATURAL**2 / 6.0})


@pytest.mark.parametrize(("brakes", "names"), [
    ({"viscous": 0.05}, set()),
    ({"viscous": 0.03, "dry": 0.15}, {"coulomb_friction"}),
    ({"dry": 0.25}, {"coulomb_friction"}),
    ({"viscous": 0.01, "square": 0.02}, {"quadratic_damping"}),
    ({"dry": 0.1, "square": 0.02}, {"coulomb_friction", "quadratic_damping"})])
def test_what_brakes_is_told_from_swing_to_swing(brakes, names):
    told = braking([swing(1, **brakes), swing(2, start=0.8, **brakes)], [], softening(), LIBRARY)
    assert set(told.sizes if told else ()) == names
    for name, size in told.sizes.items() if told else ():
        true = brakes["dry" if name == "coulomb_friction" else "square"]
        assert size.value == pytest.approx(true, rel=0.1)
    if told:
        assert told.damping == pytest.approx(brakes.get("viscous", 0.0), abs=0.01)


def test_the_fit_beside_the_brakes_begins_at_the_damping_they_leave(monkeypatch):
    """The one that was found before stood for all of them."""
    begun = []
    told = Braking({"coulomb_friction": Quantity(0.2, "N")}, 0.3, 0.1, {}, damping=0.004)
    monkeypatch.setattr(braked, "braking", lambda *_: told)
    monkeypatch.setattr(braked, "verdict", lambda _: SimpleNamespace(effects=(1,), remainder=1))
    monkeypatch.setattr(braked, "fit", lambda model, *_, **__: begun.append(model)
                        or SimpleNamespace(ok=False))
    search = SimpleNamespace(runs=[swing(1, seconds=2.0)], free=("damping",), library=LIBRARY,
                             step=lambda _: None, weights=(), noise=0.0,
                             parameters=lambda _: ["damping"])
    found = (SimpleNamespace(search=search, held=[]),
             SimpleNamespace(fit=SimpleNamespace(model=softening(), locals={})),
             SimpleNamespace(effects=(), heard=None))
    assert braked.braked(found, (), split=False) is found
    (model,) = begun
    assert model.base["damping"] == 0.004
    assert model.effect("coulomb_friction").parameters == {"force": 0.2}


def test_a_spring_that_is_wrong_by_some_percent_hides_no_friction():
    """In a balance of forces its error is many times the friction."""
    runs = [swing(1, viscous=0.02, dry=0.1), swing(2, start=0.7, viscous=0.02, dry=0.1)]
    for wrong in (0.97, 1.03):
        told = braking(runs, [], softening(wrong), LIBRARY)
        assert set(told.sizes) == {"coulomb_friction"}
        assert told.sizes["coulomb_friction"].value == pytest.approx(0.1, rel=0.1)
        assert told.left < 0.2 * told.missed


def test_a_wrong_spring_brakes_nothing():
    """Viscous damping in a linear model of a pendulum misses some percent."""
    linear = Model("m", PERIOD, {"mass": 1.0, "damping": 0.01, "stiffness": NATURAL**2})
    for seed in range(5):
        assert braking([swing(seed, start=0.8, viscous=0.05)], [], linear, LIBRARY) is None


def test_intervals_hold_the_friction_beside_the_right_spring():
    pendulum = Model("m", PERIOD, {"mass": 1.0, "damping": 0.01}).with_effect(
        "gravity", {"weight": NATURAL**2, "length": 1.0, "tilt": 0.0})
    held = 0
    for seed in range(20):
        told = braking([swing(seed, viscous=0.03, dry=0.12)], [], pendulum, LIBRARY)
        low, high = told.sizes["coulomb_friction"].ci95
        held += low < 0.12 < high
    assert held >= 17


def test_a_swing_loses_its_friction_times_its_path():
    """A closed form: of dry friction alone, the mean braking force of every swing is that."""
    rows = swings(swing(1, noise=1e-6, dry=0.1, spring=lambda x: x), Model(
        "m", PERIOD, {"mass": 1.0, "damping": 0.0, "stiffness": NATURAL**2}), [
        lambda _, v: np.ones_like(v)])
    assert rows.force.size > 30
    np.testing.assert_allclose(rows.force, 0.1, rtol=0.02)
    np.testing.assert_allclose(rows.laws, 1.0, rtol=0.02)


@pytest.mark.parametrize("offset", [0.3, 3.14])
def test_the_angle_need_not_be_zero_at_rest(offset):
    run = swing(1, viscous=0.02, dry=0.1)
    told = braking([replace(run, output=run.output + offset)], [], softening(), LIBRARY)
    assert told.sizes["coulomb_friction"].value == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("brakes", [{"by_position": 0.05}, {"viscous": 0.03, "by_position": 0.2}])
def test_a_brake_of_another_law_is_not_told_as_one_of_these(brakes):
    assert braking([swing(1, **brakes)], [], softening(), LIBRARY) is None


def test_held_out_swings_are_predicted_and_not_fitted():
    """Friction of the fitted run is told only if it brakes the held-out one as well."""
    fitted = swing(1, viscous=0.02, dry=0.1)
    other = swing(2, start=0.6, viscous=0.02, dry=0.1)
    both = braking([fitted], [other], softening(), LIBRARY)
    alone = braking([fitted], [], softening(), LIBRARY)
    assert both.sizes["coulomb_friction"].value == pytest.approx(
        alone.sizes["coulomb_friction"].value, rel=1e-6)
    assert braking([fitted], [swing(2, viscous=0.1)], softening(), LIBRARY) is None
    part = replace(other, name=fitted.name)  # as of a record that is split by time
    assert braking([fitted], [part], softening(), LIBRARY) == both


def test_without_a_spring_there_is_no_energy_to_lose():
    free = Model("m", PERIOD, {"mass": 1.0, "damping": 0.1})
    assert braking([swing(1, dry=0.1)], [], free, LIBRARY) is None


def test_noise_and_few_swings_tell_nothing():
    rng = np.random.default_rng(1)
    still = Observation("still", np.zeros(4000), 1e-3 * rng.standard_normal(4000), PERIOD)
    assert braking([still], [], softening(), LIBRARY) is None
    assert braking([swing(1, seconds=4.0, dry=0.1)], [], softening(), LIBRARY) is None


def recorded(run):
    """The same as a record of an angle without an input."""
    return Record(PERIOD * np.arange(run.output.size), PERIOD, {"x": AxisRecord(
        run.input, run.output, position_unit="rad", input_unit="Nm")}, Provenance(run.name, "csv"))


@pytest.mark.parametrize(("dry", "names"), [
    (0.1, {"cubic_stiffness", "coulomb_friction"}), (0.0, {"cubic_stiffness"})])
def test_a_diagnosis_names_the_friction_of_a_swing_beside_its_spring(dry, names):
    """Of a spring that softens by more than a cube. The friction is 0.3 % of its force."""
    first, last = (recorded(swing(
        seed, start=start, seconds=25.0, viscous=0.05 - 0.3 * dry, dry=dry,
        spring=lambda x: x - x**3 / 6.0 - 0.02 * x**5)) for seed, start in ((1, 1.0), (2, 0.8)))
    model = Model("m", PERIOD, {"mass": 1.0, "damping": 0.03, "stiffness": NATURAL**2,
                                "force_constant": 1.0}, position_unit="rad")
    told = diagnose([first], model, holdout=[last])
    assert set(told.names) == names
    assert told.verdict in ("named", "partial")
    for effect in told.effects:
        if effect.name == "coulomb_friction":
            assert effect.parameters["force"].value == pytest.approx(dry, rel=0.15)
            assert any("from swing to swing" in line for line in effect.evidence)


@pytest.mark.parametrize("name", [n for n in LIBRARY if EFFECTS[n].brakes is not None])
def test_what_is_said_to_brake_does(name):
    effect = EFFECTS[name]
    for v in (-0.3, 0.2):
        if effect.force is not None:
            assert effect.force(0.1, v, 0.0, (2.0,)) == pytest.approx(
                -2.0 * abs(v) ** effect.brakes * math.copysign(1.0, v))
    assert effect.force is not None or (effect.adds_to, effect.brakes) == ("dry_friction", 0)
