"""The plant sample by sample: the whole record to the bit, and the conventions of time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from dfm_stage.model import CoupledPlant, Model, ModelError, Plant, SimulationError, Simulator
from dfm_stage.model import load_model as load

PERIOD = 1e-3
BASE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
        "amplifier_time_constant": 7e-4, "delay": 1.4e-3, "noise": 5e-8,
        "encoder_resolution": 5e-8, "coil_resistance": 8.0}
EVERYTHING = {
    "cubic_stiffness": {"k3": 3e6}, "quadratic_stiffness": {"k2": 2e4},
    "coulomb_friction": {"force": 0.03}, "hysteresis": {"stiffness": 30.0,
                                                        "yield_displacement": 1e-4},
    "presliding_friction": {"force": 0.02, "stiffness": 1e5}, "force_offset": {"force": 0.05},
    "quadratic_damping": {"coefficient": 20.0}, "saturation": {"limit": 1.2},
    "amplifier_bandwidth": {"time_constant": 1e-3}, "transport_delay": {"delay": 3e-4},
    "back_emf": {"constant": 3.0}, "coil_inductance": {"inductance": 2e-3},
    "force_constant_slope": {"slope": 30.0}, "force_constant_droop": {"droop": 3e3},
    "second_mode": {"share": 0.07, "frequency": 16.0, "damping_ratio": 0.01},
    "encoder_quantization": {"step": 1e-6},
    "encoder_periodic_error": {"amplitude": 1e-7, "period": 2e-5},
    "creep": {"stiffness": 50.0, "time_constant": 0.2}, "thermal_drift": {"rate": 1e-6},
    "periodic_disturbance": {"amplitude": 0.1, "frequency": 33.0},
    "eddy_current_damping": {"damping": 2.0, "critical_velocity": 0.1},
}


def noise(samples: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(samples)


def models() -> list[Model]:
    plain = Model("plain", PERIOD, BASE)
    full = plain
    for name, values in EVERYTHING.items():
        full = full.with_effect(name, values)
    return [plain, load("raster_bench"), load("paper_two_mode"),
            plain.with_effect("coulomb_friction", {"force": 0.05}), full]


@pytest.mark.parametrize("model", models(), ids=lambda m: f"{m.name}-{len(m.effects)}")
def test_samples_equal_the_record_to_the_bit(model: Model) -> None:
    inputs = noise(700)
    record = Simulator(model).run(inputs)
    plant = Plant(model, seed=5)
    samples = []
    for value in inputs:
        samples.append(plant.sample())
        assert plant.sample() is samples[-1]
        plant.advance(value)
    for name, whole in (("position_m", record.position), ("velocity", record.velocity),
                        ("current", record.current), ("force_n", record.force),
                        ("reading_m", record.measured(5))):
        assert np.array_equal([getattr(s, name) for s in samples], whole), name
    assert all(s.reading_m == s.counts * plant.count_size_m for s in samples)


def test_reset_gives_the_same_run_again() -> None:
    plant = Plant(models()[-1], seed=3)
    runs = []
    for _ in range(2):
        plant.reset(position=1e-4, velocity=2e-3, past_input=0.1)
        seen = [plant.sample()]
        for value in noise(50):
            plant.advance(value)
            seen.append(plant.sample())
        runs.append(seen)
    assert runs[0] == runs[1]
    assert runs[0][0].position_m == 1e-4 * (1 - 0.07)  # the first mode's part of the point


def test_input_acts_after_its_sample_and_its_delay() -> None:
    """position[k] does not know input[k]; with a delay of d it knows input[k - 1 - floor(d)]."""
    for delay, first in ((0.0, 1), (1e-3, 2), (1.4e-3, 2), (2.0e-3, 3)):
        model = Model("m", PERIOD, {"mass": 1.0, "stiffness": 600.0, "delay": delay})
        impulse = np.zeros(6)
        impulse[0] = 1.0
        x = Simulator(model).run(impulse).position
        assert np.all(x[:first] == 0.0)
        assert x[first] == pytest.approx(0.5 * (first * PERIOD - delay) ** 2, rel=1e-3)


def test_external_force_is_felt_at_once_and_by_the_whole_mass() -> None:
    model = Model("m", PERIOD, {"mass": 2.0, "damping": 0.0, "stiffness": 0.0, "delay": 5e-3})
    plant = Plant(model)
    for _ in range(10):
        plant.advance(0.0, external_force_n=3.0)
    assert plant.sample().velocity == pytest.approx(3.0 / 2.0 * 10 * PERIOD)
    force = np.full(11, 3.0)
    assert Simulator(model).run(np.zeros(11), external_force=force).velocity[-1] == \
        plant.sample().velocity


def test_bad_input_is_refused() -> None:
    plant = Plant(load("paper_stage"))
    for bad in (float("nan"), float("inf")):
        with pytest.raises(SimulationError, match="finite"):
            plant.advance(bad)
    with pytest.raises(ModelError, match="choose one"):
        Plant(load("xy_stage"))
    with pytest.raises(SimulationError, match="2 axes"):
        CoupledPlant(load("xy_stage")).advance([1.0])


def test_coupled_axes_against_one_exact_linear_system() -> None:
    model = load("xy_stage").with_parameters({"coupling.x.y.stiffness": 200.0,
                                              "coupling.y.x.stiffness": 150.0})
    a = np.zeros((8, 8))
    for at, other, name, coupling in ((0, 3, "x", 200.0), (3, 0, "y", 150.0)):
        b = model.axes[name].base
        a[at, at + 1] = 1.0
        a[at + 1, at] = -b["stiffness"] / b["mass"]
        a[at + 1, at + 1] = -b["damping"] / b["mass"]
        a[at + 1, at + 2] = b["force_constant"] / b["mass"]
        a[at + 1, other] = -coupling / b["mass"]
        a[at + 2, at + 2] = -1e3
    a[2, 6] = a[5, 7] = 1e3
    step = expm(a * PERIOD)
    inputs = np.column_stack((noise(300, 1), noise(300, 2)))
    y, expected = np.zeros(8), []
    for k in range(300):
        expected.append([y[0], y[3]])
        y[6:] = inputs[k - 1] if k else 0.0   # one sample of delay
        y = step @ y
    stage = CoupledPlant(model)
    found, readings = [], []
    for value in inputs:
        x, y_sample = stage.sample()
        found.append([x.position_m, y_sample.position_m])
        readings.append(x.reading_m)
        stage.advance(list(value))
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(np.array(found) / scale, np.array(expected) / scale, atol=1e-7)
    error = np.array(readings) - np.array(found) @ [1.0, 0.00333]
    assert np.max(np.abs(error)) < 6 * 5e-8

    alone = Simulator(model, "x").run(inputs[:, 0], other=np.array(expected)[:, 1])
    np.testing.assert_allclose(alone.position / scale, np.array(expected)[:, 0] / scale, atol=1e-6)


def test_uncoupled_axes_are_two_plants() -> None:
    model = load("xy_stage").with_parameters({"coupling.x.y.ratio": 0.0,
                                              "coupling.y.x.ratio": 0.0})
    stage = CoupledPlant(model, seed=4)
    singles = [Plant(model, "x", seed=4), Plant(model, "y", seed=1004)]
    for value in noise(50):
        assert stage.sample() == tuple(p.sample() for p in singles)
        stage.advance([value, -value])
        for plant, sign in zip(singles, (1, -1), strict=True):
            plant.advance(sign * value)
