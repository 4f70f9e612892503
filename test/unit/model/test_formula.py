"""Effects as formulas in the simulator: against the library, and against SciPy's DOP853."""

from __future__ import annotations

import gc
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from friction_equations import coulomb
from scipy.integrate import solve_ivp

from benchmarks.formulas import AS_FORMULAS
from benchmarks.formulas import entry as mine
from dfm_stage.control.feedforward import EffectInput
from dfm_stage.model import (
    EFFECTS,
    EffectUse,
    Model,
    ModelError,
    ParameterError,
    Plant,
    SimulationError,
    Simulator,
    load_model,
    model_text,
    parse_model,
    save_model,
)
from dfm_stage.model.formula import formula_of
from dfm_stage.model.registry import effects_of

H = 1e-3
BASE = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "force_constant": 1.3, "delay": 4e-4,
        "amplifier_time_constant": 5e-4}
PLAIN = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0}
INPUT = 2.0 * np.sin(2 * np.pi * np.cumsum(np.linspace(1, 30, 600)) * H)
CABLE = {"name": "cable", "force": "-k * max(x - x0, 0)", "parameters": {
    "k": {"value": 900.0, "unit": "N/m", "range": [0, 1e4]},
    "x0": {"value": 1e-4, "unit": "m", "range": [-0.01, 0.01]}}}


def use(entry: dict[str, Any]) -> EffectUse:
    formula = formula_of(entry)
    return EffectUse(formula.name, {p.name: p.value for p in formula.parameters}, None, formula)


def with_formula(entry: dict[str, Any], base: dict[str, float] = BASE) -> Model:
    return Model("m", H, base, effects=(use(entry),))


@pytest.mark.parametrize("name", AS_FORMULAS)
def test_an_effect_of_the_library_as_a_formula_gives_the_same_motion(name: str) -> None:
    values, entry, _ = AS_FORMULAS[name]
    expected = Simulator(Model("m", H, BASE).with_effect(name, values)).run(INPUT).output
    plain = Simulator(Model("m", H, BASE)).run(INPUT).output
    found = Simulator(with_formula(entry)).run(INPUT).output
    assert np.max(np.abs(expected - plain)) > 1e-3 * np.max(np.abs(plain))
    assert np.max(np.abs(found - expected)) < 1e-8 * np.max(np.abs(expected))


Rates = Callable[[float, np.ndarray, float], list[float]]
FORCES: dict[str, tuple[dict[str, Any], int, Rates]] = {
    "a cable that only pulls": (CABLE, 0, lambda t, s, u: [-900.0 * max(s[0] - 1e-4, 0.0)]),
    "cogging with a Stribeck-like drag": (
        mine(text="f * sin(2 * pi * x / l) - c * tanh(v / w) * exp(-(v / q)**2)", f=0.2, l=1e-3,
             c=0.1, w=0.01, q=0.05), 0,
        lambda t, s, u: [0.2 * np.sin(2e3 * np.pi * s[0])
                         - 0.1 * np.tanh(100 * s[1]) * np.exp(-(20 * s[1])**2)]),
    "a damper that warms up": (
        mine(text="-c * v / (1 + y)", state={"y": "(c * v * v / e - y) / w"}, c=8.0, e=0.02,
             w=0.2), 1,
        lambda t, s, u: [-8.0 * s[1] / (1 + s[2]), (8.0 * s[1]**2 / 0.02 - s[2]) / 0.2]),
    "a dead band with hard ends": (
        mine(text="-k * where(abs(x) > g, x - g * sign(x), 0)", k=5e3, g=5e-4), 0,
        lambda t, s, u: [-5e3 * (s[0] - 5e-4 * np.sign(s[0])) * (abs(s[0]) > 5e-4)]),
    "stiff bristles": (
        mine(text="-k * y", state={"y": "v - abs(v) * y / d"}, k=1e5, d=1e-6), 1,
        lambda t, s, u: [-1e5 * s[2], s[1] - abs(s[1]) * s[2] / 1e-6]),
    "two states in a chain, with command and time": (
        mine(text="-k * y - g * q * x + h * u * u * x * cos(w * t)",
             state={"y": "r * (q * x - y)", "q": "r * (v * v / b - q)"}, k=100.0, g=200.0,
             r=80.0, b=1e-3, h=30.0, w=25.0), 2,
        lambda t, s, u: [-100 * s[2] - 200 * s[3] * s[0] + 30 * u * u * s[0] * np.cos(25 * t),
                         80 * (s[3] * s[0] - s[2]), 80 * (s[1]**2 / 1e-3 - s[3])]),
}


