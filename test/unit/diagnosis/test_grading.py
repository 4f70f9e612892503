"""Effects that explain a part: a remainder that is in no library stays beside them, or is all."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import truth

from benchmarks.blind.measured import diagnosed_files
from benchmarks.corpus.measured import make_case, measured_plan
from dfm_stage.diagnosis import diagnose, grading
from dfm_stage.diagnosis.evidence import (
    EffectEvidence,
    Errors,
    Evidence,
    ModelEvidence,
    Motion,
    Noise,
    RivalEvidence,
)
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.witness import Explained
from dfm_stage.model import EFFECTS, Model, load_model
from dfm_stage.recording import AxisRecord, Provenance, Record, read_record

believed, move, multisine, record = truth.believed, truth.move, truth.multisine, truth.record
PERIOD = truth.PERIOD

SIZE = 6000
SPRING_LIBRARY = ("cubic_stiffness", "quadratic_stiffness", "coulomb_friction",
                  "quadratic_damping", "second_mode")
CUBIC = 1e9  # N/m^3: a quarter of the spring at the largest travel
SHEARED = 1e4  # N s/m^2: damping that grows to one side, about 2 % of such a gap's power


def springs(extra):
    """A record to fit and one to hold out, each of three amplitudes, of a stage on a spring."""
    found = []
    for seed, levels in ((1, (0.6, 1.0, 1.4)), (2, (1.4, 0.6, 1.0))):
        feed = multisine(seed, 1.5)[:SIZE] * np.repeat(levels, SIZE // 3)
        found.append(record(feed, move(feed, extra), seed, f"run {seed}"))
    return found


def spring_diagnosis(extra):
    fitted, held = springs(extra)
    return diagnose([fitted], believed(), holdout=[held], library=SPRING_LIBRARY)


@pytest.fixture(scope="module")
def with_remainder():
    return spring_diagnosis(lambda x, v: -CUBIC * x**3 - SHEARED * x * v)


def test_a_remainder_stays_beside_a_cubic_spring(with_remainder):
    found = with_remainder
    assert (found.verdict, found.names, found.complete) == ("named", ("cubic_stiffness",), False)
    (cubic,) = found.effects
    assert cubic.members == ("cubic_stiffness",)
    assert 0.95 < cubic.gap_share < 0.995
    assert cubic.parameters["k3"].value == pytest.approx(CUBIC, rel=0.15)
    assert found.gap.judged == "position"
    assert found.gap.window_s is None
    assert "a remainder of" in found.sentence


def test_the_gap_shrinks_and_the_model_has_what_was_named(with_remainder):
    held = with_remainder.gap.to_dict()["held_out"]
    assert held["after"] < 0.5 * held["retuned"] < 0.5 * held["before"]
    assert with_remainder.model.effect("cubic_stiffness") is not None


def test_the_floor_that_is_told_is_the_noise_and_not_the_remainder(with_remainder):
    assert with_remainder.gap.noise_floor == pytest.approx(1e-7, rel=0.2)


def test_beside_a_larger_remainder_it_is_told_as_a_part():
    found = spring_diagnosis(lambda x, v: -CUBIC * x**3 - 2.0 * SHEARED * x * v)
    assert (found.verdict, found.names, found.complete) == ("partial", ("cubic_stiffness",), False)
    assert 0.8 < found.effects[0].gap_share < 0.95


def test_without_a_remainder_the_same_spring_is_complete():
    found = spring_diagnosis(lambda x, v: -CUBIC * x**3)
    assert (found.verdict, found.names, found.complete) == ("named", ("cubic_stiffness",), True)
    assert found.effects[0].parameters["k3"].value == pytest.approx(CUBIC, rel=1e-3)


def test_damping_to_one_side_alone_is_in_no_library():
    found = spring_diagnosis(lambda x, v: -SHEARED * x * v)
    assert (found.verdict, found.names, found.complete) == ("unknown", (), False)


def test_a_wrong_second_effect_that_takes_little_is_not_told():
    """A thousandth of the gap's power to one side: whatever takes most of that is no finding."""
    found = spring_diagnosis(lambda x, v: -CUBIC * x**3 - 0.1 * SHEARED * x * v)
    assert found.verdict == "named"
    assert found.names == ("cubic_stiffness",)
    assert found.effects[0].gap_share > 0.98


def test_damping_that_grows_with_travel_is_no_second_effect():
    found = spring_diagnosis(lambda x, v: -CUBIC * x**3 - 1e7 * x * x * v)
    assert found.names == ("cubic_stiffness",)
    assert not found.complete


def test_damping_that_grows_with_travel_alone_is_at_most_a_part_of_a_relative():
    found = spring_diagnosis(lambda x, v: -3e7 * x * x * v)
    assert found.verdict in ("unknown", "partial")
    assert found.names in ((), ("quadratic_damping",))


