"""A law that no effect of the library has, on records made without the library."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import made_evidence as made
import numpy as np
import pytest
import truth

from dfm_stage.diagnosis import other_law as module
from dfm_stage.diagnosis.evidence import OtherLaw
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.other_law import with_other_law
from dfm_stage.model import EFFECTS

GIVEN = truth.believed().with_parameters({"damping": 4.2, "stiffness": 4100.0})
FEEDS = (truth.multisine(1), truth.multisine(2, 0.5))
SQUARE = "a reading that is curved by the square of the position"
CUBE = "a reading that is curved by the cube of the position"


def told(force=None, reading=lambda x: x, noise=1e-7, known=0.0, zero=0.0, **effects):
    """What other law is told of a stage with a `force` (N) of position and velocity and a
    `reading` (m) of the position, where `effects` were found and one of the library explains the
    share `known`. The reading's `zero` (m) is known as from a fit."""
    draw = np.random.default_rng(0)
    runs = []
    for k, feed in enumerate(FEEDS):
        y = reading(truth.move(feed, force)) + zero
        runs.append(Observation(str(k), feed, y + noise * draw.standard_normal(y.size),
                                truth.PERIOD))
    model = GIVEN
    for name, parameters in effects.items():
        model = model.with_effect(name, parameters)
    fitted = SimpleNamespace(model=model, locals={("offset", 0): zero} if zero else {})
    search = SimpleNamespace(runs=runs[:1], model=GIVEN, step=lambda _: None)
    trial = SimpleNamespace(search=search, held=runs[1:], witness=SimpleNamespace(
        singles=[SimpleNamespace(share=known)]))
    return with_other_law(trial, SimpleNamespace(fit=fitted), made.case()).other_law


def pumping(x, v):
    return -1.5e4 * x * v


def spring(x, v):
    return -4e9 * x**3


FRICTION = {"force": 0.02, "length": 3e-4, "centre": -3e-4}


def test_damping_that_changes_its_sign_with_position_is_no_friction():
    found = told(pumping, position_dependent_friction=FRICTION)
    assert found.words == "a force like x * v"
    assert found.share > 0.98 > 0.5 > found.share_of_effects


@pytest.mark.parametrize(("reading", "words"), [
    (lambda x: x + 200.0 * x**2, SQUARE), (lambda x: x - 6e5 * x**3, CUBE)])
def test_a_curved_reading_is_no_force_of_the_motion(monkeypatch, reading, words):
    monkeypatch.setattr(module, "PARTIAL_SHARE", 0.0)   # at the cube
    found = told(reading=reading, directional_friction={"difference": 0.05},
                 cubic_stiffness={"k3": 1e8})
    assert found.words == words
    assert found.share > 0.8 > 0.7 > found.share_of_effects


def test_a_law_says_nothing_of_effects_that_the_force_domain_does_not_see():
    assert told(reading=lambda x: x - 6e5 * x**3, directional_friction={"difference": 0.05},
                cubic_stiffness={"k3": 1e8}) is None


def test_a_law_that_an_effect_of_the_library_has_is_no_other_law():
    assert told(pumping, known=0.998, position_dependent_friction=FRICTION) is None


def test_effects_are_compared_where_the_fit_has_the_zero_of_the_reading(monkeypatch):
    """Also in held-out records, of which the fit knows none."""
    zeros = []
    monkeypatch.setattr(module, "other_law", lambda runs, *_: zeros.extend(
        float(np.mean(run.output)) for run in runs))
    told(spring, zero=1e-3, cubic_stiffness={"k3": 4e9})
    assert np.all(np.abs(zeros) < 1e-5)


def test_an_effect_beside_a_larger_force_stays():
    """A cubic spring beside a larger one of the fifth power: neither does without the other."""
    assert told(lambda x, v: spring(x, v) - 6e16 * x**5, noise=1e-8,
                cubic_stiffness={"k3": 4e9}) is None


@pytest.mark.parametrize("beside", [
    lambda x, v: 0.0, lambda x, v: 0.4 * pumping(x, v), lambda x, v: -2e2 * max(x - 1e-4, 0.0)])
def test_an_effect_with_the_form_of_the_force_is_its_law(beside):
    """With a remainder beside it, too."""
    assert told(lambda x, v: spring(x, v) + beside(x, v), cubic_stiffness={"k3": 4e9}) is None


@pytest.mark.parametrize(("power", "better"), [(2.55, False), (2.9, True)])
def test_a_law_is_another_one_where_it_takes_most_of_what_the_effects_leave(power, better):
    """A drag between the square and the cube of the speed."""
    found = told(lambda x, v: -40.0 * np.sign(v) * abs(v / 0.1)**power,
                 quadratic_damping={"coefficient": 10.0})
    assert (found is not None) is better


def test_a_law_must_lead_clearly_on_held_out_blocks(monkeypatch):
    monkeypatch.setattr(module, "log_ratio", lambda _law, _effects: (2.9, 1.0))
    assert told(pumping, position_dependent_friction=FRICTION) is None


def test_a_law_with_more_parameters_than_the_effects_says_nothing():
    """tanh(v / s) has two, Coulomb friction has one."""
    def force(x, v):
        return -0.1 * np.tanh(v / 0.003)

    assert told(force, coulomb_friction={"force": 0.1}) is None
    brake = told(force, eddy_current_damping={"damping": 8.0, "critical_velocity": 0.01})
    assert brake.words == "a force like tanh(v / s)"


def test_noise_that_swamps_the_force_tells_no_law():
    assert told(pumping, noise=3e-5,
                position_dependent_friction=FRICTION) is None


@pytest.mark.parametrize(("names", "asked"), [
    (("directional_friction",), True), (("directional_friction", "cubic_stiffness"), True),
    (("directional_friction", "transport_delay"), False), (("second_mode",), False), ((), False)])
def test_other_laws_are_tried_in_the_place_of_forces_along_the_motion(monkeypatch, names, asked):
    """A lag has no force there that could be compared."""
    law = OtherLaw("a force like x * v", 0.9, 0.5)
    monkeypatch.setattr(module, "other_law", lambda *_: law)
    found = told(**{name: EFFECTS[name].defaults for name in names})
    assert found == (law if asked else None)


def test_brakes_that_the_energy_of_swings_bears_out_are_not_compared(monkeypatch):
    monkeypatch.setattr(module, "other_law", lambda *_: OtherLaw("a force like x**3", 0.9, 0.5))
    model = GIVEN.with_effect("coulomb_friction", {"force": 0.05})
    search = SimpleNamespace(runs=(), model=GIVEN, step=lambda _: None)
    trial = SimpleNamespace(search=search, held=(), witness=None)
    h = SimpleNamespace(fit=SimpleNamespace(model=model, locals={}))
    for braking, asked in ((None, True), (object(), False)):
        e = replace(made.case(), braking=braking)
        assert (with_other_law(trial, h, e).other_law is not None) is asked
