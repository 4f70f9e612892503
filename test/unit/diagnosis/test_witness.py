"""The witness of the force domain on records made without the library, and on measured ones."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
import truth
from scipy.integrate import solve_ivp

from dfm_stage.diagnosis import DiagnosisError
from dfm_stage.diagnosis.black_box import features
from dfm_stage.diagnosis.force_candidates import Fits
from dfm_stage.diagnosis.force_domain import RunForces
from dfm_stage.diagnosis.observation import Observation, in_windows
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.witness import witness
from dfm_stage.model import EFFECTS, Model, Simulator, load_model
from dfm_stage.model.registry import ALL, library_of

LIBRARY = tuple(EFFECTS)
GIVEN = truth.believed().with_parameters({"damping": 5.0, "stiffness": 4300.0})
"""What its user believes, numbers somewhat wrong."""


def observed(feed, position, seed=0, noise=truth.NOISE, name="run"):
    noise = noise * np.random.default_rng(seed).standard_normal(feed.size)
    return Observation(name, feed, position + noise, truth.PERIOD)


def moved(extra, *feeds, noise=truth.NOISE):
    return [observed(feed, truth.move(feed, extra), k, noise) for k, feed in enumerate(feeds)]


def hardening(x, v):
    return -4e10 * x**3


@pytest.fixture(scope="module")
def cubic():
    return moved(hardening, truth.multisine(1), truth.multisine(2, 0.4))


def test_the_missing_force_is_named_with_its_parameter(cubic):
    found = witness(cubic, GIVEN, LIBRARY)
    assert found.best.names == ("cubic_stiffness",)
    assert found.best.share > 0.98
    assert found.best.of_predictable > 0.98
    assert min(found.nearest.values()) > 5.0
    assert found.best.parameters["cubic_stiffness.k3"] == pytest.approx(4e10, rel=0.02)
    # held: the others are in its scale
    assert found.best.parameters["mass"] == pytest.approx(truth.MASS, rel=1e-12)
    for name, true in (("damping", truth.DAMPING), ("stiffness", truth.STIFFNESS),
                       ("force_constant", truth.GAIN)):
        assert found.best.parameters[name] == pytest.approx(true, rel=0.01)
    assert found.late_samples[0] == pytest.approx(0.5, abs=0.03)
    assert not found.cannot_tell
    assert {"encoder_quantization", "force_offset", "back_emf"} <= set(found.not_judged)


def test_a_free_mass_is_estimated_instead_of_the_force_constant(cubic):
    found = witness(cubic, GIVEN.with_parameters({"mass": 2.0}), ["cubic_stiffness"],
                    free=("mass", "damping", "stiffness"))
    assert found.best.parameters["mass"] == pytest.approx(truth.MASS, rel=0.01)
    assert found.best.parameters["force_constant"] == truth.GAIN


def swing(softening: float) -> Observation:
    """A free swing with a spring that softens, by DOP853; nothing drives it."""
    time = truth.PERIOD * np.arange(8000)

    def motion(_: float, state: np.ndarray) -> list[float]:
        x, v = state
        return [v, -(truth.STIFFNESS * x - softening * x**3 + truth.DAMPING * v) / truth.MASS]

    found = solve_ivp(motion, (0.0, time[-1]), [2e-4, 0.0], "DOP853", time, rtol=1e-10, atol=1e-14)
    return observed(np.zeros(time.size), found.y[0])


def test_where_nothing_drives_the_stage_the_mass_is_the_scale():
    found = witness([swing(3e10)], GIVEN, LIBRARY)
    assert found.best.names == ("cubic_stiffness",)
    assert found.best.parameters["cubic_stiffness.k3"] == pytest.approx(-3e10, rel=0.05)
    assert found.best.parameters["stiffness"] == pytest.approx(truth.STIFFNESS, rel=0.01)
    assert "without an input" in found.not_judged["second_mode"]
    assert not found.cannot_tell


def test_a_fit_begins_weaker_where_the_motion_escapes():
    run = swing(3e10)
    search = Search(GIVEN, [in_windows(run)], ("damping", "stiffness"), library=LIBRARY)
    bare = search.begin()
    found = search.once(("cubic_stiffness",), bare, [Hit.at("cubic_stiffness", {"k3": -2e11})])
    assert found.ok
    assert found.model.parameters()["cubic_stiffness.k3"] == pytest.approx(-3e10, rel=0.05)


def test_a_pair_is_told_where_both_are_there():
    def both(x, v):
        return hardening(x, v) - 2000.0 * abs(v) * v
    found = witness(moved(both, truth.multisine(1), truth.multisine(2, 0.4)), GIVEN, LIBRARY)
    assert set(found.best.names) == {"cubic_stiffness", "quadratic_damping"}
    assert found.best.share > 0.98
    assert found.of("quadratic_damping", "cubic_stiffness") == found.pairs[0]


def test_records_held_out_are_predicted_and_never_fitted(cubic):
    other = moved(lambda x, v: 5.0 * hardening(x, v), truth.multisine(3))
    alone = witness(cubic, GIVEN, ["cubic_stiffness"])
    found = witness(cubic, GIVEN, ["cubic_stiffness"], held=other)
    assert found.best.parameters["cubic_stiffness.k3"] == pytest.approx(
        alone.best.parameters["cubic_stiffness.k3"], rel=0.02)
    assert found.best.share < alone.best.share - 0.1


@pytest.mark.parametrize("noise", [truth.NOISE, 3e-5])
def test_where_nothing_shows_it_cannot_tell(noise):
    found = witness(moved(None, truth.multisine(1), noise=noise), GIVEN, LIBRARY)
    assert found.cannot_tell
    assert found.best.share < 3.0 * found.best.share_se


def test_a_black_box_sees_what_is_in_no_library():
    def strange(x, v):
        return -2e9 * x**2 * v
    found = witness(moved(strange, truth.multisine(1), truth.multisine(2, 0.6)), GIVEN, LIBRARY)
    assert found.best.of_predictable < 0.9
    assert found.left < 0.3
    assert found.left < 0.7 * math.sqrt(1.0 - found.best.share)


def test_a_black_box_is_finite_where_the_stage_stands():
    time = truth.PERIOD * np.arange(8000)
    moving = np.where(time < 0.5 * time[-1], np.sin(2.0 * math.pi * time / time[-1]) ** 8, 0.0)
    run = observed(moving, 1e-4 * moving * np.sin(60.0 * time), noise=0.0)
    assert all(np.all(np.isfinite(each)) for each in features([RunForces(run, 4.0)]))


@pytest.mark.parametrize(("name", "parameters", "alike"), [
    ("coulomb_friction", {"force": 0.12}, ()),
    ("presliding_friction", {"force": 0.2, "stiffness": 4e3}, ("hysteresis",)),
    ("saturation", {"limit": 0.6}, ()),
    ("second_mode", {"share": 0.3, "frequency": 61.0, "damping_ratio": 0.02}, ()),
    ("force_constant_droop", {"droop": 2e6}, ()),
    ("creep", {"stiffness": 400.0, "time_constant": 0.2}, ())])
def test_effects_of_the_library_come_first_in_their_class(name, parameters, alike):
    stage = Simulator(truth.believed().with_effect(name, parameters))
    runs = [observed(feed, stage.output(feed), k) for k, feed in enumerate(
        (truth.multisine(3), truth.multisine(4, 0.3), truth.scan()))]
    found = witness(runs, GIVEN, LIBRARY)
    assert found.singles[0].names[0] in (name, *alike)
    assert found.of(name).of_predictable > 0.9
    assert min(m for n, m in found.nearest.items() if n not in alike) > 3.0
    if name != "saturation":        # that less input leaves less of everything explains nothing
        assert found.of("saturation").share < 0.6


INERTIA, WEIGHT, FRICTION, PERIOD = 0.15, 3.0, 0.05, 5e-3


def swung_up(seed, seconds):
    """A pendulum that a bounded torque swings up, turned by the energy it lacks."""
    rng = np.random.default_rng(seed)
    state, torque, inputs, angles = np.array([0.0, 0.1]), 0.0, [], []
    for k in range(round(seconds / PERIOD)):
        if k % 10 == 0:
            energy = 0.5 * INERTIA * state[1] ** 2 + WEIGHT * (1.0 - math.cos(state[0]))
            torque = np.clip((2.0 * WEIGHT - energy) * 0.8 * np.sign(state[1]), -1.2, 1.2)
            torque += 0.2 * rng.standard_normal()
        inputs.append(torque)
        angles.append(state[0])
        state = solve_ivp(lambda _, y, u=torque: (y[1], (
            u - WEIGHT * math.sin(y[0]) - FRICTION * y[1]) / INERTIA), (0.0, PERIOD), state,
            rtol=1e-8, atol=1e-10).y[:, -1]
    noise = 5e-4 * rng.standard_normal(len(angles))
    return Observation(f"swing {seed}", np.array(inputs), np.array(angles) + noise, PERIOD,
                       unit="rad")


@pytest.fixture(scope="module")
def swings():
    return swung_up(1, 5.0), swung_up(2, 8.0)


HANGING = Model("pendulum", PERIOD, position_unit="rad", base={
    "mass": INERTIA, "damping": 0.1, "stiffness": WEIGHT, "force_constant": 1.0})


def test_a_pendulum_shows_its_weight_by_the_sine_of_its_angle(swings):
    """Without its weight the mass comes out at a fiftieth, which would hide the noise."""
    found = witness(swings[:1], HANGING, library_of([ALL]), held=swings[1:],
                    free=("mass", "damping", "stiffness"))
    assert found.best.names == ("gravity",)
    assert found.best.parameters["gravity.weight"] == pytest.approx(WEIGHT, rel=0.01)
    assert found.best.parameters["gravity.length"] == 1.0
    assert found.best.parameters["mass"] == pytest.approx(INERTIA, rel=0.01)
    assert found.best.parameters["damping"] == pytest.approx(FRICTION, rel=0.02)


def test_a_set_beside_which_the_mass_comes_out_negative_is_not_judged(swings, monkeypatch):
    plain = Fits.base_of
    monkeypatch.setattr(Fits, "base_of", lambda self, members, values: plain(
        self, members, values) - any(m.name == "cubic_stiffness" for m in members))
    found = witness(swings[:1], HANGING, ["gravity", "cubic_stiffness"])
    assert [e.names for e in (*found.singles, *found.pairs)] == [("gravity",)]
    assert "mass" in found.not_judged["cubic_stiffness"]


def test_short_records_and_resting_inputs_are_refused(cubic):
    with pytest.raises(DiagnosisError, match="too short"):
        witness([cubic[0].part(0, 150)], GIVEN, ["cubic_stiffness"])
    run = cubic[0]
    weak = Observation("weak", 1e-9 * run.input, run.output, run.sample_period)
    with pytest.raises(DiagnosisError, match="next to nothing"):
        witness([weak], GIVEN, ["cubic_stiffness"])


# -- measured records, where they are ------------------------------------------------------------

def measured(folder, name):
    root = Path(os.environ.get("DFM_SHARED_DATA")
                or Path(__file__).resolve().parents[4] / "shared" / "data")
    if not (root / folder / f"{name}.npz").is_file():
        pytest.skip("the recorded data are not here (DFM_SHARED_DATA)")
    data = np.load(root / folder / f"{name}.npz")
    unit = "m" if "position_m" in data else "V"
    time = data["time_s"]
    return load_model(root / folder / "model.yaml"), Observation(
        name, np.asarray(data["input_v"], float), np.asarray(data[f"position_{unit.lower()}"],
                                                             float),
        float(time[-1] - time[0]) / (time.size - 1), unit=unit)


def test_the_hardening_circuit_shows_its_cubic_spring():
    model, train = measured("silverbox", "train")
    _, other = measured("silverbox", "holdout_multisine")
    found = witness([train], model, LIBRARY, held=[other])
    assert not found.held
    assert found.late_samples[0] == pytest.approx(0.0, abs=0.01)
    assert found.singles[0].names == ("cubic_stiffness",)
    assert found.singles[0].share > 0.95
    assert max(e.share for e in found.singles[1:]) < 0.4
    assert found.best.names == ("cubic_stiffness", "quadratic_stiffness")
    assert found.best.share > 0.98
    assert found.best.of_predictable > 0.99
    assert min(found.nearest.values()) > 8.0


def test_the_servo_axis_shows_friction_and_its_offset():
    model, train = measured("emps", "train")
    _, other = measured("emps", "holdout")
    found = witness([train], model, LIBRARY, held=[other], free=("mass", "damping"))
    assert found.best.names == ("coulomb_friction", "force_offset")
    assert found.best.of_predictable > 0.9
    published = {"mass": (95.11, 0.02), "damping": (203.5, 0.08), "coulomb_friction.force":
                 (20.39, 0.08), "force_offset.force": (3.165, 0.05)}
    for name, (value, rel) in published.items():
        assert found.best.parameters[name] == pytest.approx(value, rel=rel)
    assert found.margins["coulomb_friction"]["presliding_friction"] > 3.0

