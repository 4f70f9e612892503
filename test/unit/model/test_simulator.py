"""Whole records: many sets, periodic motion, derivatives, sensors, outside forces, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim

from dfm_stage.model import Model, ModelError, SimulationError, Simulator, load_model
from dfm_stage.model.effects import hysteresis
from dfm_stage.model.simulator import hermite

PERIOD = 1e-3
BASE = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 1.082}
LAGGED = {**BASE, "amplifier_time_constant": 7e-4, "delay": 4e-4}


def noise(samples: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(samples)


@pytest.mark.parametrize("order", [2, 3, 4, 5, 6, 8])
def test_every_linear_loop_against_scipy(order: int) -> None:
    """The unrolled loops for modal and for full matrices, against scipy's zero-order hold."""
    base = {**BASE, **({"amplifier_time_constant": 7e-4} if order in (3, 5, 8) else {})}
    model = Model("m", PERIOD, base)
    m, c, k, g = (base[n] for n in ("mass", "damping", "stiffness", "force_constant"))
    a = np.zeros((order, order))
    b = np.zeros((order, 1))
    a[0, 1], a[1, 0], a[1, 1] = 1.0, -k / m, -c / m
    out = np.zeros((1, order))
    out[0, 0] = 1.0
    push, at = {1: 1.0 / m}, 2
    if "amplifier_time_constant" in base:
        a[2, 2], b[2, 0], a[1, 2] = -1 / 7e-4, 1 / 7e-4, g / m
        at = 3
    else:
        b[1, 0] = g / m
    if order >= 4:
        s, w, z = 0.07, 2 * math.pi * 16.0, 0.01
        model = model.with_effect("second_mode", {"share": s, "frequency": 16.0,
                                                  "damping_ratio": z})
        a[at, at + 1], a[at + 1, at], a[at + 1, at + 1] = 1.0, -w * w, -2 * z * w
        if at == 3:
            a[at + 1, 2] = g / m
        else:
            b[at + 1, 0] = g / m
        out[0, 0], out[0, at] = 1 - s, s
        push[at + 1] = 1.0 / m
        at += 2
    if order == 6:                    # creep and back-EMF couple everything
        model = model.with_effect("back_emf", {"constant": 2.0})
        velocity = np.zeros(order)
        velocity[1], velocity[3] = out[0, 0], out[0, 2]
        for row, value in push.items():
            a[row] -= value * g * 2.0 * velocity
        model = model.with_effect("creep", {"stiffness": 50.0, "time_constant": 0.1})
        model = model.with_effect("amplifier_bandwidth", {"time_constant": 1e-3})
        a[5, 5], b[5, 0] = -1e3, 1e3
        for row, value in push.items():
            b[row, 0] = 0.0
            a[row, 5] += value * g
            a[row, 4] += value * 50.0
            a[row, :4] -= value * 50.0 * out[0, :4]
        a[4, :4] = out[0, :4] / 0.1
        a[4, 4] = -1 / 0.1
    if order == 8:
        model = model.with_effect("periodic_disturbance", {"amplitude": 0.0, "frequency": 5.0})
        model = model.with_effect("creep", {"stiffness": 50.0, "time_constant": 0.1})
        for row, value in push.items():
            a[row, 7] += value * 50.0
            a[row, :5] -= value * 50.0 * out[0, :5]
        a[7, :5] = out[0, :5] / 0.1
        a[7, 7] = -1 / 0.1
        a[5, 5] = a[6, 6] = -1.0      # stand for the silent oscillator
    inputs = noise(600, order)
    discrete = cont2discrete((a, b, out, np.zeros((1, 1))), PERIOD)
    expected = dlsim(discrete, inputs)[1][:, 0]
    found = Simulator(model)
    assert len(found.states) == order
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(found.output(inputs) / scale, expected / scale, atol=1e-11)
    np.testing.assert_array_equal(found.run(inputs).output, found.output(inputs))


