"""The measured-like cases: determinism, shares, labels decided beforehand and apart."""

import json

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.corpus.linear import response
from benchmarks.corpus.measured import make_case, measured_plan
from benchmarks.corpus.measured.effects import LIBRARY, OUTSIDE, OUTSIDERS, REMAINDERS, can_meet
from benchmarks.corpus.measured.nuisance import NUISANCES
from benchmarks.corpus.measured.plan import GROUPS, SHARES, MeasuredSpec
from benchmarks.corpus.measured.plan import NUISANCES as NUISANCE_NAMES
from benchmarks.corpus.measured.plant import (
    ACCELERATION,
    HELD,
    INPUT,
    MISSING,
    POSITION,
    REST,
    SPEED,
)
from benchmarks.corpus.measured.truth import make_setup
from benchmarks.corpus.plan import EFFECTS, class_of
from benchmarks.corpus.uncommon import PARAMETERS


@pytest.mark.parametrize("group", GROUPS)
def test_a_case_is_the_same_whatever_number_is_asked_for(group: str) -> None:
    assert measured_plan(group, 5, 4) == measured_plan(group, 200, 4)[:5]
    spec = measured_plan(group, 5, 4)[1]
    one, two = make_case(spec), make_case(spec)
    assert json.dumps(one.label) == json.dumps(two.label)
    assert one.model == two.model
    for a, b in zip(one.records + one.holdout, two.records + two.holdout, strict=True):
        assert all(np.array_equal(a[name], b[name]) for name in a)


def test_the_plan_has_every_effect_share_and_kind() -> None:
    plan = measured_plan("remainder", 300, 1)
    assert {(s.effect, s.share) for s in plan} == {(e, s) for e in LIBRARY for s in SHARES}
    assert {s.kind for s in plan} == set(REMAINDERS)
    assert len(REMAINDERS) >= 8
    assert {s.kind for s in measured_plan("outsider", 40, 1)} == set(OUTSIDERS)
    assert {s.kind for s in measured_plan("nuisance", 40, 1)} == set(NUISANCES)
    assert set(NUISANCE_NAMES) == set(NUISANCES)


def test_relatives_are_effects_of_the_library_and_remainders_no_effect_s_own() -> None:
    for name, kind in OUTSIDE.items():
        assert kind.relatives <= {*EFFECTS, *PARAMETERS}, name
        assert name not in EFFECTS
        assert kind.reason
        for effect in LIBRARY:
            assert not (can_meet(effect, name) and effect in kind.relatives)


@pytest.mark.parametrize("share", [0.03, 0.3])
def test_a_remainder_makes_the_share_that_was_asked_for(share: float) -> None:
    # the refits once more by scipy, on the exactly discretised stage
    made = (make_setup(MeasuredSpec(i, 6, "remainder", "cubic_stiffness", "directional_damping",
                                    share))[0] for i in range(9))
    setup = next(s for s in made if s.train[0].hold == HELD and len(s.train) == 1)
    base, period = setup.known, setup.stage.period
    free = [n for n in ("damping", "stiffness", "force_constant", "amplifier_time_constant",
                        "delay") if base.get(n, 0.0) > 0.0]
    scale = setup.gap

    def refitted(outputs: list[np.ndarray]) -> np.ndarray:
        def left(z: np.ndarray) -> np.ndarray:
            model = {**base, **{n: base[n] * (1.0 + v) for n, v in zip(free, z, strict=False)}}
            gaps = []
            for i, (run, out) in enumerate(zip(setup.train, outputs, strict=True)):
                x0, v0, zero = scale * z[len(free) + 3 * i:len(free) + 3 * i + 3]
                gaps.append(out - zero - response(model, period, run.command,
                                                  (x0, v0 / (20.0 * period))))
            return np.concatenate(gaps) / scale

        return least_squares(left, np.zeros(len(free) + 3 * len(outputs)), x_scale="jac").fun

    runs = range(len(setup.train))
    whole = refitted([setup.simulate(i).clean for i in runs])
    rest = whole - refitted([setup.simulate(i, rest=False).clean for i in runs])
    assert rest @ rest / (whole @ whole) == pytest.approx(share, rel=0.2)
    assert setup.share == pytest.approx(share, rel=0.1)


