"""Words for a verdict, from hand-made evidence."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from dfm_stage.diagnosis import wording
from dfm_stage.diagnosis.evidence import (
    DropReason,
    EffectEvidence,
    Errors,
    Evidence,
    Judged,
    ModelEvidence,
    Motion,
    Noise,
    Offset,
    OtherLaw,
    Proposal,
    RivalEvidence,
)
from dfm_stage.diagnosis.rejections import Rejected, Rejection
from dfm_stage.diagnosis.remainder import Finding
from dfm_stage.diagnosis.result import told
from dfm_stage.diagnosis.verdict import (
    Doubt,
    Found,
    Reason,
    Verdict,
    verdict,
)
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import Model

MODEL = Model("stage", 1e-3, {"mass": 1.0, "stiffness": 650.0})
GAP = ModelEvidence(Errors(2e-6, 5e4, 1000), Errors(2.1e-6, 5e4, 1000),
                    {"stiffness": Quantity(651.0, "N/m", (650.0, 652.0))})
CLOSED = ModelEvidence(Errors(1e-7, 1e3, 1000), Errors(1.1e-7, 1e3, 1000, power=1.21e-14),
                       {"stiffness": Quantity(650.0, "N/m"),
                        "cubic_stiffness.k3": Quantity(3e6, "N/m^3")})
SPRING = EffectEvidence(
    "cubic_stiffness", {"k3": Quantity(3e6, "N/m^3", (2.9e6, 3.1e6))}, GAP,
    (RivalEvidence("force_constant_droop", 30.4, 30.4, Errors(1e-7, 1e3)),
     RivalEvidence("quadratic_damping", 90.0, 90.0, Errors(1e-7, 2e3))))
NAMED = Evidence(("run",), "m", Noise(1e-7, "residuals"), Motion(1e-3), GAP, GAP, CLOSED,
                 (SPRING,))
NONE = replace(NAMED, extended=GAP, effects=())


def test_a_named_effect_in_a_sentence_with_what_speaks_for_it():
    v = verdict(NAMED)
    assert wording.sentence(NAMED, v) == (
        "The model lacks cubic stiffness: with it the held-out gap falls to 1.10 times the noise "
        "floor.")
    lines = list(wording.effect_evidence(NAMED, v.effects[0]))
    assert lines[0] == "chi-square rises by 49000 without it (limit 40)"
    assert lines[1] == "held-out RMS 2.1 µm without it, 110 nm with it"
    assert lines[3:] == ["force_constant_droop in its place costs 30 in chi-square",
                         "quadratic_damping in its place costs 90 in chi-square"]


def test_a_remainder_is_said_and_where_it_was_judged():
    held = replace(CLOSED.held_out, power=1.6e-13)
    e = replace(NAMED, graded=True, retuned=replace(
        GAP, held_out=replace(GAP.held_out, power=4.1e-12)),
        extended=replace(CLOSED, held_out=held), judged=Judged("velocity", 0.5, 1e-13))
    found = (Found("cubic_stiffness", ("cubic_stiffness",), 0.98, 5e4),)
    words = wording.sentence(e, Verdict("named", Reason.GRADED, found, remainder=True))
    assert words == ("The model lacks cubic stiffness: it explains 98% of the held-out gap's "
                     "power (in velocity, windows of 0.5 s); a remainder of 1.5 % stays.")
    two = (*found, Found("coulomb_friction", ("coulomb_friction",), 0.1, 1e3))
    words = wording.sentence(e, Verdict("named", Reason.GRADED, two, remainder=True))
    assert words.startswith("The model lacks cubic stiffness and coulomb friction: they explain")
    part = wording.sentence(e, Verdict("partial", Reason.GRADED, found, remainder=True))
    assert part.startswith("A part of what is missing behaves like cubic stiffness: 98%")


def test_the_floor_told_is_that_of_the_periods():
    e = replace(NAMED, noise=Noise(1e-7, "residuals", 5.5e-8))
    assert wording.sentence(e, verdict(e)).endswith("falls to 2.00 times the noise floor.")


@pytest.mark.parametrize(("said", "kind", "told"), [
    (["quadratic_damping"], "named", True), (["cubic_stiffness"], "named", False),
    (["quadratic_damping", "cubic_stiffness"], "named", False), ([], "named", False)])
def test_the_force_domain_is_heard_where_it_says_something_else(said, kind, told):
    e = replace(NAMED, witness={"effects": said, "share": 0.6})
    spoken = [w for w in wording.warnings(e, verdict(e)) if "force domain" in w]
    assert bool(spoken) is told


def test_a_class_is_told_as_one():
    v = Verdict("ambiguous", Reason.AT_FLOOR, (
        Found("transport_delay", ("transport_delay", "amplifier_bandwidth"), 1.0, 9.0),
        Found("creep", ("creep",), 0.1, 5.0)))
    assert wording.sentence(NAMED, v) == (
        "Something is missing that these data do not tell apart: transport delay or amplifier "
        "bandwidth; creep.")


@pytest.mark.parametrize("kind", ["none", "retune", "unknown", "not_excited"])
def test_every_other_verdict_has_a_sentence(kind):
    assert wording.sentence(NONE, Verdict(kind, Reason.NOISE)) == wording.SENTENCES[kind]


def test_a_law_of_no_effect_is_told_beside_the_effects_that_stand_in_for_it():
    e = replace(NAMED, other_law=OtherLaw("a force like x * v", 0.991, 0.478))
    name = NAMED.effects[0].name.replace("_", " ")
    assert wording.sentence(e, Verdict("unknown", Reason.OTHER_LAW)) == (
        f"The gap is real, and another law than that of {name} is behind it: a force like x * v "
        f"explains 99% of the missing force on held-out blocks, {name} 48%.")


def test_an_offset_speaks_of_the_readings():
    e = replace(NONE, offset=Offset("force_offset", 2e-6, 1e-9, 650.0))
    first, second = wording.effect_evidence(e, Found("force_offset", ("force_offset",), 1.0, 9.0))
    assert first == "the readings lie 2e-06 m from where the model has them"
    assert "encoder_zero" in second


@pytest.mark.parametrize(("reason", "said"), [
    (Reason.NOT_EXERCISED, "do not exercise creep and hysteresis"),
    (Reason.NOT_HELD_OUT, "creep and hysteresis: lowers the fitted gap, not the held-out one"),
    (Reason.NEAR, "creep and hysteresis: comes near"),
    (Reason.JOINT_FIT, "at 1.3 times the noise floor"),
    (Reason.ABOVE_FLOOR, "creep and hysteresis: explains the fitted records")])
def test_a_doubt_becomes_a_warning(reason, said):
    v = Verdict("named", Reason.AT_FLOOR, doubts=(Doubt(reason, ("creep", "hysteresis"), 1.26),))
    (words,) = wording.warnings(NAMED, v)
    assert said in words


def test_noise_with_a_colour_is_told():
    loud = {"run": (Finding("excess", 5.0, 2.0, "slow", coloured=True),)}
    e = replace(NONE, retuned=replace(NONE.retuned, findings=loud))
    (words,) = wording.warnings(e, Verdict("none", Reason.NOISE))
    assert words.startswith("run: what is left is stronger than its high frequencies")


@pytest.mark.parametrize(("speed", "unit", "doubted"), [
    (0.0187, "m/s", True), (0.2, "m/s", False), (0.9, "rad/s", False)])
def test_a_brake_that_no_metal_makes_is_doubted(speed, unit, doubted):
    """A crane's cart was told one of 19 mm/s; it has dry friction and no magnets."""
    name = "eddy_current_damping"
    brake = replace(SPRING, name=name, parameters={
        "damping": Quantity(1870.0, "N s/m" if unit == "m/s" else "N s/rad", None),
        "critical_velocity": Quantity(speed, unit, None)})
    e, v = replace(NAMED, effects=(brake,)), Verdict(
        "named", Reason.AT_FLOOR, (Found(name, (name,), 0.9, 100.0),))
    words = wording.warnings(e, v)
    assert any("dry friction" in w for w in words) is doubted


