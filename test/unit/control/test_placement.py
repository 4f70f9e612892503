"""Pole placement and loop margins against python-control, scipy and a simulated loop."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
import scipy.signal

from dfm_stage.control import (
    ControlError,
    Pid,
    PidGains,
    margins,
    pid_for,
    pid_with_margin,
    sample_stage,
)
from dfm_stage.control.stage import closed_loop_poles, controller_response

PAPER = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
         "delay": 1e-3, "amplifier_time_constant": 1e-3}
H = 1e-3


def test_the_ideal_loop_has_the_poles_asked_for() -> None:
    design = pid_for({**PAPER, "delay": 0.0, "amplifier_time_constant": 0.0}, 8.0,
                     damping_ratio=0.7, integral_ratio=0.5)
    g = design.gains
    plant = np.array([1.082, 1.845, 650.0])
    polynomial = np.concatenate((plant, [0.0])) + 1.082 * np.array([0.0, g.kd, g.kp, g.ki])
    w = 2.0 * math.pi * 8.0
    expected = [-0.5 * w, w * complex(-0.7, math.sqrt(0.51)), w * complex(-0.7, -math.sqrt(0.51))]
    assert np.allclose(np.sort_complex(np.roots(polynomial)), np.sort_complex(expected))


@pytest.mark.parametrize("lag", [0.0, 1e-3])
@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1e-3, 2.6e-3])
def test_the_sampled_stage_answers_as_the_continuous_one(delay: float, lag: float) -> None:
    base = {**PAPER, "delay": delay, "amplifier_time_constant": lag}
    stage = sample_stage(base, H)
    rng = np.random.default_rng(0)
    u = rng.normal(size=60)
    fine = 100                                           # scipy on a grid 100 times as fine
    system = scipy.signal.TransferFunction([1.082], np.polymul([1.082, 1.845, 650.0],
                                                               [lag, 1.0] if lag else [1.0]))
    held = np.concatenate((np.zeros(round(delay / H * fine)), np.repeat(u, fine)))
    t = np.arange(held.size) * H / fine
    expected = scipy.signal.lsim(system, held, t, interp=False)[1][:60 * fine:fine]
    x = np.zeros(stage.b.size)
    found = []
    for each in u:
        found.append(float(stage.c @ x))
        x = stage.a @ x + stage.b * each
    assert np.allclose(found, expected, rtol=1e-7, atol=1e-12)


def test_response_and_margins_are_those_of_python_control() -> None:
    gains = PidGains(kp=3100.0, ki=38000.0, kd=94.0, derivative_filter_s=2.5e-3)
    continuous = control.ss(control.tf([1.082], np.polymul([1.082, 1.845, 650.0], [1e-3, 1.0])))
    plant = control.c2d(continuous, H) * control.tf([1.0], [1.0, 0.0], H)
    tf = gains.derivative_filter_s
    law = (control.tf([gains.kp], [1.0], H) + control.tf([gains.ki * H], [1.0, -1.0], H)
           + control.tf([gains.kd, -gains.kd], [tf + H, -tf], H))
    loop = control.tf(plant) * law
    f = np.geomspace(0.1, 450.0, 50)
    z = np.exp(2j * math.pi * f * H)
    stage = sample_stage(PAPER, H)
    assert np.allclose(stage.response(f) * controller_response(gains, f, H),
                       loop(z), rtol=1e-6)
    gain, phase, modulus, _, crossover, _ = control.stability_margins(loop, method="frd")
    found = margins(stage, gains)
    assert found.stable
    assert found.gain == pytest.approx(gain, rel=5e-3)
    assert found.phase_deg == pytest.approx(phase, abs=0.2)
    assert found.modulus == pytest.approx(modulus, rel=5e-3)
    assert found.crossover_hz == pytest.approx(crossover / (2 * math.pi), rel=5e-3)


@pytest.mark.parametrize("factor", [0.97, 1.03])
def test_the_gain_margin_is_where_the_simulated_loop_diverges(factor: float) -> None:
    design = pid_for(PAPER, 8.0, feedforward=False, output_limit_v=1e6)
    scale = design.margins.gain * factor
    g = design.gains
    gains = g.changed({"kp": g.kp * scale, "ki": g.ki * scale, "kd": g.kd * scale})
    stage, pid = sample_stage(PAPER, H), Pid(gains, H)
    assert (np.max(np.abs(closed_loop_poles(stage, gains))) < 1.0) == (factor < 1.0)
    x = np.zeros(stage.b.size)
    track = []
    for _ in range(6000):
        track.append(float(stage.c @ x))
        x = stage.a @ x + stage.b * pid.step(1e-6, track[-1])
    early, late = np.ptp(track[2000:3000]), np.ptp(track[5000:])
    assert (late < early) == (factor < 1.0)


def test_smooth_scan_with_feedforward_follows_better_than_without() -> None:
    from dfm_stage.trajectory import make_reference
    ref = make_reference({"kind": "raster"}, sample_period_s=H, duration_s=4.0)
    error = {}
    for feedforward in (False, True):
        design = pid_for(PAPER, 8.0, feedforward=feedforward)
        stage, pid = sample_stage(PAPER, H), Pid(design.gains, H)
        x = np.zeros(stage.b.size)
        y = np.zeros(ref.position.size)
        for k in range(y.size):
            y[k] = stage.c @ x
            x = stage.a @ x + stage.b * pid.step(ref.position[k], y[k], ref.velocity[k],
                                                 ref.acceleration[k])
        error[feedforward] = math.sqrt(np.mean((y - ref.position)[2000:][ref.steady[2000:]]**2))
    assert error[True] < 0.2 * error[False]
    assert error[True] < 60e-6


def test_the_fastest_design_keeps_the_margin_asked_for() -> None:
    design = pid_with_margin(PAPER, 0.5)
    assert 0.5 <= design.margins.modulus < 0.51
    assert f"modulus margin of {design.margins.modulus:.2f}" in design.reason


def test_the_default_gains_are_those_the_comment_says() -> None:
    design = pid_for(PAPER, 8.0, feedforward=False)
    for name in ("kp", "ki", "kd", "derivative_filter_s"):
        assert getattr(PidGains(), name) == pytest.approx(getattr(design.gains, name), rel=0.02)


@pytest.mark.parametrize(("base", "bandwidth", "part"), [
    (PAPER, 1.0, "ask for more than"), (PAPER, 60.0, "ask for less"),
    (PAPER, math.nan, "bandwidth_hz must be a positive number"),
    ({"stiffness": 1.0}, 5.0, "needs mass above zero"),
    ({"mass": 1.0}, 5.0, "needs force_constant above zero"),
])
def test_what_cannot_be_designed_is_refused(base: dict[str, float], bandwidth: float,
                                            part: str) -> None:
    with pytest.raises(ControlError) as caught:
        pid_for(base, bandwidth)
    assert part in str(caught.value)


def test_a_margin_no_bandwidth_keeps_is_refused() -> None:
    with pytest.raises(ControlError, match="no bandwidth"):
        pid_with_margin({**PAPER, "delay": 0.1}, 0.9)
    with pytest.raises(ControlError, match="between 0 and 1"):
        pid_with_margin(PAPER, 1.5)
