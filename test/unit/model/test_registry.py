"""Effects that come at run time, and effects of another name."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.machine_code import content_hash
from dfm_stage.model import EFFECTS, Model, ModelError, Plant, Simulator, parse_model
from dfm_stage.model.effect import Effect, Values, reads
from dfm_stage.model.registry import load_effect, register

H = 1e-3
BASE = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "force_constant": 1.0, "delay": 1.3e-3,
        "amplifier_time_constant": 5e-4, "coil_resistance": 8.0}
INPUT = 2.0 * np.sin(2 * np.pi * np.cumsum(np.linspace(1, 30, 400)) * H)
OTHER = 1e-3 * np.sin(np.arange(400) * 0.02)
OUTSIDE = Path(__file__).with_name("quintic_stiffness.py")


@pytest.fixture(autouse=True)
def _as_it_was() -> Iterator[None]:
    before = dict(EFFECTS)
    yield
    EFFECTS.clear()
    EFFECTS.update(before)


def _values(effect: Effect) -> dict[str, float]:
    return {key: math.sqrt(prior.low * prior.high) if prior.log else prior.high
            for key, prior in effect.priors.items()}


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_another_name_changes_no_number(name: str) -> None:
    effect = EFFECTS[name]
    more = {"other": OTHER} if effect.couples else {}
    model = Model("m", H, BASE).with_effect(name, _values(effect))
    simulator = Simulator(model)
    expected = simulator.run(INPUT, **more)
    address = f"{name}.{effect.parameters[0].name}"
    many = simulator.run_many(INPUT, [address], [[1.1 * model.parameters()[address]]], **more)
    del EFFECTS[name]
    register(replace(effect, name="zz_renamed"))
    with pytest.raises(ModelError, match="not known"):
        Model("m", H, BASE).with_effect(name, _values(effect))
    renamed = Model("m", H, BASE).with_effect("zz_renamed", _values(effect))
    again = Simulator(renamed)
    assert again.states == tuple(s.replace(name, "zz_renamed") for s in simulator.states)
    found = again.run(INPUT, **more)
    for signal in ("position", "current", "force", "reading", "output"):
        np.testing.assert_array_equal(getattr(found, signal), getattr(expected, signal))
    np.testing.assert_array_equal(found.measured(3), expected.measured(3))
    np.testing.assert_array_equal(again.run_many(
        INPUT, [address.replace(name, "zz_renamed")],
        [[1.1 * model.parameters()[address]]], **more), many)
    own = effect.coordinates
    if own is not None:
        assert replace(effect, name="zz_renamed").coordinates.names == tuple(
            n.replace(f"{name}.", "zz_renamed.") for n in own.names)


def test_a_coupling_takes_the_effect_that_couples_by_whatever_name() -> None:
    text = ("{dfm_model: 1, name: xy, sample_period: 0.001, axes: {x: {base: {mass: 1, damping: 2}"
            "}, y: {base: {mass: 1, damping: 3}}}, coupling: {x: {y: {ratio: 0.5}}}}")
    effect = EFFECTS.pop("cross_axis_coupling")
    register(replace(effect, name="skew"))
    model = parse_model(text, "xy")
    assert [use.name for use in model.axis("x").effects] == ["skew"]
    assert model.neighbour("x") == "y"
    del EFFECTS["skew"]
    with pytest.raises(ModelError, match="no effect is registered"):
        parse_model(text, "xy")


def test_a_file_outside_the_package_is_simulated() -> None:
    assert load_effect(OUTSIDE) is EFFECTS["quintic_stiffness"]
    base = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0}
    model = Model("m", H, base).with_effect("quintic_stiffness", {"k5": 3e13})
    simulator = Simulator(model)
    found = simulator.run(INPUT[:200]).position

    def rate(t: float, s: np.ndarray, u: float) -> list[float]:
        return [s[1], u - 2.0 * s[1] - 600.0 * s[0] - 3e13 * s[0]**5]

    state, expected = np.zeros(2), []
    for u in INPUT[:200]:
        expected.append(state[0])
        state = solve_ivp(rate, (0.0, H), state, "DOP853", args=(u,), rtol=1e-10,
                          atol=1e-14).y[:, -1]
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))
    linear = Simulator(model.without_effect("quintic_stiffness")).run(INPUT[:200]).position
    assert np.max(np.abs(found - linear)) > 1e-2 * np.max(np.abs(expected))
    plant = Plant(model)
    for u, x in zip(INPUT[:50], found, strict=False):
        assert plant.sample().position_m == x
        plant.advance(float(u))


def test_an_effect_registered_again_replaces_the_code() -> None:
    load_effect(OUTSIDE)
    base = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0}
    model = Model("m", H, base).with_effect("quintic_stiffness", {"k5": 3e13})
    before = Simulator(model).run(INPUT).position

    def force(x: float, v: float, actuator: float, p: Values) -> float:
        return -2.0 * p[0] * x**5

    register(replace(EFFECTS["quintic_stiffness"], force=force))
    after = Simulator(model).run(INPUT).position
    double = Simulator(model.with_parameters({"quintic_stiffness.k5": 6e13}))
    del EFFECTS["quintic_stiffness"]
    load_effect(OUTSIDE)
    assert np.max(np.abs(after - before)) > 1e-4 * np.max(np.abs(before))
    assert np.allclose(after, Simulator(double.model).run(INPUT).position, rtol=1e-9, atol=1e-18)


NEXT_PROCESS = """
import importlib.util, sys
import numba
from dfm_stage import machine_code
spec = importlib.util.spec_from_file_location(sys.argv[2], sys.argv[1])
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
hook = numba.njit(module.half)
def twice(x):
    return hook(x) + hook(x)
kept = machine_code.callback("t", twice, numba.float64(numba.float64), (module.half,))
print(kept.ctypes(3.0), kept.cache_hits)
"""


def test_code_of_a_file_outside_the_package_is_found_by_the_next_process(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def half(x):\n    return 0.5 * x\n")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    for module, hits in (("first", 0), ("another_name", 1)):
        done = subprocess.run(
            [sys.executable, "-c", NEXT_PROCESS, str(tmp_path / "mine.py"), module],
            capture_output=True, text=True, check=False, env=environment)
        assert done.stdout.split() == ["3.0", str(hits)], done.stderr


@pytest.mark.parametrize(("text", "message"), [
    ("EFFECT = 3\n", "holds no effect"), ("1 / 0\n", "ZeroDivisionError"),
    (None, "cannot be run")])
def test_a_file_without_an_effect_is_refused(tmp_path: Path, text: str | None,
                                             message: str) -> None:
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ModelError, match=message):
        load_effect(path)


def test_what_a_hook_reads_is_seen_in_its_code() -> None:
    assert not reads(EFFECTS["cubic_stiffness"].force, 1)
    assert reads(EFFECTS["quadratic_damping"].force, 1)
    assert reads(EFFECTS["force_constant_slope"].force, 2)
    assert not reads(EFFECTS["quadratic_damping"].force, 2)
    assert [name for name, effect in EFFECTS.items() if effect.couples] == ["cross_axis_coupling"]


def test_the_hash_of_a_function_follows_what_it_calls() -> None:
    def made(factor: float, shift: float) -> object:
        def inner(x: float) -> float:
            return factor * x

        def outer(x: float) -> float:
            return inner(x) + shift

        return outer

    assert content_hash(made(2.0, 1.0)) == content_hash(made(2.0, 1.0))
    assert len({content_hash(made(*each)) for each in ((2.0, 1.0), (3.0, 1.0), (2.0, 0.5))}) == 3
