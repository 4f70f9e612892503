"""What the force domain names by itself: where it may, and what the model then has."""

from __future__ import annotations

import math
from dataclasses import replace

import made_evidence as made
import numpy as np
import pytest
import truth

from dfm_stage.diagnosis.clear_force import by_force, clear_force
from dfm_stage.diagnosis.evidence import Heard
from dfm_stage.diagnosis.gather import with_witness
from dfm_stage.diagnosis.hypothesis import Trial
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.result import told
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.verdict import verdict
from dfm_stage.diagnosis.witness import Explained, Witness
from dfm_stage.diagnosis.wording import sentence
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import EFFECTS


def explained(share: float, *names: str) -> Explained:
    sizes = {f"{n}.{EFFECTS[n].sizes[0]}": 2.0 for n in names}
    return Explained(names, share, 0.01, share, sizes, dict.fromkeys(sizes, 0.1))


def said(best: Explained, *singles: Explained, predictable: float = 0.95, noise: float = 0.01,
         **margins: float) -> Witness:
    """A witness whose best set is `best`, with these margins in the place of any member."""
    by_member = dict.fromkeys(best.names, margins)
    pairs = (best,) if len(best.names) > 1 else ()
    left = math.sqrt(1.0 - predictable)
    return Witness(explained(0.0), (*singles, *(() if pairs else (best,))), pairs, best,
                   by_member, left, left, left, 0.1, noise, (0.5, 0.01), True, 2.0, 24,
                   {})


FRICTION = explained(0.9, "coulomb_friction")


def test_what_explains_most_and_leads_all_is_named():
    heard = clear_force(said(FRICTION, cubic_stiffness=3.1))
    assert heard is not None
    assert heard.added == {"coulomb_friction": 0.9}
    assert heard.explained == pytest.approx(0.9 / 0.95)
    assert heard.members == {"coulomb_friction": ("coulomb_friction",)}
    (force,) = heard.sizes.values()
    assert force.ci95 == pytest.approx((2.0 - 0.2069, 2.0 + 0.2069), rel=1e-3)  # t, 23 degrees


@pytest.mark.parametrize("seen", [
    said(FRICTION, cubic_stiffness=2.9, back_emf=2.9),    # level with two of other kinds
    said(explained(0.56, "coulomb_friction")),            # 0.59 of what is predictable
    said(explained(0.45, "coulomb_friction"), predictable=0.46),  # most cannot be predicted
    said(FRICTION, noise=0.6)])
def test_nothing_is_named_where_the_force_domain_is_not_clear(seen):
    assert clear_force(seen) is None


@pytest.mark.parametrize(("rival", "behind", "level"), [
    ("cubic_stiffness", 2.9, True), ("cubic_stiffness", 3.1, False),
    ("periodic_disturbance", 1.9, True),     # it has more parameters
    ("periodic_disturbance", 2.1, False),
    ("eddy_current_damping", -0.5, False)])  # few machines have it
def test_one_level_rival_of_another_kind_is_told_in_the_class_of_the_main_effect(
        rival, behind, level):
    """As where a fit of the motion leaves a remainder."""
    heard = clear_force(said(FRICTION, **{rival: behind}))
    assert heard is not None
    assert heard.members == {"coulomb_friction": ("coulomb_friction", *([rival] * level))}


@pytest.mark.parametrize(("behind", "singles", "told"), [
    (0.9, 0.8, "coulomb_friction"),
    (3.1, 0.8, "eddy_current_damping"),
    (0.9, None, "eddy_current_damping")])  # the force domain has no size of it
def test_in_the_place_of_a_rare_effect_a_level_one_is_told_that_many_machines_have(
        behind, singles, told):
    friction = () if singles is None else (explained(singles, "coulomb_friction"),)
    seen = said(explained(0.9, "eddy_current_damping"), *friction,
                coulomb_friction=behind, stribeck_friction=behind + 0.1)
    heard = clear_force(seen)
    assert heard is not None
    share = 0.9 if told == "eddy_current_damping" else 0.8
    assert heard.added == {told: share}
    assert heard.share == share
    assert heard.members.keys() == {told}
    assert "eddy_current_damping" not in heard.members[told][1:]
    assert {a.partition(".")[0] for a in heard.sizes} == {told}


