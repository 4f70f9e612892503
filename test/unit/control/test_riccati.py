"""The Riccati equation against numerical integration, closed forms and its algebraic limit."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.control import ControlError, algebraic, feedback_gain, finite_horizon

# The plant as the paper prints it (sec. 5).
A = np.array([[0.0, -1.07e4, 0.0, -5.8e6], [1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0]])
B = np.array([1.0, 0.0, 0.0, 0.0])
C = np.array([[0.0, 58.67, 0.0, 5.55e5]])
Q = 1e2 * C.T @ C
R = np.array([[1.0]])


def test_scalar_against_the_closed_form() -> None:
    # p' = -(2 a p - p^2 b^2 / r + q): tanh of the time to go.
    a, b, q, r, end = -1.0, 2.0, 3.0, 0.5, 4.0
    t = np.linspace(0.0, 2.0, 9)
    found = finite_horizon([[a]], [b], [[q]], r, [[end]], t)[:, 0, 0]
    s, root = b * b / r, np.sqrt(a * a + q * b * b / r)
    up, down = (a + root) / s, (a - root) / s
    grown = (end - up) / (end - down) * np.exp(-2.0 * root * (2.0 - t))
    assert np.allclose(found, (up - down * grown) / (1.0 - grown), rtol=1e-12)


def test_the_paper_plant_against_numerical_integration() -> None:
    t = np.linspace(0.0, 0.2, 5)
    end = np.diag([0.0, 1.0, 0.0, 1e4])
    scale = np.array([1.0, 1e2, 1e4, 1e6]) ** 0.5        # integrate in a scaling scipy can do

    def slope(_: float, flat: np.ndarray) -> np.ndarray:
        p = flat.reshape(4, 4) * np.outer(scale, scale)
        change = p @ A + A.T @ p - np.outer(p @ B, B @ p) / R[0, 0] + Q
        return (change / np.outer(scale, scale)).ravel()

    solved = solve_ivp(slope, (0.0, 0.2), (end / np.outer(scale, scale)).ravel(), rtol=1e-10,
                       atol=1e-10, t_eval=(0.2 - t)[::-1], method="DOP853")
    found = finite_horizon(A, B, Q, R, end, t)
    for k in range(5):
        expected = solved.y[:, 4 - k].reshape(4, 4) * np.outer(scale, scale)
        assert np.allclose(found[k], expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_it_tends_to_the_algebraic_solution_and_starts_at_p_f() -> None:
    end = np.diag([0.0, 1.0, 0.0, 1e4])
    found = finite_horizon(A, B, Q, R, end, [0.0, 1.0, 50.0])
    limit = algebraic(A, B, Q, R)
    assert np.array_equal(found[-1], end)
    assert np.allclose(found[0], limit, rtol=1e-6, atol=1e-9 * np.abs(limit).max())
    gain, _, _ = control.lqr(A, B[:, None], Q, R)
    assert np.allclose(feedback_gain(found[0], B, R), gain, rtol=1e-6)


def test_the_limit_is_a_fixed_point() -> None:
    limit = algebraic(A, B, Q, R)
    found = finite_horizon(A, B, Q, R, limit, [0.0, 0.3])
    assert np.allclose(found[0], limit, rtol=1e-6, atol=1e-9 * np.abs(limit).max())


def test_without_weight_on_the_way_the_cost_is_that_of_the_end_alone() -> None:
    # x' = u, cost r u^2 and p_f x(t_f)^2: p = 1 / (1 / p_f + (t_f - t) / r).
    t = np.array([0.0, 1.0, 4.0])
    found = finite_horizon([[0.0]], [1.0], [[0.0]], 2.0, [[3.0]], t)[:, 0, 0]
    assert np.allclose(found, 1.0 / (1.0 / 3.0 + (4.0 - t) / 2.0), rtol=1e-13)


@pytest.mark.parametrize(("change", "word"), [
    ({"A": np.zeros((2, 3))}, "A must be square"),
    ({"B": [1.0]}, "4 rows"),
    ({"R": [[0.0]]}, "R must be positive"),
    ({"Q": -np.eye(4)}, "Q must not"),
    ({"P_f": np.triu(np.ones((4, 4)))}, "P_f must be symmetric"),
    ({"P_f": np.full((4, 4), np.nan)}, "P_f must be finite"),
    ({"times": [0.0, 0.0]}, "rising"),
])
def test_what_cannot_be_solved_is_named(change: dict[str, object], word: str) -> None:
    given = {"A": A, "B": B, "Q": Q, "R": R, "P_f": np.eye(4), "times": [0.0, 1.0], **change}
    with pytest.raises(ControlError, match=word):
        finite_horizon(**given)


def test_a_mode_that_nothing_reaches_has_no_limit() -> None:
    with pytest.raises(ControlError, match="no stabilising solution"):
        algebraic(np.diag([1.0, 2.0]), [1.0, 0.0], np.eye(2), 1.0)