def told(share, *names):
    return SimpleNamespace(names=names, share=share)


def test_what_the_force_domain_bears_out_is_paid_for_with_its_near_rivals():
    best = told(0.9, "quadratic_stiffness", "eddy_current_damping")
    near = told(0.8, "quadratic_stiffness", "coulomb_friction")
    far = told(0.1, "creep", "hysteresis")
    seen = SimpleNamespace(best=best, pairs=(best, near, far), cannot_tell=False)
    assert grading._paid(seen) == {frozenset(best.names), frozenset(near.names)}
    alone = SimpleNamespace(best=told(0.9, "creep"), pairs=(near,), cannot_tell=False)
    assert grading._paid(alone) == {frozenset({"creep"})}
    assert grading._paid(None) == set()


def test_a_set_that_hardly_explains_the_missing_force_is_not_proposed():
    """Near a resonance forces nearly cancel, and what is missing of them says little."""
    def proposed(share):
        alone = Explained(("creep",), share, 0.0, share, {}, {})
        seen = SimpleNamespace(best=alone, singles=(alone,), pairs=(), cannot_tell=False)
        return [list(new) for new, _ in grading._proposed(
            SimpleNamespace(library=("creep",), barred=set()), seen)]

    assert proposed(0.11) == [["creep"]]
    assert proposed(0.07) == []
    assert proposed(-3.0) == []


@pytest.mark.parametrize(("library", "at_an_end", "begun"), [
    (("cubic_stiffness",), (), ["cubic_stiffness"]),   # the wider search knew others
    (("coulomb_friction", "presliding_friction", "hysteresis", "creep"),
     ("presliding_friction", "hysteresis"), ["coulomb_friction", "creep"])])
def test_grading_begins_with_the_best_single_effects_that_can_be_told(
        library, at_an_end, begun, monkeypatch):
    """Two that had become dry friction were the best on a geared arm: friction was not tried."""
    fits = [SimpleNamespace(ok=True, rms=rms, name=name) for rms, name in (
        (1.0, "gravity"), (2.0, "presliding_friction"), (2.1, "hysteresis"),
        (2.2, "coulomb_friction"), (2.3, "creep"), (2.4, "cubic_stiffness"))]
    search = SimpleNamespace(fits={(frozenset({f.name}), 0): f for f in fits}, library=library,
                             hits={n: SimpleNamespace(name=n, gain=1.0) for n in begun})
    monkeypatch.setattr(grading, "_usable", lambda _, names: names[0] not in at_an_end)
    trial = SimpleNamespace(search=search, witness=None)
    begins = grading._found_before(trial, SimpleNamespace(names=()), fits[0])
    assert [begin[0].name for begin in begins] == begun


# -- a servo axis that nothing holds -------------------------------------------------------------

MASS, VISCOUS, COULOMB, GAIN, FINE = 100.0, 200.0, 20.0, 35.0, 25
SERVO_LIBRARY = ("coulomb_friction", "force_offset", "quadratic_damping", "eddy_current_damping")


def servo(seed, one_sided, size=8000):
    """A body without a spring that a PD controller moves back and forth, in fine steps; viscous
    friction differs by direction, dry friction grows within 10 um/s."""
    rng = np.random.default_rng(seed)
    sides = rng.choice([-1.0, 1.0]) * np.cumprod(-np.ones(20)) * rng.uniform(0.02, 0.06, 20)
    stops = np.repeat(np.concatenate(([0.0], sides)), 500)[:size]
    soft = np.hanning(400)
    reference = np.convolve(np.pad(stops, (399, 0), mode="edge"), soft / soft.sum(), "valid")
    feed, out = np.empty(size), np.empty(size)
    noise = 2e-8 * rng.standard_normal(size)
    x = v = error = 0.0
    for k in range(size):
        out[k] = x + noise[k]
        before, error = error if k else reference[0] - out[0], reference[k] - out[k]
        feed[k] = (1e5 * error + 6e3 * (error - before) / PERIOD) / GAIN
        for _ in range(FINE):
            friction = COULOMB * np.tanh(v / 1e-5) + VISCOUS * v + VISCOUS * one_sided * abs(v)
            v += PERIOD / FINE * (GAIN * feed[k] - friction) / MASS
            x += PERIOD / FINE * v
    return Record(PERIOD * np.arange(size), PERIOD, {"x": AxisRecord(feed, out)},
                  Provenance(f"run {seed}", "csv"))


def servo_diagnosis(one_sided):
    model = Model("servo", PERIOD, {"mass": MASS, "damping": 150.0, "force_constant": GAIN})
    return diagnose([servo(1, one_sided)], model, holdout=[servo(2, one_sided)],
                    library=SERVO_LIBRARY)