@pytest.mark.parametrize("name", FORCES)
def test_a_force_that_is_no_effect_of_the_library_agrees_with_dop853(name: str) -> None:
    entry, states, rates = FORCES[name]
    model = with_formula(entry, PLAIN)

    def slope(t: float, s: np.ndarray, u: float) -> list[float]:
        force, *own = rates(t, s, u)
        return [s[1], u - 2.0 * s[1] - 600.0 * s[0] + force, *own]

    s, exact = np.zeros(2 + states), []
    for k, u in enumerate(INPUT):
        exact.append(s[:2])
        s = solve_ivp(slope, (k * H, (k + 1) * H), s, "DOP853", args=(u,), rtol=1e-11,
                      atol=1e-15).y[:, -1]
    found = Simulator(model).run(INPUT)
    for own, theirs in ((found.position, np.array(exact)[:, 0]),
                        (found.velocity, np.array(exact)[:, 1])):
        assert np.max(np.abs(own - theirs)) < 1e-6 * np.max(np.abs(theirs))
    plant = Plant(model)
    for u, x in zip(INPUT[:40], found.position, strict=False):
        assert plant.sample().position_m == x
        plant.advance(float(u))


def test_a_sign_of_the_speed_sticks_beside_other_terms() -> None:
    """Against event-located Coulomb friction, with a cubic spring in the same formula."""
    entry = mine(text="-k * x**3 - f * sign(v)", k=3e6, f=0.4)
    inputs = 0.6 * INPUT[:250]
    found = Simulator(with_formula(entry)).run(inputs, initial={"position": 2e-4})
    states = coulomb({**BASE, "cubic_stiffness.k3": 3e6}, 0.4, inputs, H, (2e-4, 0.0))
    assert np.mean(states[:, 1] == 0.0) > 0.01
    assert np.max(np.abs(found.position - states[:, 0])) < 1e-8 * np.max(np.abs(states[:, 0]))


def test_states_go_on_while_the_point_sticks() -> None:
    """A force that relaxes with time lets go of a stage that friction held."""
    entry = mine(text="-f * sign(v) + g * (1 - y)", state={"y": "(1 - y) / w"}, f=0.5, g=0.8,
                 w=0.1)
    found = Simulator(with_formula(entry, PLAIN)).run(np.full(300, 1.2))
    # friction holds while 1.2 + 0.8 exp(-t / w) - 600 x stays within 0.5; it moves at first
    assert found.velocity[5] > 0.0
    held = Simulator(with_formula(mine(
        text="-f * sign(v) + g * y", state={"y": "(1 - y) / w"}, f=0.5, g=0.8, w=0.1),
        PLAIN)).run(np.full(300, 0.1))
    first = int(np.argmax(held.velocity != 0.0))
    # breaks away where 0.1 + 0.8 (1 - exp(-t / w)) = 0.5
    assert (first - 1) * H <= 0.1 * np.log(2.0) <= first * H


