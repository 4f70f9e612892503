"""The acceleration of the driven point, against integrations and closed forms of their own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dfm_stage.model import Model, Simulator

PERIOD = 1e-3
BASE = {"mass": 1.3, "damping": 2.0, "stiffness": 600.0, "force_constant": 1.5}
FEED = np.repeat(np.random.default_rng(0).standard_normal(80), 5)


def ours(model: Model, feed: np.ndarray = FEED) -> np.ndarray:
    return Simulator(model).run_many(feed, [], np.zeros((1, 0)), signal="acceleration")[0]


@pytest.mark.parametrize(("effect", "values", "force"), [
    (None, {}, lambda x, v: 0.0),
    ("cubic_stiffness", {"k3": 3e8}, lambda x, v: -3e8 * x**3),
    ("force_offset", {"force": 0.4}, lambda x, v: 0.4),
    ("quadratic_damping", {"coefficient": 30.0}, lambda x, v: -30.0 * abs(v) * v)])
def test_it_is_the_total_force_over_the_mass(effect, values, force):
    model = Model("m", PERIOD, BASE)
    model = model.with_effect(effect, values) if effect else model

    def rate(_, s, u):
        return [s[1], (1.5 * u - 2.0 * s[1] - 600.0 * s[0] + force(*s)) / 1.3]

    state, before, want = np.zeros(2), 0.0, []
    for u in FEED:
        want.append(rate(0.0, state, before)[1])
        state = solve_ivp(rate, (0.0, PERIOD), state, args=(u,), rtol=1e-10,
                          atol=1e-13).y[:, -1]
        before = u
    np.testing.assert_allclose(ours(model), want, atol=1e-7 * np.std(want))


def test_a_second_mode_and_a_lag_are_in_it():
    model = Model("m", PERIOD, {**BASE, "amplifier_time_constant": 2e-3}).with_effect(
        "second_mode", {"share": 0.2, "frequency": 40.0, "damping_ratio": 0.03})
    w = 2.0 * np.pi * 40.0
    a = np.zeros((6, 6))
    a[0, 1], a[1, :3] = 1.0, (-600.0 / 1.3, -2.0 / 1.3, 0.0)
    a[2, 3], a[3, 2:4] = 1.0, (-w * w, -0.06 * w)
    a[1, 4] = a[3, 4] = 1.5 / 1.3
    a[4, 4], a[4, 5] = -500.0, 500.0
    step, state, want = expm(a * PERIOD), np.zeros(6), []
    for u in FEED:
        want.append(0.8 * (a @ state)[1] + 0.2 * (a @ state)[3])
        state[5] = u
        state = step @ state
    np.testing.assert_allclose(ours(model), want, atol=1e-9 * np.std(want))


def test_a_body_that_friction_holds_does_not_accelerate():
    model = Model("m", PERIOD, {"mass": 2.0, "damping": 0.0, "force_constant": 1.0}).with_effect(
        "coulomb_friction", {"force": 1.0})
    feed = np.repeat([0.5, 3.0, -0.9, 0.5], 50)
    moving = ours(model, feed)
    assert np.all(moving[:50] == 0.0)
    np.testing.assert_allclose(moving[52:100], 1.0)         # (3 - 1) / 2
    slow = moving[102:150]                                  # (-0.9 - 1) / 2 until it rests
    stopped = int(np.argmax(slow == 0.0)) if np.any(slow == 0.0) else slow.size
    np.testing.assert_allclose(slow[:stopped], -0.95)


def test_many_rows_and_a_single_one_agree():
    model = Model("m", PERIOD, BASE).with_effect("cubic_stiffness", {"k3": 3e8})
    both = Simulator(model).run_many(FEED, ["cubic_stiffness.k3"], [[3e8], [0.0]],
                                     signal="acceleration")
    np.testing.assert_array_equal(both[0], ours(model))
    plain = ours(Model("m", PERIOD, BASE))
    np.testing.assert_allclose(both[1], plain, atol=1e-9 * np.std(plain))