def test_no_effect_is_told_in_the_place_of_a_rare_one_that_explains_too_little():
    """0.59 of what is predictable."""
    assert clear_force(said(explained(0.6, "eddy_current_damping"), explained(
        0.56, "coulomb_friction"), coulomb_friction=0.9)) is None


@pytest.mark.parametrize(("other", "share", "told"), [
    ("cubic_stiffness", 0.69, "coulomb_friction"),
    ("cubic_stiffness", 0.72, "eddy_current_damping"),
    ("stribeck_friction", 0.72, "coulomb_friction")])  # of a class with dry friction
def test_in_the_place_of_a_rare_effect_no_other_kind_may_explain_more(other, share, told):
    heard = clear_force(said(
        explained(0.9, "eddy_current_damping"), explained(0.7, "coulomb_friction"),
        explained(share, other), coulomb_friction=2.9, **{other: 3.1}))
    assert heard is not None
    assert heard.members.keys() == {told}


@pytest.mark.parametrize(("together", "added"), [
    (0.8, {"coulomb_friction": 0.4, "force_offset": 0.4}),
    (0.62, None)])  # friction adds 0.22, and needs 0.285; the offset alone is too little
def test_what_each_adds_is_that_of_the_set_with_the_common_effect(together, added):
    seen = said(explained(0.93, "eddy_current_damping", "force_offset"),
                explained(0.5, "eddy_current_damping"), explained(0.4, "coulomb_friction"),
                explained(0.4, "force_offset"), coulomb_friction=2.9)
    heard = clear_force(replace(seen, pairs=(*seen.pairs, explained(
        together, "coulomb_friction", "force_offset"))))
    told = None if heard is None else (heard.added, heard.share, heard.margins)
    assert told == (None if added is None else (pytest.approx(added), together, {}))


def test_level_rivals_of_one_other_kind_are_told_in_the_class_of_the_main_effect():
    heard = clear_force(said(FRICTION, creep=1.9, structural_damping=2.9))
    assert heard is not None
    assert heard.members["coulomb_friction"] == ("coulomb_friction", "creep", "structural_damping")


def test_no_effect_beside_the_main_one_is_told_with_a_level_rival_of_another_kind():
    both = explained(0.93, "force_offset", "coulomb_friction")
    seen = said(both, explained(0.5, "force_offset"), explained(0.25, "coulomb_friction"))
    for behind, names in ((3.1, ("force_offset", "coulomb_friction")), (2.9, None)):
        heard = clear_force(replace(seen, margins={
            "force_offset": {"creep": 1.9}, "coulomb_friction": {"back_emf": behind}}))
        assert (None if heard is None else tuple(heard.added)) == names


def test_a_level_rival_of_its_class_joins_it():
    heard = clear_force(said(FRICTION, presliding_friction=0.4))
    assert heard is not None
    assert heard.members == {"coulomb_friction": ("coulomb_friction", "presliding_friction")}


@pytest.mark.parametrize(("offset", "friction", "names"), [
    (0.4, 0.25, ("force_offset", "coulomb_friction")),  # each adds half of it
    (0.7, 0.25, ("force_offset", "coulomb_friction")),   # the second adds 0.23 of 0.25
    (0.82, 0.25, ("force_offset", "coulomb_friction")),  # 0.11 of 0.13
    (0.84, 0.25, ("force_offset",)),                    # 0.09: little of the whole
    (0.4, -0.1, None),   # it explains nothing by itself, and the first too little
    (-3.0, -2.0, None)])  # they mend each other's errors
def test_a_second_effect_counts_where_it_adds_a_substantial_part(offset, friction, names):
    both = explained(0.93, "force_offset", "coulomb_friction")
    heard = clear_force(said(both, explained(offset, "force_offset"),
                             explained(friction, "coulomb_friction")))
    assert (None if heard is None else tuple(heard.added)) == names


@pytest.mark.parametrize(("predictable", "behind", "names"), [
    (0.95, 2.9, ("force_offset",)),                      # another does as well beside the first
    (0.99, 3.1, ("force_offset", "coulomb_friction")),   # it adds 0.12 of 0.18
    (0.999, 3.1, ("force_offset", "coulomb_friction")),  # 0.12 of 0.189
    (0.95, 3.1, ("force_offset", "coulomb_friction"))])
