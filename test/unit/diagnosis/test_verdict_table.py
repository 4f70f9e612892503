"""Verdicts by hand-made evidence: each row is a case that a user could meet."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Mapping
from dataclasses import replace

import made_evidence as made
import pytest

from dfm_stage.diagnosis.evidence import (
    Candidate,
    DropReason,
    Errors,
    Evidence,
    Judged,
    ModelEvidence,
    Motion,
    Noise,
    Offset,
    OtherLaw,
)
from dfm_stage.diagnosis.rejections import Rejected
from dfm_stage.diagnosis.remainder import Finding
from dfm_stage.diagnosis.verdict import (
    Reason,
    is_clearly_more,
    is_coloured_noise,
    needs_grading,
    needs_joint_fit,
    verdict,
)

NOISE, LEFT, QUIET, COLOURED = made.NOISE, made.LEFT, made.QUIET, made.COLOURED
left, NO_GAP, CLEAR, case = made.left, made.NO_GAP, made.CLEAR, made.case
effect, rival, at, part, parts = made.effect, made.rival, made.at, made.part, made.parts
found, FRICTION, NEAR_FLOOR, PUSH = made.found, made.FRICTION, made.NEAR_FLOOR, made.PUSH
MOVING_AT_NOISE = made.MOVING_AT_NOISE
LAW = OtherLaw("a force like x * v", 0.99, 0.9)

module = importlib.import_module("dfm_stage.diagnosis.verdict")
# what a user met, the evidence, and what is said of it
ROWS: Mapping[str, tuple[Evidence, str, tuple[str, ...], Reason]] = {
    "nothing is missing": (case(), "none", (), Reason.NOISE),
    "the mass ratio was wrong": (case(left(1e-6)), "retune", (), Reason.RETUNED),
    "noise with a colour": (
        case(retuned=replace(NO_GAP, findings=COLOURED)), "none", (), Reason.NOISE),
    "a constant in a reading that wanders": (
        case(retuned=replace(NO_GAP, findings=COLOURED), offset=PUSH), "none", (), Reason.NOISE),
    "a stiffness off by what chi-square hardly shows": (
        case(left(1e-8, above=59.0)), "none", (), Reason.NOISE),
    "a stiffness off by what it just shows": (
        case(left(1e-8, above=61.0)), "retune", (), Reason.RETUNED),
    "better in chi-square, but not by 0.2 % of the RMS": (
        case(left(5e-9, above=100.0)), "none", (), Reason.NOISE),
    "better in chi-square, and by 0.25 % of the RMS": (
        case(left(7.1e-9, above=100.0)), "retune", (), Reason.RETUNED),
    "Coulomb friction, clear": (
        found(FRICTION), "named", ("coulomb_friction",), Reason.AT_FLOOR),
    "two effects": (
        found(FRICTION, effect("creep", without=left(2e-7))), "named",
        ("coulomb_friction", "creep"), Reason.AT_FLOOR),
    "two effects, the larger found last": (
        found(effect("creep", without=left(2e-7)), FRICTION), "named",
        ("coulomb_friction", "creep"), Reason.AT_FLOOR),
    "two laws of speed that stand in for one": (
        replace(found(FRICTION, effect("quadratic_damping", without=left(2e-7))),
                one_law=("coulomb_friction", "quadratic_damping")), "partial",
        ("coulomb_friction", "quadratic_damping"), Reason.AT_FLOOR),
    "two laws of speed that stand in for one, and a remainder": (
        replace(parts(0.97, coulomb_friction=0.4, quadratic_damping=0.3),
                one_law=("coulomb_friction", "quadratic_damping")), "partial",
        ("coulomb_friction", "quadratic_damping"), Reason.GRADED),
    "the same, where no one law does better": (
        parts(0.97, coulomb_friction=0.4, quadratic_damping=0.3), "named",
        ("coulomb_friction", "quadratic_damping"), Reason.GRADED),
    "an effect that stands in for a law of no effect": (
        replace(parts(0.97, coulomb_friction=0.97), other_law=LAW), "unknown", (),
        Reason.OTHER_LAW),
    "a delay that may be a lag": (
        found(effect("transport_delay", rival("amplifier_bandwidth", 1.0, 2.0))),
        "ambiguous", ("transport_delay",), Reason.AT_FLOOR),
    "a rival just within the margin": (
        found(effect("hysteresis", rival("presliding_friction", 10.0, 5.9))),
        "ambiguous", ("hysteresis",), Reason.AT_FLOOR),
    "a rival just beyond the margin, held out": (
        found(effect("hysteresis", rival("presliding_friction", 10.0, 6.1))),
        "named", ("hysteresis",), Reason.AT_FLOOR),
    "a rival that fits worse and predicts better": (
        found(effect("hysteresis", rival("presliding_friction", 17.0, -17.0))),
        "named", ("hysteresis",), Reason.AT_FLOOR),
    "pre-sliding too short to be seen beside dry friction": (
        found(effect("coulomb_friction", rival("presliding_friction", 0.0, 0.0, 2.9))),
        "named", ("coulomb_friction",), Reason.AT_FLOOR),
    "pre-sliding just long enough to be seen": (
        found(effect("coulomb_friction", rival("presliding_friction", 0.0, 0.0, 3.1))),
        "ambiguous", ("coulomb_friction",), Reason.AT_FLOOR),
    "one of two effects is not told apart from another": (
        found(FRICTION, effect("transport_delay", rival("coil_inductance", 2.0))),
        "ambiguous", ("coulomb_friction", "transport_delay"), Reason.AT_FLOOR),
    "held-out records do not exercise it, the fitted ones show it well": (
        found(effect("saturation", exercised=False)), "named", ("saturation",),
        Reason.AT_FLOOR),
    "held-out records do not exercise it, the fitted ones show little": (
        case(NO_GAP, left(9e-9, above=79.0), NO_GAP,
             (effect("saturation", exercised=False),)), "none", (), Reason.NOISE),
    "held-out records do not exercise it, the fitted ones show twice the limit": (
        case(CLEAR, left(9e-9, above=81.0), NO_GAP, (effect("saturation", exercised=False),)),
        "named", ("saturation",), Reason.AT_FLOOR),
    "not exercised, and held-out chi-square rises by less than that means": (
        case(CLEAR, left(1e-6, held=0.0), left(0.0, held_above=19.0),
             (effect("saturation", exercised=False),)), "named", ("saturation",),
        Reason.AT_FLOOR),
    "not exercised, and it rises by more, with values that serve both, too": (
        replace(case(CLEAR, left(1e-6, held=0.0), left(0.0, held_above=21.0),
                     (effect("saturation", exercised=False),)),
                joint=(1.0 * NOISE, 1.21 * NOISE)), "none", (), Reason.NOISE),
    "not exercised, and it rises by more, but other values serve both": (
        replace(case(CLEAR, left(1e-6, held=0.0), left(0.0, held_above=21.0),
                     (effect("saturation", exercised=False),)),
                joint=(1.0 * NOISE, 1.19 * NOISE)), "named", ("saturation",), Reason.JOINT_FIT),
    "exercised, and it rises, though other values serve both": (
        replace(case(CLEAR, left(1e-6, held=0.0), left(0.0, held_above=21.0), (FRICTION,)),
                joint=(1.0 * NOISE, 1.0 * NOISE)), "none", (), Reason.NOISE),
    "not exercised, given values stand, and it rises by what retuning may": (
        case(left(1e-6, held=0.0), left(1e-6, held=0.0), left(0.0, held_above=55.0),
             (effect("saturation", exercised=False),)), "named", ("saturation",),
        Reason.AT_FLOOR),
    "not exercised, given values stand, and it rises by more than that": (
        replace(case(left(1e-6, held=0.0), left(1e-6, held=0.0), left(0.0, held_above=61.0),
                     (effect("saturation", exercised=False),)),
                joint=(1.1 * NOISE, 1.0 * NOISE)), "none", (), Reason.NOISE),
    # held-out records leave 0.24 of the noise's power, by samples that jitter
    "lowers a held-out gap that is more than noise by a quarter": (
        case(NO_GAP, left(2e-8, held=5.7e-8), left(held=4.9e-8), (FRICTION,)),
        "none", (), Reason.NOISE),
    "lowers a held-out gap that is more than noise by a third": (
        case(NO_GAP, left(2e-8, held=6.1e-8), left(held=4.9e-8), (FRICTION,)),
        "named", ("coulomb_friction",), Reason.AT_FLOOR),
    "lowers a held-out gap by a quarter, down to noise": (
        case(NO_GAP, left(2e-8, held=4.4e-8), left(held=3.8e-8), (FRICTION,)),
        "named", ("coulomb_friction",), Reason.AT_FLOOR),
    "a body that drifts: its velocity is predicted better, its position worse": (
        case(CLEAR, left(1e-6, held=3.6e-8), replace(left(), held_out=replace(
            left(held=3.8e-8).held_out, chi2=10_000.0, power=NOISE**2)), (FRICTION,)),
        "none", (), Reason.NOISE),
    "lowers the fitted gap, not the held-out one": (
        case(CLEAR, left(1e-6, held=1e-6, remainder=True), left(held=2e-6), (FRICTION,)),
        "unknown", (), Reason.REMAINDER),
    "better in held-out chi-square, and worse by 0.15 % of the RMS": (
        case(CLEAR, left(1e-6, held=0.0), left(held=5.5e-9, held_above=-50.0), (FRICTION,)),
        "named", ("coulomb_friction",), Reason.AT_FLOOR),
    "better in held-out chi-square, and worse by 0.25 % of the RMS": (
        case(CLEAR, left(1e-6, held=0.0), left(held=7.1e-9, held_above=-50.0), (FRICTION,)),
        "none", (), Reason.NOISE),
    "no better on held-out records": (
        case(CLEAR, left(1e-6, held=0.0), left(0.0), (FRICTION,)), "none", (), Reason.NOISE),
    "comes near, but a line is left": (
        found(FRICTION, after=left(4e-7, remainder=True)), "unknown", (), Reason.REMAINDER),
    "held out 1.19 times the floor": (
        found(FRICTION, after=left(held=0.645 * NOISE)), "named", ("coulomb_friction",),
        Reason.AT_FLOOR),
    "held out 1.21 times the floor, and no other values serve": (
        found(FRICTION, after=left(held=0.681 * NOISE), joint=(1.1 * NOISE, 1.1 * NOISE)),
        "unknown", (), Reason.REMAINDER),
    "held out above the floor, but as far as the parameters are known": (
        found(FRICTION, after=NEAR_FLOOR, joint=(1.04 * NOISE, 1.19 * NOISE)), "named",
        ("coulomb_friction",), Reason.JOINT_FIT),
    "values that serve both leave the held-out gap open": (
        found(FRICTION, after=NEAR_FLOOR, joint=(1.04 * NOISE, 1.21 * NOISE)), "unknown", (),
        Reason.REMAINDER),
    "values that serve both fit the fitted records 6 % worse": (
        found(FRICTION, after=NEAR_FLOOR, joint=(1.066 * NOISE, 1.19 * NOISE)), "unknown", (),
        Reason.REMAINDER),
    "no effect explains the gap": (case(CLEAR, CLEAR), "unknown", (), Reason.REMAINDER),
    "an effect at its bound was dropped, and nothing else is left": (
        case(library=(Candidate("creep", gain=90.0, dropped=DropReason.AT_BOUND),)), "none", (),
        Reason.NOISE),
    "explains 97 % of the predictable gap, a remainder stays": (
        part(0.97), "named", ("coulomb_friction",), Reason.GRADED),
    "explains 95 % of the gap": (part(0.95), "named", ("coulomb_friction",), Reason.GRADED),
    "explains 93 % of the gap": (part(0.93), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains 77 % of the gap, of which 80 % can be predicted at all": (
        part(0.77, predictable=0.8), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains 25 % of the gap, of which 80 % can be predicted at all": (
        part(0.25, predictable=0.8), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains 90 % of a small gap, and brings it to the noise": (
        part(0.9, gap=NOISE), "named", ("coulomb_friction",), Reason.GRADED),
    "explains 50 % of a small gap": (
        part(0.5, gap=NOISE), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains 31 % of the gap": (part(0.31), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains 29 % of the gap": (part(0.29), "unknown", (), Reason.GRADED),
    "explains most, with a rival 2.9 standard errors behind": (
        part(0.97, at(2.9)), "ambiguous", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a rival 3.1 standard errors behind": (
        part(0.97, at(3.1)), "named", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a larger rival 2.1 standard errors behind": (
        part(0.97, at(2.1, larger=True)), "named", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a larger rival 1.9 standard errors behind": (
        part(0.97, at(1.9, larger=True)), "ambiguous", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a rival far behind that the force domain puts before it": (
        part(0.97, at(30.0, ahead=True)), "ambiguous", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a rarer rival that held-out blocks do not part from it": (
        part(0.97, at(-2.9, rarer=True)), "named", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a rarer rival that held-out blocks clearly prefer": (
        part(0.97, at(-3.1, rarer=True)), "ambiguous", ("coulomb_friction",), Reason.GRADED),
    "explains most, with a rarer rival that the force domain puts before it": (
        part(0.97, at(1.0, rarer=True, ahead=True)), "ambiguous", ("coulomb_friction",),
        Reason.GRADED),
    "explains most, with a larger rival that makes the same motion": (
        part(0.97, at(0.0, larger=True, repeats=True)), "named", ("coulomb_friction",),
        Reason.GRADED),
    "explains all, with a larger rival that makes the same motion": (
        found(effect("one_sided_cable", replace(rival("backlash", 2.0), larger=True,
                                                repeats=True))),
        "named", ("one_sided_cable",), Reason.AT_FLOOR),
    "explains all, with a larger rival that does as well by another motion": (
        found(effect("one_sided_cable", replace(rival("backlash", 2.0), larger=True))),
        "ambiguous", ("one_sided_cable",), Reason.AT_FLOOR),
    "explain most together, and one could be left out": (
        parts(0.99, coulomb_friction=0.11, force_constant_slope=0.02), "named",
        ("coulomb_friction", "force_constant_slope"), Reason.GRADED),
    "explain most together, and each could be left out": (
        parts(0.99, coulomb_friction=0.09, force_constant_slope=0.02), "partial",
        ("coulomb_friction", "force_constant_slope"), Reason.GRADED),
    "explains a part, with a rival level": (
        part(0.5, at(0.0)), "partial", ("coulomb_friction",), Reason.GRADED),
    "explains most, with the damping at nothing": (
        part(0.97, base_shares={"damping": 8e-10, "stiffness": 1.0}), "partial",
        ("coulomb_friction",), Reason.GRADED),
    "is linear and explains most, with the damping at nothing": (
        part(0.97, base_shares={"damping": 8e-10}, linear=True), "unknown", (), Reason.GRADED),
    "explains most, with the stiffness at nothing": (
        part(0.97, base_shares={"damping": 1.0, "stiffness": 8e-10}), "unknown", (),
        Reason.GRADED),
    "explains most, with next to no damping": (
        part(0.97, base_shares={"damping": 1.2e-9}), "named", ("coulomb_friction",),
        Reason.GRADED),
    "the stage at rest": (case(motion=Motion(NOISE)), "not_excited", (), Reason.REST),
    "moving at 8 times the noise": (case(motion=MOVING_AT_NOISE), "not_excited", (),
                                    Reason.REST),
    "moving at 13 times the noise": (case(motion=Motion(13 * NOISE)), "none", (),
                                     Reason.NOISE),
    "moving at 20 times the noise with a constant input": (
        case(motion=Motion(20 * NOISE, constant_input=True)), "not_excited", (),
        Reason.REST),
    "moving at 31 times the noise with a constant input": (
        case(motion=Motion(31 * NOISE, constant_input=True)), "none", (), Reason.NOISE),
    "an untrusted offset": (case(offset=PUSH), "ambiguous", ("force_offset",), Reason.OFFSET),
    "an offset of 5 standard errors": (
        case(offset=Offset("force_offset", 1e-6, 2e-7, 650.0)), "none", (), Reason.NOISE),
    "an offset of 7 standard errors": (
        case(offset=Offset("force_offset", 1e-6, 1.4e-7, 650.0)), "ambiguous", ("force_offset",),
        Reason.OFFSET),
    "an offset that is clear and nine hundredths of the noise": (
        case(offset=Offset("force_offset", 9e-9, 1e-10, 650.0)), "none", (), Reason.NOISE),
    "an offset that is clear and eleven hundredths of the noise": (
        case(offset=Offset("force_offset", 1.1e-8, 1e-10, 650.0)), "ambiguous", ("force_offset",),
        Reason.OFFSET),
    "an offset beside a gap": (case(CLEAR, CLEAR, offset=PUSH), "unknown", (),
                               Reason.REMAINDER),
    "an offset and an effect that does not pass": (
        case(CLEAR, left(1e-6), left(held=2e-6), (FRICTION,), offset=PUSH), "ambiguous",
        ("force_offset",), Reason.OFFSET),
    "noise above what the model gives": (
        case(retuned=replace(NO_GAP, findings={"run": (
            Finding("known_noise", 2.1, 2.0, "RMS over the noise that the model gives"),)})),
        "unknown", (), Reason.REMAINDER),
    "a model that cannot be simulated without the effect": (
        case(CLEAR, ModelEvidence(Errors(0.0, math.inf), Errors(math.inf, math.inf)), NO_GAP,
             (FRICTION,)), "named", ("coulomb_friction",), Reason.AT_FLOOR),
}


@pytest.mark.parametrize("met", ROWS)
def test_the_verdict_on(met):
    evidence, kind, names, reason = ROWS[met]
    v = verdict(evidence)
    assert (v.kind, tuple(f.name for f in v.effects), v.reason) == (kind, names, reason)


@pytest.mark.parametrize("factor", [0.5, 1.5])
@pytest.mark.parametrize("name", [
    "AT_REST", "AT_REST_INPUT", "BASE_AT_ZERO", "BLOCK_MARGIN", "FITTED_ALONE", "HELD_OUT_FLOOR",
    "JOINT_LOSS", "MARGIN", "MARGIN_OVER_LARGER", "NAMED_SHARE", "NOT_EXERCISED",
    "OFFSET_NOISE", "OFFSET_SIGMAS", "PARTIAL_SHARE", "PRESLIDING_DISTANCE", "RETUNE_GAIN",
    "RETUNE_RATIO"])
def test_the_rows_would_notice_a_threshold_that_moved(monkeypatch, name, factor):
    """A ratio near 1 moves by what it is above 1."""
    value = getattr(module, name)
    near = name in ("HELD_OUT_FLOOR", "JOINT_LOSS", "RETUNE_RATIO")
    moved = 1.0 + factor * (value - 1.0) if near else factor * value
    monkeypatch.setattr(module, name, moved)
    assert any(verdict(e).kind != kind for e, kind, _, _ in ROWS.values())


def test_classes_stand_with_their_effects_and_only_open_ones_are_undecided():
    v = verdict(ROWS["one of two effects is not told apart from another"][0])
    assert {f.name: f.members for f in v.effects} == {
        "coulomb_friction": ("coulomb_friction",),
        "transport_delay": ("transport_delay", "coil_inductance")}
    assert v.undecided == ("transport_delay", "coil_inductance")


@pytest.mark.parametrize(("met", "doubts"), [
    ("Coulomb friction, clear", []),
    ("held-out records do not exercise it, the fitted ones show it well",
     [Reason.NOT_EXERCISED]),
    ("held-out records do not exercise it, the fitted ones show little",
     [Reason.NOT_EXERCISED]),
    ("lowers the fitted gap, not the held-out one", [Reason.NOT_HELD_OUT]),
    ("comes near, but a line is left", [Reason.NEAR]),
    ("held out above the floor, but as far as the parameters are known",
     [Reason.JOINT_FIT]),
    ("values that serve both leave the held-out gap open", [Reason.ABOVE_FLOOR])])
def test_the_doubts_beside_the_verdict_where(met, doubts):
    assert [d.reason for d in verdict(ROWS[met][0]).doubts] == doubts


def test_without_effects_there_is_nothing_to_doubt():
    assert not any(verdict(e).doubts for e, *_ in ROWS.values() if not e.effects)


@pytest.mark.parametrize(("met", "shown", "model", "remainder"), [
    ("two laws of speed that stand in for one", "extended", "extended", True),
    ("Coulomb friction, clear", "extended", "extended", False),
    ("explains 97 % of the predictable gap, a remainder stays", "extended", "extended", True),
    ("comes near, but a line is left", "retuned", "given", True),
    ("the mass ratio was wrong", "retuned", "retuned", False),
    ("nothing is missing", "retuned", "given", False),
    ("an untrusted offset", "retuned", "given", False)])
def test_the_model_shown_and_the_model_to_go_on_with_where(met, shown, model, remainder):
    v = verdict(ROWS[met][0])
    assert (v.shown, v.model, v.remainder) == (shown, model, remainder)


def test_a_fit_to_all_records_is_asked_for_only_where_the_verdict_hangs_on_it():
    asked = found(FRICTION, after=NEAR_FLOOR)
    assert needs_joint_fit(asked)
    assert not needs_joint_fit(replace(asked, joint=(1.0, 1.0)))
    idle = case(CLEAR, left(1e-6, held=0.0), left(0.0, held_above=21.0),
                (effect("saturation", exercised=False),))
    assert needs_joint_fit(idle)
    assert not any(needs_joint_fit(row[0]) for row in ROWS.values())


def test_an_effect_takes_its_share_of_the_gap_above_the_noise():
    v = verdict(found(FRICTION, effect("creep", without=left(0.5e-6)),
                      judged=Judged(noise_power=NOISE**2)))
    assert [f.share for f in v.effects] == pytest.approx([1.0, 0.25])


@pytest.mark.parametrize(("candidate", "kind", "value"), [
    (Candidate("creep", excluded="needs something"), Rejected.EXCLUDED, math.nan),
    (Candidate("creep", gain=90.0, dropped=DropReason.AT_BOUND), DropReason.AT_BOUND,
     math.nan),
    (Candidate("creep"), Rejected.NO_RESPONSE, math.nan),
    (Candidate("creep", gain=-3.0), Rejected.NO_RESPONSE, math.nan),
    (Candidate("creep", gain=39.0), Rejected.BELOW_LIMIT, 39.0),
    (Candidate("creep", gain=250_000.0, above=1e6), Rejected.SHARE, 0.25),
    (Candidate("creep", gain=2e6, above=1e6), Rejected.SHARE, 1.0)])
def test_an_effect_of_the_library_is_rejected_with_its_reason(candidate, kind, value):
    (only,) = verdict(case(CLEAR, CLEAR, library=(candidate,))).rejected
    assert (only.name, only.reason) == ("creep", kind)
    assert only.value == pytest.approx(value, nan_ok=True)


def test_what_white_noise_would_show_is_no_gap_where_noise_has_a_colour():
    quiet = case(library=(Candidate("creep", gain=77_786_211.0, above=8e7),))
    (only,) = verdict(quiet).rejected
    assert (only.reason, only.value) == (Rejected.COLOUR, 77_786_211.0)
    # an autoregression may take a gap for the colour of noise: it is one all the same
    swallowed = replace(quiet, retuned=left(remainder=True))
    (only,) = verdict(swallowed).rejected
    assert (only.reason, only.value) == (Rejected.SHARE, pytest.approx(0.97, abs=0.01))


@pytest.mark.parametrize(("findings", "taken"), [
    (QUIET, False), (COLOURED, True), (LEFT, False),
    ({"run": (*COLOURED["run"], *LEFT["run"])}, False)])
def test_a_colour_is_taken_for_that_of_noise_only_where_no_gap_is_left(findings, taken):
    assert is_coloured_noise(case(retuned=replace(NO_GAP, findings=findings))) is taken


def test_what_is_left_is_no_noise_floor_where_it_holds_a_remainder():
    assert Noise(13e-3, "residuals").floor == (13e-3, "residuals")
    assert Noise(13e-3, "residuals", None, 2e-4).floor == (2e-4, "high frequencies")
    assert Noise(13e-3, "residuals", 2.1e-4, 2e-4).floor == (2.1e-4, "periods")


def test_rivals_are_rejected_once_and_what_did_not_pass_says_so():
    e = found(effect("hysteresis", rival("presliding_friction", 50.0)), after=left(
        4e-7, remainder=True), library=(Candidate("presliding_friction", gain=1.0),
                                        Candidate("hysteresis", gain=1.0)))
    first, second = verdict(e).rejected
    assert (first.name, first.reason, first.about) == (
        "presliding_friction", Rejected.RIVAL, "hysteresis")
    assert (second.name, second.reason) == ("hysteresis", Rejected.NOT_HELD_OUT)


def test_effects_that_stand_in_for_another_law_are_rejected_with_it():
    e = replace(parts(0.97, coulomb_friction=0.97), other_law=LAW, library=(
        Candidate("coulomb_friction", gain=1.0), Candidate("creep")))
    said = verdict(e)
    own, other = said.rejected
    assert (own.name, own.reason, own.about, own.value) == (
        "coulomb_friction", Rejected.OTHER_LAW, LAW.words, LAW.share)
    assert (other.name, other.reason) == ("creep", Rejected.NO_RESPONSE)
    assert (said.remainder, said.shown, said.model) == (True, "retuned", "given")


@pytest.mark.parametrize(("met", "graded"), [
    ("Coulomb friction, clear", False),
    ("nothing is missing", False),
    ("comes near, but a line is left", True),
    ("no effect explains the gap", True)])
def test_parts_are_looked_for_where(met, graded):
    assert needs_grading(replace(ROWS[met][0], judged=Judged(noise_power=NOISE**2))) is graded


@pytest.mark.parametrize(("leaves", "graded"), [(0.2, True), (0.5, False)])
def test_a_small_gap_counts_where_effects_take_nearly_all_of_it(leaves, graded):
    e = case(retuned=left(1e-6, held=1.2 * NOISE, remainder=True), effects=(FRICTION,),
             extended=left(1e-8, held=leaves * NOISE, remainder=True),
             judged=Judged(noise_power=NOISE**2))
    assert needs_grading(e) is graded


@pytest.mark.parametrize(("new", "known", "taken"), [
    (part(0.2), part(0.0), False),                        # both unknown
    (part(0.5), part(0.0), True),                         # a part, where nothing was
    (part(0.79), part(0.5), False), (part(0.81), part(0.5), True),
    (part(0.95), part(0.93), True),                       # named, where a part was
    (part(0.93), part(0.9), False),                       # both a part
    (part(0.96), part(0.95), False),                      # both named
    (found(FRICTION), part(0.9), True),                   # down to the noise
    (part(0.2), part(0.5), False)])
def test_uncommon_effects_must_explain_clearly_more(new, known, taken):
    """0.8 is where 40 % stay of what explaining half of the gap leaves."""
    assert is_clearly_more(new, known) is taken
