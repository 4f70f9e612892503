"""Effects that a search may miss: large, sharp, constant or coarse; answers from closed forms."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import chirp, cont2discrete, dlsim

from dfm_stage.diagnosis import diagnose
from dfm_stage.diagnosis.candidates import late_splits
from dfm_stage.diagnosis.experiment import experiment
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.screen import Screen
from dfm_stage.diagnosis.spectra import lattice
from dfm_stage.diagnosis.verification import KnockOff
from dfm_stage.diagnosis.weighting import white_weights
from dfm_stage.model import EFFECTS

_spec = importlib.util.spec_from_file_location("diagnosis_truth",
                                               Path(__file__).with_name("truth.py"))
assert _spec is not None
assert _spec.loader is not None
truth = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(truth)

QUICK = [n for n in EFFECTS if n not in ("hysteresis", "presliding_friction")]


def linear(feed: np.ndarray, a: list[list[float]], b: list[float], c: list[float]) -> np.ndarray:
    """Position (N,) of a linear system from rest, the input held over each sample (scipy)."""
    system = cont2discrete((np.array(a), np.array(b)[:, None], np.array([c]), np.zeros((1, 1))),
                           truth.PERIOD)
    return dlsim(system, feed)[1][:, 0]


def creeping(feed: np.ndarray, stiffness: float, time_constant: float) -> np.ndarray:
    m, rate = truth.MASS, 1.0 / time_constant
    return linear(feed, [[0.0, 1.0, 0.0],
                         [-(truth.STIFFNESS + stiffness) / m, -truth.DAMPING / m, stiffness / m],
                         [rate, 0.0, -rate]], [0.0, truth.GAIN / m, 0.0], [1.0, 0.0, 0.0])


def two_modes(feed: np.ndarray, share: float, hertz: float, zeta: float) -> np.ndarray:
    m, w = truth.MASS, 2.0 * np.pi * hertz
    return linear(feed, [[0.0, 1.0, 0.0, 0.0],
                         [-truth.STIFFNESS / m, -truth.DAMPING / m, 0.0, 0.0],
                         [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -w * w, -2.0 * zeta * w]],
                  [0.0, truth.GAIN / m, 0.0, truth.GAIN / m], [1.0 - share, 0.0, share, 0.0])


def told(effect: object, name: str) -> tuple[float, float]:
    quantity = effect.parameters[name]  # type: ignore[attr-defined]
    return quantity.value, quantity.ci95[1] - quantity.value


def test_a_creep_of_a_sixth_of_the_spring_is_not_traded_for_it():
    train, held = truth.multisine(1), truth.scan()
    found = diagnose([truth.record(train, creeping(train, 600.0, 1.66), 21)],
                     truth.believed(), library=QUICK,
                     holdout=[truth.record(held, creeping(held, 600.0, 1.66), 22)])
    assert found.names == ("creep",)
    for name, true in (("stiffness", 600.0), ("time_constant", 1.66)):
        value, half = told(found.effects[0], name)
        assert abs(value - true) < 2.0 * half


def test_a_mode_sharper_than_any_grid_is_found_at_its_own_frequency():
    feed = chirp(truth.PERIOD * np.arange(truth.SAMPLES), 1.0, 9.0, 120.0)
    held, mode = 0.5 * feed, (0.5, 45.2, 0.002)
    found = diagnose([truth.record(feed, two_modes(feed, *mode), 23)], truth.believed(),
                     library=QUICK, holdout=[truth.record(held, two_modes(held, *mode), 24)])
    assert found.names == ("second_mode",)
    value, half = told(found.effects[0], "frequency")
    assert abs(value - 45.2) < 2.0 * half < 0.05


def test_a_constant_force_is_named_where_the_zero_is_trusted():
    train, held = truth.multisine(3), truth.multisine(4)

    def push(x: float, v: float) -> float:
        return 2e-3

    found = diagnose([truth.record(train, truth.move(train, push), 25)],
                     truth.believed(encoder_zero=0.0), library=QUICK,
                     holdout=[truth.record(held, truth.move(held, push), 26)])
    assert found.names == ("force_offset",)
    assert told(found.effects[0], "force")[0] == pytest.approx(2e-3, rel=0.01)


def test_a_constant_is_judged_by_what_it_lowers():
    assert KnockOff(1e4, 100.0, 1e4, np.inf).passed(per_run=False)
    assert not KnockOff(1e4, 100.0, 110.0, np.inf).passed(per_run=False)
    assert KnockOff(0.0, 100.0, 100.0, np.inf).passed(per_run=False) is None  # not exercised


def test_an_effect_that_raises_the_held_out_gap_does_not_pass():
    """Though its shifted selves do still worse."""
    assert not KnockOff(1.4e4, 3.1e4, 2.3e4, 3.6e4).passed(per_run=False)
    assert KnockOff(1.4e4, 2.1e4, 2.3e4, 3.6e4).passed(per_run=False)


def test_the_step_of_a_reading_that_is_rounded_once_more():
    step, rng = 7.396876e-7, np.random.default_rng(5)
    counts = np.unique(np.rint(np.cumsum(rng.exponential(20.0, 400))))
    seen = lattice(np.repeat(np.rint(counts * step / 5e-9) * 5e-9, 3))
    assert seen == pytest.approx(step, rel=2e-6)  # a hundredth of a step over 4900


def test_the_screen_starts_from_the_fitted_motion():
    feed = truth.multisine(6)
    run = experiment(truth.record(feed, truth.move(feed), 27), truth.believed(), "x", "run")
    rough = white_weights([[run.output[run.skip:]]])
    found = fit(truth.believed(stiffness=4600.0, damping=2.0), [run],
                ("stiffness", "damping", "force_constant"), rough)
    screen = Screen(found, [run], rough, 0.0)
    assert screen.plain is not None
    moved = run.output[run.skip:] - found.residuals[0][0]
    np.testing.assert_allclose(screen.plain, rough[0][0].apply(moved), rtol=1e-6, atol=1e-9)


def test_lateness_of_next_to_nothing_is_shared_out_within_limits():
    model = truth.believed(delay=1e-10).with_effect("amplifier_bandwidth",
                                                    {"time_constant": 1e-9})
    names = ("delay", "amplifier_bandwidth.time_constant")
    splits = late_splits(model, names)
    assert len(splits) == 2
    for values in splits:
        assert model.with_parameters(values).parameters().items() >= values.items()
