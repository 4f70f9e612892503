"""Ring-downs: what moves without an input was set going before the record began."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import diagnose
from dfm_stage.model import Model
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, NOISE = 1e-3, 4000, 2e-7
FIRST, SECOND = (12.0, 0.004), (31.0, 0.006)
MODEL = Model("stage", PERIOD, base={
    "mass": 1.0, "damping": 0.7, "stiffness": (2.0 * math.pi * 12.3) ** 2, "force_constant": 1.0})
TIME = PERIOD * np.arange(SIZE)


def decay(mode, amplitude, phase):
    frequency, zeta = mode
    w = 2.0 * math.pi * frequency
    return amplitude * np.exp(-zeta * w * TIME) * np.cos(
        w * math.sqrt(1.0 - zeta**2) * TIME + phase)


def record(seed, motion):
    noise = NOISE * np.random.default_rng(seed).standard_normal(SIZE)
    return Record(TIME, PERIOD, {"x": AxisRecord(np.zeros(SIZE), motion + noise)},
                  Provenance(f"ring {seed}", "csv"))


def ringing(seed, share):
    rng = np.random.default_rng(100 + seed)
    first, second = rng.uniform(0.5e-3, 1.5e-3, 2)
    return record(seed, decay(FIRST, first, rng.uniform(0.0, 6.0))
                  + decay(SECOND, share * second, rng.uniform(0.0, 6.0)))


@pytest.mark.parametrize("share", [0.3, 0.01])
def test_a_second_mode_that_rings_beside_the_first_is_named(share):
    """Two decays in closed form; how much of the mode the sensor sees cannot be told."""
    found = diagnose([ringing(1, share), ringing(2, share)], MODEL, holdout=[ringing(3, share)])
    assert found.verdict == "named"
    assert found.names == ("second_mode",)
    told = found.effects[0].parameters
    assert set(told) == {"frequency", "damping_ratio"}
    assert told["frequency"].covers(SECOND[0])
    assert told["damping_ratio"].covers(SECOND[1])
    assert told["frequency"].half_width < 0.01


def test_one_mode_alone_needs_no_second():
    found = diagnose([ringing(1, 0.0), ringing(2, 0.0)], MODEL, holdout=[ringing(3, 0.0)])
    assert found.verdict in ("none", "retune")


def test_drag_in_a_ring_down_is_no_second_mode():
    """Against an independent integration."""
    w, amplitudes = 2.0 * math.pi * FIRST[0], (0.8e-3, 1.2e-3, 1.0e-3)
    drag = 3.0 * FIRST[1] / 1e-3
    records = [record(seed, solve_ivp(
        lambda _, s: [s[1], -2.0 * FIRST[1] * w * s[1] - w * w * s[0] - drag * abs(s[1]) * s[1]],
        (0.0, TIME[-1]), [a, 0.0], t_eval=TIME, rtol=1e-9, atol=1e-13).y[0])
        for seed, a in enumerate(amplitudes)]
    found = diagnose(records[:2], MODEL, holdout=records[2:])
    assert found.names == ("quadratic_damping",)
    assert found.effects[0].parameters["coefficient"].covers(drag)


def test_a_ring_down_beside_a_driven_record_tells_more_and_spoils_nothing():
    """By the frequency response of both modes, with a share that the driven record shows."""
    share, omega = 0.2, 2.0 * math.pi * np.fft.rfftfreq(SIZE, PERIOD)
    feed = np.fft.rfft(np.random.default_rng(5).standard_normal(SIZE))
    feed[omega > 2.0 * math.pi * 100.0] = 0.0

    def response(mode):
        w = 2.0 * math.pi * mode[0]
        return 1.0 / (w * w - omega**2 + 2j * mode[1] * w * omega)

    held = np.sinc(omega * PERIOD / (2.0 * math.pi)) * np.exp(-0.5j * omega * PERIOD)
    motion = np.fft.irfft(held * feed * ((1.0 - share) * response(FIRST)
                                         + share * response(SECOND)), SIZE)
    size = 1e-3 / np.std(motion)
    driven = record(1, size * motion)
    driven = replace(driven, axes={"x": replace(
        driven.axes["x"], input=size * np.fft.irfft(feed, SIZE))})
    found = diagnose([driven, ringing(2, 0.3)], MODEL, holdout=[ringing(3, 0.3)])
    assert found.names == ("second_mode",)
    told = found.effects[0].parameters
    assert told["share"].covers(share)
    assert told["share"].half_width < 1e-3


def test_a_share_that_the_model_has_stays_where_nothing_shows_it():
    known = MODEL.with_effect("second_mode", {"share": 0.2, "frequency": 30.5,
                                              "damping_ratio": 0.008})
    found = diagnose([ringing(1, 0.3), ringing(2, 0.3)], known, holdout=[ringing(3, 0.3)])
    assert found.verdict == "retune"
    told = found.model.parameters()
    assert told["second_mode.share"] == 0.2
    assert told["force_constant"] == pytest.approx(1.0, rel=1e-3)
    assert told["second_mode.frequency"] == pytest.approx(SECOND[0], abs=0.01)


def test_a_mount_of_the_sensor_rings_from_where_it_was():
    """The model's only wrong number is its damping; the mount is no second mode besides."""
    known = MODEL.with_effect("sensor_mount", {"frequency": SECOND[0],
                                               "damping_ratio": SECOND[1]})
    found = diagnose([ringing(1, 0.3), ringing(2, 0.3)], known, holdout=[ringing(3, 0.3)])
    assert found.verdict == "retune"