def test_a_command_formula_acts_before_the_amplifier() -> None:
    dead = mine(kind="input", text="-max(min(u, w), -w)", w=0.5)
    found = Simulator(with_formula(dead)).run(INPUT)
    cut = Simulator(Model("m", H, BASE)).run(INPUT - np.clip(INPUT, -0.5, 0.5))
    np.testing.assert_allclose(found.position, cut.position, rtol=0, atol=1e-15)
    assert np.array_equal(found.current, cut.current)
    shaken = mine(kind="input", text="a * sin(w * t)", a=0.3, w=60.0)
    plain = Simulator(Model("m", H, BASE)).run(INPUT + 0.3 * np.sin(60.0 * H * np.arange(600)))
    found = Simulator(with_formula(shaken)).run(INPUT)
    np.testing.assert_allclose(found.position, plain.position, rtol=0, atol=1e-15)
    plant = Plant(with_formula(shaken))
    for u, x in zip(INPUT[:40], found.position, strict=False):
        assert plant.sample().position_m == x
        plant.advance(float(u))
    with pytest.raises(SimulationError, match="depends on time"):
        Simulator(with_formula(shaken)).run(INPUT, steady_state=True)


def test_a_periodic_motion_and_many_rows_know_the_states_of_formulas() -> None:
    entry = AS_FORMULAS["presliding_friction"][1]
    model, twin = with_formula(entry), Model("m", H, BASE).with_effect(
        "presliding_friction", {"force": 0.05, "stiffness": 2e4})
    wave = np.sin(2 * np.pi * np.arange(200) / 200)
    x, y = (Simulator(m).run(wave, steady_state=True).position for m in (model, twin))
    assert np.max(np.abs(x - y)) < 1e-6 * np.max(np.abs(y))
    rows = [[0.05], [0.01], [0.05]]
    many = Simulator(model).run_many(INPUT, ["mine.w"], rows, threads=1)
    assert np.array_equal(many[0], many[2])
    alone = Simulator(model.with_parameters({"mine.w": 0.01})).output(INPUT)
    assert np.array_equal(many[1], alone)


def test_feedforward_gives_what_a_formula_takes_even_where_it_has_no_value() -> None:
    spring = EffectInput(with_formula(mine(text="-k * x**3", k=3e6)))
    library = EffectInput(Model("m", H, BASE).with_effect("cubic_stiffness", {"k3": 3e6}))
    assert spring.at(1e-3, 0.01, 0.5) == pytest.approx(library.at(1e-3, 0.01, 0.5), rel=1e-12)
    assert spring.any
    cable = EffectInput(with_formula(CABLE))
    assert cable.covers == ("cable",)
    pull = 900.0 * (1e-3 - 1e-4) / 1.3
    plain = EffectInput(Model("m", H, BASE))
    assert cable.at(1e-3, 0.01, 0.5) - plain.at(1e-3, 0.01, 0.5) == pytest.approx(pull)
    slope = EffectInput(with_formula(AS_FORMULAS["force_constant_slope"][1]))
    twin = EffectInput(Model("m", H, BASE).with_effect("force_constant_slope", {"slope": 60.0}))
    assert slope.at(1e-3, 0.01, 0.5) == pytest.approx(twin.at(1e-3, 0.01, 0.5), rel=1e-12)
    assert not np.isfinite(EffectInput(with_formula(mine(text="k / x", k=1.0))).at(0.0, 0.0, 0.0))


TEXT = """\
dfm_model: 1
name: bench
sample_period: 0.001
base: {mass: 1.0, damping: 2.0, stiffness: 600.0}
effects:
  - name: cable             # seen in May
    force: "-k * max(x - x0, 0)"
    parameters:
      k: {value: 900, unit: N/m, range: [0, 1e4]}      # stiffness
      x0: {value: 1.0e-4, unit: m, range: [-0.01, 0.01]}
"""


