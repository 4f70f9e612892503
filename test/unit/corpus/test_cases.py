"""The plan and the cases: determinism, severity, labels apart."""

import json
from collections import Counter

import numpy as np
import pytest

from benchmarks.corpus import case_plan, make_case
from benchmarks.corpus.case import make_truth
from benchmarks.corpus.case_files import write_case
from benchmarks.corpus.plan import BLOCK, EFFECTS, SEVERITIES, CaseSpec, class_of
from benchmarks.corpus.rivals import DISTANCE, pair_separability, separability
from benchmarks.corpus.severity import scale_for

SHORT = 4000


def test_a_case_is_the_same_whatever_number_is_asked_for() -> None:
    assert case_plan(30, 5) == case_plan(300, 5)[:30]
    assert case_plan(30, 5) != case_plan(30, 6)
    spec = case_plan(10, 5)[3]
    one, two = make_case(spec, SHORT), make_case(spec, SHORT)
    assert json.dumps(one.label) == json.dumps(two.label)
    assert one.model == two.model
    for a, b in zip(one.records, two.records, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_the_plan_has_what_the_trials_need() -> None:
    plan = case_plan(20 * BLOCK, 1)
    assert [spec.index for spec in plan] == list(range(len(plan)))
    kinds = Counter(spec.kind for spec in plan)
    assert kinds["none"] >= 300
    assert kinds["retune"] >= 100
    assert kinds["pair"] >= 100
    assert {spec.effects[0] for spec in plan if spec.kind == "left_out"} >= set(EFFECTS) - {
        "force_offset", "back_emf"}
    by_effect = Counter((s.effects[0], s.severity) for s in plan if s.kind == "effect")
    for name in EFFECTS:
        assert all(by_effect[name, size] >= (20 if size >= 3 else 6) for size in SEVERITIES)
    assert all(class_of(a) != class_of(b) for a, b in
               (s.effects for s in plan if s.kind == "pair"))


def test_severity_is_what_a_linear_refit_leaves() -> None:
    # the refit once more, by nonlinear least squares of the exactly discretised stage
    from scipy.optimize import least_squares

    from benchmarks.corpus.linear import response

    spec = next(s for s in case_plan(BLOCK, 1)
                if s.effects == ("cubic_stiffness",) and s.severity == 3.0)
    truth = make_truth(spec, 8000)
    base, noise = truth.setup.stage.base, truth.setup.stage.noise
    runs = [truth.outputs[i] for i in range(len(truth.setup.train))]
    names = [n for n in ("damping", "stiffness", "force_constant", "amplifier_time_constant",
                         "delay", "back_emf") if n in base]

    def left(z: np.ndarray) -> np.ndarray:
        model = {**base, **{n: base[n] * (1 + v) for n, v in zip(names, z, strict=False)}}
        gaps = []
        for i, out in enumerate(runs):
            x0, v0, zero = z[len(names) + 3 * i:len(names) + 3 * i + 3] * noise
            offset = 0.0 if "encoder_zero" in base else zero
            gaps.append(out[2] - response(model, 1e-3, out[0], (x0, 100 * v0)) - offset)
        return np.concatenate(gaps) / noise

    found = least_squares(left, np.zeros(len(names) + 3 * len(runs)), x_scale="jac")
    assert np.sqrt(np.mean(found.fun**2)) == pytest.approx(3.0, rel=0.06)
    assert truth.severities["cubic_stiffness"] == pytest.approx(3.0, rel=0.03)


def test_scale_is_found_for_curved_severities() -> None:
    for law in (lambda s: 7 * s, lambda s: 2 * s**2, lambda s: 40 * s / (1 + s),
                lambda s: max(0.0, s - 0.2)):
        scale, value = scale_for(law, 3.0)
        assert law(scale) == value == pytest.approx(3.0, rel=0.03)
    with pytest.raises(ValueError, match="no scale"):
        scale_for(lambda s: 1e-6, 3.0)


def test_records_say_nothing_of_the_truth(tmp_path) -> None:
    for spec in (CaseSpec(3, 9, "effect", ("cross_axis_coupling",), 10.0),
                 CaseSpec(4, 9, "left_out", ("hysteresis",), 10.0)):
        case = make_case(spec, SHORT)
        assert case.remove == ((
            "coulomb_friction", "hysteresis", "presliding_friction") if spec.index == 4 else ())
        folder = write_case(case, tmp_path / "cases", tmp_path / "labels")
        assert {p.name for p in folder.iterdir()} >= {"run_0.csv", "holdout_0.csv", "model.yaml"}
        header, first = (folder / "run_0.csv").read_text().splitlines()[:2]
        assert header.split(",")[0] == "time_s"
        assert len(first.split(",")) == len(header.split(","))
        model = (folder / "model.yaml").read_text()
        assert not any(name in model for name in EFFECTS if name != "back_emf")
        label = json.loads((tmp_path / "labels" / f"case_{spec.index:05d}.json").read_text())
        assert label["effects"] == list(spec.effects)


def test_train_and_held_out_differ_in_kind() -> None:
    for spec in case_plan(8, 2):
        label = make_case(spec, SHORT).label
        if spec.trap not in ("rest", "feedback_noise", "free_stage"):
            assert not set(label["train"]) & set(label["held_out"])


def test_expected_answers_follow_from_physics() -> None:
    found = {}
    for index in range(7):
        for name in ("back_emf", "force_offset"):
            case = make_case(CaseSpec(index, 3, "effect", (name,), 3.0), SHORT)
            known = "current_a" in case.records[0] if name == "back_emf" else (
                "encoder_zero" in case.model["base"])
            found.setdefault((name, known), set()).add(case.label["expected"][0])
    assert found == {("back_emf", True): {"named"}, ("back_emf", False): {"retune"},
                     ("force_offset", True): {"named"}, ("force_offset", False): {"ambiguous"}}


@pytest.mark.slow
def test_separability_by_information() -> None:
    # far above the noise a curved spring is not a weakening coil; far below it they are one
    clear = make_truth(CaseSpec(0, 4, "effect", ("cubic_stiffness",), 10.0), 2000)
    lost = make_truth(CaseSpec(0, 4, "effect", ("cubic_stiffness",), 0.02), 2000)
    assert separability(lost).distance < DISTANCE < separability(clear).distance


def test_of_a_pair_each_effect_is_seen_beside_the_other() -> None:
    pair = make_truth(CaseSpec(2, 6, "pair", ("cubic_stiffness", "thermal_drift"), 10.0), SHORT)
    found = pair_separability(pair)
    assert found["separable"]
    # the linear refit cannot make more of an effect than there is on all runs together
    assert 5.0 < found["margins"]["thermal_drift"] < 20.0
    faint = make_truth(CaseSpec(2, 6, "pair", ("cubic_stiffness", "thermal_drift"), 0.01), SHORT)
    assert not pair_separability(faint)["separable"]
