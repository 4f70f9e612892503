"""Inversion, shaping and learning against the simulator and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.signal

from dfm_stage.control import (
    ControlError,
    Learner,
    LearningDesign,
    Notch,
    Pid,
    PidGains,
    Sampled,
    design_learning,
    inverse_input,
    periodic_input,
    pid_with_margin,
    sample_model,
    sample_stage,
    shape,
    shaper,
)
from dfm_stage.control.stage import controller_response
from dfm_stage.model import Model, Plant, Simulator, load_model

H = 1e-3


def quiet(name: str) -> Model:
    return load_model(name).with_parameters({"noise": 0.0, "encoder_resolution": 0.0})


def smooth(samples: int) -> np.ndarray:
    """A movement out and back, at rest at both ends."""
    t = np.linspace(0.0, 1.0, samples)
    return 2e-3 * np.sin(math.pi * t) ** 6


@pytest.mark.parametrize("name", ["paper_stage", "raster_bench", "paper_two_mode"])
def test_the_inverse_moves_the_simulator_along_the_reference(name: str) -> None:
    model = quiet(name)
    if name == "paper_two_mode":
        model = model.with_parameters({"damping": 0.5, "second_mode.damping_ratio": 0.01})
    r = smooth(900)
    u = inverse_input(sample_model(model), r)
    y = Simulator(model).run(u).position
    assert np.max(np.abs(y - r)) < 1e-9


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 3.7e-3])
def test_zeros_outside_the_circle_and_delay_do_not_matter(delay: float) -> None:
    model = Model("m", H, {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "force_constant": 1.0,
                           "amplifier_time_constant": 2e-3, "delay": delay})
    r = np.concatenate((np.zeros(20), smooth(700)))
    y = Simulator(model).run(inverse_input(sample_model(model), r)).position
    assert np.max(np.abs(y - r)) < 1e-9


def test_a_movement_that_does_not_end_at_rest_is_followed_to_its_end() -> None:
    model = quiet("raster_bench")
    r = smooth(900)[:430]
    y = Simulator(model).run(inverse_input(sample_model(model), r)).position
    assert np.max(np.abs(y - r)) < 1e-9


def test_a_periodic_movement_is_followed_exactly() -> None:
    model = quiet("raster_bench")
    t = np.arange(1000) / 1000
    r = 1e-3 * np.cos(2 * np.pi * t) + 2e-4 * np.sin(6 * np.pi * t)
    u = periodic_input(sample_model(model), r)
    y = Simulator(model).run(u, steady_state=True).position
    assert np.max(np.abs(y - r)) < 1e-12


def test_what_cannot_be_inverted_is_refused() -> None:
    stage = sample_stage({"mass": 1.0, "stiffness": 100.0, "force_constant": 1.0}, H)
    undamped = Sampled(stage.a, stage.b, np.array([1.0, 0.0]), H)
    with pytest.raises(ControlError, match="four finite"):
        inverse_input(undamped, [0.0, math.nan])
    zero = Sampled(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([0.0, 1.0]),
                   np.array([-1.0, 1.0]), H)
    with pytest.raises(ControlError, match=r"cannot follow|never dies out"):
        inverse_input(zero, np.linspace(0.0, 1.0, 50))


@pytest.mark.parametrize("impulses", [2, 3])
def test_a_shaped_step_leaves_no_vibration(impulses: int) -> None:
    f, zeta = 3.81, 0.035
    w = 2.0 * math.pi * f
    weights = shaper(f, zeta, 1e-4, impulses)
    assert np.sum(weights) == pytest.approx(1.0)
    step = np.ones(40_000)
    step[:10] = 0.0
    t = np.arange(step.size) * 1e-4
    system = scipy.signal.TransferFunction([w * w], [1.0, 2 * zeta * w, w * w])

    def left(reference: np.ndarray, scale: float = 1.0) -> float:
        other = scipy.signal.TransferFunction([scale**2 * w * w],
                                              [1.0, 2 * zeta * scale * w, scale**2 * w * w])
        y = scipy.signal.lsim(other if scale != 1.0 else system, reference, t)[1]
        after = y[10 + weights.size + 50:10 + weights.size + 5000]
        return float(np.max(np.abs(after - 1.0)))

    shaped = shape(step, weights)
    assert left(shaped) < 2e-4 < 0.5 < left(step)
    if impulses == 3:
        assert left(shaped, 1.05) < 0.5 * left(shape(step, shaper(f, zeta, 1e-4, 2)), 1.05)


def test_the_notch_is_the_filter_it_says() -> None:
    notch, f = Notch(16.02, H, 0.01, 0.2), 16.02
    t = np.arange(20_000) * H
    for frequency, expected in ((f, 0.05), (0.1, 1.0), (300.0, 1.0)):
        notch.reset()
        out = np.array([notch.step(float(v)) for v in np.sin(2 * np.pi * frequency * t)])
        assert math.sqrt(2.0 * np.mean(out[-5000:]**2)) == pytest.approx(expected, rel=0.01)
    notch.reset(3.0)
    assert [notch.step(3.0) for _ in range(5)] == pytest.approx([3.0] * 5)
    with pytest.raises(ControlError, match="between 0 and 500"):
        Notch(500.0, H)


# Learning

PERIOD = 500


def gains_for(model: Model) -> PidGains:
    return pid_with_margin(model.base, 0.55, feedforward=False).gains.changed(
        {"setpoint_weight": 1.0, "derivative_weight": 1.0})


def passes(real: Model, gains: PidGains, learner: Learner, count: int) -> list[float]:
    """Return the RMS error from the truth of each pass, m."""
    r = 1e-3 * np.cos(2 * np.pi * np.arange(PERIOD) / PERIOD)
    plant, pid = Plant(real, seed=1), Pid(gains, H)
    plant.reset(position=1e-3)
    found = []
    for _ in range(count):
        error, true = np.empty(PERIOD), np.empty(PERIOD)
        for k in range(PERIOD):
            sample = plant.sample()
            error[k], true[k] = r[k] - sample.reading_m, r[k] - sample.position_m
            plant.advance(pid.step(r[k], sample.reading_m) + learner.signal[k])
        learner.update(error)
        found.append(float(np.sqrt(np.mean(true**2))))
    return found


def test_learning_takes_the_error_down_to_the_noise() -> None:
    model = load_model("raster_bench")
    gains = gains_for(model)
    design = design_learning(sample_model(model), lambda f: controller_response(gains, f, H),
                             PERIOD)
    assert design.contraction == pytest.approx(0.5)
    found = passes(model, gains, Learner(design), 25)
    assert found[0] > 1e-5
    assert found[-1] < 6e-8


def test_with_a_wrong_model_it_converges_if_the_wrong_is_allowed_for() -> None:
    model = load_model("raster_bench")
    wrong = model.with_parameters({"mass": 1.1, "stiffness": 0.9 * model.base["stiffness"],
                                   "second_mode.frequency": 16.8})
    gains = gains_for(wrong)
    design = design_learning(sample_model(wrong), lambda f: controller_response(gains, f, H),
                             PERIOD, candidates=[sample_model(model)])
    assert design.contraction <= 0.9
    found = passes(model, gains, Learner(design), 25)
    assert found[-1] < 6e-8
    assert found[-1] < 1.2 * found[-8]


def test_the_filter_is_the_one_the_worst_candidate_converges_fastest_with() -> None:
    """Two stages a quarter turn apart: L between them, |1 - L T| = |1 - gain e^(+-j 45 deg)|."""
    class Plain(Sampled):
        answer = 1.0 + 0.0j

        def response(self, frequency_hz: np.ndarray) -> np.ndarray:
            return np.full(len(frequency_hz), self.answer)

    class Turned(Plain):
        answer = 1.0j

    one, two = (kind(np.zeros((1, 1)), np.ones(1), np.ones(1), H) for kind in (Plain, Turned))
    design = design_learning(one, np.zeros_like, PERIOD, candidates=[two], gain=1.0)
    assert np.angle(design.learning[5]) == pytest.approx(-np.pi / 4, abs=0.06)
    # the best size along that direction is cos 45 deg, and what is left then sin 45 deg
    assert design.contraction == pytest.approx(np.sin(np.pi / 4), abs=0.02)


def test_learning_that_would_diverge_is_refused_and_would() -> None:
    model = load_model("raster_bench")
    gains = gains_for(model)
    stage = sample_model(model)
    reversed_stage = Sampled(stage.a, -stage.b, stage.c, H, stage.g)
    with pytest.raises(ControlError, match=r"at 2 Hz the error would change by 1\.0"):
        design_learning(stage, np.zeros_like, PERIOD, candidates=[reversed_stage])
    design = design_learning(stage, lambda f: controller_response(gains, f, H), PERIOD)
    negated = LearningDesign(design.samples, -design.learning, design.robustness, 1.5, 125.0)
    learner = Learner(negated)
    found = passes(model, gains, learner, 8)
    assert max(found) > 2.0 * found[0]
    assert "times the error" in learner.stopped


def test_learning_that_gets_worse_is_stopped_and_goes_back() -> None:
    model = load_model("raster_bench")
    gains = gains_for(model)
    learner = Learner(design_learning(sample_model(model),
                                      lambda f: controller_response(gains, f, H), PERIOD))
    first = learner.signal
    second = learner.update(1e-6 * np.sin(2 * np.pi * np.arange(PERIOD) / 50))
    assert not learner.stopped
    back = learner.update(1e-5 * np.sin(2 * np.pi * np.arange(PERIOD) / 50))
    assert "10.0 times" in learner.stopped
    assert np.array_equal(back, first)
    assert not np.array_equal(second, first)
    with pytest.raises(ControlError, match="finite"):
        learner.update(np.full(PERIOD, math.nan))