def test_a_model_file_stands_alone(tmp_path: Path) -> None:
    before = list(EFFECTS)
    model = parse_model(TEXT, "bench.yaml")
    assert list(EFFECTS) == before
    moved = Simulator(model).run(INPUT).position
    assert np.array_equal(moved, Simulator(with_formula(CABLE, PLAIN)).run(INPUT).position)
    stiffer = model.with_parameters({"cable.k": 1000.0})
    save_model(stiffer, tmp_path / "model.yaml")
    text = (tmp_path / "model.yaml").read_text("utf-8")
    assert text.split() == TEXT.replace("value: 900", "value: 1000.0").split()
    assert load_model(tmp_path / "model.yaml") == stiffer
    assert parse_model(model_text(with_formula(CABLE, PLAIN)), "m").effects == model.effects
    again = pickle.loads(pickle.dumps(model))  # noqa: S301 our own
    assert again == model
    assert np.array_equal(Simulator(again).run(INPUT).position, moved)
    assert model.parameter("cable.x0").high == 0.01
    with pytest.raises(ParameterError, match="outside"):
        model.with_parameters({"cable.x0": 1.0})


def test_the_formula_of_a_model_is_its_own_and_leaves_with_it() -> None:
    one = parse_model(TEXT, "one")
    two = parse_model(TEXT.replace("-k * max(x - x0, 0)", "-k * min(x + x0, 0)"), "two")
    x, y = (Simulator(m).run(INPUT).position for m in (one, two))
    assert np.max(np.abs(x - y)) > 1e-2 * np.max(np.abs(x))
    assert np.array_equal(Simulator(one).run(INPUT).position, x)
    assert "cable" in EFFECTS
    assert "cable" not in list(EFFECTS)
    del one, two, x, y
    gc.collect()
    assert "cable" not in EFFECTS
    with pytest.raises(ModelError, match="not known"):
        Model("m", H, PLAIN).with_effect("cable", {"k": 1.0, "x0": 0.0})


@pytest.mark.parametrize(("changed", "line", "words"), [
    (("x - x0", "x - y0"), 7, "column 14: y0 is not known"), (("cable", "creep"), 6, "library"),
    (("value: 900", "val: 900"), 7, "value"), (("1.0e-4", "1.0"), 7, "outside its range"),
    (("force:", "Force:"), 7, "did you mean force")])
def test_a_mistake_in_a_model_file_names_line_and_column(
        changed: tuple[str, str], line: int, words: str) -> None:
    with pytest.raises(ModelError) as caught:
        parse_model(TEXT.replace(*changed), "bench.yaml")
    assert str(caught.value).startswith(f"bench.yaml:{line}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_and_folders_of_formulas_are_candidates_for_a_while(tmp_path: Path) -> None:
    (tmp_path / "one.yaml").write_text(
        "name: one\nforce: -k * x**5\nparameters: {k: {value: 0, unit: N/m^5}}\n")
    (tmp_path / "two.yml").write_text("effects:\n  - {name: two, input: -g * u, "
                                      "parameters: {g: {value: 0, unit: '', range: [0, 1]}}}\n")
    source = Path(__file__).with_name("quintic_stiffness.py")
    before = list(EFFECTS)
    with effects_of([tmp_path, source]) as found:
        names = [effect.name for effect in found]
        assert names == ["one", "two", "quintic_stiffness"]
        assert list(EFFECTS) == [*before, *names]
        model = Model("m", H, PLAIN).with_effect("one", {"k": 1e12})
    assert list(EFFECTS) == before
    del found
    assert "force: -k * x**5" in model_text(model)
    assert np.all(np.isfinite(Simulator(model).run(INPUT).position))
    for name, text, words in (
            ("bad.yaml", "name: [", "not valid YAML"), ("bad.yaml", "3", "needs name"),
            ("bad.yaml", "{name: creep, force: -k*x, parameters: {k: {value: 1}}}", "library"),
            ("bad.yaml", "{name: a, forse: -k*x, parameters: {k: {value: 1}}}", "no key"),
            ("none.yaml", None, "cannot be read")):
        if text is not None:
            (tmp_path / name).write_text(text)
        with pytest.raises(ModelError, match=words) as caught, effects_of([tmp_path / name]):
            pass
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)
