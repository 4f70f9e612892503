"""The corpus's integrator against exact discretisation, DOP853 and event-located solutions."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from benchmarks.corpus import plant
from benchmarks.corpus.linear import response, transfer
from benchmarks.corpus.signals import gains

T = 1e-3
BASE = {"mass": 0.8, "damping": 2.0, "stiffness": 3000.0, "force_constant": 1.7}


def simulate(values: dict, command: np.ndarray, finest: float = 5e-5,
             start: np.ndarray | None = None) -> np.ndarray:
    none, out = np.zeros(len(command)), np.empty((6, len(command)))
    plant.run(plant.numbers(values), T, finest, none, command, np.zeros(4), none, none,
              np.zeros(0), np.zeros(plant.STATES) if start is None else start, 0.0, out)
    return out


def command(samples: int, seed: int = 0, size: float = 3.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    t = T * np.arange(samples)
    return size * sum(np.sin(2 * math.pi * f * t + p) for f, p in
                      zip((1.3, 7.1, 9.9, 31.0), rng.uniform(0, 6, 4), strict=True)) / 4


def reference(values: dict, u: np.ndarray, force, tolerance: float = 1e-11) -> np.ndarray:
    """x at the samples by DOP853, restarted at every step of the held input."""
    state, found = np.zeros(2), []
    for held in u:
        found.append(state[0])
        solved = solve_ivp(lambda _, y, held=held: [y[1], (
            values["force_constant"] * held - values["damping"] * y[1]
            - values["stiffness"] * y[0] + force(y[0], y[1], held)) / values["mass"]],
            (0.0, T), state, method="DOP853", rtol=tolerance, atol=1e-16)
        state = solved.y[:, -1]
    return np.array(found)


@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1e-3, 2.45e-3])
@pytest.mark.parametrize("lag", [0.0, 1e-5, 1.3e-3])
def test_linear_stage_agrees_with_exact_discretisation(delay: float, lag: float) -> None:
    u = command(1500)
    fine = 20  # every delay here is a whole number of these steps
    slow = max(lag, 1e-9)
    a = np.array([[0, 1, 0], [-3000 / 0.8, -2.0 / 0.8, 1.7 / 0.8], [0, 0, -1 / slow]])
    b = np.array([[0.0], [0.0], [1 / slow]])
    step, pulse, *_ = cont2discrete((a, b, np.eye(3), np.zeros((3, 1))), T / fine)
    late = np.concatenate([np.zeros(round(delay / T * fine)), np.repeat(u, fine)])
    state, expected = np.zeros(3), []
    for k in range(u.size * fine):
        if k % fine == 0:
            expected.append(state[0])
        state = step @ state + pulse[:, 0] * late[k]
    found = simulate({**BASE, "lag": lag, "delay": delay}, u)
    size = np.max(np.abs(expected))
    assert np.max(np.abs(found[2] - expected)) < 3e-7 * size
    exact = response({**BASE, "delay": delay, "amplifier_time_constant": lag}, T, u)
    assert np.max(np.abs(exact - expected)) < (1e-10 if lag else 1e-7) * size


def test_cubic_spring_agrees_with_dop853() -> None:
    u = command(1200)
    expected = reference(BASE, u, lambda x, v, held: -4e8 * x**3)
    found = simulate({**BASE, "k3": 4e8}, u)[2]
    straight = simulate(BASE, u)[2]
    assert np.max(np.abs(found - expected)) < 1e-8 * np.max(np.abs(expected))
    assert np.max(np.abs(straight - expected)) > 1e-2 * np.max(np.abs(expected))


def test_smooth_forces_agree_with_dop853() -> None:
    u = command(800, seed=4)
    expected = reference(BASE, u, lambda x, v, held: (
        -2e5 * x**2 - 30.0 * abs(v) * v - 4.0 * v / (1 + (v / 0.02) ** 2) + 0.05
        + 1.7 * held * (40.0 * x - 5e4 * x**2)))
    found = simulate({**BASE, "k2": 2e5, "drag": 30.0, "eddy": 4.0, "eddy_speed": 0.02,
                      "offset": 0.05, "slope": 40.0, "droop": 5e4}, u)[2]
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))


def coulomb_by_events(values: dict, friction: float, u: np.ndarray) -> np.ndarray:
    """Slip by DOP853 up to the reversal that solve_ivp locates; stick while friction can hold."""
    m, c, k, kf = (values[n] for n in ("mass", "damping", "stiffness", "force_constant"))
    state, direction, found = np.zeros(2), 0, []

    def reversal(_t: float, y: np.ndarray) -> float:
        return y[1]

    reversal.terminal = True  # type: ignore[attr-defined]
    for held in u:
        found.append(state[0])
        at = 0.0
        while at < T - 1e-12:
            if direction == 0:
                pull = kf * held - k * state[0]
                if abs(pull) <= friction:
                    break
                direction = int(np.sign(pull))
            reversal.direction = -direction  # type: ignore[attr-defined]
            solved = solve_ivp(
                lambda _, y, held=held, d=direction: [
                    y[1], (kf * held - c * y[1] - k * y[0] - friction * d) / m],
                (at, T), state, method="DOP853", events=reversal, rtol=1e-11, atol=1e-15)
            state, at = solved.y[:, -1], float(solved.t[-1])
            if solved.status == 1:
                state, direction = np.array([state[0], 0.0]), 0
    return np.array(found)


@pytest.mark.parametrize("friction", [0.05, 2.0])
def test_coulomb_friction_agrees_with_located_events(friction: float) -> None:
    u = command(1000)
    expected = coulomb_by_events(BASE, friction, u)
    found = simulate({**BASE, "coulomb": friction}, u)
    assert np.max(np.abs(found[2] - expected)) < 1e-8 * np.max(np.abs(expected))
    if friction > 0.5:
        assert np.mean(found[5] == 0.0) > 0.05  # it sticks at times
        assert np.mean(found[5] != 0.0) > 0.05


def test_hysteresis_and_bristles_are_converged_and_rate_independent() -> None:
    u = command(2000)
    wen = {**BASE, "wen_stiffness": 800.0, "wen_yield": 2e-4, "wen_shape": 0.7,
           "wen_exponent": 1.5}
    lugre = {**BASE, "lugre_force": 0.3, "lugre_stiffness": 6000.0, "lugre_ratio": 1.4,
             "lugre_speed": 0.01, "lugre_damping": 0.5}
    for values in (wen, lugre):
        coarse, fine = simulate(values, u)[2], simulate(values, u, 2e-6)[2]
        assert np.max(np.abs(coarse - fine)) < 1e-6 * np.max(np.abs(fine))
        assert np.max(np.abs(coarse - simulate(BASE, u)[2])) > 1e-2 * np.max(np.abs(fine))


def test_bouc_wen_follows_its_closed_form_on_first_loading() -> None:
    # exponent 1 and shape 0.5: on first loading w' = x'/y (1 - w), so w = 1 - exp(-x/y)
    slow = np.linspace(0.0, 4.0, 3000)
    values = {**BASE, "damping": 300.0, "wen_stiffness": 2000.0, "wen_yield": 3e-4,
              "wen_shape": 0.5, "wen_exponent": 1.0}
    x = simulate(values, slow)[2][-1]
    restoring = 3000.0 * x + 2000.0 * 3e-4 * (1.0 - math.exp(-x / 3e-4))
    v = simulate(values, slow)[5][-1]
    assert restoring + 300.0 * v == pytest.approx(1.7 * slow[-1], rel=1e-3)


def test_second_mode_is_the_sum_of_two_modes() -> None:
    u = command(1500)
    mode = {"mass": 0.8, "force_constant": 1.7, "stiffness": 0.8 * (2 * math.pi * 60) ** 2,
            "damping": 2 * 0.01 * 0.8 * 2 * math.pi * 60}
    expected = 0.9 * response(BASE, T, u) + 0.1 * response(mode, T, u)
    found = simulate({**BASE, "share": 0.1, "mode_hz": 60.0, "mode_zeta": 0.01}, u)[2]
    assert np.max(np.abs(found - expected)) < 1e-6 * np.max(np.abs(expected))


def test_sensor_effects_are_added_to_the_reading() -> None:
    u = command(500)
    out = simulate({**BASE, "ripple": 2e-6, "ripple_period": 5e-5, "ripple_phase": 0.4,
                    "drift_rate": 1e-6, "drift_decay": 0.7, "zero": 3e-6, "step": 1e-6}, u)
    t, x = T * np.arange(500), response(BASE, T, u)
    expected = x + 2e-6 * np.sin(2 * math.pi * x / 5e-5 + 0.4) + 3e-6 \
        + 1e-6 * (1 - np.exp(-0.7 * t)) / 0.7
    assert np.max(np.abs(out[2] - expected)) < 1e-12
    assert np.max(np.abs(out[1] - out[2])) <= 0.5e-6 + 1e-15
    assert np.allclose(out[1] / 1e-6, np.rint(out[1] / 1e-6), atol=1e-6)


def test_saturation_clips_what_arrives() -> None:
    u = command(800)
    found = simulate({**BASE, "limit": 1.0, "delay": 0.7e-3}, u)
    assert np.array_equal(found[0], u)
    assert np.max(np.abs(found[2] - response({**BASE, "delay": 0.7e-3}, T, np.clip(u, -1, 1)))
                  ) < 1e-10


def test_coil_current_and_braking() -> None:
    u = command(1000)
    base = {**BASE, "coil_resistance": 5.0, "coil_inductance": 3e-3, "back_emf": 2.0}
    found = simulate({**BASE, "resistance": 5.0, "inductance": 3e-3, "emf": 2.0}, u)
    exact = response(base, T, u)
    assert np.max(np.abs(found[2] - exact)) < 1e-8 * np.max(np.abs(exact))
    # Newton's law between samples: m v' + c v + k x = force constant * R * current
    v, x, current = found[5], found[2], found[3]
    push = BASE["mass"] * np.gradient(v, T) + BASE["damping"] * v + BASE["stiffness"] * x
    assert np.corrcoef(push[5:-5], 1.7 * 5.0 * current[5:-5])[0, 1] > 0.999


def test_transfer_function_is_the_response_to_a_sine() -> None:
    base = {**BASE, "delay": 1.3e-3, "amplifier_time_constant": 4e-4}
    t = T * np.arange(20_000)
    x = response(base, T, np.sin(2 * math.pi * 6.0 * t))[10_000:]
    gain = 2 * np.mean(x * np.exp(-2j * math.pi * 6.0 * t[10_000:])) * 1j
    assert gain == pytest.approx(transfer(base, T, [6.0])[0], rel=1e-4)


def test_the_loop_holds_the_stage_on_its_reference() -> None:
    law = gains(BASE, T)
    r = 1e-4 * np.sin(2 * math.pi * 0.5 * T * np.arange(6000))
    none, out = np.zeros(6000), np.empty((6, 6000))
    plant.run(plant.numbers(BASE), T, 5e-5, r, none, law, none, none, np.zeros(0),
              np.zeros(plant.STATES), 0.0, out)
    assert np.all(np.isfinite(out))
    assert np.std((out[1] - r)[3000:]) < 0.3 * np.std(r)
