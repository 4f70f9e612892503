"""Which effects the data can show at all."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.diagnosis.alike import at_upper_end
from dfm_stage.diagnosis.candidates import cycles
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.model import EFFECTS, Model

STAGE = Model("stage", 1e-3, {"mass": 1.0, "stiffness": (2.0 * math.pi * 10.0) ** 2})


@pytest.mark.parametrize(("driven", "frequency", "expected"), [
    (True, 10.2, 20.4), (False, 10.2, 0.4), (False, 8.0, 4.0), (False, 14.0, 8.0)])
def test_a_vibration_is_told_from_free_motion_by_their_beats(driven, frequency, expected):
    """Two seconds of a stage that swings at 10 Hz."""
    feed = np.sin(np.arange(2000.0)) if driven else np.zeros(2000)
    run = Observation("run", feed, np.zeros(2000), 1e-3)
    shaken = STAGE.with_effect("periodic_disturbance", {"frequency": frequency, "amplitude": 1.0})
    assert cycles("periodic_disturbance", shaken, [run]) == pytest.approx(expected)
    coupled = STAGE.with_effect("second_mode", {"share": 0.05, "frequency": frequency,
                                                   "damping_ratio": 0.01})
    assert cycles("second_mode", coupled, [run]) == pytest.approx(
        math.inf if driven else expected)


@pytest.mark.parametrize(("on", "expected"), [(200, 0.4), (980, 0.4), (1020, 20.4)])
def test_after_a_pulse_a_vibration_is_told_from_the_motion_that_rings_on(on, expected):
    """The input is on for so many of 2000 samples."""
    feed = np.where(np.arange(2000) < on, np.sin(np.arange(2000.0)), 0.0)
    run = Observation("run", feed, np.zeros(2000), 1e-3)
    shaken = STAGE.with_effect("periodic_disturbance", {"frequency": 10.2, "amplitude": 1.0})
    assert cycles("periodic_disturbance", shaken, [run]) == pytest.approx(expected)
    coupled = STAGE.with_effect("second_mode", {"share": 0.05, "frequency": 10.2,
                                                   "damping_ratio": 0.01})
    assert cycles("second_mode", coupled, [run]) == math.inf


@pytest.mark.parametrize(("frequency", "vibration", "mode"), [
    (27.2, 0.4, 34.4), (18.5, 1.0, 17.0), (36.1, 18.2, 52.2), (10.9, 1.8, 1.8)])
def test_a_vibration_is_told_from_the_harmonics_of_a_free_motion(frequency, vibration, mode):
    """A softening spring swings at 9 Hz where its small swings have 10; a second mode at twice
    that is no error of the form."""
    swing = 3.0 + np.cos(2.0 * math.pi * 9.0 * 1e-3 * np.arange(2000))
    run = Observation("run", np.zeros(2000), swing, 1e-3)
    shaken = STAGE.with_effect("periodic_disturbance", {"frequency": frequency, "amplitude": 1.0})
    assert cycles("periodic_disturbance", shaken, [run]) == pytest.approx(vibration, abs=0.4)
    coupled = STAGE.with_effect("second_mode", {"share": 0.05, "frequency": frequency,
                                                   "damping_ratio": 0.01})
    assert cycles("second_mode", coupled, [run]) == pytest.approx(mode)


@pytest.mark.parametrize(("amplitude", "expected"), [(1e-6, 9.99), (0.4e-3, 6.0), (2e-3, 0.0)])
def test_an_error_of_the_reading_does_not_make_the_motion_across_it_wider(amplitude, expected):
    """Two millimetres are read. What the error itself may add to that is no motion."""
    run = Observation("run", np.ones(3), np.array([-1e-3, 0.0, 1e-3]), 1e-3)
    values = {"amplitude": amplitude, "period": 0.2e-3, "phase": 0.0}
    erring = STAGE.with_effect("encoder_periodic_error", values)
    assert cycles("encoder_periodic_error", erring, [run]) == pytest.approx(expected)
    pulled = STAGE.with_effect("cogging", values)
    assert cycles("cogging", pulled, [run]) == pytest.approx(10.0)


@pytest.mark.parametrize(("stiffness", "hidden"), [(600.0, False), (0.0, True), (None, True)])
def test_only_a_stiffness_can_creep(stiffness, hidden):
    """Beside none, a part that never relaxes would be the spring that is missing."""
    base = {"mass": 1.0, **({} if stiffness is None else {"stiffness": stiffness})}
    assert (EFFECTS["creep"].hidden_because(SimpleNamespace(base=base)) is not None) is hidden


@pytest.mark.parametrize(("commands", "seen"), [
    (np.sign(np.sin(np.arange(600) / 9.0)), False),          # a relay: one size
    (np.sin(np.arange(600) / 9.0), True),
    (np.repeat([1.0, -2.0, 2.0, -1.0], 150), True)])         # steps of two sizes
def test_a_dead_zone_is_told_from_a_gain_where_commands_differ_in_size(commands, seen):
    at = SimpleNamespace(runs=[SimpleNamespace(input=commands)])
    assert (EFFECTS["dead_zone"].hidden_because(at) is None) is seen


@pytest.mark.parametrize(("share", "ended"), [(0.9, False), (0.999, True)])
def test_a_second_mode_that_is_all_of_the_motion_is_none(share, ended):
    """On a cart in dry friction it took the place of the base, at 0.7 Hz."""
    model = Model("cart", 0.01, {"mass": 6.0, "damping": 10.0}).with_effect(
        "second_mode", {**EFFECTS["second_mode"].defaults, "share": share})
    found = SimpleNamespace(ok=True, model=model, system=SimpleNamespace(at=None))
    assert at_upper_end(found, ["second_mode"]) is ended
