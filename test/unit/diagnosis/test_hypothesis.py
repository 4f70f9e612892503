"""Steps that put a hypothesis to the test, each with a search that answers from a table."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dfm_stage.diagnosis import hypothesis
from dfm_stage.diagnosis.evidence import DropReason
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.verification import SurrogateTest
from dfm_stage.identification.periods import Periodicity
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model import Model

PASSED, FAILED = SurrogateTest(1e4, 100.0, 1e4, 5e3), SurrogateTest(1e4, 5e3, 1e4, 100.0)
IDLE = SurrogateTest(1.0, 100.0, 100.0, np.inf)
BARE = 1e5
"""Chi-square of the fitted records without any effect."""
NEARLY_IDLE = SurrogateTest(0.9e-3 * BARE, 110.0, 100.0, 90.0)


INTERVALS = {("creep", "second_mode"): {
    "creep.gain": Quantity(1.0, "", (0.1, 0.2)), "stiffness": Quantity(1.0, "", None),
    "second_mode.damping_ratio": Quantity(1.0, "", (-np.inf, np.inf))}}


class OneFit:
    """A search whose fits are the names that were fitted."""

    def __init__(self, barred=()):
        self.barred, self.noise, self.said = set(barred), 0.0, []
        self.runs = [SimpleNamespace(driven=True)]
        self.step = self.said.append

    def fitted(self, names, _):
        return SimpleNamespace(model=None, names=names, ok=True, chi2=0.0,
                               quantities=INTERVALS.get(names, {}))

    @staticmethod
    def quantities_of(_, fit):
        return fit.quantities


def start(*names, **more) -> Hypothesis:
    fit = OneFit().fitted(names, None)
    bare = SimpleNamespace(model=None, ok=True, chi2=BARE)
    return Hypothesis(names, fit, bare, **more)


def with_tests(monkeypatch, results):
    monkeypatch.setattr(hypothesis, "surrogate_test",
                        lambda _model, name, *_: results[name])


def test_an_effect_that_does_no_better_than_its_surrogates_is_dropped_and_the_rest_refitted(
        monkeypatch):
    with_tests(monkeypatch, {"creep": PASSED, "coulomb_friction": FAILED})
    trial = Trial(OneFit(), [])
    left = trial.surrogate_tests(start("coulomb_friction", "creep"))
    assert left.names == left.fit.names == ("creep",)
    assert trial.dropped == {"coulomb_friction": DropReason.SURROGATES}


def test_an_effect_free_in_each_run_is_dropped_for_what_it_does_not_lower(monkeypatch):
    with_tests(monkeypatch, {"thermal_drift": SurrogateTest(1e4, 100.0, 110.0, np.inf)})
    trial = Trial(OneFit(), [])
    assert trial.surrogate_tests(start("thermal_drift")).names == ()
    assert trial.dropped == {"thermal_drift": DropReason.NOT_HELD_OUT}


@pytest.mark.parametrize("moved", [IDLE, NEARLY_IDLE])
@pytest.mark.parametrize(("barred", "kept"), [((), ("creep",)), (("hysteresis",), ())])
def test_an_effect_not_exercised_stays_in_the_first_look_only(monkeypatch, barred, kept, moved):
    with_tests(monkeypatch, {"creep": moved})
    trial = Trial(OneFit(barred), [])
    left = trial.surrogate_tests(start("creep"))
    assert left.names == left.not_exercised == kept
    assert trial.dropped == ({} if kept else {"creep": DropReason.NOT_EXERCISED})


@pytest.mark.parametrize(("fall", "kept"), [
    (79.0, ("cogging",)), (81.0, ("cogging", "creep"))])
def test_beside_others_the_fitted_records_must_show_an_effect_not_exercised(monkeypatch, fall,
                                                                           kept):
    """74 in chi-square were an undamped mode of five millionths beside a mains disturbance."""
    with_tests(monkeypatch, {"cogging": PASSED, "creep": IDLE})
    monkeypatch.setattr(OneFit, "fitted", lambda *_: SimpleNamespace(
        model=None, ok=True, chi2=fall, quantities={}))
    trial = Trial(OneFit(), [])
    first = SimpleNamespace(model=None, ok=True, chi2=0.0)
    bare = SimpleNamespace(model=None, ok=True, chi2=BARE)
    assert trial.surrogate_tests(Hypothesis(("cogging", "creep"), first, bare)).names == kept


def test_an_effect_at_its_bound_is_dropped():
    trial = Trial(OneFit(), [])
    assert trial.at_bound(start("creep", "second_mode")).names == ("creep",)
    assert trial.dropped == {"second_mode": DropReason.AT_BOUND}


@pytest.mark.parametrize(("name", "sizes", "kept"), [
    ("creep", {"stiffness": (-5.0, 16.0)}, False), ("creep", {"stiffness": (1.0, 16.0)}, True),
    ("quadratic_damping", {"coefficient": (0.0, 3.0)}, False),
    ("cross_axis_coupling", {"ratio": (-1.0, 1.0), "stiffness": (-1.0, 1.0)}, True)])
def test_an_effect_whose_size_may_be_zero_is_not_shown(monkeypatch, name, sizes, kept):
    """Of two sizes each may be zero where both are not."""
    monkeypatch.setitem(INTERVALS, (name,), {
        f"{name}.{size}": Quantity(sum(ends) / 2.0, "", ends) for size, ends in sizes.items()})
    trial = Trial(OneFit(), [])
    assert trial.at_bound(start(name)).names == ((name,) if kept else ())
    assert trial.dropped == ({} if kept else {name: DropReason.NO_SIZE})


@pytest.mark.parametrize(("hertz", "kept"), [(0.085, ()), (0.25, ("periodic_disturbance",))])
def test_a_vibration_of_less_than_two_cycles_is_a_wandering_reading(hertz, kept):
    search = OneFit()
    search.runs = [SimpleNamespace(input=np.sin(np.arange(10_000.0)), sample_period=1e-3,
                                   driven=True)]
    model = SimpleNamespace(parameters=lambda: {"periodic_disturbance.frequency": hertz})
    fit = SimpleNamespace(model=model, quantities={})
    trial = Trial(search, [])
    assert trial.at_bound(Hypothesis(("periodic_disturbance",), fit, fit)).names == kept


@pytest.mark.parametrize(("hertz", "noisy", "kept"), [
    (5.0, False, False),  # at a line, and more than noise is left: the model's own error
    (5.0, True, True),    # at a line, and nothing else is left: a vibration
    (5.25, False, True)])  # between lines
def test_a_vibration_at_a_line_of_the_input_is_dropped_beside_a_remainder(hertz, noisy, kept):
    rng = np.random.default_rng(4)
    time = 1e-3 * np.arange(8000)
    left = rng.standard_normal(8000) + (0.0 if noisy else 20.0) * np.sin(2 * np.pi * 5.0 * time)
    run = Observation("run", time, left, 1e-3, skip=0, periodicity=Periodicity(2000, 0, 4))
    search = OneFit()
    search.runs = [run]
    model = SimpleNamespace(parameters=lambda: {"periodic_disturbance.frequency": hertz})
    h = Hypothesis(("creep", "periodic_disturbance"),
                   SimpleNamespace(model=model, residuals=[[left]]), SimpleNamespace())
    trial = Trial(search, [])
    assert trial.line_of_input(h).names == (h.names if kept else ("creep",))
    assert trial.dropped == ({} if kept else {"periodic_disturbance": DropReason.LINE_OF_INPUT})


def _fit(chi2: float, held: float) -> SimpleNamespace:
    return SimpleNamespace(chi2=chi2, model=held, system=SimpleNamespace(free=()))


@pytest.mark.parametrize(("held", "chosen"), [(80.0, "hysteresis"), (90.0, "creep")])
def test_a_rival_takes_an_effects_place_where_it_is_better_by_the_margin(monkeypatch, held,
                                                                        chosen):
    monkeypatch.setattr(hypothesis, "predict",
                        lambda model, *_: SimpleNamespace(chi2=model))
    own, other = _fit(1000.0, 100.0), _fit(1002.0, held)
    rivals = {"creep": [Rival("hysteresis", 2.0, other)]}
    h = Trial(OneFit(), []).exchange_rival(Hypothesis(("creep",), own, own, rivals))
    assert h.names == (chosen,)
    if chosen != "creep":
        assert h.fit is other
        assert [(r.name, r.cost, r.fit) for r in h.rivals["hysteresis"]] == [("creep", -2.0, own)]


def test_a_second_look_is_taken_only_after_a_drop():
    search = OneFit()
    search.second = lambda names, fit: (("back_emf", *names), fit)
    trial = Trial(search, [])
    h = start("creep")
    assert trial.second_look(h) is None
    trial.dropped["hysteresis"] = DropReason.SURROGATES
    assert trial.second_look(h) == (("back_emf", "creep"), h.fit)
    assert search.barred == {"hysteresis"}
    assert trial.second_look(h) is None


@pytest.mark.parametrize(("rms_alone", "kept"), [
    (2.06e-7, ("presliding_friction",)), (2.20e-7, ("presliding_friction", "creep"))])
def test_an_effect_is_dropped_where_the_others_refitted_predict_better(monkeypatch, rms_alone,
                                                                       kept):
    class Refits(OneFit):
        def fitted(self, names, _):
            return SimpleNamespace(model=names, names=names, quantities={})

    rms = {("presliding_friction", "creep"): 2.15e-7, ("presliding_friction",): rms_alone,
           ("creep",): 9e-7}
    monkeypatch.setattr(hypothesis, "predict",
                        lambda model, *_: SimpleNamespace(rms=rms[model]))
    search = Refits()
    h = Hypothesis(("presliding_friction", "creep"),
                   search.fitted(("presliding_friction", "creep"), None), SimpleNamespace())
    trial = Trial(search, [])
    left = trial.without_each(h)
    assert left.names == left.fit.names == kept
    assert trial.dropped == ({"creep": DropReason.REFITTED} if len(kept) == 1 else {})


@pytest.mark.parametrize(("fitted", "held", "kept"), [
    ((2.0, 1.0), (2.0, 1.0), "retuned"),   # before and after, on either kind of record
    ((2.0, 1.0), (1.0, 12.0), "given"),
    ((199.5, 203.5), (2.0, 1.0), "given"),
    ((1.0, 1.0005), (1.0, 1.0005), "retuned")])  # as noise makes it
def test_the_model_as_given_stays_where_its_re_estimation_is_worse(monkeypatch, fitted, held,
                                                                   kept):
    def left(rms, model):
        return SimpleNamespace(ok=True, residuals=[[rms * np.array([1.0, -1.0])]], locals={},
                               model=model, system=SimpleNamespace(drifts=False))

    monkeypatch.setattr(hypothesis, "nearest_to", lambda *_: left(fitted[0], "given"))
    monkeypatch.setattr(hypothesis, "fit", lambda model, *_, **__: left(fitted[0], model))
    monkeypatch.setattr(hypothesis, "predict", lambda model, *_: left(
        held[0] if model == "given" else held[1], model))
    search = OneFit()
    search.model, search.weights = "given", ()
    bare = left(fitted[1], "retuned")
    h = Trial(search, []).no_worse(Hypothesis((), bare, bare))
    assert h.bare.model == h.fit.model == kept


def test_what_was_predicted_is_predicted_anew_by_other_weights(monkeypatch):
    asked = []
    monkeypatch.setattr(hypothesis, "predict", lambda *given: asked.append(given[2]) or given[2])
    trial, model = Trial(OneFit(), []), SimpleNamespace()
    for weights in (("one",), ("other",)):
        trial.held_weights = weights
        assert trial.predicted(model) == trial.predicted(model) == weights
    assert asked == [("one",), ("other",)]


def test_other_forms_of_a_trial_are_judged_by_the_same_velocity():
    """Powers over other numbers of samples could not be compared between them."""
    cart = Model("cart", 1e-3, {"mass": 1.0, "damping": 1.0})
    search = Search(cart, [], ("mass",), library=("creep",))
    trial = Trial(search, [], 7, uncommon=("backlash",), lag=8, dropped={"creep": None})
    other, wide = trial.on([], [], free=()), trial.widened()
    assert (other.lag, other.seed, other.uncommon, other.dropped) == (8, 7, ("backlash",), {})
    assert (other.search.free, other.search.library) == ((), ("creep",))
    assert (wide.lag, wide.seed, wide.uncommon) == (8, 7, ())
    assert wide.search.library == ("creep", "backlash")
