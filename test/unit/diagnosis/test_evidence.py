"""Evidence from real searches: complete when gathered, made of plain values."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterator, Mapping
from types import SimpleNamespace

import numpy as np
import pytest
import truth
from scipy.signal import lfilter

from dfm_stage.cli.diagnose_report import write_report
from dfm_stage.diagnosis import explaining
from dfm_stage.diagnosis import fit as fitting
from dfm_stage.diagnosis import gather as gathering
from dfm_stage.diagnosis.evidence import Evidence
from dfm_stage.diagnosis.gather import gather, has_colour
from dfm_stage.diagnosis.hypothesis import Trial
from dfm_stage.diagnosis.margins import score_by_blocks
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.result import told
from dfm_stage.diagnosis.search import Search
from dfm_stage.diagnosis.surface import Surface
from dfm_stage.diagnosis.verdict import verdict
from dfm_stage.identification.system import System
from dfm_stage.identification.weights import white_weights
from dfm_stage.model import Model, Simulator
from dfm_stage.quantity import Quantity

FEW = ("cubic_stiffness", "force_constant_droop", "quadratic_damping")


def searched(extra=None, feed=None, sign=1.0) -> tuple[Trial, Evidence, object]:
    """`sign` is that of the actuator's wires."""
    train, held = truth.multisine(1) if feed is None else feed, truth.scan()
    model = truth.believed()
    model = model.with_parameters({"force_constant": sign * model.base["force_constant"]})
    runs = [observe(truth.record(sign * u, truth.move(u, extra), seed), model, None, name)
            for u, seed, name in ((train, 11, "train"), (held, 12, "held"))]
    search = Search(model, runs[:1], ("damping", "stiffness", "force_constant"), library=FEW)
    trial = Trial(search, runs[1:])
    hypothesis = trial.run(*search.run())
    return trial, gather(trial, hypothesis, ["a warning"]), hypothesis


@pytest.fixture(scope="module")
def cubic():
    return searched(lambda x, v: -4e6 * x**3)


def test_nothing_fits_or_simulates_once_the_evidence_is_there(cubic, monkeypatch, tmp_path):
    _, evidence, hypothesis = cubic

    def forbidden(*_, **__):
        raise AssertionError("the evidence was complete")

    for place, name in ((Simulator, "run"), (Simulator, "__init__"), (System, "__init__"),
                        (System, "simulated"), (fitting, "fit"), (fitting, "search"),
                        (gathering, "predict"), (gathering, "joint"), (gathering, "propose"),
                        (Search, "fitted"), (Search, "_fit")):
        monkeypatch.setattr(place, name, forbidden)
    found = told(evidence, verdict(evidence), hypothesis.fit.model)
    write_report(found, tmp_path / "report.html", ["run"], "believed")
    assert found.names == ("cubic_stiffness",)
    assert found.effects[0].parameters["k3"].value == pytest.approx(4e6, rel=0.02)
    assert "Measured against simulated" in (tmp_path / "report.html").read_text("utf-8")


def values_in(thing: object) -> Iterator[object]:
    yield thing
    inner = (vars(thing).values() if dataclasses.is_dataclass(thing) else
             thing.values() if isinstance(thing, Mapping) else
             thing if isinstance(thing, (tuple, list)) else ())
    for each in inner:
        yield from values_in(each)


def test_evidence_is_made_of_plain_values(cubic):
    from dfm_stage import quantity
    from dfm_stage.diagnosis import evidence as module
    from dfm_stage.diagnosis import margins, remainder, surface

    plain = (int, float, str, bool, type(None), enum.Enum, np.ndarray, tuple, list, dict)
    ours = {m.__name__ for m in (module, margins, remainder, surface, quantity)}
    odd = {type(v) for v in values_in(cubic[1])
           if not isinstance(v, plain) and type(v).__module__ not in ours}
    assert odd == set()


def test_a_missing_force_is_told_where_the_reading_was_not_described(cubic):
    _, evidence, hypothesis = cubic
    one = np.ones((1, 1))
    found = dataclasses.replace(
        told(evidence, verdict(evidence), hypothesis.fit.model), description=None,
        surface=Surface("m", one, one, one, one, one, 0.5, 0.75, 2.0, 3.0))
    assert found.to_dict()["description"] == {
        "parity": None, "memory": None, "amplitude_exponent": None, "frequency_hz": 3.0,
        "side": "unclear", "surface": "missing_force.csv", "predictable_share": 0.75,
        "position_velocity_share": 0.5, "formulas": []}
    assert dataclasses.replace(found, surface=None).to_dict()["description"] is None


def test_the_numbers_gathered_are_those_of_the_records(cubic):
    trial, e, hypothesis = cubic
    run, held = trial.search.runs[0], trial.held[0]
    assert e.records == ("train",)
    assert e.motion.rms == pytest.approx(np.std(run.output))
    assert e.extended.held_out.rms == pytest.approx(truth.NOISE, rel=0.05)
    assert e.noise.rms == pytest.approx(truth.NOISE, rel=0.05)
    compared = {c.name: c for c in e.comparisons}
    assert set(compared["held"].left) == {"given", "retuned", "extended"}
    assert np.sqrt(np.mean(compared["train"].left["extended"] ** 2)) == pytest.approx(
        e.extended.fitted.rms)
    simulated = Simulator(hypothesis.fit.model).run(held.input).position[held.skip:]
    left = compared["held"].measured - simulated
    assert np.std(left - compared["held"].left["extended"]) < 0.2 * truth.NOISE  # starts at rest
    (effect,) = e.effects
    assert effect.exercised
    assert effect.without.held_out.rms == pytest.approx(e.retuned.held_out.rms, rel=1e-6)
    assert e.base_shares.keys() == {"damping", "stiffness", "force_constant"}
    assert all(0.9 < share < 1.1 for share in e.base_shares.values())
    assert e.warnings == ("a warning",)


