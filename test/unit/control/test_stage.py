"""The design model against the simulator, which was written from the equations separately."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.control import ControlError, margins, pid_for, sample_model
from dfm_stage.model import Model, Plant, Simulator, load_model

BASE = {"mass": 0.9, "damping": 1.2, "stiffness": 600.0, "force_constant": 1.3}
MODE = {"share": 0.07, "frequency": 16.02, "damping_ratio": 0.01}


@pytest.mark.parametrize("extra", [
    {}, {"delay": 1e-3, "amplifier_time_constant": 5e-4}, {"delay": 2.3e-3, "back_emf": 1.4},
    {"delay": 4e-4, "coil_inductance": 4e-3, "coil_resistance": 8.0, "back_emf": 2.0,
     "amplifier_time_constant": 1e-3},
])
@pytest.mark.parametrize("second", [False, True])
def test_it_moves_as_the_simulator_does(extra: dict[str, float], second: bool) -> None:
    model = Model("m", 1e-3, {**BASE, **extra})
    model = model.with_effect("second_mode", MODE) if second else model
    stage = sample_model(model)
    u = np.random.default_rng(0).normal(size=400)
    x, found = np.zeros(stage.b.size), np.empty(400)
    for k, each in enumerate(u):
        found[k] = stage.c @ x
        x = stage.a @ x + stage.b * each
    expected = Simulator(model).run(u).position
    assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))


def test_a_force_moves_it_as_it_moves_the_plant() -> None:
    model = load_model("raster_bench").with_parameters({"noise": 0.0, "encoder_resolution": 0.0})
    stage, plant = sample_model(model), Plant(model)
    x = np.zeros(stage.b.size)
    for k in range(200):
        assert stage.c @ x == pytest.approx(plant.sample().position_m, abs=1e-12)
        force = 0.3 if k > 20 else -0.1
        plant.advance(0.5, external_force_n=force)
        x = stage.a @ x + stage.b * 0.5 + stage.g * force


def test_an_effect_that_adds_to_a_base_parameter_is_added() -> None:
    model = Model("m", 1e-3, {**BASE, "delay": 1e-3})
    both = model.with_parameters({"delay": 3e-3})
    from dfm_stage.model import EFFECTS
    if "transport_delay" not in EFFECTS:
        pytest.skip("the effect transport_delay is not there yet")
    name = EFFECTS["transport_delay"].parameters[0].name
    added = model.with_effect("transport_delay", {name: 2e-3})
    assert np.allclose(sample_model(added).a, sample_model(both).a)


def test_a_second_mode_changes_the_margins() -> None:
    model = load_model("raster_bench")
    gains = pid_for(model.base, 10.0).gains
    with_it = margins(sample_model(model), gains)
    without = margins(sample_model(model.without_effect("second_mode")), gains)
    assert with_it.stable
    assert with_it.modulus != pytest.approx(without.modulus, rel=1e-3)


def test_several_axes_need_a_choice() -> None:
    with pytest.raises(ControlError, match=r"design on model\.axis"):
        sample_model(load_model("xy_stage"))
