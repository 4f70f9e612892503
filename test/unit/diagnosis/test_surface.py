"""The missing force over position and velocity, on records made without the library."""

from __future__ import annotations

import csv
import json
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
import truth

from dfm_stage import files
from dfm_stage.cli import diagnose
from dfm_stage.diagnosis.missing_force import missing_force
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.other_form import has_forms
from dfm_stage.diagnosis.surface import FILE, Surface, binned
from dfm_stage.diagnosis.wording import missing_force as sentence
from dfm_stage.model import EFFECTS, save_model

GIVEN = truth.believed().with_parameters({"damping": 5.0, "stiffness": 4300.0})
FEEDS = (truth.multisine(1), truth.multisine(2, 0.4))


def damped_outside(x, v):
    """Damping that grows with the square of the distance: in no effect of the library."""
    return -5e7 * x * x * v


def contact(x, v):
    """A spring that touches on one side only."""
    return -2e3 * max(x - 1e-4, 0.0)


def observed(motions, noise=truth.NOISE):
    draw = np.random.default_rng(0)
    return [Observation(str(k), feed, x + noise * draw.standard_normal(x.size), truth.PERIOD)
            for k, (feed, x) in enumerate(zip(FEEDS, motions, strict=True))]


def compared(force, model=GIVEN, beside=None, noise=truth.NOISE):
    """A surface, and the true force (m,) at its m bins off all that is linear, from the motion
    without noise; `beside` is another force that is there and in the model."""
    motions = [truth.move(u, lambda x, v: force(x, v) + (beside(x, v) if beside else 0.0))
               for u in FEEDS]
    surface = missing_force(observed(motions, noise), model)
    assert surface is not None
    told = np.isfinite(surface.force)

    def columns(x, v):
        found = [np.ones_like(x), x, v, *([np.vectorize(beside)(x, v)] if beside else [])]
        return np.column_stack(found)

    x = np.concatenate(motions)
    v = np.concatenate([np.gradient(each, truth.PERIOD) for each in motions])
    linear = columns(x, v)
    norms = np.linalg.norm(linear, axis=0)
    taken = np.linalg.lstsq(linear / norms, np.vectorize(force)(x, v), rcond=None)[0] / norms
    at = surface.x[told], surface.v[told]
    return surface, told, np.vectorize(force)(*at) - columns(*at) @ taken


def test_a_force_outside_the_library_is_told_within_its_standard_errors():
    surface, told, true = compared(damped_outside)
    assert told.sum() > 100
    score = (surface.force[told] - true) / surface.standard_error[told]
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=0.4)
    assert np.mean(np.abs(score) < 2.0) > 0.9
    assert np.median(surface.standard_error[told]) < 0.05 * surface.rms
    assert surface.position_velocity_share > 0.98
    assert surface.predictable_share >= surface.position_velocity_share


def test_a_contact_on_one_side_is_told_but_for_its_edge():
    surface, told, true = compared(contact)
    wrong = surface.force[told] - true
    clear = np.abs(surface.x[told] - 1e-4) > 1e-4       # in the bin of the edge the mean is not it
    assert np.std(wrong[clear]) < 0.04 * np.std(true)
    assert surface.position_velocity_share > 0.95


def test_what_the_model_explains_is_not_in_the_surface_of_what_is_left():
    model = GIVEN.with_effect("cubic_stiffness", {"k3": 3e9})
    surface, told, true = compared(damped_outside, model, lambda x, v: -4e9 * x**3)
    assert np.std(surface.force[told] - true) < 0.05 * np.std(true)


def spring(x, v):
    return -4e9 * x**3


def drag(x, v):
    """Damping that grows more slowly than speed, in no effect of the library."""
    return -0.3 * np.sign(v) * np.sqrt(abs(v))


def brake(x, v):
    return -20.0 * v / (1.0 + (v / 0.02) ** 2)


BRAKE = {"damping": 20.0, "critical_velocity": 0.02}


@pytest.mark.parametrize(("part", "noise"), [(0.1, 1e-6), (0.03, 3e-7), (0.03, 1e-7)])
def test_a_small_force_beside_an_effect_is_told_behind_a_wider_filter(part, noise):
    """Behind the filter that suits the spring's force, noise would swamp it."""
    model = GIVEN.with_effect("cubic_stiffness", {"k3": 4e9})
    surface, told, true = compared(lambda x, v: part * damped_outside(x, v), model, spring, noise)
    wrong = surface.force[told] - true
    assert np.std(wrong) < 0.4 * np.std(true)
    assert np.sqrt(np.mean((wrong / surface.standard_error[told]) ** 2)) < 2.0


@pytest.mark.parametrize(("force", "beside", "effect", "parameters", "low", "high"), [
    (spring, damped_outside, "cubic_stiffness", {"k3": 4e9}, 0.0, 0.2),
    (brake, contact, "eddy_current_damping", BRAKE, 0.0, 0.2),
    (contact, None, "cubic_stiffness", {"k3": 3e9}, 0.8, 1.0),
    (drag, None, "eddy_current_damping", BRAKE, 0.6, 1.0)])
def test_what_a_stand_in_leaves_is_an_error_of_its_own_form(force, beside, effect, parameters,
                                                            low, high):
    moved = [truth.move(u, lambda x, v: force(x, v) + (beside(x, v) if beside else 0.0))
             for u in FEEDS]
    surface = missing_force(observed(moved), GIVEN.with_effect(effect, parameters))
    assert surface is not None
    assert low <= surface.form_shares[effect] <= high