def test_warnings_stand_in_the_order_in_which_they_arose():
    v = Verdict("named", Reason.AT_FLOOR, doubts=(Doubt(Reason.NEAR, ("creep",)),))
    e = replace(NAMED, warnings=("of a record",), split=True,
                not_compared=("hysteresis", "creep"))
    first, second, third, fourth = wording.warnings(e, v)
    assert first == "of a record"
    assert "the last 30 % of each record are held out" in second
    assert "want of work: hysteresis, creep;" in third
    assert fourth.startswith("creep")


@pytest.mark.parametrize(("rejection", "said"), [
    (Rejection("creep", Rejected.RIVAL, 12.3, "hysteresis"),
     "in place of hysteresis: chi-square +12"),
    (Rejection("creep", Rejected.EXCLUDED, about="the model has it {already}"),
     "the model has it {already}"),
    (Rejection("creep", DropReason.AT_BOUND), "its parameters run to the edge of their range"),
    (Rejection("creep", DropReason.NO_SIZE), "the interval of its size holds zero"),
    (Rejection("creep", Rejected.COLOUR, 123.0),
     "chi-square falls by 123 where noise is taken as white, which it is not"),
    (Rejection("creep", Rejected.OTHER_LAW, 0.991, "a force like x * v"),
     "a force like x * v explains 99% of the missing force, clearly more"),
    (Rejection("creep", Rejected.SHARE, 0.123), "could take 12% of the gap at best"),
    (Rejection("creep", Rejected.BELOW_LIMIT, 12.3),
     "chi-square falls by 12, below the limit 40")])