@pytest.mark.parametrize(("pole", "drifts", "colour"), [
    (0.0, False, False), (0.2, False, True), (0.9, False, True), (0.9, True, False)])
def test_colour_is_what_exceeds_the_noise_of_high_frequencies(pole, drifts, colour):
    for seed in range(20):
        noise = np.random.default_rng(seed).standard_normal(10_000)
        left = [[lfilter([1.0], [1.0, -pole], noise)]]
        found = SimpleNamespace(rms=fitting.rms([left[0][0]]),
                                system=SimpleNamespace(drifts=drifts))
        assert has_colour(found, white_weights(left)[0][0].rms) is colour


@pytest.fixture(scope="module")
def stiff():
    """A spring whose gap shows beside the noise of high frequencies."""
    return searched(lambda x, v: -1e9 * x**3)


@pytest.mark.parametrize("stands", [True, False])
def test_whether_a_gap_is_colour_is_asked_where_no_effect_explains_it(stiff, monkeypatch, stands):
    """What an effect explains on held-out records is no colour of the noise."""
    trial, _, h = stiff
    monkeypatch.setattr(trial, "_found", {})
    asked = []
    monkeypatch.setattr("dfm_stage.diagnosis.remainder.foretold",
                        lambda run, left, model: asked.append(model) or iter([0.0]))
    monkeypatch.setattr(explaining, "judge_hypothesis", lambda _: SimpleNamespace(stands=stands))
    e = explaining._judged(trial, h, (), split=False)
    assert asked == ([] if stands else [h.bare.model])
    assert e.retuned.findings["train"][0].coloured is not stands


def test_blocks_set_the_intervals_of_what_leaves_a_colour(cubic, monkeypatch):
    trial, evidence, hypothesis = cubic
    monkeypatch.setattr(gathering, "has_colour", lambda *_: True)
    told_by_blocks = gather(trial, hypothesis, [], graded=False).extended.parameters
    plain = evidence.extended.parameters
    middle = score_by_blocks(hypothesis.fit)
    for name, quantity in hypothesis.fit.quantities_over(*middle).items():
        assert told_by_blocks[name].ci95 == quantity.ci95
        assert np.ptp(quantity.ci95) >= np.ptp(plain[name].ci95)
    assert any(np.ptp(told_by_blocks[n].ci95) > np.ptp(q.ci95) for n, q in plain.items())


def test_a_force_constant_below_zero_is_not_at_zero():
    _, e, _ = searched(lambda x, v: -4e6 * x**3, sign=-1.0)
    assert all(0.9 < share < 1.1 for share in e.base_shares.values())


def test_the_floor_of_a_periodic_record_holds_no_remainder():
    """A force that no effect of the library makes repeats with the input, and is no noise."""
    _, e, _ = searched(lambda x, v: 2e4 * x * x)
    value, source = e.noise.floor
    assert source == "periods"
    assert value == pytest.approx(truth.NOISE, rel=0.03)
    assert e.noise.rms > 2.0 * value


def test_without_periods_the_floor_is_what_the_best_model_leaves():
    _, e, _ = searched(feed=truth.scan(0.7))
    assert e.noise.floor == (e.noise.rms, "residuals")
    assert e.effects == ()


@pytest.mark.parametrize(("count", "size"), [(1, None), (8, 6000)])
def test_the_error_of_an_offset_is_that_of_slow_noise(count, size):
    """Over records with noise that wanders, the offsets found scatter by what is told."""
    train, model = truth.multisine(1)[:size], truth.believed()
    still, ratios = truth.move(train, None), []
    for first in range(0, 12 * count, count):
        runs = []
        for seed in range(first, first + count):
            slow = lfilter([1e-8], [1.0, -0.999], np.random.default_rng(seed).standard_normal(
                still.size + 5000))[5000:]
            runs.append(observe(truth.record(train, still + slow, 100 + seed), model, None,
                                f"run {seed}"))
        search = Search(model, runs, ("damping", "stiffness", "force_constant"), library=FEW)
        bare = search.begin()
        offset = gathering._offset(bare, ("force_offset",))
        ratios.append(offset.value / offset.sigma)
    assert 0.3 < float(np.std(ratios)) < 2.5


def test_a_parameter_that_a_fit_held_has_no_interval():
    """It was not estimated, and the value that a search begins with has no error."""
    model = Model("m", 1e-3, {"mass": 1.0, "damping": 1.0, "stiffness": 100.0,
                                 "force_constant": 1.0}).with_effect(
        "hysteresis", {"stiffness": 40.0, "yield_displacement": 1e-5, "shape": 0.6,
                       "exponent": 1.0})
    search = SimpleNamespace(runs=[SimpleNamespace(driven=True)], model=model)
    fitted = {"hysteresis.stiffness": Quantity(41.0, "N/m", (39.0, 43.0))}
    own = gathering._own(SimpleNamespace(search=search), SimpleNamespace(
        fit=SimpleNamespace(model=model)), "hysteresis", fitted)
    assert own["stiffness"] == Quantity(40.0, "N/m", (39.0, 43.0))
    assert own["exponent"] == Quantity(1.0, "", None)
