"""Another convention of the input in the place of a fast mode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind.measured import diagnosed_files
from benchmarks.corpus.measured import make_case, measured_plan
from dfm_stage.diagnosis import diagnose, workflow
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import Observation, observe
from dfm_stage.diagnosis.other_convention import (
    by_other_conventions,
    clearer_kind,
    clearest,
    has_fast_mode,
    is_simpler,
    leaves_less,
    may_be_simpler,
    timed,
)
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.verdict import Found, Reason, Verdict
from dfm_stage.identification import Source, identify
from dfm_stage.identification.convention import Convention, reinterpreted
from dfm_stage.model import EFFECTS, Model
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD, SIZE, FINE = 1e-3, 6000, 10
MODEL = Model("stage", PERIOD, {"mass": 1.0, "damping": 40.0, "stiffness": 6e4,
                                "force_constant": 2.0, "delay": 4.5e-4})
MODE = {"share": 0.05, "frequency": 160.0, "damping_ratio": 0.01, "phase": 0.0}


def record(seed: int, model: Model = MODEL, band: float = 0.4) -> Record:
    """A stage that is moved by an input in a `band` (sampling rates), as late as its delay says:
    by its frequency response, over whole periods."""
    rng = np.random.default_rng(seed)
    spectrum = np.fft.rfft(rng.standard_normal(SIZE))
    omega = 2.0 * np.pi * np.fft.rfftfreq(SIZE, PERIOD)
    spectrum[omega > band * 2.0 * np.pi / PERIOD] = 0.0
    base = model.base
    s = 1j * omega
    stage = base["force_constant"] * np.exp(-s * base["delay"]) / (
        base["mass"] * s**2 + base["damping"] * s + base["stiffness"])
    feed, position = (np.fft.irfft(x, SIZE) for x in (spectrum, stage * spectrum))
    noise = 1e-3 * np.std(position) * np.random.default_rng(seed + 1).standard_normal(SIZE)
    return Record(PERIOD * np.arange(SIZE), PERIOD, {"x": AxisRecord(feed, position + noise)},
                  Provenance(f"run {seed}", "csv"))


def test_an_error_of_timing_is_no_second_mode():
    held = {"input_hold": "zero", "input_shift": 0.0}
    records = [record(1), record(3)]
    given = [Record(r.time, r.sample_period, {"x": replace(r.axes["x"], **held)}, r.provenance)
             for r in records]
    library = ("second_mode", "cubic_stiffness", "coulomb_friction")
    forced = diagnose(given[:1], MODEL, holdout=given[1:], library=library)
    assert forced.names == ("second_mode",)   # by hand: nothing else is tried
    found = diagnose(records[:1], MODEL, holdout=records[1:], library=library)
    assert found.names == ()
    assert found.verdict in ("none", "retune")


def test_an_input_that_is_not_held_and_acts_before_half_a_sample():
    """Held, it would act before it is set: a delay below zero, and no effect does that."""
    model = MODEL.with_parameters({"delay": 3.5e-4})
    records = [record(seed, model, band=0.1) for seed in (1, 3)]
    found = diagnose(records[:1], model, holdout=records[1:], library=("coulomb_friction",))
    assert found.verdict in ("none", "retune")
    assert all(each["input_hold"] != "zero" for each in found.conventions)
    sources = [Source.of(each) for each in records]
    fitted = identify(sources[:1], model=model, holdout=sources[1:])
    assert all(each["input_hold"] != "zero" for each in fitted.conventions)
    assert fitted.model.base["delay"] == pytest.approx(3.5e-4, abs=2e-6)
    assert fitted.evaluations[0].fit.fit_percent > 99.8


@pytest.mark.parametrize(("source", "moved"), [("estimated", True), ("given", False)])
def test_an_estimated_shift_is_moved_to_where_the_model_leaves_least(source, moved):
    """The columns are half a sample apart, the estimate is wrong by less than its error."""
    known = Convention("band_limited", -0.503, 0.01, source)
    model = Model("stage", PERIOD, {n: v for n, v in MODEL.base.items() if n != "delay"})
    early = SimpleNamespace(base={**MODEL.base, "delay": -0.5 * PERIOD})
    run, held = (observe(record(seed, early), model, known=known) for seed in (1, 3))
    tried = Trial(Search(model, [run], ("damping", "stiffness", "force_constant")), [held])
    own, fit = timed(tried, tried.search.begin())
    for each in (*own.search.runs, *own.held):
        assert each.convention.shift == pytest.approx(-0.5 if moved else -0.503, abs=2e-4)
    assert fit.rms == own.search.begin().rms


@pytest.mark.slow
def test_an_error_of_timing_near_the_noise_is_no_lag():
    """A held input that is early by a sample, and nothing else: the estimate is off by a
    thousandth of one, which leaves hardly more than the noise of the quiet record."""
    answer = diagnosed_files(make_case(measured_plan("convention", 24, 534595891)[16]))
    assert answer["effects"] == []
    for each in answer["conventions"]:
        assert each["input_shift_samples"]["value"] == pytest.approx(-1.0, abs=2e-4)


def test_a_shift_is_moved_by_its_own_standard_errors_and_never_late():
    """Of two records one hardly knows its timing: the other's stays as it is."""
    model = Model("stage", PERIOD, {n: v for n, v in MODEL.base.items() if n != "delay"})
    early = SimpleNamespace(base={**MODEL.base, "delay": -0.5 * PERIOD})
    sure, other = (observe(record(seed, early), model, known=Convention(
        "band_limited", shift, sigma, "estimated"))
        for seed, shift, sigma in ((1, -0.5, 0.01), (3, -0.68, 0.09)))
    tried = Trial(Search(model, [sure, other], ("damping", "stiffness", "force_constant")), [])
    own, _ = timed(tried, tried.search.begin())
    first, second = (run.convention.shift for run in own.search.runs)
    assert first == pytest.approx(-0.5, abs=0.021)
    assert second == pytest.approx(-0.5, abs=0.09)
    late = observe(record(1, SimpleNamespace(base={**MODEL.base, "delay": 0.1 * PERIOD})), model,
                   known=Convention("band_limited", -0.1, 0.09, "estimated"))
    tried = Trial(Search(model, [late], ("damping", "stiffness", "force_constant")), [])
    own, _ = timed(tried, tried.search.begin())
    assert own.search.runs[0].convention.shift <= 0.0


