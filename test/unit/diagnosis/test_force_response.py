"""First-order responses against simulations of the effect itself, small enough to be linear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dfm_stage.diagnosis.candidates import starts
from dfm_stage.diagnosis.fit import system_of
from dfm_stage.diagnosis.force_response import ForceResponse
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.convention import Drive
from dfm_stage.identification.system import System
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.formula import formula_of
from dfm_stage.model.registry import ALL, library_of

PERIOD, SAMPLES = 1e-3, 4000
TIME = PERIOD * np.arange(SAMPLES)
DRIVE = np.sin(2.0 * np.pi * 3.0 * TIME) + 0.6 * np.sin(2.0 * np.pi * 17.0 * TIME + 1.0) \
    + 0.2 * np.sin(2.0 * np.pi * 0.5 * TIME)
STAGE = {"mass": 1.0, "damping": 6.0, "stiffness": 4000.0, "force_constant": 2.0,
         "delay": 0.4e-3}
SMALLER = 0.1
"""Of the size at which a screen begins: there, the response is proportional to it."""
FORCES = [n for n in library_of([ALL]) if EFFECTS[n].curves]


def system(base: dict[str, float], **how: object) -> System:
    """A stage that moves from rest by DRIVE, as its own record."""
    model = Model("stage", PERIOD, base)
    bare = Observation("run", DRIVE, DRIVE, PERIOD, **{"start": "free", **how})
    moved = system_of(model, [bare], ())
    output = np.pad(moved.signals(0, moved.start[None, :])[0][0], (bare.skip, 0))
    return system_of(model, [replace(bare, output=output)], ())


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """What is left of an expected signal over its size, without its mean, which is fitted."""
    return float(np.std(found - expected) / np.std(expected))


def simulated(stage: System, name: str, values: dict[str, float],
              x: np.ndarray) -> list[np.ndarray]:
    own = system_of(stage.model.with_effect(name, values), stage.runs, ())
    plain = stage.signals(0, x[None, :])
    return [a[0] - b[0] for a, b in zip(own.signals(0, x[None, :]), plain, strict=True)]


def small(stage: System, name: str) -> dict[str, float]:
    run = stage.runs[0]
    at = Conditions.of(stage.model.base, stage.model.drive, [run],
                       1e-3 * float(np.std(run.output)), "m")
    points = starts(name, replace(at, frequencies=(5.0,), periods=(1e-4,)))
    return EFFECTS[name].scaled(points[len(points) // 2], SMALLER)


@pytest.mark.parametrize("name", FORCES)
@pytest.mark.parametrize("how", ["held", "finer", "velocity", "current"])
def test_a_small_effect_moves_the_stage_as_it_is_said_to(name, how):
    stage = system({**STAGE, "coil_resistance": 8.0, "back_emf": 2.0} if how == "current"
                   else STAGE, **{
        "finer": {"drive": Drive(np.repeat(DRIVE, 4), 4, -0.5)},
        "velocity": {"measures": "velocity"}, "current": {"current": DRIVE}}.get(how, {}))
    x, values = stage.start.copy(), small(stage, name)
    if how == "current":
        x[[u.name for u in stage.unknowns].index("current.gain")] = -1000.0
    assert ForceResponse.serves(stage)
    for found, expected in zip(ForceResponse(stage, x).changes(name, values)[0],
                               simulated(stage, name, values, x), strict=True):
        assert apart(found, expected) < 0.05


@pytest.mark.parametrize(("how", "served"), [
    ({}, True), ({"window": 500}, False), ({"start": "periodic", "period": 2000}, False),
    ({"measures": "acceleration"}, False)])
def test_it_serves_where_the_response_does_not_depend_on_the_motion(how, served):
    assert ForceResponse.serves(system(STAGE, **how)) == served


def test_a_force_of_the_time_knows_the_time():
    timed = {"name": "timed", "parameters": {"k": {"value": 1.0}}}
    effect = formula_of({**timed, "force": "k * cos(1800 * t) * abs(x)"}).effect()
    moved = ForceResponse(system(STAGE), system(STAGE).start).runs[0]
    time = (np.arange(moved.motion.position.size) + 0.5) * PERIOD / moved.parts
    expected = np.cos(1800.0 * time) * np.abs(moved.motion.position)
    np.testing.assert_allclose(moved._force(effect, np.ones(1)),
                               expected.reshape(-1, moved.parts).mean(axis=1), rtol=1e-9,
                               atol=1e-12 * np.max(expected))


def test_a_force_of_the_command_is_not_told_by_the_motion():
    one = {"name": "one", "parameters": {"k": {"value": 1.0}}}
    assert not ForceResponse.tells(formula_of({**one, "force": "-k * u * x"}).effect())
    assert ForceResponse.tells(formula_of({**one, "force": "-k * i * x"}).effect())


def test_dry_friction_stops_a_stage_that_comes_to_rest():
    stage = system({**STAGE, "damping": 40.0})
    pushed = np.where(TIME < 0.5, 1.0, 0.0)
    run = replace(stage.runs[0], input=pushed)
    stage = system_of(stage.model, [run], ())
    values = {"force": 1e-4}
    found = ForceResponse(stage, stage.start).changes("coulomb_friction", values)[0]
    assert float(np.ptp(found[0][2000:])) < 0.1 * float(np.ptp(found[0][:2000]))


def test_a_model_that_is_curved_or_misread_by_position_is_not_served():
    stage = system(STAGE)
    for name, values in (("cubic_stiffness", {"k3": 1e8}),
                         ("encoder_periodic_error", {"amplitude": 1e-7, "period": 1e-5})):
        model = stage.model.with_effect(name, values)
        assert not ForceResponse.serves(system_of(model, stage.runs, ()))
