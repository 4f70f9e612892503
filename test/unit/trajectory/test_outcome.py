"""Whether a run counts: the output was on, and the stage followed its reference."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.trajectory import Bounds, Outcome

SINE = 1e-3 * np.sin(np.linspace(0.0, 20.0, 2001))


def outcome(position, reference=SINE, bounds: Bounds | None = None, before_m: float = 0.0,
            open_loop: bool = False) -> Outcome:
    watched = Outcome(np.asarray(reference), before_m, bounds or Bounds(), open_loop)
    for y, r in zip(position, reference, strict=True):
        watched.measured(float(y), float(r))
    return watched


@pytest.mark.parametrize(("share", "counts"), [(0.0, False), (0.4, False), (0.6, True),
                                               (1.0, True), (1.4, True), (1.6, False)])
def test_by_default_more_than_half_of_the_movement_must_be_made(share, counts):
    assert (outcome(share * SINE).complaint() == "") is counts


def test_a_movement_begins_where_the_stage_was_held_before():
    there = np.full(500, 2e-3)
    assert "was not followed" in outcome(np.zeros(500), there).complaint()
    assert outcome(there + 1e-4, there, before_m=2e-3).complaint() == ""


def test_noise_is_no_failure_to_follow_nanometres():
    noise = np.random.default_rng(1).normal(0.0, 5e-8, SINE.size)
    assert outcome(1e-5 * SINE + noise, 1e-5 * SINE).complaint() == ""


def test_the_bounds_of_the_experiment_count_and_are_told_with_what_was_seen():
    moved = SINE + 2e-6
    assert outcome(moved, bounds=Bounds(error_rms_m=3e-6)).complaint() == ""
    said = outcome(moved, bounds=Bounds(error_rms_m=1e-6)).complaint()
    assert said == "the reference was not followed: RMS error 2 µm, allowed 1 µm"
    moved[7] += 5e-6
    said = outcome(moved, bounds=Bounds(error_peak_m=4e-6)).complaint()
    assert said == "the reference was not followed: largest error 7 µm, allowed 4 µm"
    assert outcome(0.0 * SINE, bounds=Bounds(error_rms_m=1.0)).complaint() == ""


def test_in_open_loop_there_is_nothing_to_follow():
    assert outcome(SINE, 0.0 * SINE, open_loop=True).complaint() == ""


def test_the_first_reason_why_the_output_was_off_counts():
    watched = outcome(0.0 * SINE)
    watched.output("")
    watched.output("stale command")
    watched.output("disarmed")
    assert watched.complaint().startswith("stale command; the reference was not followed")
    careless = outcome(SINE, bounds=Bounds(output_on=False))
    careless.output("disarmed")
    assert careless.complaint() == ""
