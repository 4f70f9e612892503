"""Every smooth effect, alone and in combinations, against SciPy's DOP853 on equations of our own.

The reference is restarted at every jump of the input; see stage_equations.py.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from stage_equations import integrate

from dfm_stage.model import Model, Simulator

PERIOD = 1e-3
BASE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
        "amplifier_time_constant": 7e-4, "delay": 4e-4, "coil_resistance": 8.0}
SMOOTH = {
    "cubic_stiffness": {"k3": 3e6},
    "quadratic_stiffness": {"k2": 2e4},
    "quadratic_damping": {"coefficient": 40.0},
    "force_offset": {"force": 0.3},
    "amplifier_bandwidth": {"time_constant": 1.5e-3},
    "transport_delay": {"delay": 1.23e-3},
    "saturation": {"limit": 1.1},
    "back_emf": {"constant": 6.0},
    "coil_inductance": {"inductance": 4e-3},
    "force_constant_slope": {"slope": 60.0},
    "force_constant_droop": {"droop": 6e3},
    "second_mode": {"share": 0.07, "frequency": 16.0, "damping_ratio": 0.01},
    "creep": {"stiffness": 80.0, "time_constant": 0.12},
    "periodic_disturbance": {"amplitude": 0.2, "frequency": 37.3, "phase": 0.7},
    "eddy_current_damping": {"damping": 4.0, "critical_velocity": 0.05},
}
UNCOMMON = {
    "gravity": {"weight": 0.9, "length": 2e-3, "tilt": 0.2},
    "cogging": {"amplitude": 0.1, "period": 7e-4, "phase": 0.5},
    "directional_friction": {"difference": 1.5},
    "one_sided_cable": {"stiffness": -300.0, "slack": 2e-4},
    "end_stop": {"stiffness": 4e3, "position": 7e-4, "dissipation": 3.0},
    "backlash": {"stiffness": 900.0, "gap": 8e-4, "centre": 1e-4},
    "structural_damping": {"loss_stiffness": 60.0},
    "stiffness_drift": {"rate": 150.0},
    "sensor_lag": {"time_constant": 2e-3},
    "sensor_mount": {"frequency": 45.0, "damping_ratio": 0.03},
    "supply_sag": {"sag": 0.03, "time_constant": 0.2},
    "coil_heating": {"rise": 0.01, "time_constant": 0.3},
}


def multisine(samples: int, seed: int, amplitude: float = 1.5) -> np.ndarray:
    """A random-phase multisine from 2 to 60 Hz, V."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) * PERIOD
    frequencies = np.arange(2.0, 60.0, 3.0)
    phases = rng.uniform(0.0, 2 * np.pi, len(frequencies))
    signal = np.cos(2 * np.pi * frequencies[:, None] * t + phases[:, None]).sum(axis=0)
    return amplitude * signal / np.std(signal)


def compare(effects: dict[str, dict[str, float]], seed: int, samples: int = 240,
            base: dict[str, float] = BASE, tolerance: float = 1e-6) -> None:
    model = Model("test", PERIOD, base)
    given = dict(base)
    for name, values in effects.items():
        model = model.with_effect(name, values)
        given.update({f"{name}.{key}": value for key, value in values.items()})
    inputs = multisine(samples, seed)
    ours = Simulator(model).run(inputs)
    states, equations = integrate(given, inputs, PERIOD)
    points = np.array([equations.point(y) for y in states])
    read = np.array([equations.reading(y) for y in states])
    for name, own, theirs in (("position", ours.position, points[:, 0]),
                              ("velocity", ours.velocity, points[:, 1]),
                              ("reading", ours.reading, read)):
        scale = np.max(np.abs(theirs))
        assert_allclose(own / scale, theirs / scale, rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("name", sorted(SMOOTH | UNCOMMON))
def test_effect_alone(name: str) -> None:
    # a gain that changes within a sample is held at its mean
    tolerance = 1e-5 if name in ("supply_sag", "coil_heating") else 1e-6
    compare({name: (SMOOTH | UNCOMMON)[name]}, seed=1, tolerance=tolerance)


@pytest.mark.parametrize("seed", range(4))
def test_uncommon_effects_beside_others(seed: int) -> None:
    rng = np.random.default_rng(2000 + seed)
    forces = sorted(UNCOMMON.keys() - {"sensor_lag", "sensor_mount", "supply_sag",
                                         "coil_heating"})
    chosen = [*rng.choice(sorted(SMOOTH), 2, replace=False), *rng.choice(forces, 3, replace=False),
              str(rng.choice(["sensor_lag", "sensor_mount"]))]
    # no step ends at a kink of a contact
    compare({str(name): (SMOOTH | UNCOMMON)[str(name)] for name in chosen}, seed, samples=160,
            tolerance=1e-5)


@pytest.mark.parametrize("seed", range(10))
def test_random_combination(seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    chosen = rng.choice(sorted(SMOOTH), size=rng.integers(3, 9), replace=False)
    effects = {}
    for name in chosen:
        effects[str(name)] = {key: value * float(rng.uniform(0.4, 1.3))
                              for key, value in SMOOTH[name].items()}
    compare(effects, seed, samples=160)
