"""Patterns over an area, shortest moves, files, the way out of a raster; limits of a whole run."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from dfm_stage.model import load_model
from dfm_stage.trajectory import (
    LimitError,
    Limits,
    Reference,
    TrajectoryError,
    check_run,
    load_experiment,
    make_excitation,
    make_reference,
    require_run_within,
)
from dfm_stage.trajectory.scans import segments

DT = 1e-3
EXPERIMENTS = Path(__file__).parents[3] / "config" / "experiments"


def made(kind: str, duration_s: float = 4.0, **settings: object) -> Reference:
    return make_reference({"kind": kind, **settings}, sample_period_s=DT, duration_s=duration_s)


def test_a_spiral_of_two_axes_has_an_even_pitch_and_comes_back() -> None:
    turns, turn_s, radius = 6, 0.25, 1.2e-3
    one = {"radius_m": radius, "turns": turns, "turn_s": turn_s}
    x, y = made("spiral", **one), made("spiral", phase_deg=-90.0, **one)
    assert x.period_samples == round(2 * (turns + 1) * turn_s / DT)
    r = np.hypot(x.position, y.position)[:x.period_samples]
    turn = round(turn_s / DT)
    for k in range(1, turns - 1):                       # the same angle, a turn further out
        assert r[(k + 1) * turn] - r[k * turn] == pytest.approx(radius / turns, rel=1e-9)
    assert np.max(r) == pytest.approx(radius, rel=1e-9)
    assert np.allclose(r[1:], r[:0:-1], atol=1e-12)     # inwards as outwards
    angle = np.unwrap(np.arctan2(y.position[200:1400], x.position[200:1400]))
    assert np.allclose(np.diff(angle), 2.0 * math.pi * DT / turn_s)
    for each in (x, y):
        assert (each.position[0], each.velocity[0]) == pytest.approx((0.0, 0.0), abs=1e-15)


def test_a_lissajous_pattern_repeats_after_the_stated_time() -> None:
    r = made("lissajous", pattern_s=2.0, cycles=7, ramp_s=0.5, amplitude_m=2e-3, center_m=1e-3)
    assert np.array_equal(r.position[500:2000], r.position[2500:4000])
    spectrum = np.abs(np.fft.rfft(r.position[2000:] - 1e-3))
    assert np.argmax(spectrum) == 7
    assert spectrum[7] / 1000 == pytest.approx(2e-3)
    with pytest.raises(TrajectoryError, match="not below half"):
        made("lissajous", pattern_s=0.02, cycles=10)


@pytest.mark.parametrize("distance", [1e-7, 3e-5, 7e-5, 1e-3, -8e-3])
def test_a_move_is_the_shortest_within_its_limits(distance: float) -> None:
    v, a, j = 0.02, 0.5, 50.0
    times, jerks = segments(distance, v, a, j)
    edges = np.concatenate(([0.0], np.cumsum(times)))

    def integrated(rate, t):
        return quad(rate, 0.0, t, points=edges[(edges > 0) & (edges < t)], limit=200)[0]

    def acceleration(t):
        return sum(p * min(max(t - e, 0.0), s)
                   for e, s, p in zip(edges, times, jerks, strict=False))

    def velocity(t):
        return integrated(acceleration, t)

    end = edges[-1]
    assert acceleration(end) == pytest.approx(0.0, abs=1e-12)
    assert velocity(end) == pytest.approx(0.0, abs=1e-12)
    assert integrated(velocity, end) == pytest.approx(distance, rel=1e-6)
    top_v, top_a = abs(velocity(0.5 * end)), abs(acceleration(edges[1]))
    assert top_v <= v * (1 + 1e-9)
    assert top_a <= a * (1 + 1e-9)
    assert times[3] == 0.0 or top_v == pytest.approx(v)         # a limit is always used up
    assert times[1] == 0.0 or top_a == pytest.approx(a)
    assert np.max(np.abs(jerks)) == j


def test_points_are_reached_and_held() -> None:
    points = [0.0, 2e-3, -1e-3, 5e-7]
    r = made("point_to_point", points_m=points, dwell_s=0.2)
    held = r.position[r.steady]
    for point in points:
        assert np.sum(np.abs(held - point) < 1e-12) >= 199
    assert r.position[-1] == pytest.approx(5e-7)
    assert np.max(np.abs(r.velocity)) <= 0.02 * (1 + 1e-9)
    again = made("point_to_point", points_m=[0.0, 1e-3], dwell_s=0.1, repeat=True)
    n = again.period_samples
    assert n > 0
    assert np.allclose(again.position[:n], again.position[n:2 * n], atol=1e-12)


def test_a_raster_with_a_way_out_ends_at_rest_in_the_middle() -> None:
    r = made("raster", duration_s=3.5, lead_out_s=0.5, rest_s=0.25, center_m=1e-3)
    assert (r.position[0], r.position[-1]) == pytest.approx((1e-3, 1e-3))
    assert not np.any(r.velocity[-250:])
    plain = made("raster", duration_s=3.5, center_m=1e-3)
    assert np.array_equal(r.position[:2400], plain.position[:2400])
    assert np.max(np.abs(np.diff(r.acceleration))) <= np.max(
        np.abs(np.diff(plain.acceleration))) * 1.0001
    assert np.allclose(np.diff(r.position), 0.5 * DT * (r.velocity[1:] + r.velocity[:-1]),
                       atol=1e-8)
    assert np.sum(r.steady[2400:]) == 0
    with pytest.raises(TrajectoryError, match=r"1\.9 s are needed"):
        made("raster", duration_s=1.8, lead_out_s=0.5)


def written(path: Path, rows: str) -> str:
    path.write_text(rows, encoding="utf-8")
    return str(path)


def test_a_movement_from_a_file_passes_its_rows_smoothly(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0001, 0.04)
    x = 0.5e3 * (1.0 - np.cos(math.pi * t)) * np.exp(-0.2 * t)
    file = written(tmp_path / "path.csv", "time_s,position_um\n" + "\n".join(
        f"{a:.9f},{b:.9f}" for a, b in zip(t, x, strict=True)))
    r = made("csv", file=file, delay_s=0.5, scale=2.0)
    assert np.allclose(r.position[500:2501:40], 2e-6 * x, atol=1e-13)
    assert (r.position[0], r.position[-1]) == pytest.approx((0.0, 2e-6 * x[-1]))
    assert np.allclose(np.diff(r.position), 0.5 * DT * (r.velocity[1:] + r.velocity[:-1]),
                       atol=2e-9)
    fine = make_reference({"kind": "csv", "file": file}, sample_period_s=1e-4, duration_s=3.0)
    assert np.max(np.abs(np.diff(fine.acceleration))) < 0.15 * np.max(
        np.abs(np.diff(made("csv", file=file).acceleration)))


def test_a_voltage_from_a_file_is_held_from_row_to_row(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    volts = rng.standard_normal(300)
    file = written(tmp_path / "u.csv", "time_s,x_excitation_v,y_excitation_v\n" + "\n".join(
        f"{k * 2e-3:.6f},{v!r},0" for k, v in enumerate(volts.tolist())))
    spec = {"kind": "csv", "file": file, "column": "x_excitation_v", "delay_s": 0.1}
    e = make_excitation(spec, sample_period_s=DT, duration_s=1.0)
    assert np.array_equal(e.voltage[100:700], np.repeat(volts, 2))
    assert not np.any(e.voltage[:100])
    assert not np.any(e.voltage[700:])
    assert make_excitation({**spec, "repeat": True}, sample_period_s=DT,
                           duration_s=1.4).period_samples == 600


@pytest.mark.parametrize(("rows", "extra", "says"), [
    ("time_s,position_m\n0,0\n1,nan\n", {}, ":3: not a row of finite numbers"),
    ("time_s,position_m\n0,0\n0,1\n", {}, ":3: time_s must rise"),
    ("t,position_m\n0,0\n", {}, "there is no column time_s"),
    ("time_s,a_m,b_m\n0,0,0\n", {}, "which column?"),
    ("time_s,a_m\n0,0\n", {"column": "b_m"}, "there is no column 'b_m'"),
    ("time_s,a_m\n0,0\n1,1\n", {}, "at least 6"),
    ("time_s,a_m\n", {}, "no rows"),
    ("", {}, "is empty"),
])
def test_an_unusable_file_is_refused_in_one_line(tmp_path: Path, rows: str, extra: dict,
                                                 says: str) -> None:
    file = written(tmp_path / "bad.csv", rows)
    with pytest.raises(TrajectoryError) as caught:
        made("csv", file=file, **extra)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_none_at_all_are_refused() -> None:
    with pytest.raises(TrajectoryError, match=r"cannot read /nowhere\.csv: No such file"):
        made("csv", file="/nowhere.csv")
    with pytest.raises(TrajectoryError, match="needs the setting file"):
        made("csv")


def test_a_file_beside_the_experiment_is_found(tmp_path: Path) -> None:
    written(tmp_path / "u.csv", "time_s,volts_v\n0,1.5\n")
    (tmp_path / "e.yaml").write_text(
        "name: e\nmode: open_loop\nduration_s: 1\naxes:\n  x:\n"
        "    excitation: {kind: csv, file: u.csv}\n", encoding="utf-8")
    e = load_experiment(tmp_path / "e.yaml").excitation("x", DT)
    assert e.voltage[0] == 1.5


@pytest.mark.parametrize("file", sorted(EXPERIMENTS.glob("*.yaml")), ids=lambda file: file.stem)
def test_every_experiment_that_comes_along_is_within_the_limits(file: Path) -> None:
    experiment = load_experiment(file)
    open_loop = experiment.mode == "open_loop"
    model = load_model(experiment.model or "paper_stage")
    for name in experiment.axes:
        axis = model.axis(name) if model.axes else model
        reference, shake = experiment.reference(name, DT), experiment.excitation(name, DT)
        assert np.any(reference.position) or np.any(shake.voltage) or len(experiment.axes) > 1
        require_run_within(reference, shake, Limits(travel_m=8.5e-3, voltage_v=10.0), axis,
                           open_loop=open_loop)


BASE = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "force_constant": 2.0}


def stage(**base: float):
    from dfm_stage.model import parse_model

    values = "".join(f"  {name}: {value}\n" for name, value in {**BASE, **base}.items())
    return parse_model(f"dfm_model: 1\nname: s\nsample_period: 0.001\nbase:\n{values}", "s.yaml")


def test_a_closed_loop_run_counts_reference_and_excitation() -> None:
    r = made("hold", position_m=5e-3)
    e = make_excitation({"kind": "hold", "voltage_v": 1.0}, sample_period_s=DT, duration_s=4.0)
    assert check_run(r, e, Limits(voltage_v=2.5, force_n=5.1), stage()) is None
    violation = check_run(r, e, Limits(voltage_v=2.4), stage())
    assert violation is not None
    assert (violation.quantity, violation.value) == ("voltage", pytest.approx(2.5))
    violation = check_run(r, e, Limits(force_n=4.9), stage())
    assert violation is not None
    assert violation.value == pytest.approx(5.0)
    violation = check_run(r, e, Limits(current_a=0.49), stage(coil_resistance=5.0))
    assert violation is not None
    assert (violation.quantity, violation.value) == ("current", pytest.approx(0.5))
    with pytest.raises(LimitError, match="coil_resistance"):
        check_run(r, e, Limits(current_a=1.0), stage())
    with pytest.raises(LimitError, match="force_n needs a model"):
        check_run(r, e, Limits(force_n=1.0))
    assert check_run(r, e, Limits(voltage_v=0.9)) is not None       # the excitation alone


def test_an_excitation_in_open_loop_is_tried_on_the_model_first() -> None:
    model = load_model("paper_stage")
    shake = make_excitation({"kind": "sine", "amplitude_v": 0.5, "frequency_hz": 3.9},
                            sample_period_s=DT, duration_s=6.0)
    rest = made("hold", duration_s=6.0)
    with pytest.raises(LimitError) as caught:
        require_run_within(rest, shake, Limits(travel_m=7.7e-3), model, open_loop=True,
                           where="resonance")
    said = str(caught.value)
    assert said.startswith("resonance: position of ")
    assert "exceeds the limit of 0.0077 m; make the movement smaller" in said
    assert said.endswith("it was not started")
    # 0.5 V at resonance: static gain 1.66 mm/V times Q = 14.4 gives 12 mm, reached in 1.2 s
    violation = check_run(rest, shake, Limits(travel_m=7.7e-3), model, open_loop=True)
    assert violation is not None
    assert 1.0 < violation.time_s < 1.6
    assert check_run(rest, shake, Limits(travel_m=13e-3), model, open_loop=True) is None
    fast = check_run(rest, shake, Limits(travel_m=13e-3, velocity_m_s=0.1), model, open_loop=True)
    assert fast is not None
    assert fast.quantity == "velocity"
