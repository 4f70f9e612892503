"""Each uncommon effect is named, where it is asked for, on a stage that has it at clear size."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.corpus.measured import make_case, measured_plan
from dfm_stage.diagnosis import DiagnosisError, diagnose, hypothesis, uncommon
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.hypothesis import Trial
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.search import Search, explains_most
from dfm_stage.diagnosis.uncommon import may_stand_alone
from dfm_stage.diagnosis.witness import Explained
from dfm_stage.identification import Run, fit_model
from dfm_stage.model import EFFECTS, Model, Simulator, model_from_dict
from dfm_stage.model.registry import ALL, library_of
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SAMPLES, NOISE = 1e-3, 4000, 2e-7
STIFFNESS = (2.0 * np.pi * 20.0) ** 2
BASE = {"mass": 1.0, "damping": 4.0, "stiffness": STIFFNESS, "force_constant": 1.0, "noise": NOISE}
STAGE = Model("s", PERIOD, BASE)
BELIEVED = STAGE.with_parameters({"damping": 3.8, "stiffness": 1.01 * STIFFNESS})
CASES = {
    "backlash": ({"stiffness": 0.2 * STIFFNESS, "gap": 8e-4},
                 ("cubic_stiffness", "quadratic_damping")),
    "coil_heating": ({"rise": 2e-3, "time_constant": 0.5},
                     ("force_constant_droop", "saturation")),
    "cogging": ({"amplitude": 0.05, "period": 2e-4},
                ("cubic_stiffness", "encoder_periodic_error")),
    "dead_zone": ({"width": 0.05}, ("saturation", "coulomb_friction")),
    "directional_friction": ({"difference": 0.3}, ("quadratic_damping", "quadratic_stiffness")),
    "end_stop": ({"stiffness": 5.0 * STIFFNESS, "position": 1.3e-3},
                 ("cubic_stiffness", "quadratic_stiffness")),
    "gravity": ({"weight": 0.6, "length": 4e-4}, ("cubic_stiffness", "quadratic_damping")),
    "hardening_hysteresis": ({"stiffness": 0.02 * STIFFNESS, "distance": 1e-3, "shape": 1.5},
                             ("hysteresis", "cubic_stiffness")),
    "load_dependent_friction": ({"force": 0.05, "load": 1.0},
                                ("coulomb_friction", "quadratic_damping")),
    "one_sided_cable": ({"stiffness": 0.01 * STIFFNESS, "slack": 1e-4},
                        ("quadratic_stiffness", "cubic_stiffness")),
    "position_dependent_friction": ({"force": 0.05, "length": 3e-4},
                                    ("coulomb_friction", "quadratic_damping")),
    "prandtl_ishlinskii": ({"weight": 0.1, "range": 2.0}, ("hysteresis", "saturation")),
    "sensor_clipping": ({"limit": 1e-3}, ("saturation", "cubic_stiffness")),
    "sensor_lag": ({"time_constant": 2e-4}, ("amplifier_bandwidth", "transport_delay")),
    "sensor_mount": ({"frequency": 60.0, "damping_ratio": 0.02},
                     ("creep", "transport_delay")),
    "slew_limit": ({"rate": 800.0}, ("amplifier_bandwidth", "saturation")),
    "stiffness_drift": ({"rate": 0.005 * STIFFNESS}, ("cubic_stiffness", "thermal_drift")),
    "stribeck_friction": ({"force": 0.1, "sliding_ratio": 0.5, "stribeck_velocity": 0.01},
                          ("coulomb_friction", "quadratic_damping")),
    "structural_damping": ({"loss_stiffness": 0.02 * STIFFNESS}, ("creep", "quadratic_damping")),
    "supply_sag": ({"sag": 0.01, "time_constant": 0.1}, ("force_constant_droop", "saturation")),
}
"""uncommon effect -> its parameters and two rivals of the usual library."""
TOLERANCE = 0.02
"""Relative error of a parameter that the noise lets be."""
CLASSES = {"sensor_lag": {"sensor_lag", "amplifier_bandwidth"}}
"""Those that these records do not part from others."""


def record(name: str, values: dict[str, float], seed: int, amplitude: float,
           stage: Model = STAGE) -> Record:
    """A multisine from 0.5 to 100 Hz, V RMS, with noise on the reading."""
    rng = np.random.default_rng(seed)
    t = PERIOD * np.arange(SAMPLES)
    f = np.arange(0.5, 100.0, 0.5)
    feed = np.cos(2 * np.pi * f[:, None] * t + rng.uniform(0, 6.283, (f.size, 1))).sum(axis=0)
    feed *= amplitude / np.std(feed)
    moved = Simulator(stage.with_effect(name, values)).run(feed)
    return Record(t, PERIOD, {"x": AxisRecord(feed, moved.measured(seed))},
                  Provenance(f"run {seed}", "csv"))


@pytest.mark.parametrize("name", CASES)
def test_a_fit_finds_the_parameters(name: str) -> None:
    values, _ = CASES[name]
    run = record(name, values, 10, 3.0).axes["x"]
    off = STAGE.with_effect(name, {n: 0.97 * v for n, v in values.items()})
    free = ["damping", "stiffness", *(f"{name}.{n}" for n in values)]
    found = fit_model(off, [Run("r", run.input, run.position, PERIOD)], free).model.parameters()
    assert {n: found[f"{name}.{n}"] for n in values} == pytest.approx(values, rel=TOLERANCE)


def test_who_asks_for_an_unknown_effect_is_told_of_all() -> None:
    run = Record(PERIOD * np.arange(100), PERIOD, {"x": AxisRecord(np.ones(100), np.ones(100))},
                 Provenance("run", "csv"))
    with pytest.raises(DiagnosisError, match=r"no effect hum.*creep.*gravity"):
        diagnose([run], BELIEVED, library=["hum"])


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_effect_or_its_class_is_named(name: str) -> None:
    values, rivals = CASES[name]
    runs = [record(name, values, 10 + k, a) for k, a in enumerate((3.0, 1.5, 2.0))]
    found = diagnose(runs[:2], BELIEVED, holdout=runs[2:], library=(name, *rivals))
    members = CLASSES.get(name, {name})
    assert [set(e.members) for e in found.effects] == [members]
    assert found.verdict == ("named" if len(members) == 1 else "ambiguous")
    for parameter, value in values.items() if len(members) == 1 else ():
        low, high = found.effects[0].parameters[parameter].ci95
        assert low - (high - low) < value < high + (high - low), parameter


@pytest.mark.parametrize(("name", "values", "without", "named", "widened"), [
    ("dead_zone", {"width": 0.05}, (), ["dead_zone"], True),
    ("dead_zone", {"width": 0.05}, ("dead_zone",), [], True),
    ("structural_damping", {"loss_stiffness": 0.02 * STIFFNESS}, (), ["structural_damping"],
     True),
    # two springs, or a second mode, leave no more than noise either:
    ("gravity", {"weight": 0.1, "length": 1.2e-3, "tilt": -0.2}, (), ["gravity"], True),
    ("sensor_mount", {"frequency": 90.0, "damping_ratio": 0.006}, (), ["sensor_mount"], True),
    ("cubic_stiffness", {"k3": 2e7}, (), ["cubic_stiffness"], False)])
def test_uncommon_effects_are_looked_for_where_the_common_ones_do_not_suffice(
        name: str, values: dict[str, float], without: tuple[str, ...], named: list[str],
        widened: bool) -> None:
    runs = [record(name, values, 10 + k, a) for k, a in enumerate((3.0, 1.5, 2.0))]
    steps: list[str] = []
    found = diagnose(runs[:2], BELIEVED, holdout=runs[2:], without=without, step=steps.append)
    assert ("looking for uncommon effects, too" in steps) is widened
    if named:
        assert [e.name for e in found.effects] == named
        assert found.verdict == "named"
    else:
        assert name not in {e.name for e in found.effects}


def test_a_sensor_that_clips_rarely_is_not_taken_for_noise() -> None:
    """What few samples miss repeats with nothing, and passes for coloured noise."""
    free = record("sensor_clipping", {"limit": 1.0}, 1, 3.0)
    values = {"limit": 0.98 * float(np.max(np.abs(free.axes["x"].position)))}
    allowed = {"sensor_clipping", "cubic_stiffness", "encoder_periodic_error"}
    found = diagnose([record("sensor_clipping", values, 1, 3.0)], BELIEVED,
                     holdout=[record("sensor_clipping", values, 2, 3.0)],
                     without=[n for n in library_of([ALL]) if n not in allowed])
    assert [e.members for e in found.effects] == [("sensor_clipping",)]


def test_a_second_lag_is_no_wrong_number_of_the_first() -> None:
    """Two lags in series are no lag of another size, whatever the size."""
    def run(seed: int) -> Record:
        rng = np.random.default_rng(seed)
        feed = 3.0 * rng.standard_normal(SAMPLES)
        stage = STAGE.with_parameters({"amplifier_time_constant": 1e-3})
        moved = Simulator(stage.with_effect("sensor_lag", {"time_constant": 2e-3})).run(feed)
        return Record(PERIOD * np.arange(SAMPLES), PERIOD, {
            "x": AxisRecord(feed, moved.measured(seed))}, Provenance(f"run {seed}", "csv"))

    found = diagnose([run(1)], BELIEVED.with_parameters({"amplifier_time_constant": 0.8e-3}),
                     holdout=[run(2)],
                     library=["sensor_lag", "amplifier_bandwidth", "cubic_stiffness"])
    assert [set(e.members) for e in found.effects] == [{"sensor_lag", "amplifier_bandwidth"}]


def test_one_uncommon_effect_is_tried_before_several_common_ones() -> None:
    values = {"width": 0.05}
    steps: list[str] = []
    found = diagnose([record("dead_zone", values, 1, 3.0)], BELIEVED,
                     holdout=[record("dead_zone", values, 2, 3.0)], step=steps.append)
    assert [e.members for e in found.effects] == [("dead_zone",)]
    assert not [step for step in steps if " and " in step or "force domain" in step]


@pytest.mark.parametrize(("name", "values"), [
    ("one_sided_cable", {"stiffness": 0.02 * STIFFNESS, "slack": -2e-4}),
    ("backlash", {"stiffness": 0.003 * STIFFNESS, "gap": 8e-4, "centre": 5e-5})])
def test_an_effect_of_which_the_spring_takes_most_is_found(
        name: str, values: dict[str, float]) -> None:
    allowed = {name, "cubic_stiffness", "quadratic_stiffness", "gravity", "cogging"}
    found = diagnose([record(name, values, 1, 3.0)], BELIEVED,
                     holdout=[record(name, values, 2, 3.0)],
                     without=[n for n in library_of([ALL]) if n not in allowed])
    assert [e.members for e in found.effects] == [(name,)]


@pytest.mark.parametrize(("force", "velocity"), [
    (0.004, 0.054),  # hardly more than noise is left where an eddy brake stands in its place,
    (0.01, 0.054),   # where Coulomb friction and a drag do,
    (0.01, 0.193)])  # where Coulomb friction does: only what is left shows the fall
def test_a_friction_that_falls_is_told_as_itself_beside_another_effect(
        force: float, velocity: float) -> None:
    shaken = STAGE.with_effect("periodic_disturbance", {
        "amplitude": 0.3, "frequency": 13.0, "phase": 0.3})
    values = {"force": force, "sliding_ratio": 0.0, "stribeck_velocity": velocity}
    allowed = {"stribeck_friction", "coulomb_friction", "periodic_disturbance",
               "quadratic_damping", "eddy_current_damping"}
    runs = [record("stribeck_friction", values, seed, 3.0, shaken) for seed in (1, 2)]
    found = diagnose(runs[:1], BELIEVED, holdout=runs[1:],
                     without=[n for n in library_of([ALL]) if n not in allowed])
    assert [e.members for e in found.effects] == [("periodic_disturbance",),
                                                  ("stribeck_friction",)]


@pytest.mark.parametrize(("chi2", "common", "tested"), [
    (1140.0, 1800.0, True), (1160.0, 1800.0, False),  # not near the noise
    (1100.0, 1165.0, True), (1100.0, 1155.0, False)])  # hardly better than a common effect
def test_one_effect_is_tested_alone_near_the_noise_and_before_the_common_ones(
        chi2: float, common: float, tested: bool) -> None:
    fits = [SimpleNamespace(chi2=value, white=np.zeros(1000)) for value in (chi2, common)]
    search = SimpleNamespace(score=lambda fit: fit.chi2)
    assert may_stand_alone(search, *fits) is tested


@pytest.mark.parametrize(("periods", "force"), [
    (2.2, 0.05), (2.45, 0.05), (7.2, 0.003), (11.3, 0.003)])
def test_cogging_of_a_few_periods_is_found(periods: float, force: float) -> None:
    """The noise of the acceleration hides it, and a polynomial over position takes most of it."""
    none = record("cogging", {"amplitude": 0.0, "period": 1.0}, 1, 3.0)
    values = {"amplitude": force, "period": float(np.ptp(none.axes["x"].position)) / periods}
    found = diagnose([record("cogging", values, 1, 3.0)], BELIEVED,
                     holdout=[record("cogging", values, 2, 3.0)],
                     library=["cogging", "cubic_stiffness", "quadratic_stiffness"])
    assert [e.members for e in found.effects] == [("cogging",)]


@pytest.mark.parametrize(("seed", "index", "allowed", "told"), [
    (1141420023, 73, {"cubic_stiffness", "eddy_current_damping", "stribeck_friction"},
     [("cubic_stiffness",), ("stribeck_friction",)]),
    (872403957, 4, {"eddy_current_damping", "stribeck_friction"}, [("stribeck_friction",)])])
def test_beside_a_remainder_a_brake_is_compared_with_a_stribeck_curve(
        seed: int, index: int, allowed: set[str], told: list[tuple[str, ...]]) -> None:
    """Cases of the measured-like corpus with such a curve, which is no common effect: beside a
    cubic spring, and alone, where the library lacks what else there is."""
    case = make_case(measured_plan("remainder", index + 1, seed)[index])
    runs, held = ([Record(c["time_s"], case.sample_period, {
        "x": AxisRecord(c["input_v"], c["position_m"])}, Provenance(f"{name} {k}", "csv"))
        for k, c in enumerate(each)] for name, each in (("run", case.records),
                                                        ("held", case.holdout)))
    found = diagnose(runs, model_from_dict(case.model), holdout=held, without=[
        n for n in library_of([ALL]) if n not in allowed])
    assert [e.members for e in found.effects] == told


def test_an_effect_that_may_not_be_named_must_be_one() -> None:
    run = Record(PERIOD * np.arange(100), PERIOD, {"x": AxisRecord(np.ones(100), np.ones(100))},
                 Provenance("run", "csv"))
    with pytest.raises(DiagnosisError, match="without: there is no effect hum"):
        diagnose([run], BELIEVED, without=["hum"])


class Twins:
    """A search in which the twin of a second mode ends early by loose weights."""

    def __init__(self) -> None:
        self.weights, self.noise, self.again = "loose", 1.0, True
        self.model = BELIEVED

    def conditions(self, _: object) -> SimpleNamespace:
        return SimpleNamespace(runs=())

    def begin_work(self, _: float) -> None:
        pass

    def reweigh(self, weights: str, noise: float) -> None:
        self.weights, self.noise = weights, noise

    def screened(self, *_: object) -> tuple[None, list[object]]:
        return None, []

    def score(self, found: SimpleNamespace) -> float:
        return found.chi2 + 12.0 * len(found.system.free)

    def further(self, *_: object) -> float:
        return 60.0

    def in_place_of(self, *_: object) -> SimpleNamespace:
        return fit_of(2.0, 5)

    def fitted(self, *_: object) -> SimpleNamespace:
        return fit_of(1.0 if self.weights == "tight" else 2.0, 5)

    def pruned(self, names: Names, found: SimpleNamespace) -> tuple[Names, SimpleNamespace]:
        return names, found


class Curve(Twins):
    """A search in which one Stribeck curve does what two laws of friction do."""

    def __init__(self, rms: float) -> None:
        super().__init__()
        self.rms = rms

    def screened(self, *_: object) -> tuple[None, list[Hit]]:
        return None, [replace(Hit.at("stribeck_friction", EFFECTS["stribeck_friction"].defaults),
                              gain=1e4)]

    def fitted(self, *_: object) -> SimpleNamespace:
        return fit_of(self.rms, 9)

    def pruned(self, names: Names, found: SimpleNamespace) -> tuple[Names, SimpleNamespace]:
        return tuple(n for n in names if n != "quadratic_damping"), found


def fit_of(rms: float, free: int) -> SimpleNamespace:
    return SimpleNamespace(ok=True, chi2=1e4 * rms**2, weights="tight",
                           system=SimpleNamespace(free=range(free)))


@pytest.mark.parametrize(("names", "rms", "taken"), [
    (("second_mode",), 1.01, ("sensor_mount",)),
    (("second_mode", "hysteresis"), 1.01, ("sensor_mount", "hysteresis")),
    (("second_mode",), 0.9995, ("sensor_mount",)),  # two parameters are worth more than that
    (("second_mode",), 0.9985, ("second_mode",))])
def test_a_twin_is_compared_by_the_weights_of_what_was_found(monkeypatch, names, rms,
                                                             taken) -> None:
    """By those of the whole gap its fit ends far above the noise, and a second mode stays."""
    monkeypatch.setattr(uncommon, "to_noise",
                        lambda _, names, *__: (SimpleNamespace(names=names), None))
    monkeypatch.setattr(uncommon, "verdict", lambda _: SimpleNamespace(complete=True))
    own = SimpleNamespace(search=SimpleNamespace(weights="tight", noise=0.1),
                          uncommon=("sensor_mount",))
    found = own, SimpleNamespace(names=names, fit=fit_of(rms, 7)), None
    wide = SimpleNamespace(search=Twins())
    other = uncommon._one_for_all(wide, None, found, {"sensor_mount"}, (), split=False)
    assert other[1].names == taken


@pytest.mark.parametrize(("rms", "taken"), [
    (1.0, ("saturation", "stribeck_friction")),      # two more parameters, one effect less
    (1.0032, ("saturation", "coulomb_friction", "quadratic_damping"))])  # two effects fit better
def test_one_in_the_place_of_two_may_cost_what_a_further_effect_must_bring(
        rms, taken, monkeypatch) -> None:
    monkeypatch.setattr(uncommon, "to_noise",
                        lambda _, names, *__: (SimpleNamespace(names=names), None))
    monkeypatch.setattr(uncommon, "verdict", lambda _: SimpleNamespace(complete=True))
    own = SimpleNamespace(search=SimpleNamespace(weights="tight", noise=0.1),
                          uncommon=("stribeck_friction",))
    found = own, SimpleNamespace(names=("saturation", "coulomb_friction", "quadratic_damping"),
                                 fit=fit_of(1.0, 7)), None
    wide = SimpleNamespace(search=Curve(rms))
    other = uncommon._one_for_all(wide, None, found, set(), (), split=False)
    assert sorted(other[1].names) == sorted(taken)


@pytest.mark.parametrize(("rms", "taken"), [
    (1.0, ("saturation", "stribeck_friction")),
    (1.0065, ("saturation", "coulomb_friction", "quadratic_damping"))])
def test_one_law_of_speed_of_its_class_is_tried_in_the_place_of_all(rms, taken,
                                                                    monkeypatch) -> None:
    """Also where it does not do without the others once it stands beside them."""
    def fitted(_, names: Names, *__: object) -> SimpleNamespace:
        return fit_of(rms if set(names) == {"saturation", "stribeck_friction"} else 1.0, 9)

    monkeypatch.setattr(uncommon, "to_noise",
                        lambda _, names, *__: (SimpleNamespace(names=names), None))
    monkeypatch.setattr(uncommon, "verdict", lambda _: SimpleNamespace(complete=True))
    monkeypatch.setattr(Twins, "fitted", fitted)
    own = SimpleNamespace(search=SimpleNamespace(weights="tight", noise=0.1),
                          uncommon=("stribeck_friction",))
    found = own, SimpleNamespace(names=("saturation", "coulomb_friction", "quadratic_damping"),
                                 fit=fit_of(1.0, 7)), None
    wide = SimpleNamespace(search=Twins())
    other = uncommon._one_for_all(wide, None, found, set(), (), split=False)
    assert sorted(other[1].names) == sorted(taken)


def test_an_effect_that_cannot_be_a_candidate_takes_no_place(monkeypatch) -> None:
    """One that the model has would lose the values given for it, and be named as missing."""
    monkeypatch.setattr(uncommon, "to_noise",
                        lambda _, names, *__: (SimpleNamespace(names=names), None))
    monkeypatch.setattr(uncommon, "verdict", lambda _: SimpleNamespace(complete=True))
    wide = SimpleNamespace(search=Twins())
    wide.search.model = BELIEVED.with_effect("sensor_mount", {"frequency": 60.0,
                                                              "damping_ratio": 0.02})
    found = SimpleNamespace(search=SimpleNamespace(weights="tight", noise=0.1), uncommon=(
        "sensor_mount",)), SimpleNamespace(names=("second_mode",), fit=fit_of(1.01, 7)), None
    assert uncommon._one_for_all(wide, None, found, {"sensor_mount"}, (), split=False) is found


def test_what_is_left_is_looked_at_under_the_weights_of_the_search() -> None:
    """A filter of the noise of another length left three samples more: the screen ended in an
    error."""
    screened = []
    search = SimpleNamespace(
        weights=("now",), runs=[SimpleNamespace(window=0)], fitted=lambda *given: ("anew", *given),
        widened=lambda _: search, screened=lambda fit, *_: (screened.append(fit), []))
    earlier, same = (SimpleNamespace(names=("hysteresis",), fit=SimpleNamespace(weights=weights))
                     for weights in (("earlier",), search.weights))
    for h in (earlier, same):
        uncommon._seen_in_what_is_left(SimpleNamespace(search=search), h, ["backlash"])
    assert screened == [("anew", ("hysteresis",), earlier.fit), same.fit]


FIRST, MOST = (SimpleNamespace(ok=True, chi2=chi2, white=np.zeros(1000))
               for chi2 in (1e5, 2e3))


@pytest.mark.parametrize(("names", "share", "behind", "ended", "begun"), [
    (("gravity",), 0.99, 5.0, False, ("gravity",)),
    (("gravity",), 0.99, 5.0, True, None),             # another effect in the limit
    (("gravity",), 0.90, 5.0, False, None),            # leaves more than an effect may
    (("gravity",), 0.99, 2.9, False, None),            # a cubic spring does nearly as well
    (("gravity",), 0.99, None, False, None),           # the force domain cannot tell
    (("cubic_stiffness",), 0.99, 5.0, False, None),    # a common one
    (("sensor_lag", "creep"), 0.99, 5.0, False, None), # of lags, forces know little
    (("creep", "gravity"), 0.99, 5.0, False, ("creep", "gravity"))])
def test_an_effect_begins_where_the_force_domain_saw_it(names, share, behind, ended, begun,
                                                        monkeypatch) -> None:
    """The response to a small force of a swing through half a circle promises little: a cubic
    spring was named in part."""
    found, tried = begun_by_force(names, share, behind, ended, (), FIRST, monkeypatch)
    assert (None if found is None else found[0]) == begun
    assert [(start, h.parameters["weight"]) for start, hits in tried for h in hits
            if h.name == "gravity"] == ([(FIRST, 0.4)] if begun or ended else [])


@pytest.mark.parametrize(("usual", "common", "begun"), [
    ("coil_inductance", MOST, ("coil_inductance", "gravity")),  # a lag is beside all forces
    ("coil_inductance", FIRST, ("amplifier_bandwidth", "gravity")),  # one that explains little
    ("coulomb_friction", MOST, None)])                          # the gap has its name
def test_an_effect_that_the_force_domain_saw_begins_beside_a_lag(usual, common, begun,
                                                                 monkeypatch) -> None:
    """Beside the inductance of a coil, a cable was named quadratic stiffness."""
    found, tried = begun_by_force(("amplifier_bandwidth", "gravity"), 0.99, 5.0, False, (usual,),
                                  common, monkeypatch)
    assert (None if found is None else found[0]) == begun
    assert [start for start, _ in tried] == ([common] if begun else [])


def begun_by_force(names, share, behind, ended, usual, common, monkeypatch):
    """What `_begun_by_force` finds, and the fits and hits that it began with."""
    told = Explained(names, share, 0.01, share, {"stiffness": 68.0, "gravity.weight": 0.4}, {})
    tried = []
    search = SimpleNamespace(
        step=lambda _: None, begin_work=lambda _: None,
        around=lambda own, start, hits: tried.append((start, hits)))
    monkeypatch.setattr(uncommon, "at_upper_end", lambda *_: ended)
    margins = {n: {"cubic_stiffness": behind, "cogging": 0.1} for n in names}
    wide = SimpleNamespace(search=search, witness=SimpleNamespace(
        cannot_tell=behind is None, best=told, margins=margins))
    trial = SimpleNamespace(uncommon=("gravity", "cogging", "sensor_lag"),
                            search=SimpleNamespace(library=("cubic_stiffness",)))
    return uncommon._begun_by_force(trial, wide, FIRST, usual, common), tried


@pytest.mark.parametrize(("ended", "complete", "taken"), [
    (("creep", "gravity"), True, True),
    (("gravity",), True, True),
    (("creep",), True, True),
    (("creep", "gravity"), False, False),
    (("creep", "cubic_stiffness"), True, False),   # common ones have a search of their own
    (("creep", "gravity", "cogging"), True, False),
    ((), True, False)])
def test_the_first_look_ends_only_with_an_uncommon_effect_or_a_single_one(ended, complete, taken,
                                                          monkeypatch) -> None:
    begun = ("creep", "gravity"), SimpleNamespace(chi2=1000.0, white=np.zeros(1000))
    search = SimpleNamespace(runs=[SimpleNamespace(window=0)], begin_work=lambda _: None,
                             alone=lambda _: (("creep",), MOST), step=lambda _: None,
                             alone_of=lambda *_: begun, score=lambda fit: fit.chi2)
    wide = SimpleNamespace(search=search)
    trial = SimpleNamespace(uncommon=("gravity", "cogging"), search=search,
                            widened=lambda: wide)
    monkeypatch.setattr(uncommon, "to_noise",
                        lambda *_: (SimpleNamespace(names=ended), "evidence"))
    monkeypatch.setattr(uncommon, "verdict", lambda _: SimpleNamespace(complete=complete))
    found = uncommon._one_uncommon(trial, FIRST, (), False)
    assert (found is not None) == taken


@pytest.mark.parametrize(("common", "most"), [(1599.0, True), (1601.0, False)])
def test_a_common_effect_explains_most_from_the_share_from_which_it_is_named(common,
                                                                             most) -> None:
    first, found = (SimpleNamespace(chi2=chi2, white=np.zeros(1000))
                    for chi2 in (11_000.0, common))
    assert explains_most(first, found) is most


def test_what_the_force_domain_said_is_known_to_a_wider_trial(monkeypatch) -> None:
    asked: list[tuple[str, ...]] = []
    monkeypatch.setattr(hypothesis, "witness",
                        lambda *given, **_: asked.append(given[2]))
    run = record("cogging", {"amplitude": 0.0, "period": 1.0}, 1, 3.0)
    trial = Trial(Search(BELIEVED, [observe(run, BELIEVED)], ("damping",),
                         library=("cubic_stiffness",)), [], uncommon=("gravity",))
    for each in (trial, trial.widened(), trial.widened()):
        assert each.witness is None
    assert asked == [("cubic_stiffness",), ("cubic_stiffness", "gravity")]
