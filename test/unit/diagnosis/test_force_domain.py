"""Signals and terms of the force domain against closed forms and the effects' own hooks."""

from __future__ import annotations

import math

import numpy as np
import pytest
import truth

from dfm_stage.diagnosis.force_domain import (
    Linear,
    RunForces,
    Terms,
    Timing,
    noise_density,
    not_judged,
)
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.model import EFFECTS
from dfm_stage.model.registry import ALL, library_of

PERIOD, believed = truth.PERIOD, truth.believed
TIME = PERIOD * np.arange(4000)
SINE = Observation("sine", np.cos(40.0 * TIME), 1e-4 * np.sin(40.0 * TIME + 0.3), PERIOD)
HELD = Timing(0.0, 0.0, False)


def damped(width: float, omega: float = 40.0) -> float:
    """What a Gaussian filter leaves of a sine."""
    return math.exp(-0.5 * (omega * width * PERIOD) ** 2)


@pytest.mark.parametrize(("order", "shape"), [
    (0, np.sin), (1, np.cos), (2, lambda phase: -np.sin(phase))])
def test_derivatives_are_those_of_the_motion_behind_the_filter(order, shape):
    run = RunForces(SINE, 4.0)
    expected = damped(4.0) * 40.0**order * 1e-4 * shape(40.0 * TIME + 0.3)
    inner = slice(50, -50)
    np.testing.assert_allclose(run.derivative(order)[inner], expected[inner],
                               atol=1e-3 * np.max(np.abs(expected)))


def test_the_input_acts_late_through_hold_delay_and_lag():
    run = RunForces(SINE, 1.0)
    found = run.drive(Timing(0.5 * PERIOD, 0.01, True))
    gain = np.sinc(40.0 * PERIOD / (2.0 * math.pi)) / (1.0 + 0.4j)
    expected = damped(1.0) * np.real(gain * np.exp(1j * 40.0 * (TIME - 0.5 * PERIOD)))
    np.testing.assert_allclose(found[50:-50], expected[50:-50], atol=2e-3)


def test_white_noise_is_measured_beside_a_motion_and_a_drift():
    noise = 1e-7 * np.random.default_rng(4).standard_normal(TIME.size)
    found = noise_density(SINE.output + 0.1 * TIME + noise)
    assert math.sqrt(found) == pytest.approx(1e-7, rel=0.1)


@pytest.mark.parametrize("mass", [1e-20, 0.0, -1.0, 1e20])
def test_what_is_fitted_in_the_force_domain_may_be_no_stage(mass):
    """A column that was late by a sample left an inertia of 4e-6 of the true one, below what a
    model may have, and the diagnosis ended in an error."""
    run, linear = RunForces(SINE, 1.0), Linear(mass, 1e20, -1.0)
    assert Terms([run], believed(), linear, HELD).bare.base["mass"] > 0.0


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if e.force is not None])
def test_a_smooth_force_is_the_hook_along_the_motion(name):
    effect = EFFECTS[name]
    values = {n: v or 1.0 for n, v in effect.defaults.items()}
    run, linear = RunForces(SINE, 1.0), Linear(1.0, 4.0, 4000.0)
    given = Terms([run], believed(), linear, HELD).parts(name, values)
    motion = run.trajectory
    own = tuple(values.values())
    plain = [effect.force(x, v, d, own) for x, v, d in zip(
        motion.x, motion.v, linear.force(motion), strict=True)]
    np.testing.assert_allclose(given(run), run.filtered(np.array(plain)), rtol=1e-9,
                               atol=1e-12 * np.max(np.abs(plain)))


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if e.advance is not None])
def test_a_force_with_memory_is_its_state_along_the_path(name):
    effect = EFFECTS[name]
    run = RunForces(SINE, 1.0)
    given = Terms([run], believed(), Linear(1.0, 4.0, 4000.0), HELD).parts(name, effect.defaults)
    own, z, plain = tuple(effect.defaults.values()), 0.0, []
    x, v = run.trajectory.x, run.trajectory.v
    for k in range(x.size):
        if k:
            z = effect.advance(z, x[k] - x[k - 1], v[k - 1], v[k], own)
        plain.append(effect.bristle_force(z, v[k], own))
    np.testing.assert_allclose(given(run), run.filtered(np.array(plain)), rtol=1e-9,
                               atol=1e-12 * np.max(np.abs(plain)))


def test_creep_is_the_force_of_a_relaxing_spring():
    run = RunForces(SINE, 1.0)
    given = Terms([run], believed(), Linear(1.0, 4.0, 4000.0), HELD).parts(
        "creep", {"stiffness": 50.0, "time_constant": 0.1})
    slow = 4.0j / (1.0 + 4.0j)              # x - z of time_constant z' = x - z
    expected = np.imag(-50.0 * slow * damped(1.0) * 1e-4 * np.exp(1j * (40.0 * TIME + 0.3)))
    inner = slice(500, -500)
    np.testing.assert_allclose(given(run)[inner], expected[inner], atol=2e-5)


def test_friction_has_no_sign_where_the_stage_rests():
    feed = np.concatenate((truth.multisine(1)[:3000], np.zeros(7000)))
    position = truth.move(feed)
    position += truth.NOISE * np.random.default_rng(1).standard_normal(feed.size)
    kept = RunForces(Observation("rests", feed, position, PERIOD), 4.0).kept
    assert np.mean(kept < 3000) > 0.3
    assert not np.any(kept > 9000)          # it has died out after twelve time constants


@pytest.mark.parametrize("name", [n for n in library_of([ALL]) if EFFECTS[n].friction])
def test_friction_that_varies_acts_against_the_motion(name):
    effect, run, linear = EFFECTS[name], RunForces(SINE, 1.0), Linear(1.0, 4.0, 4000.0)
    values = {p.name: p.default or 1.0 for p in effect.parameters}
    motion = run.trajectory
    size = [effect.friction(x, v, d, tuple(values.values())) for x, v, d in zip(
        motion.x, motion.v, linear.force(motion), strict=True)]
    given = Terms([run], believed(), linear, HELD).parts(name, values)
    np.testing.assert_allclose(given(run), run.filtered(-np.array(size) * np.sign(motion.v)),
                               atol=1e-3 * np.max(size))


def test_what_has_no_force_says_why():
    assert "timing" in not_judged(EFFECTS["transport_delay"])
    assert "rounded" in not_judged(EFFECTS["encoder_quantization"])
    assert not_judged(EFFECTS["cubic_stiffness"]) is None
    assert not_judged(EFFECTS["thermal_drift"]) is None
    assert "spring" in not_judged(EFFECTS["thermal_drift"], spring=False)