def test_a_small_second_effect_must_lead_those_of_other_kinds(predictable, behind, names):
    both = explained(0.93, "force_offset", "coulomb_friction")
    seen = said(both, explained(0.81, "force_offset"), explained(0.25, "coulomb_friction"),
                predictable=predictable)
    heard = clear_force(replace(seen, margins={"force_offset": {}, "coulomb_friction": {
        "back_emf": behind, "presliding_friction": 0.1}}))
    assert heard is not None
    assert tuple(heard.added) == names


@pytest.mark.parametrize(("share", "told"), [(0.88, True), (0.86, False)])
def test_a_small_second_effect_must_take_most_of_what_the_first_leaves(share, told):
    """Of 0.95 that are predictable, of which the first explains 0.75."""
    both = explained(share, "force_offset", "coulomb_friction")
    heard = clear_force(said(both, explained(0.75, "force_offset"),
                             explained(0.25, "coulomb_friction")))
    assert heard is not None
    assert ("coulomb_friction" in heard.added) is told


def test_rivals_of_an_effect_that_is_not_told_do_not_count():
    """They say nothing of the first; its own are compared beside the second."""
    both = explained(0.93, "force_offset", "coulomb_friction")
    seen = said(both, explained(0.9, "force_offset"), explained(0.25, "coulomb_friction"))
    seen = replace(seen, margins={"force_offset": {"back_emf": 8.0},
                                  "coulomb_friction": {"back_emf": 0.5}})
    assert seen.nearest == {"back_emf": 0.5}
    heard = clear_force(seen)
    assert heard is not None
    assert heard.margins == {"force_offset": {"back_emf": 8.0}}
    assert clear_force(replace(seen, margins={
        "force_offset": {"back_emf": 2.0, "creep": 1.9}, "coulomb_friction": {}})) is None


@pytest.fixture(scope="module")
def trial():
    """A hardening spring that the model lacks."""
    runs = [observe(truth.record(feed, truth.move(feed, lambda x, v: -4e10 * x**3), seed, "run"),
                    truth.believed()) for seed, feed in enumerate(
                        (truth.multisine(1), truth.multisine(2, 0.8)))]
    return Trial(Search(truth.believed(), runs[:1], ("damping", "stiffness"),
                        library=tuple(EFFECTS)), runs[1:])


def test_the_model_has_the_size_that_the_force_domain_gives(trial):
    seen = trial.witness
    heard = clear_force(seen)
    assert heard is not None
    found = by_force(trial, trial.search.begin(), seen, heard, (), split=False)
    assert found is not None
    h, e = found
    v = verdict(e)
    assert (v.kind, [f.name for f in v.effects], v.complete) == (
        "named", ["cubic_stiffness"], False)
    (k3,) = (x.parameters["k3"] for x in e.effects)
    assert k3.covers(4e10)
    assert (k3.value, k3.unit) == (h.fit.model.effect("cubic_stiffness").parameters["k3"], "N/m^3")
    assert e.extended.held_out.rms < 0.1 * e.retuned.held_out.rms
    d = told(e, v, h.fit.model).to_dict()
    assert d["gap"]["judged"] == "force"
    assert "judged in force alone" in sentence(e, v)
    assert d["effects"][0]["gap_share"] > 0.95
    assert not any("chi-square" in line for line in d["effects"][0]["evidence"])


def test_what_makes_the_held_out_motion_worse_is_not_taken(trial):
    wrong = Heard({"cubic_stiffness": 0.9}, 0.9, 0.95, {"cubic_stiffness": ("cubic_stiffness",)},
                  clear_force(trial.witness).sizes,
                  {"cubic_stiffness.k3": -4e10})
    assert by_force(trial, trial.search.begin(), trial.witness, wrong, (), split=False) is None


def test_what_hardly_moves_the_stage_is_not_taken(trial):
    """A false mount of the sensor explained 99 % of the force, and 0.003 % of the motion."""
    heard = clear_force(trial.witness)
    (address, size), = heard.sizes.items()
    faint = replace(heard, sizes={address: replace(size, value=1e-4 * size.value)},
                    start={**heard.start, address: 1e-4 * size.value})
    assert by_force(trial, trial.search.begin(), trial.witness, faint, (), split=False) is None