def test_rows_of_run_many_are_runs_of_changed_models() -> None:
    model = (Model("m", PERIOD, LAGGED).with_effect("cubic_stiffness", {"k3": 3e6})
             .with_effect("coulomb_friction", {"force": 0.03})
             .with_effect("transport_delay", {"delay": 2e-4}))
    names = ["mass", "delay", "coulomb_friction.force", "transport_delay.delay", "encoder_zero",
             "initial.velocity", "coil_inductance"]
    rows = np.array([[1.0, 0.4e-3, 0.03, 2e-4, 0.0, 0.0, 0.0],
                     [1.2, 3.7e-3, 0.00, 9e-4, 1e-5, 2e-3, 0.0],
                     [0.9, 0.0, 0.10, 0.0, -1e-5, -1e-3, 0.0]])
    inputs = noise(400)
    for threads in (1, 2):
        many = Simulator(model).run_many(inputs, names, rows, threads=threads)
        for row, found in zip(rows, many, strict=True):
            changed = model.with_parameters(dict(zip(names[:5], row[:5], strict=True)))
            one = Simulator(changed).run(inputs, initial={"velocity": row[5]})
            np.testing.assert_array_equal(found, one.output)


def test_rows_that_see_a_part_of_the_input_are_runs_of_it() -> None:
    model = load_model("paper_stage").with_effect("cubic_stiffness", {"k3": 1e6})
    feed = np.random.default_rng(1).standard_normal(500)
    parts = [slice(0, 200), slice(200, 500), slice(0, 200), slice(120, 320), slice(100, 300)]
    rows = np.array([[600.0, 0.0], [600.0, 1e-3], [700.0, 2e-3], [650.0, 0.0], [600.0, 2e-3]])
    found = Simulator(model).run_many(feed, ["stiffness", "initial.position"], rows, parts=parts,
                                      past_input=0.3)
    assert found.shape == (5, 300)
    for row, part, (stiffness, position) in zip(found, parts, rows, strict=True):
        alone = Simulator(model.with_parameters({"stiffness": stiffness})).run(
            feed[part], initial={"position": position},
            past_input=float(feed[part.start - 1]) if part.start else 0.3)
        assert np.array_equal(row[:alone.output.size], alone.output)
    with pytest.raises(SimulationError, match="3 parts for 5 rows"):
        Simulator(model).run_many(feed, ["stiffness", "initial.position"], rows, parts=parts[:3])



@pytest.mark.parametrize(("effects", "tolerance"), [
    ({}, 1e-12),
    ({"creep": {"stiffness": 80.0, "time_constant": 40.0}}, 1e-10),
    ({"cubic_stiffness": {"k3": 3e6}}, 1e-8),
    ({"coulomb_friction": {"force": 0.05}}, 1e-8),
    ({"hysteresis": {"stiffness": 50.0, "yield_displacement": 1e-4}}, 1e-8),
    ({"presliding_friction": {"force": 0.05, "stiffness": 5e4}}, 1e-8),
])
def test_periodic_motion_repeats(effects: dict[str, dict[str, float]], tolerance: float) -> None:
    """From the state of steady_state, the period after this one is the same again."""
    model = Model("m", PERIOD, LAGGED)
    for name, values in effects.items():
        model = model.with_effect(name, values)
    t = np.arange(1000) * PERIOD
    inputs = sum(0.3 * np.cos(2 * np.pi * f * t + f * f) for f in range(1, 30, 2))
    once = Simulator(model).run(inputs, steady_state=True).position
    periods = 60 if "creep" not in effects else 1500
    later = Simulator(model).run(np.tile(inputs, periods)).position[-1000:]
    assert np.max(np.abs(once - later)) < max(tolerance, 1e-11) * np.max(np.abs(once)) \
        + (1e-9 * np.max(np.abs(once)) if "creep" in effects else 0.0)
    many = Simulator(model).run_many(inputs, ["mass"], [[LAGGED["mass"]]], steady_state=True)
    np.testing.assert_array_equal(many[0], once)


def test_no_periodic_motion_is_said() -> None:
    free = Model("m", PERIOD, {"mass": 1.0, "damping": 2.0})
    with pytest.raises(SimulationError, match="no spring"):
        Simulator(free).run(np.ones(100), steady_state=True)
    out = Simulator(free).run_many(np.ones(100), ["mass"], [[1.0]], steady_state=True,
                                   partial=True)
    assert np.all(np.isnan(out))
    shaken = Model("m", PERIOD, BASE).with_effect("periodic_disturbance",
                                                  {"amplitude": 0.1, "frequency": 12.34})
    with pytest.raises(SimulationError, match="cycles"):
        Simulator(shaken).run(np.ones(100), steady_state=True)


