"""The estimator: unknowns of a model on runs, their sensitivities, weights and the search."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from dfm_stage.identification import Problem, Run, Unknown, fit_model
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.fit import search
from dfm_stage.identification.system import System, rounding_step
from dfm_stage.identification.weights import (
    Weight,
    high_band_rms,
    weights_of,
    white_weights,
)
from dfm_stage.model import EFFECTS, Model, Simulator
from dfm_stage.model.scales import typical_size

H, N = 1e-3, 2500
STAGE = Model("stage", H, {"mass": 1.1, "damping": 2.0, "stiffness": 640.0, "force_constant": 1.1,
                           "amplifier_time_constant": 8e-4, "delay": 1.3e-3})
FREE = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay")
RNG = np.random.default_rng(3)
INPUT = np.convolve(RNG.standard_normal(N + 20), np.ones(21) / 21.0, "valid")


def run_of(model: Model, name: str = "run", noise: float = 0.0, seed: int = 0, **more) -> Run:
    y = Simulator(model).run(INPUT, past_input=float(INPUT[0])).output
    return Run(name, INPUT, y + noise * np.random.default_rng(seed).standard_normal(N), H, **more)


def white(system: Problem, sigma: float = 1e-7):
    return tuple(tuple(Weight(np.ones(1), sigma, "") for _ in r.measured) for r in system.runs)


def test_unknowns_are_parameters_then_what_belongs_to_each_run():
    system = System(STAGE, [run_of(STAGE, "a"), run_of(STAGE, "b")], FREE)
    shared = [u.name for u in system.unknowns if u.run is None]
    assert len(shared) == len(FREE)
    assert [(u.name, u.run) for u in system.unknowns[5:]] == [
        (n, i) for i in (0, 1) for n in ("initial.position", "initial.velocity", "offset")]
    assert system.physical(system.start) == pytest.approx(
        {n: STAGE.parameters()[n] for n in FREE}, rel=1e-12)


@pytest.mark.parametrize("effect", [None, "cubic_stiffness", "creep"])
def test_sensitivities_are_those_of_the_simulator(effect):
    model = STAGE
    if effect is not None:
        model = model.with_effect(effect, {"k3": 4e6} if effect == "cubic_stiffness" else
                                  {"stiffness": 40.0, "time_constant": 0.2})
    own = [f"{effect}.k3"] if effect == "cubic_stiffness" else []
    names = ["damping", "force_constant", *own]
    system = System(model, [run_of(model)], names)
    slopes = system.sensitivities(0, system.start)[0]
    _, expected = Simulator(model).sensitivities(
        INPUT, [*names, "initial.position", "initial.velocity"], past_input=float(INPUT[0]))
    for mine, theirs in zip(slopes, expected, strict=False):
        assert np.max(np.abs(mine - theirs)) < 1e-3 * np.max(np.abs(theirs))
    np.testing.assert_array_equal(slopes[-1], np.ones(N))


def test_an_offset_beside_a_rounding_is_simulated():
    model = STAGE.with_effect("encoder_quantization", {"step": 2e-6})
    assert rounding_step(model) == 2e-6
    system = System(model, [run_of(model)], FREE, noise=1e-7)
    x = system.start.copy()
    x[-1] = 3.3e-6
    moved = system.signals(0, x[None, :])[0][0]
    expected = Simulator(model.with_parameters({"encoder_zero": 3.3e-6})).run(
        INPUT, past_input=float(INPUT[0]), dither=1e-7).output
    np.testing.assert_allclose(moved, expected, atol=1e-14)
    assert np.ptp(moved - system.signals(0, system.start[None, :])[0][0]) > 1e-6


def test_the_phase_of_a_vibration_is_its_own_in_each_run():
    phases = (0.4, 2.1)
    runs = [run_of(STAGE.with_effect("periodic_disturbance", {
        "amplitude": 0.02, "frequency": 11.0, "phase": phase}), f"r{phase}", 1e-8, k)
        for k, phase in enumerate(phases)]
    begin = STAGE.with_effect("periodic_disturbance", {
        "amplitude": 0.015, "frequency": 11.0, "phase": 0.1})
    free = (*FREE, "periodic_disturbance.amplitude", "periodic_disturbance.phase")
    system = System(begin, runs, free)
    found = search(system, white(system, 1e-8), system.start)
    assert found.chi2 < 1.1 * 2 * N
    values = found.model.parameters()
    assert values["periodic_disturbance.phase"] == pytest.approx(phases[0], abs=0.01)
    own = found.locals
    turned = np.arctan2(own["periodic_disturbance.quadrature", 1],
                        own["periodic_disturbance.in_phase", 1])
    assert turned == pytest.approx(phases[1], abs=0.01)


def test_the_search_finds_what_scipy_finds():
    run = run_of(STAGE, noise=1e-6, seed=4)
    names = ("damping", "stiffness", "force_constant")
    system = System(STAGE.with_parameters({"damping": 3.0, "stiffness": 600.0}), [run], names)
    found = search(system, white(system, 1e-6), system.start, iterations=60, tolerance=1e-8)

    def gap(x):
        simulated = Simulator(STAGE).run_many(
            INPUT, [*names, "initial.position", "initial.velocity"], x[None, :5] * scale[:5],
            past_input=float(INPUT[0]))[0]
        return (run.output - simulated - x[5] * scale[5]) / 1e-6

    scale = np.array([2.0, 640.0, 1.1, 1e-5, 1e-3, 1e-5])
    theirs = least_squares(gap, np.array([1.5, 0.94, 1.0, 0.0, 0.0, 0.0]), xtol=1e-14, ftol=1e-14)
    assert found.chi2 == pytest.approx(2.0 * theirs.cost, rel=1e-6)
    assert found.x == pytest.approx(theirs.x * scale, rel=1e-4, abs=1e-9)
    quantities = found.quantities
    for name, true in (("damping", 2.0), ("stiffness", 640.0), ("force_constant", 1.1)):
        assert quantities[name].covers(true)


def test_a_search_stops_where_its_work_is_used_up():
    model = STAGE.with_effect("cubic_stiffness", {"k3": 4e6})
    begin = model.with_parameters({"cubic_stiffness.k3": 1e6})
    system = System(begin, [run_of(model)], ("cubic_stiffness.k3",))
    cut = search(system, white(system), system.start, allowance=2.0 * N)
    whole = search(System(begin, [run_of(model)], ("cubic_stiffness.k3",)), white(system),
                   system.start)
    assert system.work < 40.0 * N
    assert whole.chi2 < cut.chi2
    again = System(begin, [run_of(model)], ("cubic_stiffness.k3",))
    search(again, white(system), again.start, allowance=2.0 * N)
    assert again.work == system.work  # counted, not timed


def test_weights_make_coloured_noise_white():
    noise = lfilter([1.0], [1.0, -0.9], RNG.standard_normal(20_000))
    weights = weights_of([[noise]])
    e = weights[0][0].apply(noise)
    assert float(np.std(e)) == pytest.approx(1.0, abs=0.03)
    assert abs(float(np.mean(e[1:] * e[:-1]))) < 0.03
    assert weights[0][0].rms == pytest.approx(float(np.std(noise)), rel=0.05)
    rough = white_weights([[1e-3 * np.sin(0.01 * np.arange(20_000)) + 1e-6 * noise]])
    assert rough[0][0].sigma == pytest.approx(high_band_rms(1e-6 * noise), rel=0.05)


def test_the_joint_criterion_differentiates_by_the_noise_as_well():
    t = np.arange(300)
    y = np.sin(0.1 * t) + 0.1 * np.random.default_rng(1).standard_normal(300)
    problem = Problem((Unknown("a", 0.7, 1.0),), (Run("toy", y, y, 1.0),),
                      lambda i, rows: rows[:, :1] * np.sin(0.1 * t))
    criterion = Criterion(problem, ((Weight(np.array([1.0, 0.3, -0.2]), 0.1, ""),),), joint=True)
    z = criterion.start(problem.start)
    jacobian = criterion.jacobian(z)
    for k in range(z.size):
        up, down = z.copy(), z.copy()
        up[k] += 1e-6
        down[k] -= 1e-6
        numeric = (criterion.residual(up) - criterion.residual(down)) / 2e-6
        np.testing.assert_allclose(jacobian[:, k], numeric, atol=1e-6)


def test_every_parameter_has_a_size():
    for name, effect in EFFECTS.items():
        model = STAGE.with_parameters({"coil_resistance": 8.0}).with_effect(name, {
            p.name: min(max(0.0, p.low), p.high) for p in effect.parameters})
        for parameter in effect.parameters:
            assert typical_size(model, f"{name}.{parameter.name}") > 0.0
    assert typical_size(STAGE, "stiffness") == 640.0
    assert typical_size(Model("free", H, {"mass": 2.0, "damping": 1.0}), "stiffness") == 2.0


def test_a_value_left_next_to_zero_does_not_freeze_the_search():
    run = run_of(STAGE, noise=1e-7, seed=9)
    nothing = {"amplifier_time_constant": 1.5e-14, "delay": 1.5e-14}
    system = System(STAGE.with_parameters(nothing), [run], FREE)
    found = search(system, white(system), system.start, iterations=60)
    assert found.chi2 < 1.1 * N
    assert found.model.base["delay"] == pytest.approx(1.3e-3, rel=0.05)


def test_a_small_parameter_beside_a_large_one_of_another_unit_is_not_at_its_limit():
    values = {"stiffness": 600.0, "yield_displacement": 3e-4}
    model = STAGE.with_effect("hysteresis", values)
    found = fit_model(model, [run_of(model, noise=1e-8)], [
        "damping", *(f"hysteresis.{n}" for n in values)])
    for n, value in values.items():
        assert found.model.parameters()[f"hysteresis.{n}"] == pytest.approx(value, rel=0.02)


def test_a_row_that_is_asked_for_again_is_counted_and_not_simulated(monkeypatch):
    model = STAGE.with_effect("cubic_stiffness", {"k3": 1e6})
    system = System(model, [run_of(model)], FREE)
    x = system.start[None, :]
    first, work = system.simulated(0, x), system.work
    assert work > 0.0
    monkeypatch.setattr(Simulator, "run_many", None)
    again = system.simulated(0, x.copy())
    assert np.array_equal(again[0], first[0])
    assert system.work == 2.0 * work
    with pytest.raises(TypeError):
        system.simulated(0, 1.01 * x)


@pytest.mark.parametrize("central", [True, False])
@pytest.mark.parametrize("limits", [(-np.inf, 1.0), (1.0, np.inf)])
def test_where_one_side_cannot_be_simulated_the_slope_is_that_of_the_other(central, limits):
    """A parameter that depends on several unknowns leaves its limits on one side of one."""
    y = np.linspace(1.0, 2.0, 60)

    def simulate(_, rows):
        return np.array([a * b * y if limits[0] <= a + b <= limits[1] else np.full(60, np.nan)
                         for a, b in rows])

    problem = Problem((Unknown("a", 0.3, 1.0), Unknown("b", 0.7, 1.0)),
                      (Run("toy", y, y, 1.0, trend=-1),), simulate)
    out = problem.no_slopes(0)
    problem.differences(0, np.array([0.3, 0.7]), [0, 1], central, out)
    for k, factor in ((0, 0.7), (1, 0.3)):
        assert problem.slope(out[0], k, 0) == pytest.approx(factor * y, rel=1e-6)


def test_a_free_motion_begins_where_the_record_does():
    """From rest, the states of a wide swing are a far minimum."""
    time = H * np.arange(N)
    rest = Run("free", np.zeros(N), 0.3 * np.cos(20.0 * time + 1.0), H)
    start = System(STAGE, [rest], FREE).start[5:7]
    assert start == pytest.approx([0.3 * np.cos(1.0), -6.0 * np.sin(1.0)], rel=0.15)
    assert not np.any(System(STAGE, [run_of(STAGE)], FREE).start[5:7])