def test_dry_friction_of_a_servo_is_judged_by_its_velocity_in_windows():
    found = servo_diagnosis(0.04)
    assert (found.verdict, found.names, found.complete) == ("named", ("coulomb_friction",), False)
    assert (found.gap.judged, found.gap.window_s) == ("velocity", pytest.approx(0.2))
    assert found.gap.velocity_s == pytest.approx(PERIOD)  # its noise is small
    assert found.effects[0].gap_share > 0.9
    assert found.effects[0].parameters["force"].value == pytest.approx(COULOMB, rel=0.08)
    assert found.base["damping"].value == pytest.approx(VISCOUS, rel=0.08)
    assert found.gap.noise_floor < 1e-7
    assert found.witness["effects"][0] == "coulomb_friction"


def test_what_the_force_domain_puts_first_is_a_rival_of_what_a_fit_puts_first():
    """With a tenth of the viscous friction one-sided, an eddy brake leaves a little less than dry
    friction in windows: neither is told without the other."""
    found = servo_diagnosis(0.1)
    assert found.verdict in ("partial", "ambiguous")
    assert "coulomb_friction" in found.effects[0].members


# -- measured records, where they are ------------------------------------------------------------


@pytest.mark.parametrize(("taken", "fitted"), [
    (0.99, ["coulomb_friction"]),
    (0.5, ["coulomb_friction", "eddy_current_damping", "presliding_friction"])])
def test_small_sets_come_first_and_one_that_takes_nearly_all_is_the_last(
        taken, fitted, monkeypatch):
    seen = []

    def leaving(chi2):
        return SimpleNamespace(chi2=chi2, white=np.zeros(10), model=SimpleNamespace(effects=()),
                               system=SimpleNamespace(free=()))

    def once(names, *_):
        seen.extend(names)
        return leaving(10.0 + 1e4 * (1.0 - taken))

    search = SimpleNamespace(step=lambda _: None, once=once)
    monkeypatch.setattr(grading, "_usable", lambda *_: True)
    bare = leaving(10.0 + 1e4)
    begins = [(bare, {name: dict(EFFECTS[name].defaults)}, {}) for name in (
        "presliding_friction", "eddy_current_damping", "coulomb_friction")]
    names, _ = grading._largest(search, bare, begins, frozenset())
    assert (names, seen) == (("coulomb_friction",), fitted)


def test_beside_the_base_as_given_only_hits_near_the_best_are_fitted():
    fitted = []
    hits = [replace(Hit.at(name, {}), gain=gain) for name, gain in (
        ("creep", 100.0), ("cogging", 81.0), ("gravity", 79.0))]
    failed = SimpleNamespace(ok=False)
    search = SimpleNamespace(as_given=lambda _: SimpleNamespace(ok=True), step=lambda _: None,
                             screened=lambda *_: (None, hits),
                             once_of=lambda hit, *_: fitted.append(hit.name) or failed)
    assert grading._as_given(search, failed, (), failed) == ((), failed)
    assert fitted == ["creep", "cogging"]


def judged_in_turn(monkeypatch, parameters, first, margin, heard):
    """How many effects are judged one after the other, and which one is told, of two with so many
    free `parameters`, where the second would be `margin` behind in the place of the `first`, and
    the force domain has `heard` of them."""
    def errors(power):
        return Errors(1.0, 1.0, 100, power)

    fits = {n: SimpleNamespace(ok=True, chi2=0.0, system=SimpleNamespace(free=("p",) * k))
            for n, k in parameters.items()}
    seen = []

    def gather(_trial, h, *_, **__):
        name, = h.names
        other, = parameters.keys() - {name}
        seen.append(name)
        left, bare = (ModelEvidence(errors(1.0), errors(p)) for p in (0.1, 1.0))
        rival = RivalEvidence(other, 0.0, 0.0, errors(0.1), related=True,
                              margin=margin if name == first else 2.5,
                              larger=parameters[other] > parameters[name])
        return Evidence(("r",), "m", Noise(1.0, ""), Motion(1.0), bare, bare, left, (
            EffectEvidence(name, {}, bare, (rival,), margin=9.0, **heard.get(name, {})),),
            graded=True)

    monkeypatch.setattr(grading, "gather", gather)
    monkeypatch.setattr(grading, "with_witness", lambda e, _: e)
    monkeypatch.setattr(grading, "_rivals", lambda _s, _w, name, *_: [
        grading.Rival(n, -100.0 if n == first else 100.0, fits[n])
        for n in parameters if n != name])
    search = SimpleNamespace(most_steps=1e9, steps=0.0, library=tuple(parameters),
                             begin_work=lambda _: None, settled=lambda _, f: f)
    trial = SimpleNamespace(search=search, witness=None, no_worse=lambda h: h, dropped={})
    second, = parameters.keys() - {first}
    h, _ = grading._standing(trial, (first,), fits[first], fits[second], (), False)
    return len(seen), h.names


