"""Ultimate gains against closed forms, python-control and a simulated loop; the table; relays."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from dfm_stage.control import (
    ControlError,
    Oscillation,
    Sampled,
    Ultimate,
    oscillation,
    sample_model,
    sample_stage,
    ultimate,
    ultimate_from_relays,
    ziegler_nichols,
)
from dfm_stage.model import Plant, load_model

H = 1e-3


@pytest.mark.parametrize("name", ["paper_stage", "raster_bench"])
def test_the_loop_oscillates_at_the_ultimate_gain_and_at_no_smaller(name: str) -> None:
    stage = sample_model(load_model(name))
    found = ultimate(stage)

    def poles(share: float) -> np.ndarray:
        return np.linalg.eigvals(stage.a - share * found.gain_v_m * np.outer(stage.b, stage.c))

    at = poles(1.0)
    critical = at[np.argmax(np.abs(at))]
    assert abs(critical) == pytest.approx(1.0, abs=1e-9)
    assert abs(np.angle(critical)) * found.period_s == pytest.approx(2.0 * math.pi * H, rel=1e-6)
    assert all(np.max(np.abs(poles(share))) < 1.0 for share in np.linspace(0.01, 0.999, 40))
    assert np.max(np.abs(poles(1.01))) > 1.0


def test_it_is_the_gain_margin_of_python_control() -> None:
    base = {"mass": 1.0, "damping": 12.0, "stiffness": 650.0, "force_constant": 1.0,
            "delay": 3.4e-3, "amplifier_time_constant": 2e-3}
    stage = sample_stage(base, H)
    system = control.ss(stage.a, stage.b[:, None], stage.c[None], 0.0, H)
    gain, _, at, _ = control.margin(1.0 * system)
    found = ultimate(stage)
    assert found.gain_v_m == pytest.approx(gain, rel=1e-5)
    assert found.period_s == pytest.approx(2.0 * math.pi / at, rel=1e-5)


def test_a_first_order_lag_sampled_oscillates_at_half_the_rate() -> None:
    # x+ = a x + (1 - a) u: the pole a - K (1 - a) reaches -1 at K = (1 + a) / (1 - a).
    found = ultimate(Sampled(np.array([[0.9]]), np.array([0.1]), np.array([1.0]), H))
    assert found.gain_v_m == pytest.approx(19.0, rel=1e-12)
    assert found.period_s == pytest.approx(2.0 * H)


def test_a_stage_without_damping_has_none() -> None:
    with pytest.raises(ControlError, match="must be stable"):
        ultimate(sample_stage({"mass": 1.0, "stiffness": 600.0, "force_constant": 1.0}, H))


def test_the_table_is_the_classic_one() -> None:
    gains = ziegler_nichols(Ultimate(100.0, 0.4))
    assert (gains.kp, gains.ki, gains.kd) == pytest.approx((60.0, 300.0, 3.0))
    pi = ziegler_nichols(Ultimate(100.0, 0.4), "pi")
    assert (pi.kp, pi.ki, pi.kd) == pytest.approx((45.0, 135.0, 0.0))
    assert ziegler_nichols(Ultimate(100.0, 0.4), "p").kp == pytest.approx(50.0)
    with pytest.raises(ControlError, match="rule must be one of"):
        ziegler_nichols(Ultimate(1.0, 1.0), "pd")          # type: ignore[arg-type]
    with pytest.raises(ControlError, match="period must be above zero"):
        ziegler_nichols(Ultimate(1.0, 0.0))


def relay_run(name: str, early: int, volts: float = 0.5) -> Oscillation:
    plant = Plant(load_model(name), seed=1)
    y, u, last = np.empty(20_000), np.empty(20_000), 0.0
    for k in range(y.size):
        y[k] = plant.sample().reading_m
        u[k] = -volts if y[k] + early * (y[k] - last) > 0.0 else volts
        last = y[k]
        plant.advance(u[k])
    return oscillation(y, u, H, periods=8)


@pytest.mark.parametrize("name", ["paper_stage", "raster_bench"])
def test_relays_find_the_exact_gain_within_two_percent(name: str) -> None:
    exact = ultimate(sample_model(load_model(name)))
    found = ultimate_from_relays([relay_run(name, early) for early in (-1, 0, 1)])
    assert found.gain_v_m == pytest.approx(exact.gain_v_m, rel=0.02)
    assert found.period_s == pytest.approx(exact.period_s, rel=0.01)


def test_an_oscillation_is_read_off() -> None:
    t = np.arange(5000) * H
    y = 1e-4 * np.sin(2.0 * math.pi * 7.3 * t) + 2e-5
    found = oscillation(y, -300.0 * (y - 2e-5), H)
    assert found.gain_v_m == pytest.approx(300.0, rel=1e-3)
    assert found.period_s == pytest.approx(1.0 / 7.3, rel=1e-4)
    assert found.lead_rad == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(("y", "u", "word"), [
    (np.zeros(100), np.zeros(100), "0 whole periods"),
    (np.zeros(100), np.zeros(99), "of one length"),
    (np.sin(np.arange(900) ** 2 / 9e3), np.zeros(900), "differ by more"),
    (np.sin(np.arange(900) / 9.0), np.sin(np.arange(900) / 9.0), "opposite phase"),
    (np.full(100, np.nan), np.zeros(100), "finite"),
])
def test_what_is_no_oscillation_is_refused(y: np.ndarray, u: np.ndarray, word: str) -> None:
    with pytest.raises(ControlError, match=word):
        oscillation(y, u, H)


def test_relays_all_on_one_side_are_refused() -> None:
    runs = [Oscillation(1.0, 1.0, 0.1), Oscillation(2.0, 1.0, 0.2)]
    with pytest.raises(ControlError, match="opposite phase"):
        ultimate_from_relays(runs)
    with pytest.raises(ControlError, match="no oscillation"):
        ultimate_from_relays([])