def test_derivatives_against_closed_forms() -> None:
    """Static deflection x = g u / k with offset, and a release from x0."""
    model = Model("m", PERIOD, {**BASE, "damping": 40.0, "encoder_zero": 0.0})
    simulator = Simulator(model)
    output, slopes = simulator.sensitivities(np.ones(4000), ["stiffness", "force_constant",
                                                             "encoder_zero"])
    static = 1.082 / 650.0
    assert output[-1] == pytest.approx(static, rel=1e-9)
    np.testing.assert_allclose(slopes[:, -1], [-static / 650.0, static / 1.082, 1.0], rtol=1e-6)
    free = Model("m", PERIOD, {"mass": 1.0, "stiffness": 400.0})
    _, slopes = Simulator(free).sensitivities(
        np.zeros(500), ["initial.position", "initial.velocity", "stiffness"],
        initial={"position": 1e-3})
    t = np.arange(500) * PERIOD
    np.testing.assert_allclose(slopes[0], np.cos(20 * t), atol=1e-9)
    np.testing.assert_allclose(slopes[1], np.sin(20 * t) / 20, atol=1e-9)
    np.testing.assert_allclose(slopes[2], -1e-3 * np.sin(20 * t) * t / 40, atol=1e-10)


def test_derivatives_of_nonlinear_models_do_not_depend_on_the_step(
        monkeypatch: pytest.MonkeyPatch) -> None:
    model = (Model("m", PERIOD, LAGGED).with_effect("cubic_stiffness", {"k3": 3e6})
             .with_effect("coulomb_friction", {"force": 0.05}))
    names = ["mass", "damping", "stiffness", "cubic_stiffness.k3", "coulomb_friction.force"]
    inputs = np.convolve(noise(600), np.ones(20) / 10, "same")
    _, slopes = Simulator(model).sensitivities(inputs, names)
    monkeypatch.setattr("dfm_stage.model.simulator.RELATIVE_STEP", 3e-4)
    _, coarser = Simulator(model).sensitivities(inputs, names)
    for fine, coarse in zip(slopes, coarser, strict=True):
        assert np.linalg.norm(fine - coarse) < 1e-4 * np.linalg.norm(fine)


def test_derivative_at_a_limit_is_one_sided() -> None:
    """Friction of zero cannot be lowered; the derivative from above is that of a small force."""
    model = Model("m", PERIOD, BASE).with_effect("coulomb_friction", {"force": 0.0})
    inputs = np.convolve(noise(600), np.ones(20) / 10, "same")
    _, slopes = Simulator(model).sensitivities(inputs, ["coulomb_friction.force"])
    small = Simulator(model.with_parameters({"coulomb_friction.force": 1e-5})).output(inputs)
    difference = (small - Simulator(model).output(inputs)) / 1e-5
    assert np.linalg.norm(slopes[0] - difference) < 1e-2 * np.linalg.norm(difference)


def test_sensor_effects_are_their_equations() -> None:
    model = Model("m", PERIOD, {**BASE, "encoder_zero": 2e-6, "noise": 3e-7})
    inputs = np.convolve(noise(500), np.ones(20) / 10, "same")
    x = Simulator(model).run(inputs).position
    t = np.arange(500) * PERIOD
    other = 1e-3 * np.sin(7 * t)
    cases = {
        "encoder_periodic_error": ({"amplitude": 1e-7, "period": 2e-5, "phase": 0.3},
                                   1e-7 * np.sin(2 * np.pi * x / 2e-5 + 0.3)),
        "thermal_drift": ({"rate": 1e-6, "decay": 3.0}, 1e-6 * (1 - np.exp(-3 * t)) / 3),
        "cross_axis_coupling": ({"ratio": 0.004}, 0.004 * other),
    }
    for name, (values, expected) in cases.items():
        more = {"other": other} if name == "cross_axis_coupling" else {}
        result = Simulator(model.with_effect(name, values)).run(inputs, **more)
        np.testing.assert_allclose(result.output, x + 2e-6 + expected, rtol=0, atol=1e-18)
        np.testing.assert_array_equal(result.position, x)
    linear = Simulator(model.with_effect("thermal_drift", {"rate": 1e-6})).run(inputs)
    np.testing.assert_allclose(linear.output, x + 2e-6 + 1e-6 * t, rtol=0, atol=1e-18)


