"""LQR and Kalman filter against filterpy, python-control, the cost itself and the plant."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace

import control
import numpy as np
import pytest

from dfm_stage.control import (
    ControlError,
    Lqg,
    LqrDesign,
    LqrSpec,
    Pid,
    PidGains,
    design_lqr,
    kalman,
    sample_model,
)
from dfm_stage.control.laws.lqr import LqrPlan
from dfm_stage.control.lqr import on_reference
from dfm_stage.model import Model, Plant, load_model

NAMES = ["paper_stage", "raster_bench"]
VARIANTS = {
    "regulator": LqrSpec(lqr_integral=False, lqr_feedforward=False),
    "model": LqrSpec(lqr_integral=False),
    "integral": LqrSpec(),
    "disturbance": LqrSpec(lqr_integral=False, lqr_disturbance=True),
    "both": LqrSpec(lqr_disturbance=True),
}
SPECS = [pytest.param(spec, id=name) for name, spec in VARIANTS.items()]


def run(model: Model, controller: Lqg | Pid, samples: int, *, reference: float = 1e-3,
        force: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    plant = Plant(model, seed=2)
    y, u = np.empty(samples), np.empty(samples)
    for k in range(samples):
        sample = plant.sample()
        y[k] = sample.position_m
        u[k] = controller.step(reference, sample.reading_m)
        plant.advance(u[k], external_force_n=force)
    return y, u


@pytest.mark.parametrize("integral", [False, True])
def test_the_gain_is_that_of_python_control(integral: bool) -> None:
    spec = LqrSpec(lqr_integral=integral)
    design = design_lqr(load_model("raster_bench"), spec)
    stage, n = design.stage, design.stage.b.size
    a, b, q = np.eye(n + 1), np.append(stage.b, 0.0), np.zeros((n + 1, n + 1))
    a[:n, :n], a[n, :n] = stage.a, -stage.sample_period_s * stage.c
    q[:n, :n] = np.outer(stage.c, stage.c) / spec.lqr_error_m**2 + np.outer(
        stage.velocity, stage.velocity) / spec.lqr_velocity_m_s**2
    q[n, n] = spec.lqr_integral_m_s**-2
    used = n + integral
    theirs = control.dlqr(a[:used, :used], b[:used, None], q[:used, :used],
                          [[spec.lqr_effort_v**-2]])[0][0]
    np.testing.assert_allclose(np.append(design.gain, -design.integral_gain)[:used], theirs,
                               rtol=1e-9)


def test_a_design_in_a_running_node_loads_no_plots() -> None:
    """A controller designs when it starts and where an operator sets parameters."""
    code = ("import sys; from dfm_stage.control import design_lqr; "
            "from dfm_stage.model import load_model; design_lqr(load_model('paper_stage')); "
            "print([name for name in ('control', 'matplotlib') if name in sys.modules])")
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                           check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("name", NAMES)
def test_the_fixed_gain_filter_is_filterpys_filter(name: str, spec: LqrSpec) -> None:
    design = design_lqr(load_model(name), spec)
    reference = design.filter.reference_filter()
    rng = np.random.default_rng(3)
    lqg = Lqg(design)
    y = rng.normal(size=300) * 1e-4
    reference.x = (design.start * y[0])[:, None]
    for each in y:
        reference.update(each)
        u = lqg.step(0.0, each)
        reference.predict(u)
        mine = lqg._next + design.filter.B * u
        assert np.allclose(mine, reference.x[:, 0], rtol=1e-8, atol=1e-9 * np.abs(mine).max())
    assert np.allclose(reference.K[:, 0], design.filter.gain, rtol=1e-5, atol=1e-12)


def test_the_gain_is_where_filterpys_covariance_goes() -> None:
    stage = sample_model(load_model("raster_bench"))
    design = kalman(stage, noise_m=5e-8, force_n=0.03, drift_n_per_root_s=1.0)
    found = design.reference_filter()
    found.P = np.zeros_like(design.P)
    for _ in range(15_000):
        found.update(0.0)
        found.predict(0.0)
    found.update(0.0)
    assert np.allclose(found.K[:, 0], design.gain, rtol=1e-4)


def test_the_regulator_is_the_cheapest() -> None:
    model = load_model("raster_bench")
    design = design_lqr(model, VARIANTS["regulator"])
    stage, spec = design.stage, design.spec
    velocity = np.zeros(stage.b.size)
    velocity[[1, 3]] = 0.93, 0.07

    def cost(gain: np.ndarray, start: np.ndarray) -> float:
        x, total = start.copy(), 0.0
        for _ in range(4000):
            u = -float(gain @ x)
            total += ((stage.c @ x / spec.lqr_error_m) ** 2
                      + (velocity @ x / spec.lqr_velocity_m_s) ** 2
                      + (u / spec.lqr_effort_v) ** 2)
            x = stage.a @ x + stage.b * u
        return float(total)

    start = on_reference(stage)[0][:, 0] * 1e-3
    best = cost(design.gain, start)
    for index in range(stage.b.size):
        for factor in (0.97, 1.03):
            other = design.gain.copy()
            other[index] *= factor
            assert cost(other, start) >= best * (1.0 - 1e-9)


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("name", NAMES)
def test_the_loop_is_what_the_analysis_says(name: str, spec: LqrSpec) -> None:
    model = load_model(name).with_parameters({"noise": 0.0, "encoder_resolution": 0.0})
    design = design_lqr(load_model(name), spec)
    lqg, h = Lqg(design, output_limit_v=1e6), 1e-3
    y, u = run(model, lqg, 400, reference=0.0, force=0.3)
    # The same loop as one linear system, driven by the force.
    full = design.closed_loop(design.stage)
    x = np.zeros(len(full))
    for k in range(400):
        assert y[k] == pytest.approx(design.stage.c @ x[:design.stage.b.size], abs=1e-10)
        x = full @ x
        x[:design.stage.b.size] += design.stage.g * 0.3
    a, b, c, d = design.controller()
    loop = -control.ss(a, b[:, None], c[None], d, h) * control.ss(
        design.stage.a, design.stage.b[:, None], design.stage.c[None], 0.0, h)
    w = 2.0 * math.pi * np.geomspace(0.01, 499.0, 4000)
    assert design.margins.modulus == pytest.approx(
        np.min(np.abs(1.0 + loop(np.exp(1j * w * h)))), rel=2e-3)
    assert np.all(np.isfinite(u))


@pytest.mark.parametrize("name", NAMES)
def test_without_integral_action_the_error_has_the_predicted_size(name: str) -> None:
    model = load_model(name)
    stage = sample_model(model)
    for spec in (VARIANTS["regulator"], VARIANTS["model"]):
        design = design_lqr(model, spec)
        predicted = design.steady_error(stage, 1e-3, 0.2)
        assert abs(predicted) > 50e-6
        y, _ = run(model, Lqg(design), 6000, force=0.2)
        assert 1e-3 - np.mean(y[-1000:]) == pytest.approx(predicted, abs=5e-8)
    # A spring k against a gain L on the position: the regulator stops k r / (k + L) short.
    design = design_lqr(model.with_parameters({"delay": 0.0, "amplifier_time_constant": 0.0}
                                              ).without_effect("second_mode"),
                        VARIANTS["regulator"])
    k, force = model.base["stiffness"], model.base["force_constant"]
    assert design.steady_error(design.stage, 1e-3) == pytest.approx(
        1e-3 * k / (k + force * design.gain[0]), rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("variant", ["integral", "disturbance", "both"])
def test_with_it_or_with_the_force_estimated_it_is_gone_to_one_count(name: str,
                                                                     variant: str) -> None:
    model = load_model(name)
    lqg = Lqg(design_lqr(model, VARIANTS[variant]))
    y, _ = run(model, lqg, 6000, force=0.2)
    assert abs(np.mean(y[-1000:]) - 1e-3) < 5e-8
    if variant == "disturbance":
        assert lqg.force_n == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize("wrong", [0.9, 1.1])
def test_a_wrong_model_leaves_the_predicted_error_until_integral_action_removes_it(
        wrong: float) -> None:
    model = load_model("raster_bench")
    real = model.with_parameters({"stiffness": model.base["stiffness"] * wrong})
    design = design_lqr(model, VARIANTS["model"])
    predicted = design.steady_error(sample_model(real), 1e-3)
    assert abs(predicted) > 1e-6
    y, _ = run(real, Lqg(design), 6000)
    assert 1e-3 - np.mean(y[-1000:]) == pytest.approx(predicted, abs=5e-8)
    y, _ = run(real, Lqg(design_lqr(model)), 6000)
    assert abs(np.mean(y[-1000:]) - 1e-3) < 5e-8


def test_on_a_reference_of_constant_acceleration_it_follows_exactly() -> None:
    model = load_model("raster_bench").with_parameters({"noise": 0.0, "encoder_resolution": 0.0})
    design = design_lqr(model, VARIANTS["model"])
    plant, lqg = Plant(model), Lqg(design)
    for k in range(3000):
        t = k * 1e-3
        sample = plant.sample()
        if k > 2500:
            assert sample.position_m == pytest.approx(1e-3 * t * t, abs=1e-9)
        plant.advance(lqg.step(1e-3 * t * t, sample.reading_m, 2e-3 * t, 2e-3))


def test_taking_over_gives_no_bump() -> None:
    model = load_model("paper_stage").with_parameters({"noise": 0.0})
    for name, spec in VARIANTS.items():
        plant, pid, lqg = Plant(model), Pid(PidGains(), 1e-3), Lqg(design_lqr(model, spec))
        outputs = []
        for k in range(3000):
            y = plant.sample().reading_m
            if k < 1500:
                outputs.append(pid.step(1e-3, y))
                lqg.track(outputs[-1], 1e-3, y)
            else:
                outputs.append(lqg.step(1e-3, y))
            plant.advance(outputs[-1])
        change = np.abs(np.diff(outputs))
        assert change[1499] < 2.0 * np.max(change[1400:1499]) + 1e-3, name
        assert np.max(change[1499:1520]) < 0.02, name


def test_what_the_amplifier_gave_is_what_the_filter_believes() -> None:
    model = load_model("paper_stage").with_parameters({"noise": 0.0, "encoder_resolution": 0.0})
    design = design_lqr(model)
    plant, told, untold = Plant(model), Lqg(design), Lqg(design)
    for _ in range(300):
        y = plant.sample().reading_m
        wanted = told.step(1e-3, y)
        untold.step(1e-3, y)
        given = min(wanted, 0.4)
        told.observe(given)
        plant.advance(given)
    y = plant.sample().reading_m
    true = plant.sample().position_m
    estimate = [float(design.filter.c @ (each._next + design.filter.B * each.output_v))
                for each in (told, untold)]
    assert y == pytest.approx(true)
    assert abs(estimate[0] - true) < 1e-9 < abs(estimate[1] - true)


def test_limits_hold_and_do_not_wind_up() -> None:
    model = load_model("paper_stage")
    lqg = Lqg(design_lqr(model), output_limit_v=1.0)
    y, u = run(model, lqg, 6000, reference=1e-3)
    assert np.max(np.abs(u)) <= 1.0
    assert abs(np.mean(y[-500:]) - 1e-3) < 5e-8
    assert np.max(y) < 1.4e-3
    y, _ = run(model, Lqg(design_lqr(model), output_limit_v=1.0), 3000, reference=4e-3)
    held = abs(lqg.integral_v)
    assert held < 2.0


def test_bad_numbers_give_zero_and_a_fault_and_pass() -> None:
    model = load_model("paper_stage")
    lqg, plant = Lqg(design_lqr(model)), Plant(model, seed=1)
    y = np.empty(6000)
    for k in range(y.size):
        y[k] = plant.sample().reading_m
        bad = k in (700, 701)
        u = lqg.step(1e-3, math.nan if bad else float(y[k]))
        assert math.isfinite(u)
        assert bool(lqg.fault) is bad
        assert u == 0.0 or not bad
        plant.advance(u)
    assert abs(np.mean(y[-500:]) - 1e-3) < 5e-8
    assert lqg.step(math.inf, 0.0) == 0.0
    lqg.step(0.0, 0.0, dt_s=math.nan)
    with pytest.raises(ControlError, match="finite"):
        lqg.track(math.nan, 0.0, 0.0)


def test_missed_samples_are_bridged() -> None:
    model = load_model("paper_stage").with_parameters({"noise": 0.0, "encoder_resolution": 0.0})
    design = design_lqr(model)
    plant, lqg, u, k = Plant(model), Lqg(design), 0.0, 0
    for _ in range(400):
        step = 4 if k == 90 else 1
        for _ in range(step):
            plant.advance(u)
        k += step
        y = plant.sample().reading_m
        u = lqg.step(1e-3, y, dt_s=step * 1e-3)
        estimate = float(design.filter.c @ (lqg._next + design.filter.B * u))
        assert estimate == pytest.approx(_ahead(plant, u), abs=2e-7)


def _ahead(plant: Plant, u: float) -> float:
    import copy
    other = Plant(plant.model)
    other._work = copy.deepcopy(plant._work)
    other.advance(u)
    return other.sample().position_m


@pytest.mark.parametrize(("spec", "word"), [
    ({"lqr_error_m": -1.0}, "lqr_error_m"), ({"lqr_effort_v": math.nan}, "lqr_effort_v"),
])
def test_bad_weights_are_named(spec: dict[str, float], word: str) -> None:
    with pytest.raises(ControlError, match=word):
        LqrSpec(**spec)


def test_a_design_for_a_stage_without_force_is_refused() -> None:
    model = load_model("paper_stage").with_parameters({"force_constant": 0.0})
    with pytest.raises(ControlError, match="force_constant"):
        design_lqr(model)
    with pytest.raises(ControlError, match="output_limit_v"):
        Lqg(design_lqr(load_model("paper_stage")), output_limit_v=0.0)
    assert isinstance(design_lqr(load_model("paper_stage")), LqrDesign)


@pytest.mark.parametrize(("first", "second"), [
    ("integral", "both"), ("both", "integral"), ("model", "integral"), ("integral", "model"),
    ("regulator", "disturbance"),
])
def test_a_new_design_gives_no_bump(first: str, second: str) -> None:
    model = load_model("raster_bench").with_parameters({"noise": 0.0})
    plant, lqg = Plant(model), Lqg(design_lqr(model, VARIANTS[first]))
    outputs = []
    for k in range(2600):
        if k == 1500:
            spec = replace(VARIANTS[second], lqr_error_m=2e-4)
            lqg.change(LqrPlan(design_lqr(model, spec), 10.0))
        outputs.append(lqg.step(1e-3, plant.sample().reading_m))
        plant.advance(outputs[-1], external_force_n=0.1)
    change = np.abs(np.diff(outputs))
    assert change[1499] < 1e-3
    assert np.max(change[1499:1600]) < 0.02 + 2.0 * np.max(change[-500:])
    with pytest.raises(ControlError, match="samples every"):
        lqg.change(LqrPlan(design_lqr(model, sample_period_s=2e-3), 10.0))


def test_a_design_with_other_states_starts_its_filter_again() -> None:
    model = load_model("raster_bench")
    plant, lqg = Plant(model, seed=1), Lqg(design_lqr(model))
    for k in range(6000):
        if k == 1500:
            lqg.change(LqrPlan(design_lqr(model.without_effect("second_mode")), 10.0))
        plant.advance(lqg.step(1e-3, plant.sample().reading_m))
    assert abs(plant.sample().position_m - 1e-3) < 2e-7


def test_the_integral_waits_while_the_amplifier_gives_less() -> None:
    law = Lqg(design_lqr(load_model("paper_stage")))
    for _ in range(50):
        law.step(1e-3, 0.0)
        law.applied(0.1)
        law.observe(0.1)
    waited = law.integral_v
    free = Lqg(law.design)
    for _ in range(50):
        free.step(1e-3, 0.0)
        free.observe(0.1)
    assert 0.0 <= waited < 0.1 * free.integral_v


def test_a_model_without_a_word_on_noise_still_gives_a_filter_that_smooths() -> None:
    model = load_model("paper_stage")
    silent = Model("s", model.sample_period, {
        name: value for name, value in model.base.items()
        if name not in ("noise", "encoder_resolution")})
    found = design_lqr(silent, LqrSpec())
    assert found.filter.gain == pytest.approx(design_lqr(model, LqrSpec()).filter.gain, rel=0.1)
