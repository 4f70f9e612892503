"""Which effects stand beside a remainder, and which fall."""

from __future__ import annotations

import math
from dataclasses import replace

import made_evidence as made
import numpy as np
import pytest

from dfm_stage.diagnosis.alike import kinds
from dfm_stage.diagnosis.evidence import DropReason, EffectEvidence
from dfm_stage.diagnosis.margins import Constancy
from dfm_stage.diagnosis.surface import Surface
from dfm_stage.diagnosis.verdict import fallen, small_parts, verdict
from dfm_stage.diagnosis.wording import sentence

left, at, part, found, FRICTION = made.left, made.at, made.part, made.found, made.FRICTION


LAGS = ("amplifier_bandwidth", "transport_delay", "sensor_lag")


@pytest.mark.parametrize(("names", "number"), [
    ((), 0), (LAGS, 1), (("creep", *LAGS, "cubic_stiffness"), 3),
    (("coulomb_friction", "eddy_current_damping"), 2),
    (("coulomb_friction", "eddy_current_damping", "stribeck_friction"), 2),  # a class with each
    (("transport_delay", "second_mode"), 2),
    (("transport_delay", "second_mode", "sensor_mount"), 2)])
def test_effects_of_one_class_are_one_kind(names, number):
    """One more name never makes fewer kinds."""
    assert kinds(names) == kinds(names[::-1]) == number


@pytest.mark.parametrize(("evidence", "reason"), [
    (part(0.9), None),
    (part(0.9, margin=2.9), DropReason.BLOCKS),
    (part(0.49), DropReason.SMALL_PART),
    (part(0.9, at(2.9)), None),
    (part(0.9, at(2.9), replace(at(2.9), name="creep")), DropReason.RIVALS),
    (part(0.9, at(-2.9, rarer=True), replace(at(2.9), name="creep")), None),
    (part(0.9, at(-3.1, rarer=True), replace(at(2.9), name="creep")), DropReason.RIVALS),
    (part(0.9, *(replace(at(2.9), name=n) for n in LAGS)), None),  # they are one kind
    (part(0.9, replace(at(-2.9), related=True)), None),
    (part(0.9, replace(at(-3.1), related=True)), DropReason.RIVALS)])
def test_an_effect_falls_beside_a_remainder(evidence, reason):
    assert fallen(evidence) == (None if reason is None else ("coulomb_friction", reason))


@pytest.mark.parametrize(("related", "finished", "joins"), [
    (True, False, True), (True, True, False), (False, False, False)])
def test_a_rival_of_its_kind_whose_fit_was_cut_short_joins_the_class(related, finished, joins):
    e = part(0.97, replace(at(9.0), related=related, finished=finished))
    members = ("coulomb_friction", "eddy_current_damping") if joins else ("coulomb_friction",)
    assert verdict(e).effects[0].members == members


@pytest.mark.parametrize(("share", "in_best", "falls"), [
    (0.49, False, True), (0.51, False, False), (0.49, True, False), (None, False, False)])
def test_an_effect_that_the_force_domain_does_not_find_falls(share, in_best, falls):
    e = part(0.9)
    e = replace(e, effects=(replace(e.effects[0], force_share=share, in_best=in_best),))
    assert (fallen(e) is not None) is falls


@pytest.mark.parametrize(("taken", "falls"), [(0.94, True), (0.96, False)])
def test_a_further_effect_may_take_nearly_all_of_what_is_left_unheard(taken, falls):
    """The force domain has two effects in a set at most."""
    e = part(0.99)
    further = replace(e.effects[0], name="force_offset", force_share=0.1, in_best=False,
                      without=part(1.0 - 0.01 / (1.0 - taken)).extended)
    found = fallen(replace(e, effects=(*e.effects, further)))
    assert found == (("force_offset", DropReason.UNHEARD) if falls else None)


