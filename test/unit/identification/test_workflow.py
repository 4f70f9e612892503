"""From records to a model: the whole way, on records made by SciPy alone."""

from __future__ import annotations

import numpy as np
import pytest

from dfm_stage.identification import IdentificationError, Source, identify
from dfm_stage.identification.model_fit import default_free, expand_names
from dfm_stage.model import Model, load_model
from dfm_stage.recording import AxisRecord

LINES = np.setdiff1d(np.arange(1, 141, 2), [9, 23, 41, 77, 101])
COUNT = 5e-8


def source(reference_stage, multisine, seed, periods=6, name="run", **truth):
    rng = np.random.default_rng(seed)
    u = 0.08 * multisine(LINES, 2000, periods, seed)
    u, y = reference_stage(**truth).simulate(u, noise=5e-8 * rng.standard_normal(u.size))
    return Source(name, AxisRecord(u, COUNT * np.round(y / COUNT)), 1e-3)


def test_the_papers_stage_within_its_bars(reference_stage, multisine):
    hits = []
    for seed in range(10):
        found = identify([source(reference_stage, multisine, seed)])
        assert found.estimate.status == "converged"
        truth = {"natural_frequency_hz": np.sqrt(650 / 1.082) / 2 / np.pi,
                 "damping_ratio": 1.845 / 2 / np.sqrt(650 * 1.082), "gain": 1.082 / 650}
        for name, bar in (("natural_frequency_hz", 0.005), ("damping_ratio", 0.03),
                          ("gain", 0.005)):
            q = getattr(found, name)
            assert q.value == pytest.approx(truth[name], rel=bar)
            hits.append(q.covers(truth[name]))
    assert np.mean(hits) >= 0.8
    assert found.model.base["mass"] == 1.082
    assert found.held_out[0].fit.rms == pytest.approx(5.2e-8, rel=0.1)
    assert found.evaluations[0].floor.known_from == "periods"
    assert all(t.passed for t in found.tests)
    assert {row.symbol for row in found.paper} == {"b", "c/m", "k/m"}
    assert abs(found.paper[0].deviation_percent) < 0.1
    assert found.transfer_function.misfit < 2.0


def test_the_answer_as_json(reference_stage, multisine):
    found = identify([source(reference_stage, multisine, 0)]).to_dict()
    assert found["schema"] == 1
    for name in ("natural_frequency_hz", "damping_ratio", "gain"):
        assert set(found[name]) == {"value", "unit", "ci95"}
        low, high = found[name]["ci95"]
        assert low < found[name]["value"] < high
    assert found["parameters"]["mass"] == {"value": 1.082, "unit": "kg", "ci95": None,
                                           "held": True}
    assert found["parameters"]["stiffness"]["unit"] == "N/m"
    assert found["fit"]["unit"] == "m"
    assert {"rms", "noise_floor", "unit"} <= set(found["held_out"])
    assert [t["name"] for t in found["residual_tests"]] == ["whiteness", "input_correlation"]


def test_another_mass_scales_the_rest(reference_stage, multisine):
    one = identify([source(reference_stage, multisine, 0)], fixed={"mass": 2.164})
    assert one.model.base["stiffness"] == pytest.approx(1300.0, rel=1e-3)
    assert one.natural_frequency_hz.value == pytest.approx(3.9009, rel=1e-4)


def test_a_wrong_model_is_corrected_and_a_missing_mode_stands_out(reference_stage, multisine):
    train = source(reference_stage, multisine, 1, second=(0.07, 16.0, 0.01))
    start = Model("start", 1e-3, base={"mass": 1.082, "damping": 3.0, "stiffness": 500.0,
                                       "force_constant": 2.0, "amplifier_time_constant": 1e-3,
                                       "delay": 1e-3})
    plain = identify([train], model=start)
    two = identify([train], model=start.with_effect(
        "second_mode", {"share": 0.02, "frequency": 14.0, "damping_ratio": 0.03}))
    assert plain.evaluations[0].fit.rms > 20 * two.evaluations[0].fit.rms
    assert two.evaluations[0].fit.rms == pytest.approx(5.2e-8, rel=0.1)
    assert two.estimate.quantity("second_mode.frequency").value == pytest.approx(16.0, rel=1e-3)
    assert two.estimate.quantity("second_mode.share").value == pytest.approx(0.07, rel=0.01)
    assert not plain.line_residuals.passed
    assert two.line_residuals.passed