def test_a_remainder_of_a_closed_loop_is_a_share_of_the_force() -> None:
    made = (make_setup(MeasuredSpec(i, 6, "remainder", "coulomb_friction", "root_drag", 0.1))[0]
            for i in range(2, 20))
    setup = next(s for s in made if s.judged == "force")
    # least squares of the force along the motion, by the plant's own rows
    rows = np.hstack([setup.simulate(i).rows for i in range(len(setup.train))])
    linear = np.column_stack([rows[POSITION], rows[SPEED], rows[ACCELERATION], rows[INPUT],
                              np.ones(rows.shape[1])])
    linear /= np.std(linear, axis=0) + 1e-300 + (np.std(linear, axis=0) == 0.0)
    speed = rows[SPEED]
    force = setup.rest["root_drag"] * np.sqrt(np.abs(speed)) * np.sign(speed)
    moving = np.abs(speed) > 0.0
    assert np.allclose(-force[moving], rows[REST][moving], rtol=1e-6, atol=1e-9 * force.max())
    left = [r - linear @ np.linalg.lstsq(linear, r, rcond=None)[0]
            for r in (rows[MISSING], rows[REST])]
    assert left[1] @ left[1] / (left[0] @ left[0]) == pytest.approx(0.1, rel=0.2)
    assert all(run.closed for run in setup.runs)


def test_labels_of_remainders_and_outsiders() -> None:
    case = make_case(next(s for s in measured_plan("remainder", 64, 2)
                          if s.effect == "quadratic_stiffness"))
    assert set(case.label["right"]) == class_of("quadratic_stiffness")
    assert set(case.label["allowed"]) >= OUTSIDE[case.spec.kind].relatives
    assert 3.0 <= case.label["gap_over_noise"] <= 100.0
    plan = measured_plan("outsider", 40, 2)
    out = make_case(next(s for s in plan if s.kind == "sensor_even"))
    assert out.label["right"] == []
    assert out.label["expected"] == ["unknown", "partial"]
    uncommon = make_case(next(s for s in plan if s.kind == "cogging"))
    assert uncommon.label["right"] == ["cogging", "gravity"]
    assert "named" in uncommon.label["expected"]


def test_a_model_says_nothing_of_the_truth() -> None:
    for group in GROUPS:
        for spec in measured_plan(group, 1, 3):
            case = make_case(spec)
            assert set(case.model) == {"dfm_model", "name", "sample_period", "base"}
            assert spec.kind == "" or spec.kind not in json.dumps(case.model)
            assert spec.effect == "" or spec.effect not in json.dumps(case.model)
            for run in case.records + case.holdout:
                assert set(run) <= {"time_s", "input_v", "position_m", "reference_m"}


def test_nuisances_do_to_the_log_what_they_say() -> None:
    made = {s.kind: make_case(s) for s in measured_plan("nuisance", len(NUISANCES), 5)}
    steps = {name: np.diff(case.records[0]["time_s"]) / case.sample_period
             for name, case in made.items()}
    assert np.any(steps["repeated_rows"] == 0.0)
    assert np.any(np.round(steps["lost_rows"]) == 2)
    assert np.allclose(steps["lost_silently"], 1.0)
    assert 0.01 < np.std(steps["jitter_stamps"]) < 0.5
    assert 0.01 < np.std(steps["jitter_samples"]) < 0.1
    gain = made["inverted"].records[0]
    assert np.corrcoef(gain["position_m"], _linear(made["inverted"]))[0, 1] < -0.9
    stale = made["stale_samples"].records[0]["position_m"]
    fresh = made["complete"].records[0]["position_m"]
    assert np.mean(np.diff(stale) == 0.0) > 5e-4
    assert made["low_resolution"].label["resolution"] > 0.0
    assert fresh.size > 0
    early = made["output_early"].label["conventions"][0]
    assert early["input_shift_samples"] == -1.0


def _linear(case: object) -> np.ndarray:
    run = case.records[0]
    return response(case.label["true_base"], case.sample_period, run["input_v"])
