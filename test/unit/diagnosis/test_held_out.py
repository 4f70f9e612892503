"""Predictions of records that were not fitted, and the experiment to do next."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import truth

from dfm_stage.diagnosis import verification
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.next_experiment import experiments, propose
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.verification import (
    SurrogateTest,
    joint,
    predict,
    surrogate_test,
    weights_like,
)
from dfm_stage.identification.weights import Weight, weights_of
from dfm_stage.model import Model
from dfm_stage.trajectory import load_experiment

K3 = 4e6
WEIGHT = Weight(np.ones(1), truth.NOISE, "given")
MODEL = truth.believed()
SPRING = MODEL.with_effect("cubic_stiffness", {"k3": K3})


@pytest.fixture(scope="module")
def runs():
    return [observe(truth.record(u, truth.move(u, lambda x, v: -K3 * x**3), seed), MODEL)
            for u, seed in ((truth.multisine(1), 1), (truth.scan(), 2))]


def test_a_true_model_predicts_to_the_noise_and_a_poor_one_does_not(runs):
    good, poor = (predict(m, runs, ((WEIGHT,),) * 2) for m in (SPRING, MODEL))
    assert good.rms == pytest.approx(truth.NOISE, rel=0.03)
    assert good.chi2 == pytest.approx(good.count, rel=0.05)
    assert poor.rms > 3.0 * good.rms


@pytest.mark.parametrize(("again", "expected"), [(30.0, 30.0), (900.0, 600.0)])
def test_what_is_left_is_looked_for_where_a_weighted_fit_leaves_less(monkeypatch, again, expected):
    """By states from nothing a search ends at 600; by those of the weighted fit, which leaves 20,
    it need not."""
    begun = []

    def found(*_, earlier=None, **__):
        begun.append(earlier)
        rms = 600.0 if earlier is None else again
        return SimpleNamespace(ok=True, rms=rms, chi2=rms**2)

    monkeypatch.setattr(verification, "fit", found)
    coloured = Weight(np.array([1.0, -0.9]), 1.0, "residuals")
    weighted = SimpleNamespace(ok=True, rms=20.0, locals={("initial.velocity", 0): 3.0})
    run = observe(truth.record(truth.scan(), truth.move(truth.scan()), 0), MODEL)
    nearest = verification.nearest_to(MODEL, [run], ((coloured,),), 0.0, weighted)
    assert begun == [None, weighted.locals]
    assert nearest.rms == expected


def test_a_model_that_cannot_be_simulated_predicts_nothing(runs):
    gone = predict(MODEL.with_effect("cubic_stiffness", {"k3": -1e12}), runs, ((WEIGHT,),) * 2)
    assert math.isinf(gone.rms)
    assert gone.residuals == []


def test_an_effect_that_is_there_passes_its_surrogates_and_one_that_is_not_does_not(runs):
    there = surrogate_test(SPRING, "cubic_stiffness", runs[1:], ((WEIGHT,),), 0.0, 0)
    assert there.passed(per_run=False)
    assert there.original < there.without < there.best
    wrong = MODEL.with_effect("quadratic_damping", {"coefficient": 5.0})
    assert not surrogate_test(wrong, "quadratic_damping", runs[1:], ((WEIGHT,),), 0.0,
                              0).passed(per_run=False)


@pytest.mark.parametrize(("contribution", "original", "passed"), [
    (19.0, 50.0, None), (21.0, 50.0, True), (21.0, 101.0, False)])
def test_an_effect_below_the_limit_is_not_exercised(contribution, original, passed):
    test = SurrogateTest(contribution, original, 100.0, 120.0)
    assert test.passed(per_run=False) is passed


@pytest.mark.parametrize(("fall", "passed"), [(31e3, None), (30e3, False)])
def test_an_effect_next_to_nothing_beside_the_fitted_records_is_not_exercised(fall, passed):
    """A mount at 435 Hz moved a slow scan by 30; of fast records it explained five million."""
    assert SurrogateTest(30.5, 102.0, 100.0, 96.0).passed(per_run=False, fall=fall) is passed
    assert SurrogateTest(30.5, 80.0, 100.0, 96.0).passed(per_run=False, fall=fall) is True
    assert SurrogateTest(30.5, 121.0, 100.0, 96.0).passed(per_run=False, fall=fall) is False


@pytest.mark.parametrize(("original", "passed"), [(84.0, True), (86.0, False)])
def test_an_effect_free_in_each_run_must_bring_fifteen(original, passed):
    assert SurrogateTest(0.0, original, 100.0, math.inf).passed(per_run=True) is passed


def test_one_set_of_values_for_all_records(runs):
    names = ("stiffness", "cubic_stiffness.k3")
    off = SPRING.with_parameters({"cubic_stiffness.k3": 0.8 * K3})
    weights = ((WEIGHT,),)
    start = fit(off, runs[:1], names, weights)
    fitted, held = joint(off, names, runs[:1], runs[1:], weights, weights, start, 0.0)
    assert fitted == pytest.approx(truth.NOISE, rel=0.05)
    assert held == pytest.approx(truth.NOISE, rel=0.05)


def test_held_out_weights_are_those_of_the_same_sensors(runs):
    current = replace(runs[1], current=np.linspace(0.0, 1.0, runs[1].input.size))
    other = Weight(np.ones(1), 3.0, "given")
    assert weights_like([runs[1], current], ((WEIGHT, other),)) == ((WEIGHT,), (WEIGHT, other))
    (_, spread), = weights_like([current], ((WEIGHT,),))
    assert spread.sigma == pytest.approx(np.std(current.current))


def test_without_rivals_the_liveliest_experiment_is_proposed(runs):
    found = propose((), MODEL, [], runs[:1], WEIGHT, [])
    assert found.expected is None
    voltage = load_experiment(dict(found.experiment)).excitation("x", truth.PERIOD).voltage
    largest = np.max(np.abs(runs[0].input - runs[0].input.mean()))
    assert 0.9 * largest < np.max(np.abs(voltage)) < 1.01 * largest


@pytest.mark.parametrize("period", [0.0016384, 1.0 / 610.35, 0.003])
def test_an_experiment_lasts_whole_samples_of_any_machine(runs, period):
    slow = [replace(runs[0], sample_period=period)]
    model = replace(MODEL, sample_period=period)
    found = propose((), model, [], slow, WEIGHT, [])
    for spec in (found.experiment, *experiments(model, 1.0)):
        for duration in (spec["duration_s"], 80.0):
            asked = load_experiment({**spec, "duration_s": duration})
            assert np.any(asked.excitation("x", period).voltage)


def test_nothing_is_proposed_for_a_current_drive(runs):
    assert propose((), replace(MODEL, drive="current"), [], runs[:1], WEIGHT, []) is None


def test_an_experiment_that_parts_two_models_is_as_long_as_it_must_be(runs):
    rival = fit(MODEL, runs[:1], ("stiffness", "damping"), ((WEIGHT,),))
    found = propose(("cubic_stiffness", "none"), SPRING, [rival], runs[:1], WEIGHT,
                    [("stiffness", "damping")])
    assert found.parts == ("cubic_stiffness", "none")
    assert found.expected > 4.0 * 16.0
    assert found.experiment["duration_s"] == 24.0  # clear within the shortest


def test_states_are_found_by_what_is_left_and_not_by_the_colour_of_a_gap():
    # a free body with friction that its model lacks: an autoregression of the gap hardly sees
    # slow motion, and let the body drift away by several times its motion
    feed = truth.scan()
    x = truth.move(feed, lambda _, v: -0.3 * math.tanh(v / 1e-3), stiffness=0.0)
    model = Model("free", truth.PERIOD, {"mass": truth.MASS, "damping": truth.DAMPING,
                                         "force_constant": truth.GAIN})
    observed = observe(truth.record(feed, x, 3), model)
    white = ((Weight(np.ones(1), truth.NOISE, ""),),)
    gap = weights_of(predict(model, [observed], white).residuals)
    assert gap[0][0].order > 1
    assert predict(model, [observed], gap).rms < 1.05 * predict(model, [observed], white).rms