def test_a_rejection_in_words(rejection, said):
    assert wording.rejection(rejection) == said


def test_every_reason_has_words():
    assert set(wording.REJECTED) == {*Rejected, *DropReason}
    assert set(wording.DOUBTS) < set(Reason)


@pytest.mark.parametrize(("expected", "said"), [
    (63.6, ("In 48 s it is expected to part transport delay and amplifier bandwidth by 64 in "
     "chi-square (needed: 16).")),
    (15.9, ("No experiment within the recorded voltage and travel is expected to part transport "
     "delay and amplifier bandwidth; this one comes nearest, with 15.9 in chi-square (needed: "
     "16) in 48 s.")),
    (None, None)])
def test_an_experiment_says_what_is_expected_of_it(expected, said):
    spec = {"name": "next", "description": "A multisine.", "duration_s": 48.0}
    proposal = Proposal(spec, ("transport_delay", "amplifier_bandwidth"), expected)
    words = wording.experiment(proposal)["description"]
    assert words.startswith("A multisine. ")
    assert "In general: " in words
    assert said is None or said in words
    assert spec["description"] == "A multisine."


def test_a_diagnosis_is_put_together_as_schema_2():
    extended = MODEL.with_effect("cubic_stiffness", {"k3": 3e6})
    found = told(NAMED, verdict(NAMED), extended)
    data = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert data["schema"] == 2
    assert data["schema_note"].startswith("schema 2 keeps every key")
    assert data["verdict"] == "named"
    assert data["complete"] is True
    assert data["effects"][0]["class"] == ["cubic_stiffness"]
    assert data["effects"][0]["gap_share"] == 1.0
    assert data["base"] == {"stiffness": {"value": 650.0, "unit": "N/m", "ci95": None}}
    assert data["gap"]["fit"] == {"before": 2e-6, "retuned": 2e-6, "after": 1e-7}
    assert data["gap"]["held_out"] == {"before": 2.1e-6, "retuned": 2.1e-6, "after": 1.1e-7}
    assert [r["name"] for r in data["rejected"]] == ["force_constant_droop", "quadratic_damping"]
    assert found.model.effect("cubic_stiffness").origin == {
        "diagnosed_from": ["run"], "ci95": {"k3": [2.9e6, 3.1e6]}}


def test_an_offset_is_told_as_a_force_with_its_interval():
    e = replace(NONE, retuned=CLOSED, given=CLOSED,
                offset=Offset("force_offset", 1e-6, 1e-8, 650.0))
    (effect,) = told(e, verdict(e), MODEL).effects
    force = effect.parameters["force"]
    assert force.value == pytest.approx(6.5e-4)
    assert force.ci95 == pytest.approx((6.5e-4 - 1.27e-5, 6.5e-4 + 1.27e-5), rel=1e-2)


def test_detection_limits_are_told_where_nothing_was_found():
    limits = {"creep": {"gain": Quantity(0.1, "1")}}
    quiet = replace(NONE, retuned=CLOSED, given=CLOSED, limits=limits)
    assert told(quiet, verdict(quiet), MODEL).detection_limits == limits
    assert told(replace(NAMED, limits=limits), verdict(NAMED), MODEL).detection_limits == {}
