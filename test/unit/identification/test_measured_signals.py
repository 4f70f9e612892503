"""A measured velocity or acceleration in the place of the position, or a velocity beside it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete

from dfm_stage.identification.convention import Convention
from dfm_stage.identification.motion import differentiated
from dfm_stage.identification.run import Run
from dfm_stage.identification.source import Source
from dfm_stage.identification.system import System
from dfm_stage.identification.workflow import identify
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord

PERIOD, SAMPLES = 2e-3, 4000
TRUE = {"damping": 3.0, "stiffness": 2500.0, "force_constant": 1.2}
MODEL = Model("stage", PERIOD, {"mass": 1.0, "damping": 2.5, "stiffness": 2400.0,
                                "force_constant": 1.0})


def feed() -> np.ndarray:
    rng, time = np.random.default_rng(1), PERIOD * np.arange(SAMPLES)
    return np.sum([np.sin(2.0 * np.pi * f * time + p) for f, p in
                   zip(0.25 * np.arange(1, 60), rng.uniform(0.0, 6.28, 59), strict=True)], axis=0)


def motion(spring: float = TRUE["stiffness"]) -> dict[str, np.ndarray]:
    """Position, velocity and acceleration from rest, by scipy's zero-order hold."""
    a = np.array([[0.0, 1.0], [-spring, -TRUE["damping"]]])
    b = np.array([[0.0], [TRUE["force_constant"]]])
    ad, bd, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), PERIOD)
    state, before, found, u = np.zeros(2), 0.0, [], feed()
    for each in u:
        found.append([*state, (a @ state + b[:, 0] * before)[1]])
        state, before = ad @ state + bd[:, 0] * each, each
    return dict(zip(("position", "velocity", "acceleration"), np.array(found).T, strict=True))


def noisy(signal: np.ndarray, seed: int, share: float = 0.02) -> np.ndarray:
    return signal + share * np.std(signal) * np.random.default_rng(seed).standard_normal(
        signal.size)


def identified(what: str, spring: float = TRUE["stiffness"], bias: float = 0.0, **more):
    model = MODEL if spring else Model("body", PERIOD, {
        "mass": 1.0, "damping": 2.5, "force_constant": 1.0})
    axis = AxisRecord(feed(), noisy(motion(spring)[what], 5) + bias, measures=what, **more)
    return identify([Source("r", axis, PERIOD)], model=model)


@pytest.mark.parametrize("what", ["velocity", "acceleration"])
def test_each_signal_alone_gives_the_parameters_whatever_its_offset(what):
    found = identified(what, bias=0.1)
    assert found.estimate.status == "converged"
    for name, value in TRUE.items():
        assert found.estimate.quantity(name).covers(value), name
    first = found.to_dict()["fit"]
    assert first["unit"] == {"velocity": "m/s", "acceleration": "m/s^2"}[what]
    spread = 0.02 * np.std(motion()[what])
    assert first["rms"] == pytest.approx(spread, rel=0.05)
    assert found.gain.unit == "m/V"
    assert found.responses[0].unit == "m/V"
    lines = found.responses[0]
    at = int(np.argmin(np.abs(lines.frequency_hz - 8.25)))
    w = lines.omega[at]
    want = 1.2 / (2500.0 - w * w + 3.0j * w) * np.exp(-0.5j * w * PERIOD)
    assert abs(lines.response[at] / want - 1.0) < 0.05


def test_the_velocity_of_a_free_body_has_no_initial_position_and_no_offset():
    run = Run("r", feed(), motion(0.0)["velocity"], PERIOD, measures="velocity")
    free = System(MODEL.with_parameters({"stiffness": 0.0}), [run], ["damping"])
    assert [u.name for u in free.unknowns] == ["damping", "initial.velocity"]
    sprung = System(MODEL, [run], ["damping"])
    assert [u.name for u in sprung.unknowns] == [
        "damping", "initial.position", "initial.velocity", "offset"]
    assert sprung.unknowns[-1].unit == "m/s"
    found = identified("velocity", 0.0)
    assert found.estimate.quantity("damping").covers(3.0)
    assert found.estimate.quantity("force_constant").covers(1.2)


def test_a_velocity_beside_the_position_narrows_the_intervals():
    beside = noisy(motion()["velocity"], 6) + 0.01
    alone, both = identified("position"), identified("position", velocity=beside)
    for name, value in TRUE.items():
        wide, narrow = (f.estimate.quantity(name) for f in (alone, both))
        assert narrow.covers(value), name
        assert narrow.half_width < 0.85 * wide.half_width, name     # equal shares would give 0.71


@pytest.mark.parametrize("order", [1, 2])
def test_an_integral_is_the_motion_and_not_the_drift_of_the_noise(order):
    made = motion()
    noise = noisy(made[("velocity", "acceleration")[order - 1]], 7, 0.01)
    position = made["position"] - np.mean(made["position"])
    error = differentiated(noise + 0.3, -order, PERIOD) - position
    assert np.std(error) < {1: 0.1, 2: 0.2}[order] * np.std(position)


def test_the_acceleration_of_a_band_limited_input_follows_at_once():
    """No lag stands between the input and the acceleration: steps that lay between the samples
    would be an eighth of a sample late."""
    lines, count = np.arange(1, 60), 500
    phases = np.random.default_rng(2).uniform(0.0, 6.28, lines.size)
    turns = 2.0 * np.pi * np.outer(lines, np.arange(count)) / count + phases[:, None]
    s = 2.0j * np.pi * lines / (count * PERIOD)
    answer = 1.2 * s**2 / (s**2 + 3.0 * s + 2500.0)
    wave, moved = np.sin(turns).sum(0), np.imag(answer[:, None] * np.exp(1j * turns)).sum(0)
    run = Run("r", wave, moved, PERIOD, start="periodic", period=count, trend=-1,
              measures="acceleration").by(Convention("band_limited", source="given"))
    true = MODEL.with_parameters(TRUE)
    left = System(true, [run], []).residuals(np.empty(0))[0][0]
    assert np.std(left) < 3e-3 * np.std(moved)
