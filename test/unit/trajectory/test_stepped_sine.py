"""The stepped sine: frequencies, continuity and segments against the signal itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dfm_stage.trajectory import TrajectoryError, make_excitation

DT = 1e-3


def made(duration_s: float = 10.0, **settings):
    return make_excitation({"kind": "stepped_sine", **settings}, sample_period_s=DT,
                           duration_s=duration_s)


def test_every_segment_holds_its_frequency_and_nothing_else():
    e = made(frequencies_hz=[50.0, 10.0, 4.0], settle_s=1.0, measure_s=2.0, amplitude_v=0.3)
    assert [s.frequency_hz for s in e.segments] == [50.0, 10.0, 4.0]
    for segment in e.segments:
        assert segment.settled - segment.first == 1000
        part = e.voltage[segment.settled:segment.end]
        spectrum = np.abs(np.fft.rfft(part)) / (part.size / 2)
        line = round(segment.frequency_hz * 2.0)
        assert spectrum[line] == pytest.approx(0.3, rel=1e-9)
        assert np.max(np.delete(spectrum, line)) < 1e-9
    assert not e.voltage[9000:].any()


def test_no_jump_where_the_frequency_changes():
    e = made(low_hz=1.3, high_hz=70.0, count=7, settle_s=0.7, measure_s=0.7, amplitude_v=1.0)
    largest = np.max(np.abs(np.diff(e.voltage[:9800])))
    assert largest <= 2.0 * math.sin(math.pi * 70.0 * DT) * (1.0 + 1e-9)
    assert e.segments[0].frequency_hz == pytest.approx(70.0)
    assert e.segments[-1].frequency_hz == pytest.approx(1.3)
    up = made(low_hz=1.3, high_hz=70.0, count=7, settle_s=0.7, measure_s=0.7, rising=True)
    assert up.segments[0].frequency_hz == pytest.approx(1.3)


def test_a_segment_cut_off_is_not_listed_and_metadata_has_them():
    e = made(duration_s=7.0, frequencies_hz=[5.0, 4.0, 3.0], settle_s=1.0, measure_s=2.0)
    assert len(e.segments) == 2
    assert e.metadata()["segments"] == [[5.0, 0, 1000, 3000], [4.0, 3000, 4000, 6000]]
    assert "segments" not in make_excitation({"kind": "hold"}, sample_period_s=DT,
                                             duration_s=1.0).metadata()


@pytest.mark.parametrize(("settings", "words"), [
    ({"frequencies_hz": [600.0]}, "half the sample rate"),
    ({"low_hz": 9.0, "high_hz": 2.0}, "is above high_hz"),
    ({"measure_s": 30.0}, "lengthen duration_s"),
    ({"settle_s": 0.00033}, "whole number"),
])
def test_what_cannot_be_made_is_refused(settings, words):
    with pytest.raises(TrajectoryError, match=words):
        made(**settings)