def test_quantisation_is_the_mean_over_the_noise() -> None:
    step = 1e-6
    model = Model("m", PERIOD, {**BASE, "noise": 2e-7}).with_effect("encoder_quantization",
                                                                    {"step": step})
    inputs = np.full(400, 1e-3)
    simulator = Simulator(model)
    result = simulator.run(inputs)
    rng = np.random.default_rng(1)
    drawn = result.reading[300] + 2e-7 * rng.standard_normal(400_000)
    mean = np.mean(np.floor(drawn / step + 0.5) * step)
    assert result.output[300] == pytest.approx(mean, abs=4e-9)
    sharp = simulator.run(inputs, dither=0.0).output
    np.testing.assert_allclose(sharp, np.floor(result.reading / step + 0.5) * step, atol=1e-18)
    counts = result.measured(3) / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)


def test_current_and_force_of_a_coil_driven_by_voltage() -> None:
    """At rest the current is u/R; while it moves it is (u - Ke x')/R, and F = Kf R i."""
    base = {**BASE, "coil_resistance": 8.0, "back_emf": 5.0}
    result = Simulator(Model("m", PERIOD, base)).run(np.full(300, 2.0))
    drive = np.where(np.arange(300) > 0, 2.0, 0.0) - 5.0 * result.velocity
    np.testing.assert_allclose(result.current, drive / 8.0, atol=1e-14)
    np.testing.assert_allclose(result.force, 1.082 * drive, atol=1e-13)
    droop = Model("m", PERIOD, base).with_effect("force_constant_droop", {"droop": 1e4})
    result = Simulator(droop).run(np.full(300, 2.0))
    np.testing.assert_allclose(result.force, 1.082 * 8.0 * result.current
                               * (1 - 1e4 * result.position**2), atol=1e-12)


def test_hermite_is_exact_for_cubics_and_periodic_signals_wrap() -> None:
    t = np.arange(12.0)
    values = 1 + t - 0.3 * t**2 + 0.02 * t**3
    coefficients = hermite(values)
    middle = coefficients @ [1.0, 0.5, 0.25, 0.125]
    u = t + 0.5
    np.testing.assert_allclose(middle[:-1], (1 + u - 0.3 * u**2 + 0.02 * u**3)[:-1], rtol=1e-12)
    wave = np.sin(2 * np.pi * np.arange(40) / 40)
    middle = hermite(wave, periodic=True) @ [1.0, 0.5, 0.25, 0.125]
    np.testing.assert_allclose(middle, np.sin(2 * np.pi * (np.arange(40) + 0.5) / 40), atol=3e-6)


def test_past_input_and_initial_states() -> None:
    """Held from long ago by a constant input, the stage stays where that input holds it."""
    model = Model("m", PERIOD, LAGGED)
    static = 1.082 * 0.5 / 650.0
    result = Simulator(model).run(np.full(50, 0.5), past_input=0.5,
                                  initial={"position": static, "amplifier": 0.5})
    np.testing.assert_allclose(result.position, static, rtol=1e-12)
    with pytest.raises(ModelError, match=r"did you mean initial\.position"):
        Simulator(model).run(np.zeros(3), initial={"positon": 1.0})


def test_refusals() -> None:
    model = load_model("paper_stage")
    simulator = Simulator(model)
    with pytest.raises(SimulationError, match="not finite at sample 2"):
        simulator.run([0.0, 1.0, math.nan])
    with pytest.raises(SimulationError, match="shape"):
        simulator.run(np.ones((3, 2)))
    with pytest.raises(SimulationError, match="columns"):
        simulator.run_many(np.ones(3), ["mass"], np.ones((2, 2)))
    with pytest.raises(ModelError, match="did you mean mass"):
        simulator.run_many(np.ones(3), ["masss"], [[1.0]])
    with pytest.raises(SimulationError, match="4 samples, the input 3"):
        simulator.run(np.ones(3), external_force=np.ones(4))
    coupled = model.with_effect("cross_axis_coupling", {"ratio": 0.01})
    with pytest.raises(SimulationError, match="other axis"):
        Simulator(coupled).run(np.ones(3))
    soft = model.with_effect("cubic_stiffness", {"k3": -1e9})
    with pytest.raises(SimulationError, match="escapes to infinity"):
        Simulator(soft).run(np.full(2000, 5.0))
    assert np.isnan(Simulator(soft).run_many(np.full(2000, 5.0), ["mass"], [[1.0]])[0, -1])


