"""Formulas for forces that have no name, on records made without the library."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import truth

from dfm_stage.cli import diagnose as command
from dfm_stage.diagnosis import diagnose, formula_offer
from dfm_stage.diagnosis.formula_search import Regression, search
from dfm_stage.diagnosis.formula_terms import TERMS, Part, formula_from
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.verdict import Reason, Verdict
from dfm_stage.diagnosis.verification import Prediction
from dfm_stage.model import EFFECTS, Model, Simulator, load_model, save_model
from dfm_stage.model.formula_text import value
from dfm_stage.model.registry import effects_of
from dfm_stage.recording import AxisRecord, Provenance, Record

NOTHING_LIKE_IT = ["back_emf", "saturation"]
BY_TEXT = {term.text: term for term in TERMS}
SCALES = {"x": 1e-3, "v": 0.1, "1": 1.0}


def cogged(x, v):
    return -0.05 * np.sin(2.0 * np.pi * x / 2e-4 + 0.4)


def braked(x, v):
    """Damping that grows with the distance, and a spring that touches on one side."""
    return -2e7 * x * x * v - 300.0 * max(x - 1.2e-4, 0.0)


@pytest.mark.parametrize(("force", "forms", "shapes"), [
    (cogged, ["sin(2 * pi * x / p + q)"], [2e-4, 0.4]),
    (braked, ["max(x - x0, 0)", "x**2 * v"], [1.2e-4])])
def test_the_regression_finds_the_terms_that_a_force_is_made_of(force, forms, shapes):
    draw = np.random.default_rng(0)
    feeds = (truth.multisine(1), truth.multisine(2, 0.5))
    runs = [Observation(str(k), feed, truth.move(feed, force)
                        + truth.NOISE * draw.standard_normal(feed.size), truth.PERIOD)
            for k, feed in enumerate(feeds)]
    best = search(Regression(runs, truth.believed(damping=5.0, stiffness=4300.0), {}))[0]
    assert sorted(p.term.text for p in best.parts) == forms
    assert [s for p in sorted(best.parts, key=lambda p: p.term.text)
            for s in p.shapes] == pytest.approx(shapes, rel=0.03)
    assert best.came_back == (20,) * len(forms)


def test_parts_become_a_formula_with_names_units_and_ranges_of_their_own():
    parts = [Part(BY_TEXT["max(x - x0, 0)"], 200.0, (1e-4,)),
             Part(BY_TEXT["max(x - x0, 0)"], -50.0, (-3e-4,)), Part(BY_TEXT["sign(v)"], 0.02)]
    formula = formula_from("found", parts, SCALES)
    assert formula.text == "-k1 * max(x - x0_1, 0) - k2 * max(x - x0_2, 0) - f * sign(v)"
    given = {p.name: p for p in formula.parameters}
    assert (given["k1"].value, given["k2"].value, given["x0_2"].value) == (200.0, -50.0, -3e-4)
    assert (given["k1"].unit, given["f"].unit) == ("N/m", "N")
    assert given["f"].range == (0.0, 1.0)
    assert given["x0_1"].range == (-4e-3, 4e-3)
    effect = formula.effect()
    assert effect.adds_to == "dry_friction"
    at = {"x": 5e-4, "v": 0.1, **{n: p.value for n, p in given.items()}}
    assert value(effect.tree, at) == pytest.approx(-200.0 * 4e-4 + 50.0 * 8e-4 - 0.02)


@pytest.mark.parametrize("term", TERMS, ids=[term.text for term in TERMS])
def test_every_term_is_a_formula_that_the_simulator_takes(term):
    shapes = term.begins(SCALES)[0]
    effect = formula_from("one", [Part(term, 0.5, shapes)], SCALES).effect()
    x, v = 3e-4, 0.07
    told = {"x": x, "v": v, "i": 0.2}
    expected = term.values({**told, "direction": np.sign(v)}, shapes)
    assert value(effect.tree, {**told, **effect.defaults}) == pytest.approx(-0.5 * expected)


def left(rms, draw):
    signal = rms * draw.standard_normal(4000)
    return Prediction(rms, 0.0, signal.size, [[signal]])


@pytest.mark.parametrize(("before", "after", "offered"), [
    (5.0, 1.2, True),       # nearly all of what is above the noise
    (5.0, 4.6, False),      # a little of it
    (1.0, 1.0, False),      # noise
    (3.0, 3.3, False)])     # worse than without
def test_an_offer_needs_a_part_of_what_is_left_of_held_out_records(before, after, offered):
    draw = np.random.default_rng(1)
    fitted = SimpleNamespace(left=left(after, draw),
                             proposal=SimpleNamespace(without=left(before, draw)))
    evidence = SimpleNamespace(judged=SimpleNamespace(lag=0, noise_power=1.0))
    assert formula_offer._pays(fitted, evidence) is offered


@pytest.mark.parametrize(("kind", "remainder", "wanted"), [
    ("unknown", True, True), ("partial", True, True), ("named", True, True),
    ("named", False, False), ("none", False, False), ("ambiguous", True, False)])
def test_formulas_are_looked_for_where_something_has_no_name(kind, remainder, wanted):
    assert formula_offer.wants_formulas(
        Verdict(kind, Reason.GRADED, remainder=remainder)) is wanted


def answered(force, noise_seed=3):
    feed, other = truth.multisine(4), truth.scan()
    return diagnose([truth.record(feed, truth.move(feed, force), noise_seed)], truth.believed(),
                    holdout=[truth.record(other, truth.move(other, force), noise_seed + 1)],
                    library=NOTHING_LIKE_IT)


def test_of_noise_no_formula_is_made():
    found = answered(None)
    assert (found.verdict, found.formulas) == ("none", ())


def test_of_a_force_that_is_none_of_the_motion_no_formula_is_made():
    time_s = truth.PERIOD * np.arange(truth.SAMPLES)
    shake = 0.05 * np.sin(2.0 * np.pi * 31.7 * time_s)
    records = [truth.record(feed, truth.move(feed + shake), k)
               for k, feed in enumerate((truth.multisine(4), truth.multisine(5)))]
    found = diagnose(records[:1], truth.believed(), holdout=records[1:], library=NOTHING_LIKE_IT)
    assert (found.verdict, found.formulas) == ("unknown", ())
    assert found.to_dict()["description"]["formulas"] == []


def cogged_body(seed):
    """A body without a spring in a loop that follows a few sines, over magnets 4 mm apart."""
    draw, h = np.random.default_rng(seed), truth.PERIOD / 4
    time_s = truth.PERIOD * np.arange(8000)
    wanted = sum(a * np.sin(2.0 * np.pi * f * time_s + p) for a, f, p in zip(
        draw.uniform(1e-3, 5e-3, 5), draw.uniform(0.3, 4.0, 5), draw.uniform(0.0, 6.0, 5),
        strict=True))
    x = v = 0.0
    feed, out = np.empty(time_s.size), np.empty(time_s.size)

    def pushed(x, v, u):
        return 2.0 * u - 3.0 * v - 0.6 * np.sin(2.0 * np.pi * x / 4e-3 + 0.5)

    for k, target in enumerate(wanted.tolist()):
        out[k], feed[k] = x, 200.0 * (target - x) - 10.0 * v
        for _ in range(4):          # midpoint rule
            half = v + 0.5 * h * pushed(x, v, feed[k])
            v += h * pushed(x + 0.5 * h * v, half, feed[k])
            x += h * half
    return Record(time_s, truth.PERIOD, {"x": AxisRecord(
        feed, out + 1e-6 * draw.standard_normal(out.size))}, Provenance(str(seed), "csv"))


def test_a_body_without_a_spring_gets_its_formula_in_the_windows_it_is_judged_in():
    model = Model("body", truth.PERIOD, {"mass": 1.0, "damping": 3.3, "force_constant": 2.0})
    found = diagnose([cogged_body(1)], model, holdout=[cogged_body(2)], library=NOTHING_LIKE_IT)
    assert (found.verdict, found.gap.judged) == ("unknown", "velocity")
    assert found.gap.window_s is not None
    first = found.formulas[0]
    assert first.formula.text == "-f * sin(2 * pi * x / p + q)"
    assert first.parameters["f"].value == pytest.approx(0.6, rel=0.02)
    assert first.parameters["p"].value == pytest.approx(4e-3, rel=0.002)


K, X0 = truth.CABLE
FEEDS = {"fitted": 2.0 * truth.multisine(31)[:5000], "held": 2.0 * truth.scan()[:5000]}


@pytest.fixture(scope="module")
def cable(tmp_path_factory):
    """A folder with two records of a stage with a cable and the model that lacks it, and the
    motion of the held-out one without noise."""
    folder, draw = tmp_path_factory.mktemp("cable"), np.random.default_rng(5)
    moved = {name: truth.pulled(feed) for name, feed in FEEDS.items()}
    for name, x in moved.items():
        table = np.column_stack((truth.PERIOD * np.arange(x.size), FEEDS[name],
                                 x + truth.NOISE * draw.standard_normal(x.size)))
        np.savetxt(folder / f"{name}.csv", table, "%.10g", ",",
                   header="time_s,input_v,position_m", comments="")
    save_model(truth.believed(), folder / "model.yaml")
    return folder, moved["held"]


def run(folder, out, *more):
    assert command.main([str(folder / "fitted.csv"), "--holdout", str(folder / "held.csv"),
                         "--model", str(folder / "model.yaml"), "--out", str(folder / out),
                         "--library", ",".join(NOTHING_LIKE_IT), *more]) == 0
    return json.loads((folder / out / "diagnosis.json").read_text("utf-8"))


def test_what_has_no_name_gets_a_formula_and_accepting_it_closes_the_gap(cable, capsys):
    folder, moved = cable
    answer = run(folder, "out")
    said = capsys.readouterr().out
    assert (answer["verdict"], answer["effects"]) == ("unknown", [])
    offered = answer["description"]["formulas"][0]
    assert offered["force"] == "-k * max(x - x0, 0)"
    assert offered["force"] in said
    assert "--accept" in said
    assert offered["held_out_rms"] < 1.5 * truth.NOISE
    assert offered["share"] > 0.99
    assert offered["found_in_percent"] == 100.0
    for name, true in (("k", K), ("x0", X0)):
        low, high = offered["parameters"][name]["ci95"]
        assert low - 0.5 * (high - low) < true < high + 0.5 * (high - low)
    assert offered["file"] in (folder / "out" / "report.html").read_text("utf-8")

    file = folder / "out" / offered["file"]
    with effects_of([file]) as effects:
        assert [effect.name for effect in effects] == [offered["name"]]
    more = run(folder, "accepted", "--accept", str(file))
    said = capsys.readouterr().out
    held = more["gap"]["held_out"]
    assert held["before"] == pytest.approx(answer["gap"]["held_out"]["before"], rel=1e-6)
    assert held["retuned"] == pytest.approx(answer["gap"]["held_out"]["retuned"], rel=0.05)
    assert held["after"] < 1.5 * truth.NOISE < 0.1 * held["retuned"]
    assert more["verdict"] in ("none", "retune")
    assert more["accepted"][0]["force"] == offered["force"]
    assert "With formula_1 the held-out gap falls" in said
    assert "What was accepted" in (folder / "accepted" / "report.html").read_text("utf-8")
    model = load_model(folder / "accepted" / "model.yaml")
    assert np.std(Simulator(model).run(FEEDS["held"]).position - moved) < truth.NOISE
    assert offered["name"] not in list(EFFECTS)


def test_a_formula_that_does_nothing_is_accepted_and_told_as_it_is(cable, capsys):
    folder, _ = cable
    (folder / "out").mkdir(exist_ok=True)
    (folder / "out" / "formula_3.yaml").write_text("of an earlier answer")
    (folder / "idle.yaml").write_text(
        "{name: idle, force: '-c * v**3', parameters: {c: {value: 0, range: [-1e-9, 1e-9]}}}")
    answer = run(folder, "out", "--accept", str(folder / "idle.yaml"), "--no-report")
    assert answer["verdict"] == "unknown"
    assert "The gap is real" in capsys.readouterr().out
    assert not (folder / "out" / "formula_3.yaml").exists()
    assert answer["description"]["formulas"]


def test_a_file_that_cannot_be_accepted_is_one_line(cable, capsys):
    folder, _ = cable
    (folder / "named.yaml").write_text(
        "{name: creep, force: '-k * x**3', parameters: {k: {value: 1}}}")
    for file, reason in (("named.yaml", "effect of the library"), ("none.yaml", "cannot be read")):
        assert command.main([str(folder / "fitted.csv"), "--model", str(folder / "model.yaml"),
                             "--accept", str(folder / file)]) == 2
        said = capsys.readouterr().err
        assert reason in said
        assert said.strip().count("\n") == 0