@pytest.mark.parametrize(("explained", "heard", "lead", "confirmed", "falls"), [
    (0.49, 0.31, 3.1, True, False), (0.49, 0.29, 3.1, True, True), (0.49, 0.31, 2.9, True, True),
    (0.49, 0.61, 3.1, False, True), (0.29, 0.99, 9.0, True, True),
    (0.49, 0.31, math.inf, True, True)])  # nothing was compared
def test_less_is_enough_of_the_main_effect_where_the_force_domain_finds_it(
        explained, heard, lead, confirmed, falls):
    e = part(explained)
    e = replace(e, effects=(replace(e.effects[0], force_share=heard, force_margin=lead,
                                    confirmed=confirmed),))
    assert (fallen(e) is not None) is falls


def surface(share: float) -> Surface:
    """A force that is left, of which friction in another form explains a `share`."""
    grid = np.ones((1, 1))
    return Surface("m", grid, grid, grid, grid, grid, 0.9, 0.9, 1.0,
                   form_shares={"coulomb_friction": share})


@pytest.mark.parametrize(("share", "kind"), [(0.39, "named"), (0.41, "partial")])
def test_an_effect_that_leaves_an_error_of_its_own_form_is_a_part(share, kind):
    e = part(0.99, surface=surface(share))
    assert verdict(e).kind == kind
    assert ("another form" in sentence(e, verdict(e))) is (kind == "partial")


def test_an_effect_whose_form_the_records_do_not_show_is_a_part():
    """98.8 and 97.7 % of two gaps were explained by relatives of what was there."""
    e = part(0.988, form_hidden=("coulomb_friction",))
    assert verdict(e).kind == "partial"
    assert "do not show whether" in sentence(e, verdict(e))


@pytest.mark.parametrize(("gain", "kind"), [(0.25, "named"), (0.26, "partial")])
def test_an_effect_that_needs_another_size_for_other_motion_is_a_part(gain, kind):
    """1 - exp(-2 * 0.255) is the limit of 0.4."""
    e = part(0.99, gain=gain)
    assert verdict(e).kind == kind
    assert ("another form" in sentence(e, verdict(e))) is (kind == "partial")


def test_another_size_for_other_motion_counts_where_it_is_clear():
    assert Constancy(0.3, 0.11).share == 0.0
    assert Constancy(0.3, 0.09).share == pytest.approx(0.451, abs=1e-3)


@pytest.mark.parametrize(("both", "share", "confirmed", "named"), [
    (0.99, 0.11, False, True), (0.99, 0.09, False, False), (0.99, 0.09, True, True),
    (0.999, 0.09, False, True)])
def test_a_small_further_effect_needs_the_force_domain_or_takes_all_that_is_left(
        both, share, confirmed, named):
    e = part(both)
    offset = EffectEvidence("force_offset", {}, part(both - share).extended, margin=20.0,
                            confirmed=confirmed)
    e = replace(e, effects=(*e.effects, offset))
    assert (fallen(e) is None) is named
    assert small_parts(e) == (() if named else ("force_offset",))


@pytest.mark.parametrize(("share", "held", "named"), [
    (0.11, 0.99, True), (0.09, 0.99, False), (0.09, 1.0, False)])
def test_a_further_effect_that_held_out_records_do_not_exercise_is_judged_on_the_fitted_ones(
        share, held, named):
    e = part(0.99)
    e = replace(e, extended=replace(e.extended, held_out=part(held).extended.held_out))
    without = replace(e.extended, fitted=part(0.99 - share).extended.fitted)
    mode = EffectEvidence("second_mode", {}, without, exercised=False)
    assert small_parts(replace(e, effects=(*e.effects, mode))) == (
        () if named else ("second_mode",))


def test_a_small_effect_alone_is_not_a_further_one():
    assert small_parts(found(FRICTION)) == ()


def test_two_effects_fall_the_lesser_first():
    e = part(0.9, margin=1.0)
    lesser = replace(e.effects[0], name="force_offset",
                     without=replace(e.effects[0].without, held_out=part(0.85).extended.held_out))
    assert fallen(replace(e, effects=(*e.effects, lesser)))[0] == "force_offset"