def test_a_refinement_is_held_until_the_model_makes_use_of_it():
    mode = {"share": 0.02, "frequency": 14.0, "damping_ratio": 0.03}
    base = Model("start", 1e-3, base={"mass": 1.0, "stiffness": 500.0})
    plain, complex_mode = (base.with_effect("second_mode", {**mode, "phase": p})
                           for p in (0.0, 0.01))
    assert "second_mode.phase" not in default_free(plain)
    assert default_free(complex_mode) == (*default_free(plain), "second_mode.phase")
    assert expand_names(plain, ["second_mode"]) == tuple(f"second_mode.{n}" for n in mode)
    assert expand_names(plain, ["second_mode.phase"]) == ("second_mode.phase",)


def test_hold_out_record_and_several_records(reference_stage, multisine):
    runs = [source(reference_stage, multisine, s, name=f"run{s}") for s in (1, 2, 3)]
    found = identify(runs[:2], holdout=runs[2:])
    assert [e.source for e in found.evaluations] == ["run1", "run2"]
    assert [e.source for e in found.held_out] == ["run3"]
    assert found.held_out[0].fit.fit_percent > 99.0
    assert found.held_out[0].floor.known_from == "periods"


def test_radians_and_amperes_are_carried(reference_stage, multisine):
    plain = source(reference_stage, multisine, 1)
    turned = Source("run", AxisRecord(plain.axis.input, plain.axis.position, "A", "rad"), 1e-3)
    found = identify([turned])
    assert found.gain.unit == "rad/A"
    assert found.model.position_unit == "rad"
    assert found.model.drive == "current"
    assert not found.paper
    assert found.to_dict()["fit"]["unit"] == "rad"


def test_records_that_do_not_belong_together_are_refused(reference_stage, multisine):
    one = source(reference_stage, multisine, 1)
    other = Source("other", AxisRecord(one.axis.input, one.axis.position, "A", "m"), 1e-3)
    with pytest.raises(IdentificationError, match="same units"):
        identify([one, other])
    with pytest.raises(IdentificationError, match="resample"):
        identify([one, Source("slow", one.axis, 2e-3)])
    with pytest.raises(IdentificationError, match="at least one"):
        identify([])


@pytest.mark.parametrize("kind", ["sine", "step", "square"])
def test_signals_with_too_few_lines_start_from_a_grid(reference_stage, kind):
    t = np.arange(12_000) * 1e-3
    u = {"sine": 0.05 * np.sin(2 * np.pi * 2.0 * t), "step": 0.05 * (t > 0.5),
         "square": 0.05 * np.sign(np.sin(2 * np.pi * 0.25 * t + 1e-9))}[kind]
    rng = np.random.default_rng(0)
    u, y = reference_stage().simulate(u, noise=5e-8 * rng.standard_normal(u.size))
    found = identify([Source(kind, AxisRecord(u, y), 1e-3)])
    assert found.estimate.ok
    assert found.natural_frequency_hz.value == pytest.approx(3.9009, rel=2e-3)
    assert found.evaluations[0].fit.rms == pytest.approx(5e-8, rel=0.05)


def test_a_body_without_a_spring_is_recognised(reference_stage, multisine):
    rng = np.random.default_rng(0)
    u = 0.5 * multisine(LINES, 2000, 5)
    stage = reference_stage(stiffness=0.0, damping=8.0)
    u, y = stage.simulate(u, noise=5e-8 * rng.standard_normal(u.size), start=(1e-3, 2e-3))
    found = identify([Source("free", AxisRecord(u, y), 1e-3)])
    assert "stiffness" not in found.model.base
    assert not np.isfinite(found.natural_frequency_hz.value)
    assert found.to_dict()["damping_ratio"]["value"] is None or not np.isfinite(
        found.damping_ratio.value)
    assert found.gain.unit == "m/V/s^2"
    assert found.gain.value == pytest.approx(1.0, rel=1e-3)
    assert found.estimate.quantity("damping").value == pytest.approx(8.0, rel=0.02)


def test_ratios_keep_their_intervals_when_mass_is_free(reference_stage, multisine):
    run = source(reference_stage, multisine, 0)
    held = identify([run], model=load_model("paper_stage"))
    free = identify([run], model=load_model("paper_stage"), free=(
        "mass", "damping", "stiffness", "force_constant", "amplifier_time_constant", "delay"))
    assert free.estimate.status == "not_identifiable"
    assert not np.isfinite(free.estimate.quantity("mass").half_width)
    for name in ("natural_frequency_hz", "damping_ratio", "gain"):
        ours, theirs = getattr(free, name), getattr(held, name)
        assert ours.value == pytest.approx(theirs.value, abs=0.1 * theirs.half_width)
        assert ours.half_width == pytest.approx(theirs.half_width, rel=0.05)