@pytest.mark.parametrize(("known", "late", "shift", "own"), [
    (Convention("zero", -0.8, source="estimated"), 0.2, -1.0, 0.2),
    (Convention("zero", -0.8, source="given"), 0.2, -0.8, None),
    (Convention("zero", late=0.1, source="estimated"), 0.2, 0.0, 0.1),
    # surely early, but a held one may look so by what the regression does not know
    (Convention("first", late=-0.05, late_sigma=0.01, source="estimated"), 0.95, -1.0, 0.95),
    (Convention("first", late=-0.03, late_sigma=0.01, source="estimated"), 0.95, 0.0, -0.03),
    (Convention("zero", late=-0.05, late_sigma=0.01, source="estimated"), 0.95, 0.0, -0.05),
    (Convention("first", late=-0.05, late_sigma=0.01, source="estimated"), 0.0, 0.0, -0.05)])
def test_an_early_input_of_a_stage_that_is_late_was_set_so_much_earlier(known, late, shift, own):
    found = known.behind(late)
    assert found.shift == pytest.approx(shift)
    assert found.late == own


@pytest.mark.parametrize(("known", "kind", "shift", "late"), [
    (Convention("zero", late=-0.05), "band_limited", 0.0, 0.45),
    (Convention("zero"), "first", 0.0, 0.5), (Convention("band_limited", -0.4), "zero", -0.9, 0.0),
    (Convention("first", late=0.2), "zero", -0.3, 0.0),
    (Convention("zero", late=-0.02), "zero", 0.0, -0.02)])
