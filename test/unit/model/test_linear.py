"""The linear part against SciPy and closed forms, and as control and identification see it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from dfm_stage.control import sample_model
from dfm_stage.identification import linear_plant
from dfm_stage.model import Model, Simulator
from dfm_stage.model.linear import held, linear_part

H = 1e-3
BASE = {"mass": 0.9, "damping": 1.2, "stiffness": 600.0, "force_constant": 1.3}
LAGS = {"amplifier_time_constant": 4e-4, "coil_inductance": 4e-3, "coil_resistance": 8.0}
CREEP = {"stiffness": 90.0, "time_constant": 0.03}
OMEGA = np.geomspace(1.0, 3000.0, 40)


def _two_masses(dashpot: float) -> tuple[np.ndarray, np.ndarray]:
    """ds/dt = a s + b F of two masses with spring and dashpot between them; s holds position and
    velocity of each."""
    k, c, m1, m2 = 20000.0, dashpot, 1.0, 0.25
    return np.array([[0.0, 1.0, 0.0, 0.0],
                     [-(4000.0 + k) / m1, -(4.0 + c) / m1, k / m1, c / m1],
                     [0.0, 0.0, 0.0, 1.0], [k / m2, c / m2, -k / m2, -c / m2]]), \
        np.array([0.0, 1.0 / m1, 0.0, 0.0])


def _as_modes(a: np.ndarray, b: np.ndarray, output: int) -> Model:
    """The same in modes of a mass of 1 kg, from its poles and residues. Those of the second mass
    add up to nothing: a share far below zero stands for that."""
    poles, shapes = np.linalg.eig(a)
    residues = shapes[2 * (output - 1)] * np.linalg.solve(shapes, b.astype(complex))
    order = [i for i in np.argsort(np.abs(poles)) if poles[i].imag > 0.0]
    (p1, p2), (_, r2) = poles[order], residues[order]
    share, w = -2.0 * (r2 * p2.conj()).real, abs(p2)
    scale = 1.0 if output == 1 else -share / 1e6
    return Model("modes", H, {"mass": 1.0, "damping": -2.0 * p1.real, "stiffness": abs(p1)**2,
                              "force_constant": scale}).with_effect("second_mode", {
        "share": share / scale, "frequency": w / (2.0 * np.pi), "damping_ratio": -p2.real / w,
        "phase": np.arctan(-2.0 * r2.real * w / share)})


def _creep_answer(s: np.ndarray) -> np.ndarray:
    """Position per volt, from the equations of the creep and of the stage."""
    relaxing = CREEP["stiffness"] * s * CREEP["time_constant"] / (1 + s * CREEP["time_constant"])
    return 1.3 / (0.9 * s**2 + 1.2 * s + 600.0 + relaxing)


def test_the_hold_is_scipys() -> None:
    a = np.array([[0.0, 1.0, 0.2], [-600.0, -1.2, 3.0], [0.0, 0.0, -50.0]])
    b = np.array([[0.0, 1.0], [0.5, 0.0], [2.0, 0.3]])
    ad, bd, *_ = cont2discrete((a, b, np.eye(3), np.zeros((3, 2))), 0.7e-3)
    phi, gamma = held(a, b, 0.7e-3)
    np.testing.assert_allclose(phi, ad, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(gamma, bd, rtol=1e-12, atol=1e-15)
    assert np.array_equal(held(a, b, 0.0)[0], np.eye(3))
    assert not held(a, b, 0.0)[1].any()


def test_creep_is_in_the_linear_part() -> None:
    part = linear_part(Model("m", H, BASE).with_effect("creep", CREEP))
    assert part.states == ("position", "velocity", "creep")
    assert part.motion == 3
    np.testing.assert_allclose(part.response(OMEGA), _creep_answer(1j * OMEGA), rtol=1e-10)
    assert part.static_gain == pytest.approx(1.3 / 600.0, rel=1e-12)
    stiff = linear_part(Model("m", H, BASE)).response(OMEGA)
    assert np.max(np.abs(part.response(OMEGA) / stiff - 1.0)) > 0.1


@pytest.mark.parametrize("effects", [
    {"creep": CREEP}, {"creep": CREEP, "second_mode": {"share": 0.07, "frequency": 16.0,
                                                       "damping_ratio": 0.01, "phase": 0.2}},
    {"amplifier_bandwidth": {"time_constant": 7e-4}, "back_emf": {"constant": 1.4}},
    {"coil_inductance": {"inductance": 2e-3}, "transport_delay": {"delay": 1.6e-3}}])
def test_control_moves_as_the_simulator_does(effects: dict[str, dict[str, float]]) -> None:
    model = Model("m", H, {**BASE, **LAGS, "delay": 1.3e-3})
    for name, values in effects.items():
        model = model.with_effect(name, values)
    stage = sample_model(model)
    u = np.random.default_rng(0).normal(size=400)
    x, position, velocity = np.zeros(stage.b.size), np.empty(400), np.empty(400)
    for k, each in enumerate(u):
        position[k], velocity[k] = stage.c @ x, stage.velocity @ x
        x = stage.a @ x + stage.b * each
    expected = Simulator(model).run(u)
    for ours, theirs in ((position, expected.position), (velocity, expected.velocity)):
        assert np.max(np.abs(ours - theirs)) < 1e-9 * np.max(np.abs(theirs))


@pytest.mark.parametrize("dashpot", [0.5, 5.0, 30.0])
@pytest.mark.parametrize(("output", "far"), [(1, 1e-9), (2, 2e-6)])
def test_two_masses_with_a_dashpot_between_them_are_two_complex_modes(
        dashpot: float, output: int, far: float) -> None:
    a, b = _two_masses(dashpot)
    phi, gamma, *_ = cont2discrete((a, b[:, None], np.eye(4), np.zeros((4, 1))), H)
    u = np.random.default_rng(2).normal(size=600)
    states = np.zeros((u.size, 4))
    for k in range(u.size - 1):
        states[k + 1] = phi @ states[k] + gamma[:, 0] * u[k]
    model = _as_modes(a, b, output)
    ours = Simulator(model).run(u)
    for own, theirs in zip((ours.position, ours.velocity), states.T[2 * output - 2:],
                           strict=False):
        assert np.max(np.abs(own - theirs)) < far * np.max(np.abs(theirs))
    real = Simulator(model.with_parameters({"second_mode.phase": 0.0})).run(u).position
    assert np.max(np.abs(real - ours.position)) > 1e-4 * np.max(np.abs(ours.position))


def test_a_nonlinear_force_acts_on_the_first_of_two_masses() -> None:
    a, b = _two_masses(30.0)

    def rates(_: float, s: np.ndarray, u: float) -> np.ndarray:
        return a @ s + b * (u - 2e9 * s[0]**3)

    u = np.repeat(np.random.default_rng(3).normal(size=15), 10)
    state, theirs = np.zeros(4), []
    for each in u:
        theirs.append(state[0])
        state = solve_ivp(rates, (0.0, H), state, args=(each,), method="DOP853", rtol=1e-10,
                          atol=1e-15).y[:, -1]
    plain = _as_modes(a, b, 1)
    ours = Simulator(plain.with_effect("cubic_stiffness", {"k3": 2e9})).run(u).position
    assert np.max(np.abs(ours - theirs)) < 1e-6 * np.max(np.abs(theirs))
    assert np.max(np.abs(Simulator(plain).run(u).position - ours)) > 0.1 * np.max(np.abs(theirs))


def test_the_drawn_response_has_creep_coil_and_bandwidth_in_it() -> None:
    model = Model("m", H, {**BASE, **LAGS}).with_effect("creep", CREEP)
    plant = linear_plant(model)
    s = 1j * OMEGA
    expected = _creep_answer(s) / ((1 + 4e-4 * s) * (1 + 4e-3 / 8.0 * s))
    np.testing.assert_allclose(plant.continuous_response(OMEGA), expected, rtol=1e-9)
    u = np.tile(np.random.default_rng(1).normal(size=500), 1)
    periodic = Simulator(model).run(u, steady_state=True).position
    lines = np.arange(1, 200)
    measured = np.fft.rfft(periodic)[lines] / np.fft.rfft(u)[lines]
    np.testing.assert_allclose(plant.sampled_response(2 * np.pi * lines / (500 * H), H), measured,
                               rtol=1e-7)
    assert plant.lag == pytest.approx(4e-4 + 4e-3 / 8.0, rel=1e-9)
    assert len(plant.modes) == 1
    assert plant.modes[0].stiffness == pytest.approx((600.0 + 90.0) / 0.9)


def test_a_vibration_is_not_a_state_of_the_stage() -> None:
    model = Model("m", H, BASE).with_effect("periodic_disturbance", {"amplitude": 1.0,
                                                                     "frequency": 7.0})
    assert linear_part(model).states == ("position", "velocity")


def test_a_free_body_has_no_static_gain() -> None:
    free = Model("m", H, {"mass": 1.0, "damping": 2.0, "amplifier_time_constant": 1e-3})
    assert np.isinf(linear_plant(free).static_gain)
    assert np.isinf(linear_plant(free.with_effect("creep", CREEP)).static_gain)
