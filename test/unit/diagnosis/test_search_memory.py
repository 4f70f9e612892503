"""What a search need not do twice, and what it must."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import truth

from dfm_stage.diagnosis import hypothesis
from dfm_stage.diagnosis.hypothesis import Trial
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.screen import Hit, Screen, best_of_each
from dfm_stage.diagnosis.search import Search, _elsewhere
from dfm_stage.identification.weights import Weight
from dfm_stage.model import EFFECTS

OTHER = ((Weight(np.ones(1), 1e-6, "given"),),)


@pytest.fixture
def search() -> Search:
    feed = truth.multisine(1)
    run = observe(truth.record(feed, truth.move(feed, lambda x, v: -4e6 * x**3), 1, "run"),
                  truth.believed())
    return Search(truth.believed(), [run], ("damping", "stiffness"),
                  library=("cubic_stiffness", "quadratic_damping"))


@pytest.fixture
def looked(monkeypatch) -> list[str]:
    """The effects that were screened so far."""
    names: list[str] = []
    hits = Screen.hits
    monkeypatch.setattr(Screen, "hits", lambda self, name, keep=2: (
        names.append(name), hits(self, name, keep))[1])
    return names


def test_fits_and_screens_by_the_same_weights_are_made_once(search):
    bare = search.begin()
    weights, noise = search.weights, search.noise
    screen = search.screened(bare, ())
    cubic = search.fitted(("cubic_stiffness",), bare, screen[1][:1])
    search.reweigh(OTHER)
    assert search.fitted(("cubic_stiffness",), bare, screen[1][:1]) is not cubic
    assert search.screened(bare, ())[0] is not screen[0]
    search.reweigh(weights, noise)
    assert search.fitted(("cubic_stiffness",), bare) is cubic
    assert search.screened(bare, ())[0] is screen[0]
    assert "cubic_stiffness" in {h.name for h in screen[1]}
    search.barred = {"cubic_stiffness"}
    assert "cubic_stiffness" not in {h.name for h in search.screened(bare, ())[1]}


def test_a_wider_search_knows_fits_that_came_to_their_end(search):
    """One that ended for want of work is made again; one of the same effect that did not is not,
    whatever its effects ran out of elsewhere."""
    bare = search.begin()
    hits = search.screened(bare, ())[1]
    cubic, damping = (search.fitted((name,), bare, [h for h in hits if h.name == name][:1])
                      for name in search.library)
    assert not cubic.cut
    search.begin_work(0.0)
    drag = bare.model.with_effect("quadratic_damping", {"coefficient": 1.0})
    damping = search.keep(("quadratic_damping",), search._fit(drag, search.free, bare))
    assert damping.cut
    assert search.not_compared == ("quadratic_damping",)
    search.begin_work(1e9)
    wide = search.widened(("gravity",))
    assert wide.library == (*search.library, "gravity")
    assert not wide.not_compared
    wide.reweigh(search.weights, search.noise)
    assert wide.fitted(("cubic_stiffness",), bare) is cubic
    assert wide.fitted(("quadratic_damping",), bare) is not damping


def test_a_wider_search_screens_only_what_was_not_looked_at(search, looked):
    bare = search.begin()
    narrow = search.screened(bare, ())[1]
    assert looked == list(search.library)
    looked.clear()
    wide = search.widened(("gravity",)).screened(bare, ())[1]
    assert looked == ["gravity"]
    assert [h for h in wide if h.name != "gravity"] == narrow


def test_only_the_effects_asked_for_are_screened(search, looked):
    bare = search.begin()
    found = search.screened(bare, (), ("cubic_stiffness",))[1]
    assert looked == ["cubic_stiffness"]
    assert {h.name for h in found} == {"cubic_stiffness"}
    search.screened(bare, ())
    assert looked == ["cubic_stiffness", "quadratic_damping"]


def test_rivals_begin_where_the_first_look_saw_them_whatever_weighs_now(search, monkeypatch):
    bare = search.begin()
    names, cubic = search.alone(bare)
    assert names == ("cubic_stiffness",)
    search.reweigh(OTHER)
    monkeypatch.setattr(search, "screened", lambda *_: pytest.fail("screened again"))
    assert [h.name for h in search.screens[frozenset()]] == ["cubic_stiffness"]
    search.all_rivals(names, search.fitted(names, cubic))


def test_a_failed_beginning_elsewhere_is_no_fit_of_its_effect(search, monkeypatch):
    bare = search.begin()
    cubic = [h for h in search.screened(bare, ())[1] if h.name == "cubic_stiffness"][:1]
    with monkeypatch.context() as patch:
        patch.setattr(search, "_from", lambda *_, **__: replace(bare, chi2=math.inf))
        assert not search.around(("cubic_stiffness",), bare, cubic).ok
    assert search.fitted(("cubic_stiffness",), bare, cubic).ok


def test_a_twin_that_cannot_be_simulated_is_no_fit_of_its_effects(search, monkeypatch):
    """What the screen begins with is still tried."""
    bare = search.begin()
    mode = search._fit(bare.model.with_effect("second_mode", {
        "share": 0.1, "frequency": 200.0, "damping_ratio": 0.03}), (), bare, iterations=0)
    monkeypatch.setattr(search, "_from", lambda *_, **__: replace(bare, chi2=math.inf))
    assert not search.in_place_of("second_mode", "sensor_mount", ("sensor_mount",), mode).ok
    monkeypatch.setattr(search, "_from", lambda *_, **__: bare)
    assert search.fitted(("sensor_mount",), bare).ok


def test_an_effect_begins_on_another_side_of_zero_or_at_the_second_best_size():
    def hit(name, **parameters):
        return Hit.at(name, parameters)

    cable = [hit("one_sided_cable", stiffness=k, slack=1e-3) for k in (-2.0, -5.0, 1.0)]
    curve = [hit("stribeck_friction", force=1.0, stribeck_velocity=v) for v in (0.1, 0.2)]
    screen = SimpleNamespace(hits=lambda name, keep: {"one_sided_cable": cable,
                                                      "stribeck_friction": curve}[name])
    assert _elsewhere(cable[0], screen) is cable[2]
    assert _elsewhere(curve[0], screen) is curve[1]
    assert _elsewhere(curve[0], SimpleNamespace(hits=lambda name, keep: curve[:1])) is None


@pytest.mark.parametrize(("promise", "known", "leaves", "tried", "left"), [
    (0.5, 7.0, 1.0, ["one_sided_cable"], 1.0),              # noise: no other is tried
    (0.5, 7.0, 2.0, ["one_sided_cable", "gravity"], 2.0),
    (0.9, 2.5, 1.0, [], 3.0),                               # a common effect explains more
    (0.5, 6.0, 1.0, [], 99.0)])                             # and most, as none of them promises
def test_effects_begin_at_another_size_until_one_leaves_noise(search, monkeypatch, promise, known,
                                                              leaves, tried, left):
    def fit(above):
        return SimpleNamespace(ok=True, chi2=100.0 * above, white=np.zeros(100),
                               system=SimpleNamespace(free=()))

    def hit(name, times=1.0):
        return SimpleNamespace(name=name, gain=9000.0 * times, parameters={})

    begun, names = [], ("gravity", "one_sided_cable")
    common = hit("periodic_disturbance", 1.0 / promise)     # looks better than they do
    monkeypatch.setattr(search, "_looked", lambda *_: (None, [common, *map(hit, names)]))
    monkeypatch.setattr(search, "_singles", lambda _, __, listed, *___: [
        ((h.name,), fit(3.0)) for h in listed])
    monkeypatch.setattr(search, "around", lambda own, *_: (begun.append(own[0]), fit(leaves))[1])
    monkeypatch.setattr("dfm_stage.diagnosis.search._elsewhere", lambda hit, screen: hit)
    monkeypatch.setattr("dfm_stage.diagnosis.search.at_upper_end", lambda *_: False)
    _, found = search.alone_of(names, fit(99.0), fit(known))
    assert begun == tried
    assert found.chi2 == 100.0 * left


@pytest.mark.parametrize("known", ["bare", "given"])
def test_a_mount_in_the_place_of_a_far_mode_begins_with_the_base_as_it_was(search, monkeypatch,
                                                                           known):
    """A mode with a share far below zero leaves the force constant next to nothing; without any
    effect the base may be as far off, and then the one given is nearer."""
    bare = search.begin()
    far = bare.model.with_parameters({"force_constant": 1e-4})
    if known == "given":
        search.keep((), search._fit(far, (), bare, iterations=0))
    search.free = (*search.free, "force_constant")
    mode = search._fit(far.with_effect(
        "second_mode", {"share": -1e4, "frequency": 200.0, "damping_ratio": 0.03}), (), bare,
        iterations=0)
    begun = []
    monkeypatch.setattr(search, "_from", lambda model, *_, **__: (begun.append(model), bare)[1])
    search.in_place_of("second_mode", "sensor_mount", ("sensor_mount",), mode)
    wanted = bare.model if known == "bare" else search.model
    assert begun[0].base["force_constant"] == wanted.base["force_constant"]


def test_a_fit_that_was_not_begun_is_no_trial(search, monkeypatch):
    """For want of work it is the fit without the effect, whose base may still be improved."""
    bare = search.begin()
    hits = [Hit.at(name, {}) for name in search.library]
    monkeypatch.setattr(search, "_from", lambda *_, **__: replace(bare, chi2=math.inf))
    assert not search._singles((), bare, hits, math.inf, math.inf)
    assert not search._pairs((), bare, [hits], math.inf)


@pytest.mark.parametrize(("leaves", "sizes"), [
    ({0.5: 90.0}, [0.5]), ({0.5: 500.0, 0.25: 500.0, 0.125: 500.0}, [0.5, 0.25, 0.125])])
def test_a_fit_that_ends_above_one_with_fewer_effects_begins_again_there(search, leaves, sizes):
    """Begun at the size that a linear screen promises, it ended at 400; without the second effect
    200 were left."""
    drag = {"coefficient": 8.0}

    def found(chi2, *names):
        model = truth.believed()
        for name in names:
            model = model.with_effect(name, drag if name == "quadratic_damping" else {"k3": 1.0})
        return SimpleNamespace(ok=True, cut=False, chi2=chi2, model=model)

    fewer, far = found(200.0, "cubic_stiffness"), found(400.0, *search.library)
    search.keep(("cubic_stiffness",), fewer)
    begun = []

    def begin(at, hits):
        assert at is fewer
        begun.append(hits[0].parameters["coefficient"] / drag["coefficient"])
        return found(leaves[begun[-1]], *search.library)

    best = search._no_worse(far, search.library, [Hit.at("quadratic_damping", drag)], begin)
    assert begun == sizes
    assert best.chi2 == min(400.0, *leaves.values())


@pytest.mark.parametrize(("distance", "freed"), [(0.1, False), (1.0, True)])
def test_nothing_more_is_freed_of_friction_that_the_noise_makes_dry(search, monkeypatch, distance,
                                                                    freed):
    """A loop that yields within a tenth of the noise is dry friction: its knee shows nowhere, and
    took half a minute to fit."""
    bare = search.begin()
    shortest = 0.1 * search.noise
    loop = bare.model.with_effect("hysteresis", {
        "stiffness": 1.0, "yield_displacement": 10.0 * distance * shortest})
    found = replace(search._fit(loop, (), bare, iterations=0), chi2=1.0)
    begun = []

    def fit(model, free, start, **_):
        begun.append(free)
        return found

    monkeypatch.setattr(search, "_fit", fit)
    monkeypatch.setattr(search, "refined", lambda found: found)
    begin = Hit.at("hysteresis", EFFECTS["hysteresis"].defaults)
    search._from(loop, ("hysteresis",), bare, [begin], math.inf)
    assert any("hysteresis.exponent" in free for free in begun) is freed


@pytest.mark.parametrize(("bent", "forces"), [(1.5, [8.0]), (400.0, [8.0, 8.0, 0.02])])
def test_effects_begin_beside_the_base_as_given_too_where_its_gain_was_bent(search, monkeypatch,
                                                                           bent, forces):
    """Slow motion shows the ratio of force constant and stiffness alone, and friction moves both:
    by a factor of 370 in one record. Beside the base as given, forces are so much smaller."""
    search.free = (*search.free, "force_constant")
    bare = search.begin()
    far = search._fit(bare.model.with_parameters(
        {n: bent * search.model.base[n] for n in search.free}), (), bare, iterations=0)
    begun = []

    def fit(model, names, start, hits, *_, **__):
        begun.append((model.base["force_constant"], hits[0].parameters["force"]))
        return replace(bare, chi2=1.0 + len(begun))

    monkeypatch.setattr(search, "_from", fit)
    search.fitted(("coulomb_friction",), far, [Hit.at("coulomb_friction", {"force": 8.0})])
    assert [force for _, force in begun] == pytest.approx(forces)
    assert begun[-1][0] == pytest.approx(truth.GAIN * (bent if len(forces) == 1 else 1.0))


def test_the_best_hit_of_each_effect_comes_by_its_gain():
    """A screen gives two of each: the order of the second ones says nothing."""
    hits = [replace(Hit.at(name, {}), gain=gain) for name, gain in (
        ("gravity", 100.0), ("creep", 90.0), ("cogging", 80.0), ("cogging", 79.0),
        ("creep", 78.0), ("gravity", 1.0))]
    assert [(h.name, h.gain) for h in best_of_each(hits)] == [
        ("gravity", 100.0), ("creep", 90.0), ("cogging", 80.0)]


def test_a_motion_that_escapes_is_as_far_off_as_can_be(search):
    bare = search.begin()
    assert bare.rms > 0.0
    assert replace(bare, chi2=math.inf, residuals=[]).rms == math.inf


def test_forces_are_in_the_scale_of_what_is_free(search, monkeypatch):
    """With the mass free the force constant is as given, and sizes are in its scale."""
    told = {}
    monkeypatch.setattr(hypothesis, "witness", lambda *_, **more: told.update(more))
    search.free = ("mass", "damping")
    assert Trial(search, ()).witness is None
    assert told["free"] == ("mass", "damping")


@pytest.mark.parametrize("dropped", [True, False])
def test_rivals_stand_beside_the_effects_that_are_left(dropped, monkeypatch):
    """Fitted beside one that was dropped later, they had more parameters than what they are
    compared with."""
    stub = SimpleNamespace(
        settle=lambda names, found: (names, found, "bare"), step=lambda _: None, weights=(),
        compare=lambda names, found: (names, found, {"creep": ["beside a mode"]}),
        polished=lambda _, found: found, all_rivals=lambda *_: {"creep": ["alone"]})
    monkeypatch.setattr(hypothesis, "weights_like", lambda *_: ())
    for test in ("exchange_rival", "without_each", "line_of_input", "at_bound"):
        monkeypatch.setattr(Trial, test, lambda _, h: h)
    monkeypatch.setattr(Trial, "surrogate_tests", lambda _, h: replace(
        h, names=h.names[:1]) if dropped else h)
    monkeypatch.setattr(Trial, "second_look", lambda *_: None)
    h = Trial(stub, ()).run(("creep", "second_mode"), "fit")
    assert h.rivals == {"creep": ["alone" if dropped else "beside a mode"]}