def test_the_same_instant_by_another_kind(known, kind, shift, late):
    other = reinterpreted(known, kind)
    assert (other.hold, other.source) == (kind, known.source)
    assert other.shift == pytest.approx(shift)
    assert other.late == pytest.approx(late)


def trial(source: str, driven: bool = True, late: float | None = None) -> Trial:
    feed = np.sin(np.arange(1000) / 7.0) * driven
    run = Observation("run", feed, 1e-6 * feed, PERIOD).by(
        Convention(source=source, late=late, late_sigma=late and 0.01))
    return Trial(Search(MODEL, [run], ("damping", "delay"), library=tuple(EFFECTS)), [run])


@pytest.mark.parametrize(("source", "late", "tried"), [
    ("estimated", 0.08, False), ("estimated", -0.08, False), ("estimated", 0.3, True),
    ("estimated", -0.3, True), ("assumed", None, True),
    ("estimated", 0.37, False), ("estimated", 0.53, False), ("estimated", 0.56, True)])
def test_an_input_that_acts_as_a_held_one_is_not_taken_for_another_kind(monkeypatch, source,
                                                                        late, tried):
    """Behind another kind it is a lag of half a sample, which may be less or more: what is left
    is less for that, as drag that the model lacked made it. The model is late by 0.45 samples."""
    first, other = fitted(1.0, 3), fitted(0.5, 3)
    monkeypatch.setattr(Search, "fit_like", lambda *_: other)
    monkeypatch.setattr(Search, "begin", lambda _: other)
    chosen, _ = clearest(trial(source, late=late), first)
    assert chosen.search.runs[0].convention.hold == ("first" if tried else "zero")


@pytest.mark.parametrize(("late", "first", "other", "taken"), [
    (0.3, 1.9, 1.4, True), (0.3, 1.9, 1.5, False),  # half of what is above the noise
    (0.3, 1.113, 0.882, True),                # an output that is early by a sample, as measured
    (0.3, 1.02, 0.99, False),                 # 30 in chi-square: by chance
    (0.6, 1.9, 1.0, False), (0.6, 1.9, 0.9, True)])  # later than given: half of all
def test_another_kind_must_leave_half_of_what_is_above_the_noise(monkeypatch, late, first, other,
                                                                 taken):
    looked = by_chi2(other)
    monkeypatch.setattr(Search, "fit_like", lambda *_: looked)
    monkeypatch.setattr(Search, "begin", lambda _: looked)
    chosen, _ = clearest(trial("estimated", late=late), by_chi2(first))
    assert chosen.search.runs[0].convention.hold == ("first" if taken else "zero")


def test_another_kind_is_judged_with_its_shift_moved_to_where_it_leaves_least(monkeypatch):
    """An output that was early by a sample stayed held, and was named a second mode: by the right
    kind, too, a shift wrong by 0.02 samples left 0.2 % more."""
    asked = []
    monkeypatch.setattr(Search, "begin", lambda _: fitted(1.0, 3))
    monkeypatch.setattr(workflow, "timed", lambda each, _: (each, fitted(0.5, 3)))
    monkeypatch.setattr(workflow, "may_be_simpler", lambda _, first, __: asked.append(first.rms))
    judgement = trial("estimated"), found(("second_mode",)), None
    assert workflow._simplest(judgement, (), False) is judgement
    assert asked == [0.5, 0.5]


def test_what_is_given_by_hand_or_not_driven_has_no_other_convention():
    assert not list(by_other_conventions(trial("given")))
    assert not list(by_other_conventions(trial("estimated", driven=False)))
    kinds = [t.search.runs[0].convention.hold for t in by_other_conventions(trial("assumed"))]
    assert kinds == ["first", "band_limited"]


@pytest.mark.parametrize(("names", "linear"), [
    (("second_mode",), True), (("cubic_stiffness", "second_mode"), True), (("creep",), False),
    (("cubic_stiffness",), False), (("transport_delay",), False),
    (("amplifier_bandwidth",), False),
    (("periodic_disturbance",), False), ((), False)])