UNHEARD = {"coulomb_friction": {"force_share": 0.3, "in_best": False}}


@pytest.mark.parametrize(("margin", "heard", "judged", "told"), [
    (-2.5, {}, 2, "coulomb_friction"),
    (0.0, {}, 1, "stribeck_friction"),  # no block tells
    (-2.5, UNHEARD, 2, "stribeck_friction")])
def test_of_two_that_held_out_blocks_do_not_part_the_simpler_one_is_told(
        monkeypatch, margin, heard, judged, told):
    """A Stribeck curve fits a record of dry friction better by its further parameters. Where
    dry friction falls for another reason, the curve stays, as it stood."""
    parameters = {"coulomb_friction": 3, "stribeck_friction": 5}
    assert judged_in_turn(monkeypatch, parameters, "stribeck_friction", margin, heard) == (
        judged, (told,))


CONFIRMED = {"eddy_current_damping": {"force_margin": 3.1, "confirmed": True}}


@pytest.mark.parametrize(("other", "margin", "heard", "judged", "told"), [
    ("coulomb_friction", 2.9, {}, 2, "coulomb_friction"),
    ("coulomb_friction", 3.1, {}, 1, "eddy_current_damping"),
    ("coulomb_friction", 2.9, CONFIRMED, 1, "eddy_current_damping"),
    ("coulomb_friction", 2.9, {"eddy_current_damping": {"force_margin": 3.1}}, 2,
     "coulomb_friction"),
    ("coulomb_friction", 2.9, UNHEARD, 2, "eddy_current_damping"),
    ("cubic_stiffness", 2.9, {}, 1, "eddy_current_damping"),
    ("stribeck_friction", 2.9, {}, 2, "stribeck_friction"),
    ("stribeck_friction", 3.1, {}, 1, "eddy_current_damping"),
    ("quadratic_damping", 2.9, {}, 1, "eddy_current_damping")])
def test_a_rare_effect_gives_way_to_a_level_one_that_looks_like_it(monkeypatch, other, margin,
                                                                   heard, judged, told):
    """Also to one with as many parameters; where the force domain has no doubt, it stays."""
    parameters = {other: 4, "eddy_current_damping": 4}
    assert judged_in_turn(monkeypatch, parameters, "eddy_current_damping", margin, heard) == (
        judged, (told,))


@pytest.mark.slow
def test_an_effect_stands_beside_the_given_base_where_held_out_records_refute_another():
    """A vibration beside damping that grows with position, which bends the base."""
    answer = diagnosed_files(make_case(measured_plan("remainder", 16, 1040220614)[15]))
    assert answer["verdict"] == "partial"
    assert [e["name"] for e in answer["effects"]] == ["periodic_disturbance"]
    assert answer["effects"][0]["parameters"]["frequency"]["value"] == pytest.approx(14.852,
                                                                                     abs=0.005)


DATA = Path(os.environ.get("DFM_SHARED_DATA") or Path(__file__).resolve().parents[4]
            / "shared" / "data")


def measured(folder, fitted, held):
    if not (DATA / folder / f"{fitted}.npz").is_file():
        pytest.skip("the recorded data are not here (DFM_SHARED_DATA or ../shared/data)")
    records = [read_record(DATA / folder / f"{name}.npz") for name in (fitted, held)]
    return diagnose(records[:1], load_model(DATA / folder / "model.yaml"), holdout=records[1:])


@pytest.mark.slow
def test_the_hardening_circuit():
    found = measured("silverbox", "train", "holdout_multisine")
    assert found.verdict == "named"
    assert found.names[0] == "cubic_stiffness"
    assert set(found.names) <= {"cubic_stiffness", "quadratic_stiffness"}
    assert found.gap.to_dict()["held_out"]["after"] <= 0.31e-3
    assert {c["input_hold"] for c in found.conventions} == {"band_limited"}


@pytest.mark.slow
def test_the_servo_axis_with_its_published_figures():
    """The mass is given and the force constant free: scaled to the published 35.15 N/V."""
    found = measured("emps", "train", "holdout")
    assert found.verdict == "named"
    assert set(found.names) == {"coulomb_friction", "force_offset"}
    assert found.gap.judged == "velocity"
    force = {e.name: e.parameters["force"].value for e in found.effects}
    scale = 35.15 / found.base["force_constant"].value
    assert found.model.base["mass"] * scale == pytest.approx(95.11, rel=0.02)
    assert force["force_offset"] * scale == pytest.approx(3.165, rel=0.05)
    assert found.base["damping"].value * scale == pytest.approx(203.5, rel=0.08)
    assert force["coulomb_friction"] * scale == pytest.approx(20.39, rel=0.08)
