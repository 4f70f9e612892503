"""References: derivatives, joints, periods and limits against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from dfm_stage.trajectory import (
    REFERENCE_KINDS,
    LimitError,
    Limits,
    Reference,
    TrajectoryError,
    check_limits,
    make_reference,
    require_run_within,
)

DT = 1e-4
SMOOTH = {
    "hold": {"position_m": 1e-3},
    "steps": {"levels_m": [0.0, 2e-3, -1e-3, 0.0], "dwell_s": 0.5, "rise_s": 0.2},
    "raster": {},
    "sine": {"ramp_s": 0.3, "frequency_hz": 0.7, "phase_deg": 30.0},
    "chirp": {"low_hz": 0.5, "high_hz": 9.0, "period_s": 2.0, "ramp_s": 0.3},
    "multisine": {"low_hz": 0.5, "high_hz": 9.0, "period_s": 2.0, "ramp_s": 0.3},
    "spiral": {"turns": 3, "turn_s": 0.25, "phase_deg": -90.0},
    "lissajous": {"pattern_s": 2.0, "cycles": 3, "phase_deg": 40.0, "ramp_s": 0.3},
    "point_to_point": {"points_m": [0.0, 2e-3, -1e-3], "dwell_s": 0.1, "delay_s": 0.05,
                       "jerk_m_s3": 10.0},
}


def made(kind: str, duration_s: float = 3.0, dt: float = DT, **settings: object) -> Reference:
    return make_reference({"kind": kind, **settings}, sample_period_s=dt, duration_s=duration_s)


def test_every_kind_is_covered_here() -> None:
    assert {*SMOOTH, "csv"} == set(REFERENCE_KINDS)     # csv: test_patterns.py


@pytest.mark.parametrize("kind", SMOOTH)
def test_stated_derivatives_are_those_of_the_position(kind: str) -> None:
    r = made(kind, **SMOOTH[kind])
    # Simpson's rule over [k, k+2]: the integral of each derivative is the difference above it.
    for below, above in ((r.velocity, r.position), (r.acceleration, r.velocity)):
        simpson = DT / 3.0 * (below[:-2] + 4.0 * below[1:-1] + below[2:])
        scale = max(float(np.max(np.abs(above))), 1e-12)
        assert np.max(np.abs(above[2:] - above[:-2] - simpson)) < 2e-6 * scale


@pytest.mark.parametrize("kind", SMOOTH)
def test_jerk_is_bounded_so_acceleration_has_no_jump(kind: str) -> None:
    coarse, fine = (made(kind, dt=dt, **SMOOTH[kind]) for dt in (1e-3, 1e-4))
    largest = [float(np.max(np.abs(np.diff(r.acceleration)))) for r in (coarse, fine)]
    assert largest[1] <= 0.11 * largest[0] + 1e-12


def test_raster_line_is_straight_and_the_turnaround_has_the_stated_extremes() -> None:
    length, line_s, turn_s = 5e-3, 0.4, 0.1
    r = made("raster", line_length_m=length, line_time_s=line_s, turnaround_s=turn_s)
    speed = length / line_s
    assert np.allclose(np.abs(r.velocity[r.steady]), speed, rtol=1e-12)
    assert np.all(r.acceleration[r.steady] == 0.0)
    runs = np.flatnonzero(np.diff(r.steady.astype(int)))
    assert runs[1] - runs[0] == round(line_s / DT) + 1      # both ends of the line included
    assert np.ptp(r.position[runs[0] + 1:runs[1] + 1]) == pytest.approx(length, rel=1e-9)
    after = slice(r.start_samples, None)
    assert np.max(np.abs(r.acceleration[after])) == pytest.approx(3.75 * speed / turn_s, rel=1e-6)
    assert np.max(np.abs(r.position[after])) == pytest.approx(
        0.5 * length + speed * turn_s * quad(
            lambda u: 1 - 2 * (10 * u**3 - 15 * u**4 + 6 * u**5), 0.0, 0.5)[0], rel=1e-6)
    jerk = np.diff(r.acceleration[after]) / DT
    assert np.max(np.abs(jerk)) == pytest.approx(20.0 / math.sqrt(3.0) * speed / turn_s**2,
                                                 rel=1e-2)


def test_raster_repeats_exactly_and_starts_at_rest() -> None:
    r = made("raster", duration_s=6.0, dt=1e-3, center_m=1e-3)
    one = slice(r.start_samples, r.start_samples + r.period_samples)
    two = slice(r.start_samples + 2 * r.period_samples, r.start_samples + 3 * r.period_samples)
    assert r.period_samples == 1000
    for each in (r.position, r.velocity, r.acceleration):
        assert np.array_equal(each[one], each[two])
    assert (r.position[0], r.velocity[0], r.acceleration[0]) == (1e-3, 0.0, 0.0)
    assert not r.steady[:r.start_samples].any()


def test_raster_without_lead_in_is_periodic_from_the_first_sample() -> None:
    r = made("raster", dt=1e-3, lead_in_s=0.0)
    assert r.position[0] == -2.5e-3
    assert r.velocity[0] == pytest.approx(12.5e-3)
    assert np.array_equal(r.position[:1000], r.position[1000:2000])


@pytest.mark.parametrize("lead_in_s", [0.04, 0.5, 3.0])
def test_the_lead_in_goes_no_further_out_than_the_scan(lead_in_s: float) -> None:
    r = made("raster", duration_s=6.0, dt=1e-3, lead_in_s=lead_in_s)
    lead = slice(0, r.start_samples)
    assert np.max(np.abs(r.position[lead])) <= np.max(np.abs(r.position[r.start_samples:])) + 1e-12
    assert np.max(np.abs(np.diff(r.position, 2))) < 1e-6 * np.max(np.abs(r.acceleration)) * 1.01


def test_a_lead_in_longer_than_the_run_is_cut() -> None:
    r = made("raster", duration_s=0.2, dt=1e-3)
    assert r.position.shape == (200,)
    assert not r.steady.any()


def test_staircase_levels_and_jumps() -> None:
    r = made("steps", dt=1e-2, duration_s=1.0, start_m=1e-3, step_m=2e-3, count=3, dwell_s=0.2,
             delay_s=0.1)
    expected = np.repeat([1e-3, 3e-3, 5e-3, 7e-3], [30, 20, 20, 30])
    assert np.allclose(r.position, expected, rtol=1e-15)
    assert not r.velocity.any()
    assert r.steady.all()


def test_staircase_down_again_repeats_with_a_period() -> None:
    r = made("steps", dt=1e-2, duration_s=2.0, step_m=1e-3, count=2, dwell_s=0.1,
             down_again=True, repeat=True)
    assert np.allclose(r.position[::10][:9] * 1e3, [0, 1, 2, 1, 0, 1, 2, 1, 0])
    assert r.period_samples == 40


def test_repeated_smooth_steps_stay_continuous() -> None:
    r = made("steps", dt=1e-3, duration_s=3.0, levels_m=[0.0, 1e-3, -1e-3], dwell_s=0.5,
             rise_s=0.2, repeat=True)
    assert np.max(np.abs(np.diff(r.position))) < 2e-3 * 1.875 / 200 * 1.01
    assert np.array_equal(r.position[1000:1500], r.position[2500:])
    assert r.position[1600] == pytest.approx(-0.5e-3)


def test_a_smooth_step_is_not_steady_while_it_moves() -> None:
    r = made("steps", dt=1e-2, duration_s=1.0, levels_m=[0.0, 1e-3], dwell_s=0.5, rise_s=0.2)
    assert r.position[50] == 0.0
    assert r.position[60] == pytest.approx(0.5e-3)
    assert not r.steady[50:70].any()
    assert r.steady[:50].all()
    assert r.steady[71:].all()


def test_sine_about_a_centre() -> None:
    r = made("sine", dt=1e-3, duration_s=2.0, amplitude_m=2e-3, frequency_hz=0.5, center_m=1e-3)
    t = np.arange(2000) * 1e-3
    assert np.allclose(r.position, 1e-3 + 2e-3 * np.sin(math.pi * t), atol=1e-15)
    assert r.period_samples == 2000


@pytest.mark.parametrize(("spec", "part"), [
    ({"kind": "rastr"}, "did you mean 'raster'?"),
    ({"kind": "raster", "line_lenght_m": 1e-3}, "did you mean 'line_length_m'?"),
    ({"kind": "raster", "line_time_s": 0.40005}, "not a whole number; use"),
    ({"kind": "raster", "line_time_s": -1.0}, "line_time_s = -1 s is outside"),
    ({"kind": "sine", "amplitude_m": "big"}, "amplitude_m must be a number in m"),
    ({"kind": "sine", "amplitude_m": math.nan}, "amplitude_m must be finite"),
    ({"kind": "steps", "dwell_s": 0.1, "rise_s": 0.2}, "rise_s = 0.2 s is longer than dwell_s"),
    ({"kind": "steps", "count": 1.5}, "count = 1.5 must be a whole number"),
    ({"kind": "steps", "repeat": 1}, "repeat must be true or false"),
    ({"kind": "chirp", "sweep": "log"}, "sweep must be one of linear, logarithmic"),
    ({"kind": "chirp", "ramp_s": 11.0}, "more than half"),
    ({}, "kind is missing"),
    ([], "must be a mapping"),
])
def test_a_bad_specification_is_refused_in_one_line(spec: object, part: str) -> None:
    with pytest.raises(TrajectoryError) as caught:
        make_reference(spec, sample_period_s=1e-3, duration_s=1.0,  # type: ignore[arg-type]
                       where="axes.x.reference")
    assert part in str(caught.value)
    assert str(caught.value).startswith("axes.x.reference: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [{"sample_period_s": 0.0}, {"duration_s": math.inf},
                                 {"duration_s": 1e-4}, {"seed": -1}, {"seed": 0.5}])
def test_a_bad_grid_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(TrajectoryError, match=next(iter(bad))):
        make_reference({"kind": "hold"}, **{"sample_period_s": 1e-3, "duration_s": 1.0, **bad})


@pytest.mark.parametrize("kind", REFERENCE_KINDS)
def test_every_default_stands_in_its_own_range(kind: str) -> None:
    for entry in (*REFERENCE_KINDS[kind].parameters, *REFERENCE_KINDS[kind].options):
        assert entry.checked(entry.default) == entry.default
        assert entry.description


def test_the_first_violation_is_named_with_time_and_value() -> None:
    r = made("sine", dt=1e-3, duration_s=4.0, amplitude_m=8e-3, frequency_hz=0.5)
    violation = check_limits(r, Limits(travel_m=7.7e-3))
    assert violation is not None
    assert violation.quantity == "position"
    assert violation.time_s == pytest.approx(math.asin(7.7 / 8.0) / math.pi, abs=1e-3)
    assert violation.value > 7.7e-3
    with pytest.raises(LimitError, match=r"position of 0.0077\d+ m at t = 0\.41\d s"):
        require_run_within(r, None, Limits(travel_m=7.7e-3), where="reference")


def test_the_earliest_of_several_violations_wins() -> None:
    r = made("sine", dt=1e-3, duration_s=4.0, amplitude_m=8e-3, frequency_hz=0.5)
    violation = check_limits(r, Limits(travel_m=7.7e-3, velocity_m_s=0.02))
    assert violation is not None
    assert (violation.quantity, violation.time_s) == ("velocity", 0.0)


def test_a_jump_counts_as_velocity() -> None:
    r = made("steps", dt=1e-3, levels_m=[0.0, 1e-3], dwell_s=1.0)
    violation = check_limits(r, Limits(velocity_m_s=0.5))
    assert violation is not None
    assert violation.time_s == pytest.approx(1.0)
    assert violation.value == pytest.approx(1.0)


def test_force_and_voltage_follow_from_the_model() -> None:
    base = {"mass": 1.082, "damping": 1.845, "stiffness": 650.0, "force_constant": 2.0}
    r = made("hold", position_m=5e-3)
    assert check_limits(r, Limits(force_n=3.26), base) is None
    violation = check_limits(r, Limits(force_n=3.24), base)
    assert violation is not None
    assert violation.value == pytest.approx(3.25)
    violation = check_limits(r, Limits(voltage_v=1.6), base)
    assert violation is not None
    assert (violation.quantity, violation.unit) == ("voltage", "V")
    with pytest.raises(LimitError, match="force_constant"):
        check_limits(r, Limits(voltage_v=1.0), {"mass": 1.0})
    with pytest.raises(LimitError, match="mass"):
        check_limits(r, Limits(force_n=1.0))