@pytest.mark.parametrize(("name", "asked"), [
    ("coulomb_friction", True), ("cubic_stiffness", True), ("saturation", True),
    ("cogging", True), ("transport_delay", False), ("second_mode", False),
    ("periodic_disturbance", False), ("encoder_quantization", False)])
def test_a_force_may_stand_in_for_another_form_and_a_lag_or_a_wave_may_not(name, asked):
    assert has_forms(EFFECTS[name]) is asked


def test_a_vibration_at_another_frequency_is_no_other_form():
    seconds = truth.PERIOD * np.arange(truth.SAMPLES)
    shaken = [truth.move(u + 0.05 * np.sin(2.0 * np.pi * 30.0 * seconds)) for u in FEEDS]
    surface = missing_force(observed(shaken), GIVEN.with_effect(
        "periodic_disturbance", {"amplitude": 0.01, "frequency": 10.0}))
    assert surface is not None
    assert surface.form_shares["periodic_disturbance"] < 0.1


def test_a_force_that_is_not_of_the_motion_is_not_predictable():
    seconds = truth.PERIOD * np.arange(truth.SAMPLES)
    shaken = [truth.move(u + 0.05 * np.sin(2.0 * np.pi * 31.7 * seconds)) for u in FEEDS]
    surface = missing_force(observed(shaken), GIVEN)
    assert surface is not None
    assert surface.predictable_share < 0.4
    assert surface.frequency_hz == pytest.approx(31.7, abs=0.2)
    assert "does not follow the motion" in sentence(surface)


def test_where_noise_is_all_there_is_no_surface():
    plain = [truth.move(u) for u in FEEDS]
    assert missing_force(observed(plain, 1e-6), GIVEN) is None
    short = [Observation("short", run.input[:300], run.output[:300], truth.PERIOD)
             for run in observed(plain)]
    assert missing_force(short, GIVEN) is None


def test_bins_have_the_standard_error_of_independent_samples():
    draw = np.random.default_rng(3)
    x, v, noise = draw.uniform(-1.0, 1.0, (3, 30_000))
    found = binned(x, v, x + noise, np.tile(x + noise, (30, 1)), np.arange(0, 30_001, 1000))
    assert found is not None
    assert found.samples.sum() == pytest.approx(30_000, rel=0.03)
    expected = np.std(noise) / np.sqrt(found.samples)
    assert np.mean(found.standard_error / expected) == pytest.approx(1.0, abs=0.05)
    score = (found.force - found.x) / expected
    assert np.std(score) == pytest.approx(1.0, abs=0.15)


def test_single_samples_make_no_bin():
    x, v = np.linspace(-1.0, 1.0, 12), np.linspace(1.0, -1.0, 12)
    assert binned(x, v, x, np.tile(x, (3, 1)), np.array([0, 4, 8, 12])) is None


def test_the_table_has_one_line_a_bin_with_units_in_its_names():
    grid = np.array([[1.0, np.nan], [2.0, 3.0]])
    surface = Surface("rad", grid, grid, grid, grid / 10.0, np.nan_to_num(9.0 * grid), 0.5, 0.6,
                      1.0)
    rows = list(csv.DictReader(StringIO(surface.to_csv())))
    assert [float(row["force_Nm"]) for row in rows] == [1.0, 2.0, 3.0]
    assert rows[1] == {"position_rad": "2", "velocity_rad_s": "2", "force_Nm": "2",
                       "standard_error_Nm": "0.2", "samples": "18"}


def written(folder, force, seed=11):
    for name, feed in (("fitted", truth.multisine(1)), ("held", truth.scan())):
        reading = truth.record(feed, truth.move(feed, force), seed)
        np.savetxt(folder / f"{name}.csv", np.column_stack(
            (reading.time, feed, reading.axis("x").position)), delimiter=",",
            header="time_s,input_V,position_m", comments="")
    save_model(truth.believed(), folder / "model.yaml")
    return diagnose.main([str(folder / "fitted.csv"), "--holdout", str(folder / "held.csv"),
                          "--model", str(folder / "model.yaml"), "--out", str(folder / "out"),
                          "--library", "back_emf,saturation"])


def test_the_command_writes_the_surface_whole_or_not_at_all_and_none_for_none(
        tmp_path, monkeypatch, capsys):
    replaced = files.os.replace

    def full(source, target):
        if Path(target).name == FILE:
            raise OSError("no space left on device")
        replaced(source, target)

    with monkeypatch.context() as patched:
        patched.setattr(files.os, "replace", full)
        assert written(tmp_path, damped_outside) == 2
    assert not list((tmp_path / "out").glob(f"*{FILE}*"))
    assert written(tmp_path, damped_outside) == 0
    assert f"{FILE} in " in capsys.readouterr().out
    answer = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert answer["verdict"] == "unknown"
    assert answer["description"]["surface"] == FILE
    assert answer["description"]["position_velocity_share"] > 0.95
    assert {"parity", "memory", "amplitude_exponent", "frequency_hz", "side",
            "predictable_share"} < answer["description"].keys()
    rows = list(csv.DictReader(StringIO((tmp_path / "out" / FILE).read_text())))
    assert len(rows) > 50
    assert "The force that is missing" in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert written(tmp_path, None) == 0
    answer = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert (answer["verdict"], answer["description"]) == ("none", None)
    assert not (tmp_path / "out" / FILE).exists()
    assert "The force that is missing" not in (tmp_path / "out" / "report.html").read_text("utf-8")