def test_a_force_too_stiff_to_follow_ends_in_nan_and_not_in_minutes_of_tiny_steps():
    """As a fit may try one: an eddy damper of 7e7 N s/m slows the stage within 13 ns."""
    drive = np.sin(2.0 * np.pi * 2.0 * PERIOD * np.arange(24_000))
    model = Model("stage", PERIOD, base=BASE).with_effect("coulomb_friction", {"force": 0.004})
    stiff = Simulator(model.with_effect(
        "eddy_current_damping", {"damping": 7e7, "critical_velocity": 6e-3}))
    assert np.isnan(stiff.run_many(drive, ["mass"], [[0.9]])[0, -1])
    with pytest.raises(SimulationError, match="too stiff to follow"):
        stiff.run(drive)


def test_whoever_asks_may_allow_fewer_steps_than_a_stiff_force_takes():
    """A fit does not follow a force that takes 30 steps a sample for long; without one it may."""
    drive = np.sin(2.0 * np.pi * 2.0 * PERIOD * np.arange(24_000))
    loop = {"stiffness": 1e8, "yield_displacement": 1e-9}
    stage = Simulator(Model("stage", PERIOD, base=BASE).with_effect("hysteresis", loop))
    taken = np.zeros(1, dtype=np.int64)
    usual = stage.run_many(drive, ["mass"], [[0.9]], steps=taken)
    assert np.all(np.isfinite(usual))
    mean = int(taken[0]) / drive.size
    fewer, more = (stage.run_many(drive, ["mass"], [[0.9]], steps_allowed=share * mean)
                   for share in (0.5, 2.0))
    assert np.isnan(fewer[0, -1])
    assert np.array_equal(more, usual)


@pytest.mark.parametrize("lag", [0.0, 1e-9, 1e-5])
def test_a_step_whose_iteration_overflows_is_halved(lag: float) -> None:
    """Strong drag from a high speed, against m/c ln(1 + c v t/m): over a whole sample the force is
    squared in each iteration until it is infinite, which is no answer."""
    mass, drag, speeds, time = 1.3, 2.8e5, np.linspace(0.01, 0.2, 96), PERIOD * np.arange(50)
    base = {"mass": mass, "damping": 0.0, "amplifier_time_constant": lag}
    model = Model("drag", PERIOD, base).with_effect("quadratic_damping", {"coefficient": drag})
    found = Simulator(model).run_many(0.0 * time, ["initial.velocity"], speeds[:, None])
    exact = mass / drag * np.log1p(drag / mass * speeds[:, None] * time)
    assert found == pytest.approx(exact, rel=1e-5, abs=1e-12)


@pytest.mark.timeout(60)
def test_a_loop_whose_state_is_lost_ends_in_nan_and_not_never():
    """In an iteration that does not contract the motion may be anything before it is given up."""
    values = np.array([5184.0, 1.5e-7, 5.0, 4.019])
    for state, path in ((math.nan, 1.0), (-math.inf, 1e12), (-1.0, math.inf), (0.3, 1e12)):
        found = hysteresis.advance(state, path, 1.0, 1.0, values)
        assert math.isnan(found) or found == pytest.approx(1.0)


def test_steps_are_counted_alike_in_every_run() -> None:
    model = Model("m", 1e-3, {"mass": 1.0, "damping": 2.0, "stiffness": 600.0})
    inputs = np.random.default_rng(0).normal(size=300)
    steps = np.full(3, -1)
    Simulator(model).run_many(inputs, ["damping"], [[1.0], [2.0], [3.0]], steps=steps)
    assert steps.tolist() == [300] * 3
    rubbing = Simulator(model.with_effect("coulomb_friction", {"force": 0.1}))
    rows = [[0.0], [0.1], [0.3]]
    rubbing.run_many(inputs, ["coulomb_friction.force"], rows, steps=steps, threads=2)
    again = np.zeros(3, dtype=np.int64)
    rubbing.run_many(inputs, ["coulomb_friction.force"], rows, steps=again, threads=1)
    assert steps.tolist() == again.tolist()
    assert np.all(steps > 300)
    steps[:] = 0
    rubbing.run_many(inputs[:150], ["coulomb_friction.force"], rows, steps=steps)
    assert np.all(steps < again)
    with pytest.raises(SimulationError, match="one number a row"):
        rubbing.run_many(inputs, ["coulomb_friction.force"], rows, steps=steps[:2])
