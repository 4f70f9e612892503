"""Every number of the paper has its row; rows move with the model; bars of the paper's tests."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dfm_stage.paper.lqr import printed_plant
from dfm_stage.paper.row import CONTRADICTIONS, PRINTED, TABLE_1, as_json
from dfm_stage.paper.stage import DirectStage
from dfm_stage.paper.workflow import Models, PaperError, compare

# What the paper prints, what follows from it and where it contradicts itself: one name each.
WANTED = {
    *PRINTED,
    *(f"table1.{part}.{load:g}N" for part in ("deflection", "stiffness", "error")
      for load, *_ in TABLE_1),
    "derived.mass", "derived.damping", "derived.force_constant", "derived.static_gain",
    "derived.resonance_amplitude", "derived.quality",
    "lqr.order", "lqr.modes", "lqr.pole_1", "lqr.pole_2", "lqr.zero", "lqr.second_mode_hz",
    "lqr.static_gain", "lqr.gain_ratio", "lqr.residue_1", "lqr.residue_2",
    "damping.factor_as_printed", "damping.factor_standard", "damping.factor_eq3",
    "encoder.coarse", "lqr.state_names", "lqr.damping_1", "zn.without_delay",
    "zn.ultimate_gain", "zn.kp", "zn.ki", "zn.kd", "lqr.steady_error_plain",
    "lqr.steady_error_integral", "theory.frequency", "geometry.stiffness", "geometry.fatigue",
    "geometry.stroke", "xy.blocks", "xy.stiffness_x", "xy.stiffness_y", "quasistatic.printed",
    "quasistatic.third", "lqr.error_sign", "lqr.solvable_at_rest", "lqr.solvable_moving",
    "pid.accuracy_sine", "xy.fea_x", "xy.fea_y", "xy.closed_form", "xy.error_angle",
    "lqr.riccati_8s",
}


def test_every_number_of_the_paper_has_its_row(rows, comparison):
    assert set(rows) >= WANTED
    assert len(rows) == len(comparison.rows)
    assert set(rows) >= CONTRADICTIONS
    assert all(row.reason for row in comparison.rows)


def test_json_is_complete_and_plain(comparison):
    content = json.loads(json.dumps(as_json(comparison.rows, {}), allow_nan=False))
    for row in content["rows"]:
        assert {"id", "paper", "ours", "unit", "deviation_percent", "reason"} <= set(row)
        if row["paper"] and row["ours"] is not None:
            expected = 100 * (row["ours"] - row["paper"]) / abs(row["paper"])
            assert row["deviation_percent"] == pytest.approx(expected)


def test_bars(rows, models):
    base = models.stage.base
    assert rows["table1.theory"].ours == pytest.approx(base["stiffness"], rel=0.005)
    ratio = base["damping"] / (2 * math.sqrt(base["stiffness"] * base["mass"]))
    assert rows["damping.decrement"].ours == pytest.approx(
        2 * math.pi * ratio / math.sqrt(1 - ratio**2), rel=0.02)
    for name, truth in (("numerator", base["force_constant"]), ("damping", base["damping"]),
                        ("stiffness", base["stiffness"])):
        assert rows[f"eq3.{name}"].ours == pytest.approx(truth / base["mass"], rel=0.01)
    assert abs(rows["theory.frequency_error"].ours) < 5.0
    assert rows["theory.agreement"].ours < 5.0


def test_numbers_that_follow_from_the_print(rows):
    close = {"derived.mass": 1.082, "derived.damping": 1.845, "derived.force_constant": 1.082,
             "derived.static_gain": 1.66e-3, "derived.resonance_amplitude": 1.9e-3,
             "derived.quality": 14.4, "lqr.pole_1": 23.93, "lqr.pole_2": 100.63,
             "lqr.zero": 97.26, "lqr.static_gain": 0.0957, "lqr.gain_ratio": 57.5,
             "lqr.residue_1": 54.6, "lqr.residue_2": 4.10, "xy.stiffness_x": 4670.0,
             "xy.blocks": 7.2, "damping.factor_as_printed": 0.034766,
             "damping.factor_standard": 0.034724}
    for name, value in close.items():
        assert rows[name].paper == pytest.approx(value, rel=8e-3), name
        assert rows[name].kind == "derived"


def test_what_the_reading_says_of_control(rows):
    assert rows["pid.accuracy"].ours < 1e-6
    assert 1e-4 < rows["pid.accuracy_sine"].ours < 1e-3
    assert rows["pid.accuracy_feedforward"].ours < rows["pid.accuracy"].paper
    assert rows["zn.without_delay"].ours is None
    assert rows["zn.period_measured"].ours == pytest.approx(rows["zn.ultimate_period"].ours,
                                                            rel=1e-3)
    assert rows["encoder.coarse"].ours > rows["pid.accuracy"].paper
    assert abs(rows["lqr.steady_error_plain"].ours) > 1e-5
    assert abs(rows["lqr.steady_error_feedforward"].ours) > 1e-6
    assert abs(rows["lqr.steady_error_integral"].ours) < 5e-8
    assert rows["lqr.error_sign"].ours == pytest.approx(-1.0)
    assert (rows["lqr.solvable_at_rest"].ours, rows["lqr.solvable_moving"].ours) == (0.0, 1.0)
    errors = [rows[f"lqr.riccati_{t}s"].ours for t in ("0.25", "0.5", "1", "2", "4", "8")]
    assert all(b < a for a, b in pairwise(errors))
    assert errors[-1] < 1e-6
    assert rows["quasistatic.printed"].ours == pytest.approx(-87.5, abs=0.1)


def test_the_printed_plant_against_numpy_polynomials():
    plant = printed_plant()
    poles = np.roots([1.0, 0.0, 1.07e4, 0.0, 5.8e6])
    zeros = np.roots([58.67, 0.0, 5.55e5])
    assert sorted(plant.poles) == pytest.approx(sorted(p.imag for p in poles if p.imag > 0))
    assert plant.zeros == pytest.approx([z.imag for z in zeros if z.imag > 0])
    assert plant.static_gain == pytest.approx(5.55e5 / 5.8e6)
    for s in (1j * 10.0, 1j * 50.0, 3.0 + 70.0j):
        ours = sum(r / (s * s + w * w) for r, w in zip(plant.residues, plant.poles, strict=True))
        assert ours == pytest.approx((58.67 * s * s + 5.55e5) / (s**4 + 1.07e4 * s * s + 5.8e6))


def test_rows_move_with_the_models(comparison, experiments, models):
    def changed(model, scale):
        base = {name: value * scale.get(name, 1.0) for name, value in model.base.items()}
        return replace(model, base=base, document=None)

    scale = {"stiffness": 1.2, "damping": 1.5, "mass": 1.1, "force_constant": 0.9,
             "encoder_resolution": 2.0}
    axes = {name: replace(axis, base={**axis.base, "stiffness": 0.8 * axis.base["stiffness"]})
            for name, axis in models.xy.axes.items()}
    other = compare(DirectStage(), Models(
        changed(models.stage, scale), changed(models.two_mode, {"stiffness": 1.1,
                                                                "damping": 1.5}),
        replace(models.xy, axes=axes, document=None)), experiments, elements=4)
    before = {row.id: row.ours for row in comparison.rows}
    after = {row.id: row.ours for row in other.rows}
    same = {name for name in before if before[name] == after[name]}
    # What rests on the chosen geometry, the printed matrices or the signals alone.
    fixed = {name for name in before if name.startswith((
        "geometry.", "lqr.riccati", "lqr.error", "lqr.solvable", "lqr.state", "lqr.end",
        "lqr.order", "lqr.modes", "xy.error_", "xy.closed", "xy.load", "xy.increment",
        "xy.cross_perfect", "xy.gauge", "response.amplitude", "response.low", "response.high",
        "zn.without", "quasistatic.limit"))}
    assert same <= fixed
    assert after["table1.theory"] == pytest.approx(1.2 * 650.0, rel=0.005)
    assert after["eq3.damping"] == pytest.approx(1.5 / 1.1 * before["eq3.damping"], rel=0.01)
    assert after["xy.stiffness_x"] == pytest.approx(0.8 * before["xy.stiffness_x"], rel=0.005)
    assert after["encoder.resolution"] == pytest.approx(1e-7)


def test_models_that_are_no_such_stage_are_refused(models):
    with pytest.raises(PaperError, match="several axes"):
        Models(models.xy, models.two_mode, models.xy)
    with pytest.raises(PaperError, match="axes x and y"):
        Models(models.stage, models.two_mode, models.stage)
    bare = replace(models.stage, base={"mass": 1.0, "damping": 1.0}, document=None)
    with pytest.raises(PaperError, match="lacks stiffness"):
        Models(bare, models.two_mode, models.xy)
