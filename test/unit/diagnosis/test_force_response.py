"""First-order responses against simulations of the effect itself, small enough to be linear."""

from __future__ import annotations

from collections.abc import Sequence
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


def apart(found: Sequence[np.ndarray], expected: Sequence[np.ndarray]) -> float:
    """What is left of the expected signals, over their size, without what a screen fits away."""
    left = size = 0.0
    for a, b in zip(found, expected, strict=True):
        left += float(np.sum((a - b - np.mean(a - b)) ** 2))
        size += float(np.sum((b - np.mean(b)) ** 2))
    return float(np.sqrt(left / size))


def simulated(stage: System, name: str, values: dict[str, float]) -> list[np.ndarray]:
    own = system_of(stage.model.with_effect(name, values), stage.runs, ())
    plain = stage.signals(0, stage.start[None, :])
    return [a[0] - b[0] for a, b in zip(own.signals(0, own.start[None, :]), plain, strict=True)]


def small(stage: System, name: str) -> dict[str, float]:
    run = stage.runs[0]
    at = Conditions.of(stage.model.base, stage.model.drive, [run],
                       1e-3 * float(np.std(run.output)), "m")
    points = starts(name, replace(at, frequencies=(5.0,), periods=(1e-4,)))
    return EFFECTS[name].scaled(points[len(points) // 2], SMALLER)


@pytest.mark.parametrize("name", FORCES)
@pytest.mark.parametrize("how", ["held", "finer", "periodic", "velocity"])
def test_a_small_effect_moves_the_stage_as_it_is_said_to(name, how):
    if how == "periodic" and EFFECTS[name].on_the_clock:
        pytest.skip("nothing is periodic under it")
    stage = system(STAGE, **{
        "finer": {"drive": Drive(np.repeat(DRIVE, 4), 4, -0.5)},
        "periodic": {"start": "periodic", "period": 2000},
        "velocity": {"measures": "velocity"}}.get(how, {}))
    assert ForceResponse.serves(stage)
    values = small(stage, name)
    found = ForceResponse(stage, stage.start).changes(name, values)[0]
    assert apart(found, simulated(stage, name, values)) < 0.05


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


def test_what_depends_on_the_clock_has_no_periodic_response():
    stage = system(STAGE, start="periodic", period=2000)
    found = ForceResponse(stage, stage.start).changes("stiffness_drift", {"rate": 1.0})[0]
    assert not np.any(np.isfinite(found[0]))
