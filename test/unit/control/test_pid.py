"""The PID law against the same law written with SciPy, and what it does at its limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

from dfm_stage.control import PID_PARAMETERS, ControlError, Pid, PidGains

H = 1e-3
FREE = PidGains(kp=800.0, ki=9000.0, kd=30.0, derivative_filter_s=4e-3, output_limit_v=1e6)


def run(pid: Pid, reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    return np.array([pid.step(float(r), float(y)) for r, y in zip(reference, position,
                                                                  strict=True)])


@pytest.fixture
def signals() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return (1e-3 * np.cumsum(rng.normal(size=400)), 1e-3 * np.cumsum(rng.normal(size=400)))


@pytest.mark.parametrize(("b", "c"), [(1.0, 0.0), (0.3, 0.0), (1.0, 1.0), (0.0, 0.5)])
def test_unlimited_it_is_the_transfer_functions_of_its_docstring(
        signals: tuple[np.ndarray, np.ndarray], b: float, c: float) -> None:
    r, y = signals
    r, y = r - r[0], y - y[0]            # the derivative starts from the first sample
    gains = replace(FREE, setpoint_weight=b, derivative_weight=c)
    tf = gains.derivative_filter_s
    expected = (gains.kp * (b * r - y)
                + scipy.signal.lfilter([0.0, gains.ki * H], [1.0, -1.0], r - y)
                + scipy.signal.lfilter([gains.kd, -gains.kd], [tf + H, -tf], c * r - y))
    assert np.allclose(run(Pid(gains, H), r, y), expected, rtol=1e-9, atol=1e-12)


def test_feedforward_adds_what_it_says() -> None:
    gains = PidGains(kp=0.0, ki=0.0, kd=0.0, feedforward_position=600.0, feedforward_velocity=2.0,
                     feedforward_acceleration=1.0)
    assert Pid(gains, H).step(1e-3, 5e-3, 0.1, -0.3) == pytest.approx(0.6 + 0.2 - 0.3)


def test_a_measured_period_gives_the_same_as_that_sample_period(
        signals: tuple[np.ndarray, np.ndarray]) -> None:
    r, y = signals
    slow, told = Pid(FREE, 2e-3), Pid(FREE, H)
    expected = run(slow, r, y)
    found = [told.step(float(a), float(b), dt_s=2e-3) for a, b in zip(r, y, strict=True)]
    assert np.allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize(("dt", "as_if"), [(math.nan, H), (-1.0, H), (math.inf, H), (0.0, H),
                                           (60.0, 10 * H)])
def test_an_impossible_period_is_not_believed(dt: float, as_if: float) -> None:
    one, two = Pid(FREE, H), Pid(FREE, H)
    one.step(1e-3, 0.0, dt_s=dt)
    two.step(1e-3, 0.0, dt_s=as_if)
    assert one.integral_v == pytest.approx(two.integral_v)


def closed_loop(pid: Pid, reference: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray]:
    """A mass on a spring, Euler-Cromer in 20 parts of a sample, whose actuator has a limit."""
    x = v = 0.0
    position, output = np.zeros(reference.size), np.zeros(reference.size)
    for k, r in enumerate(reference):
        position[k] = x
        u = pid.step(float(r), x)
        output[k] = max(-limit, min(limit, u))
        pid.applied(output[k])
        for _ in range(20):
            v += H / 20 * (output[k] - 1.705 * v - 600.7 * x)
            x += H / 20 * v
    return position, output


def overshoot(anti_windup: str, own_limit: float, limit: float) -> float:
    gains = PidGains(kp=3100.0, ki=38000.0, kd=94.0, derivative_filter_s=2.5e-3,
                     output_limit_v=own_limit, anti_windup=anti_windup, setpoint_weight=0.8)
    reference = np.where(np.arange(3000) < 1500, 4e-3, 0.0)      # 2.4 V hold it
    position, output = closed_loop(Pid(gains, H), reference, limit)
    assert np.max(np.abs(output)) <= limit + 1e-12
    assert position[-1] == pytest.approx(0.0, abs=1e-5)
    return float(np.max(position)) / 4e-3 - 1.0


def test_neither_law_winds_up_at_its_own_limit() -> None:
    without = overshoot("none", 2.7, 2.7)
    assert without > 0.05
    for law in ("back_calculation", "clamping"):
        assert -0.01 < overshoot(law, 2.7, 2.7) < 0.5 * without


@pytest.mark.parametrize("law", ["back_calculation", "clamping"])
def test_a_limit_of_the_actuator_alone_does_not_wind_it_up_either(law: str) -> None:
    assert -0.01 < overshoot(law, 100.0, 2.7) < 0.5 * overshoot("none", 100.0, 2.7)


def test_back_calculation_is_the_equation_of_the_docstring() -> None:
    gains = PidGains(kp=1000.0, ki=4000.0, kd=0.0, output_limit_v=2.0, tracking_time_s=0.02)
    pid = Pid(gains, H)
    assert pid.step(5e-3, 0.0) == 2.0                   # wanted 5 V
    assert pid.integral_v == pytest.approx(4000.0 * H * 5e-3 + H / 0.02 * (2.0 - 5.0))
    before = pid.integral_v
    pid.applied(1.5)
    assert pid.integral_v == pytest.approx(before + H / 0.02 * (1.5 - 2.0))


@pytest.mark.parametrize(("values", "seconds"), [
    ({"ki": 400.0, "kd": 4.0}, 0.1), ({"ki": 400.0, "kp": 80.0, "kd": 0.0}, 0.2),
    ({"tracking_time_s": 0.3}, 0.3), ({"tracking_time_s": 1e-6}, H), ({"ki": 0.0}, 0.1),
])
def test_the_tracking_time_in_force(values: dict[str, float], seconds: float) -> None:
    assert PidGains(**values).back_calculation_time_s(H) == pytest.approx(seconds)


def test_output_and_slew_are_limited_and_flagged() -> None:
    gains = PidGains(kp=1000.0, ki=0.0, kd=0.0, output_limit_v=2.0, slew_limit_v_s=100.0)
    pid = Pid(gains, H)
    outputs = run(pid, np.full(40, 5e-3), np.zeros(40))
    assert np.allclose(outputs, np.minimum(2.0, 0.1 * np.arange(1, 41)))
    assert pid.saturated
    pid.step(0.0, -1.9e-3)
    assert not pid.saturated
    assert pid.output_v == pytest.approx(1.9)


def test_the_integral_stays_within_the_limit_whatever_the_law_does() -> None:
    gains = PidGains(kp=0.0, ki=1e5, kd=0.0, output_limit_v=2.0, anti_windup="clamping")
    pid = Pid(gains, H)
    run(pid, np.full(100, 1e-3), np.zeros(100))
    assert pid.integral_v <= 2.0 + 0.1
    run(pid, np.zeros(40), np.full(40, 1e-3))
    assert pid.output_v < 0.0                           # it comes back at once


@pytest.mark.parametrize("change", [
    {"kp": 400.0}, {"ki": 100.0}, {"kd": 3.0}, {"setpoint_weight": 0.1}, {"ki": 0.0},
    {"derivative_weight": 1.0}, {"feedforward_position": 600.0}, {"feedforward_velocity": 5.0},
    {"feedforward_acceleration": 5.0}, {"kp": -300.0, "kd": 0.0},
])
def test_a_change_of_gains_gives_no_bump(change: dict[str, float]) -> None:
    def outputs(change_at: int) -> np.ndarray:
        pid = Pid(FREE, H)
        out = []
        for k in range(60):
            if k == change_at:
                pid.change(FREE.changed(change))
            out.append(pid.step(1e-3, 0.9e-3, 0.02, 0.3))
        return np.array(out)
    plain, changed = outputs(99), outputs(50)
    assert changed[50] == pytest.approx(plain[50], abs=1e-3 * abs(plain[50]))


def test_without_integral_the_leftover_of_a_change_fades() -> None:
    pid = Pid(FREE, H)
    run(pid, np.full(100, 1e-3), np.full(100, 0.9e-3))
    pid.change(FREE.changed({"ki": 0.0}))
    run(pid, np.full(2000, 1e-3), np.full(2000, 0.9e-3))
    assert pid.output_v == pytest.approx(FREE.kp * 1e-4, rel=1e-6)


@pytest.mark.parametrize("samples", [1, 30])
def test_taking_over_from_another_controller_gives_no_bump(samples: int) -> None:
    gains = FREE.changed({"feedforward_position": 600.0, "feedforward_velocity": 1.0,
                          "output_limit_v": 10.0})
    pid = Pid(gains, H)
    for k in range(samples):
        pid.track(1.25, 2e-3, 1.9e-3 + 1e-6 * k, 0.01)
    if samples == 1:
        assert pid.step(2e-3, 1.9e-3, 0.01) == pytest.approx(1.25)
    else:                                        # the stage goes on: kp acts, no derivative kick
        expected = 1.25 - gains.kp * 1e-6
        assert pid.step(2e-3, 1.9e-3 + 1e-6 * samples, 0.01) == pytest.approx(expected, abs=2e-4)


def test_following_does_not_end_in_a_bump_when_the_stage_is_far_from_the_reference() -> None:
    gains = FREE.changed({"output_limit_v": 2.0})
    pid = Pid(gains, H)
    pid.track(0.5, 10e-3, 0.0)                          # the proportional part alone wants 8 V
    first, second = pid.step(10e-3, 0.0), pid.step(10e-3, 0.0)
    assert first == pytest.approx(0.5)
    assert second == pytest.approx(0.5 + gains.ki * H * 10e-3)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(4))
def test_an_input_that_is_no_number_gives_zero_and_a_reason(bad: float, place: int) -> None:
    pid = Pid(FREE.changed({"feedforward_velocity": 1.0, "feedforward_acceleration": 1.0}), H)
    run(pid, np.full(10, 1e-3), np.zeros(10))
    integral = pid.integral_v
    inputs = [1e-3, 0.0, 0.0, 0.0]
    inputs[place] = bad
    assert pid.step(*inputs) == 0.0
    assert "not a finite number" in pid.fault
    assert pid.integral_v == integral
    assert math.isfinite(pid.step(1e-3, 0.0))
    assert pid.fault == ""
    with pytest.raises(ControlError, match="finite"):
        pid.track(0.0, *inputs)


def test_reset_forgets_everything() -> None:
    pid = Pid(FREE, H)
    run(pid, np.full(10, 1e-3), np.linspace(0, 1e-3, 10))
    pid.reset()
    assert run(pid, np.zeros(3), np.zeros(3)).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(("values", "part"), [
    ({"kpp": 1.0}, "no parameter 'kpp', did you mean 'kp'?"),
    ({"ki": -1.0}, "ki = -1 V/(m s) is outside"),
    ({"kd": math.nan}, "kd must be finite"),
    ({"kp": "high"}, "kp must be a number in V/m"),
    ({"output_limit_v": 0.0}, "output_limit_v = 0 V is outside"),
    ({"anti_windup": "clamp"}, "anti_windup must be one of back_calculation, clamping, none"),
])
def test_bad_parameters_are_refused_in_one_line(values: dict[str, object], part: str) -> None:
    with pytest.raises(ControlError) as caught:
        PidGains.from_mapping(values, "controller.yaml")
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_table_names_every_number_with_its_default() -> None:
    defaults = PidGains().to_dict()
    assert defaults.pop("anti_windup") == "back_calculation"
    assert {p.name: p.default for p in PID_PARAMETERS} == defaults
    assert PidGains.from_mapping(PidGains(kp=5.0).to_dict()) == PidGains(kp=5.0)


@pytest.mark.parametrize("period", [0.0, -1.0, math.nan, math.inf])
def test_a_bad_sample_period_is_refused(period: float) -> None:
    with pytest.raises(ControlError, match="sample_period_s"):
        Pid(FREE, period)