def test_only_a_fast_linear_part_of_several_parameters_stands_for_timing(names, linear):
    assert has_fast_mode(found(names), told(*names)) is linear
    assert not has_fast_mode(found(names), told())   # unknown: nothing to replace


@pytest.mark.parametrize(("frequency", "fast"), [(49.0, False), (51.0, True)])
def test_a_mode_below_a_twentieth_of_the_sampling_rate_does_not(frequency, fast):
    mode = found(("second_mode",), frequency)
    assert has_fast_mode(mode, told("second_mode")) is fast


def told(*names: str) -> Verdict:
    return Verdict("named", Reason.AT_FLOOR, tuple(Found(n, (n,), 1.0, 100.0) for n in names))


def found(names, frequency=160.0):
    """A hypothesis with these effects, a mode at a frequency (Hz), sampled at 1 kHz."""
    model = MODEL
    for name in names:
        given = {**MODE, "frequency": frequency} if name == "second_mode" else {}
        model = model.with_effect(name, {**EFFECTS[name].defaults, **given})
    fitted = type("Fitted", (), {"model": model})()
    return Hypothesis(names, fitted, None, {})


class Fitted:
    """As much of a hypothesis and its evidence as the comparison reads."""

    def __init__(self, free: int, rms: float, held_out: float) -> None:
        part = type("Part", (), {})
        self.fit, self.extended = part(), part()
        self.fit.ok, self.fit.rms, self.fit.white = True, rms, np.zeros(10_000)
        self.fit.system, self.extended.held_out = part(), part()
        self.fit.system.free = tuple(range(free))
        self.extended.held_out.rms = held_out


@pytest.mark.parametrize(("free", "rms", "held_out", "simpler"), [
    (3, 1.0, 1.0, True), (5, 1.0, 1.0, True), (3, 1.0, 1.009, True), (3, 1.0, 1.02, False),
    (3, 1.002, 1.0, True), (3, 1.003, 1.0, False),   # 40 and 60 in chi-square, for 4 parameters
    (5, 1.002, 1.0, False), (6, 1.0, 1.0, False), (7, 0.5, 0.5, False)])
def test_it_must_explain_as_much_with_fewer_parameters(free, rms, held_out, simpler):
    other, found = Fitted(free, rms, held_out), Fitted(7, 1.0, 1.0)
    assert is_simpler((other, other), (found, found)) is simpler


LATE = {"delay": 1.5 * PERIOD}


@pytest.mark.parametrize(("base", "names", "late", "beside", "delay"), [
    ({}, ("second_mode",), None, (), {}),
    ({}, ("second_mode",), 0.05, (), {}),                         # no shift that counts
    ({}, ("second_mode", "cubic_stiffness"), 0.5, ("cubic_stiffness", "transport_delay"),
     {"transport_delay.delay": 0.5 * PERIOD}),
    ({}, ("transport_delay", "second_mode"), 2.0, ("transport_delay",),
     {"transport_delay.delay": 2.0 * PERIOD}),
    (LATE, ("second_mode",), 2.0, (), {"delay": 2.0 * PERIOD})])
def test_another_kind_is_fitted_without_the_mode_and_as_late_as_the_input_acts(
        monkeypatch, base, names, late, beside, delay):
    """Judged in full, each of two other kinds took as long as the search that found a mode."""
    asked = []

    def fit(_, chosen, start):
        asked.append((chosen, start.model))
        return fitted(1.0, 5)

    monkeypatch.setattr(Search, "fitted", fit)
    model = Model("stage", PERIOD, {**{n: v for n, v in MODEL.base.items() if n != "delay"},
                                    **base})
    for name in names:
        model = model.with_effect(name, MODE if name == "second_mode" else (
            LATE if name == "transport_delay" else EFFECTS[name].defaults))
    found = fitted(1.0, 9)
    found.model, found.system.free = model, tuple(model.parameters())
    tried = trial("estimated", late=late)
    assert may_be_simpler(tried, Start(), Hypothesis(names, found, None, {})) is True
    (chosen, begun), = asked
    assert chosen == beside
    assert tuple(use.name for use in begun.effects) == beside
    assert {n: v for n, v in begun.parameters().items() if n.endswith("delay")} == \
        pytest.approx(delay)