def test_a_fit_begins_at_the_given_damping_where_forces_balance_below_zero(trial):
    heard = clear_force(trial.witness)
    below = replace(heard, start={**heard.start, "damping": -0.5})
    found, plain = (by_force(trial, trial.search.begin(), trial.witness, each, (), split=False)
                    for each in (below, heard))
    assert found[0].fit.rms == pytest.approx(plain[0].fit.rms, rel=1e-3)
    assert found[0].fit.model.base["damping"] == pytest.approx(
        plain[0].fit.model.base["damping"], rel=1e-2)


def test_forces_that_balance_with_a_mass_below_zero_name_nothing(trial):
    old, heard = trial.search, clear_force(trial.witness)
    own = Trial(Search(old.model, old.runs, ("damping", "mass"), library=old.library), trial.held)
    below, plain = (by_force(own, own.search.begin(), trial.witness, replace(
        heard, start={**heard.start, "mass": mass}), (), split=False)
        for mass in (-0.1, old.model.base["mass"]))
    assert below is None
    assert plain is not None


def test_most_of_a_part_is_told_as_a_part(trial):
    heard = clear_force(trial.witness)
    less = Heard({"cubic_stiffness": 0.7}, 0.7, 0.95, heard.members, heard.sizes, heard.start)
    _, e = by_force(trial, trial.search.begin(), trial.witness, less, (), split=False)
    assert verdict(e).kind == "partial"
    assert np.isclose(verdict(e).effects[0].predictable_share, 0.7 / 0.95)
    quiet = replace(e.extended.held_out, power=e.judged.noise_power)
    assert verdict(replace(e, extended=replace(e.extended, held_out=quiet))).kind == "named"
    loud = replace(e.extended.held_out, power=2.0 * e.judged.noise_power)
    assert verdict(replace(e, extended=replace(e.extended, held_out=loud))).kind == "partial"


@pytest.mark.parametrize(("seen", "ahead"), [
    (said(FRICTION, explained(0.6, "eddy_current_damping"), eddy_current_damping=5.0), True),
    (said(FRICTION, explained(0.6, "eddy_current_damping"), eddy_current_damping=2.9), False),
    (said(explained(0.9, "creep"), explained(0.6, "eddy_current_damping"),
          eddy_current_damping=5.0), False),
    (said(explained(0.9, "coulomb_friction", "creep"), explained(0.6, "eddy_current_damping"),
          eddy_current_damping=5.0), False),  # perhaps in the place of creep
    (said(FRICTION, explained(0.6, "eddy_current_damping"), eddy_current_damping=5.0,
          noise=0.9), False)])
def test_a_rival_that_the_force_domain_prefers_is_marked(seen, ahead):
    rival = made.rival("coulomb_friction", 1e6)
    own = replace(made.effect("eddy_current_damping", rival), parameters={
        "damping": Quantity(5.0, "N s/m", (4.0, 6.0)),
        "critical_velocity": Quantity(0.01, "m/s", (0.005, 0.02))})
    (effect,) = with_witness(made.found(own), seen).effects
    assert effect.rivals[0].ahead is ahead


@pytest.mark.parametrize(("behind", "ahead"), [(3.1, True), (2.9, False)])
def test_so_is_one_of_a_pair_whose_other_effect_is_found(behind, ahead):
    own = made.effect("coulomb_friction", made.rival("eddy_current_damping", 1e6))
    seen = said(explained(0.9, "eddy_current_damping", "force_offset"),
                explained(0.5, "coulomb_friction"), coulomb_friction=behind)
    effect = with_witness(made.found(own, made.effect("force_offset")), seen).effects[0]
    assert effect.rivals[0].ahead is ahead


@pytest.mark.parametrize(("seen", "enough"), [
    (said(FRICTION), True),
    (said(explained(0.56, "coulomb_friction")), False),   # 0.59 of what is predictable
    (said(explained(0.58, "coulomb_friction")), True),
    (said(explained(0.9, "coulomb_friction", "dead_zone")), False),
    (said(FRICTION, noise=0.9), False)])
def test_the_force_domain_says_whether_common_effects_are_enough(seen, enough):
    assert seen.explained_by(["coulomb_friction", "creep"]) is enough