@dataclass(frozen=True)
class Start:
    """As much of a first fit as is given on."""

    model: Model = MODEL


def fitted(rms, free):
    """A fit of 1000 samples, of noise of 0.3."""
    return SimpleNamespace(ok=True, rms=rms, system=SimpleNamespace(free=range(free)),
                           chi2=1000.0 * (rms / 0.3)**2, white=np.zeros(1000))


def by_chi2(each):
    """A fit of 1000 samples with a chi-square for each."""
    return fitted(0.3 * each**0.5, 3)


def instant(seed: int, model: Model = MODEL, late: float = 3.5e-4) -> Record:
    """A record of a stage that is `late` (s), both columns sampled at the same instant."""
    return record(seed, model.with_parameters({"delay": late}), band=0.1)


def test_a_delay_is_not_taken_for_a_held_input_that_acts_before_it_is_set():
    """A delay of 0.35 samples is near half a sample, by which a held input acts late: taken as
    held it left half the gap, which no effect explained."""
    base = {n: v for n, v in MODEL.base.items() if n != "delay"}
    model = Model("stage", PERIOD, base)
    run, held = (instant(seed) for seed in (1, 3))
    found = diagnose([run], model, holdout=[held], library=("transport_delay", "coulomb_friction"))
    assert all(each["input_hold"] != "zero" for each in found.conventions)
    assert found.names == ("transport_delay",)
    assert found.effects[0].parameters["delay"].value == pytest.approx(3.5e-4, abs=2e-6)


@pytest.mark.parametrize(("left", "late", "grown", "kind"), [
    ({"first": 0.9, "band_limited": 0.8}, -0.15, True, None),       # less, but not clearly
    ({"first": 0.5, "band_limited": 0.6}, -0.15, True, "first"),
    ({"first": 0.5, "band_limited": 0.4}, -0.15, True, "band_limited"),
    ({"first": 0.5, "band_limited": 0.4}, 0.3, False, "band_limited"),
    ({"first": 0.5, "band_limited": 0.4}, 0.6, False, None),        # later than given: a delay
    ({"first": 0.5, "band_limited": 0.4}, 0.05, False, None)])      # as late as a held one
def test_the_kind_of_hold_that_leaves_least_is_taken_where_that_is_clearly_less(
        monkeypatch, left, late, grown, kind):
    """One more effect is looked for only where a held input would act before it is set."""
    asked = []
    monkeypatch.setattr(Search, "begin", lambda _: fitted(1.0, 3))
    monkeypatch.setattr(Search, "fitted", lambda *_: fitted(1.0, 3))
    monkeypatch.setattr(Search, "grown", lambda *_, **__: (
        asked.append("grown"), fitted(1.0, 3)))
    monkeypatch.setattr(Search, "fit_like", lambda _, first, runs: fitted(
        left.get(runs[0].convention.hold, 1.0), 3))
    h = SimpleNamespace(names=(), fit=fitted(1.0, 3))
    found = clearer_kind(trial("estimated", late=late), h)
    assert (found and found[0].search.runs[0].convention.hold) == kind
    assert bool(asked) is grown


def test_records_in_windows_are_not_asked():
    tried = trial("assumed")
    tried.search.runs[0] = replace(tried.search.runs[0], window=50)
    assert clearer_kind(tried, SimpleNamespace(names=(), fit=fitted(1.0, 3))) is None


@pytest.mark.parametrize(("fit", "held_out", "less"), [
    (0.9, 0.9, True), (1.0, 0.5, False), (0.5, 1.1, False)])
def test_it_must_leave_less_of_fitted_and_of_held_out_records(fit, held_out, less):
    def judged(*powers):
        fit, held = (SimpleNamespace(power=each) for each in powers)
        return None, SimpleNamespace(extended=SimpleNamespace(fitted=fit, held_out=held))

    assert leaves_less(judged(fit, held_out), judged(1.0, 1.0)) is less
