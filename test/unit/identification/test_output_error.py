"""Output error on simulated records: values, intervals, and what cannot be told apart."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from dfm_stage.identification import (
    IdentificationError,
    Problem,
    Run,
    Unknown,
    estimate,
    evaluate,
    fit_model,
)
from dfm_stage.model import Model

LINES = np.arange(1, 301, 2)
TRUTH = {"damping": 1.845, "stiffness": 650.0, "force_constant": 1.082,
         "amplifier_time_constant": 1e-3, "delay": 1e-3}
START = Model("start", 1e-3, base={
    "mass": 1.082, "damping": 1.5, "stiffness": 620.0, "force_constant": 1.0,
    "amplifier_time_constant": 7e-4, "delay": 1.4e-3})


def coloured(rng, samples, rms):
    noise = lfilter([1.0], [1.0, -0.95], rng.standard_normal(samples + 500))[500:]
    return rms * noise / noise.std()


def open_loop(reference_stage, multisine, seed, samples=6000, rms=2e-7, start=(0.0, 0.0)):
    rng = np.random.default_rng(seed)
    u = 0.08 * multisine(LINES, 2000, samples // 2000, seed)
    u, y = reference_stage().simulate(u, noise=coloured(rng, samples, rms), start=start)
    return Run(f"open{seed}", u, y, 1e-3)


def closed_loop(reference_stage, multisine, seed, samples=6000, rms=3e-6):
    rng = np.random.default_rng(seed)
    r = 1e-5 * multisine(LINES, 2000, samples // 2000, seed)
    memory = {"last": 0.0, "slope": 0.0}

    def pid(k, y):
        error = r[k] - y
        memory["slope"] += ((error - memory["last"]) / 1e-3 - memory["slope"]) / 3.0
        memory["last"] = error
        return 240.0 * error + 9.0 * memory["slope"]

    u, y = reference_stage().simulate(pid, samples, noise=coloured(rng, samples, rms))
    return Run(f"closed{seed}", u, y, 1e-3)


def scores(runs, **options):
    """Errors over standard errors (runs, parameters), and whether intervals hold."""
    errors, hits = [], []
    for run in runs:
        found = fit_model(START, [run], tuple(TRUTH), **options).estimate
        assert found.ok or options
        at = [found.index(n) for n in TRUTH]
        errors.append((found.values[at] - list(TRUTH.values())) / found.std[at])
        hits.append([found.quantity(n).covers(v) for n, v in TRUTH.items()])
    return np.array(errors), np.mean(hits)


def test_intervals_hold_in_open_loop_with_a_transient(reference_stage, multisine):
    errors, held = scores([open_loop(reference_stage, multisine, s, start=(2e-4, -5e-3))
                           for s in range(16)])
    assert held > 0.86
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)


def test_intervals_hold_in_closed_loop_where_plain_output_error_fails(reference_stage,
                                                                      multisine):
    runs = [closed_loop(reference_stage, multisine, s) for s in range(16)]
    errors, held = scores(runs)
    assert held > 0.86
    assert np.std(errors) == pytest.approx(1.0, abs=0.25)
    _, held_plain = scores(runs, noise="white")
    assert held_plain < held - 0.1


def test_several_records_share_parameters_and_keep_their_own_start(reference_stage, multisine):
    runs = [open_loop(reference_stage, multisine, s, start=(1e-4 * s, 0.0)) for s in (1, 2, 3)]
    alone = fit_model(START, runs[:1], tuple(TRUTH)).estimate
    together = fit_model(START, runs, tuple(TRUTH)).estimate
    ratio = together.quantity("stiffness").half_width / alone.quantity("stiffness").half_width
    assert 0.25 < ratio < 0.8
    for n, v in TRUTH.items():
        assert abs(together.value(n) - v) < 4 * together.std[together.index(n)]
    assert together.value("initial.position[open3]") == pytest.approx(3e-4, abs=2e-6)
    assert [s.name for s in together.segments] == ["open1", "open2", "open3"]


def test_periodic_record_in_steady_state(reference_stage, multisine):
    whole = open_loop(reference_stage, multisine, 5, samples=24_000)
    run = Run("steady", whole.input[-4000:], whole.output[-4000:], 1e-3, start="periodic",
              period=2000)
    found = fit_model(START, [run], tuple(TRUTH)).estimate
    assert not any(n.startswith("initial") for n in found.names)
    for n, v in TRUTH.items():
        assert abs(found.value(n) - v) < 4 * found.std[found.index(n)]


def test_mass_and_force_constant_only_as_a_ratio(reference_stage, multisine):
    run = open_loop(reference_stage, multisine, 0)
    found = fit_model(START, [run], ("mass", "force_constant", "damping", "stiffness")).estimate
    assert found.status == "not_identifiable"
    assert "only as ratios" in found.message
    assert {"mass", "force_constant"} <= set(found.identifiability.directions[0].members)
    assert found.quantity("mass").to_dict()["ci95"] == [None, None]
    gain = found.derived(lambda x: x[1] / x[3], "m/V")
    assert gain.covers(1.082 / 650.0) or gain.ci95 == (-np.inf, np.inf)
    ratio = found.value("force_constant") / found.value("mass")
    assert ratio == pytest.approx(1.0, rel=1e-3)


def test_holding_frees_the_rest(reference_stage, multisine):
    run = open_loop(reference_stage, multisine, 0)
    found = fit_model(START, [run], ("damping", "stiffness", "force_constant")).estimate
    assert found.held["mass"] == 1.082
    assert found.value("delay") == 1.4e-3


def test_a_parameter_on_its_limit_is_told(reference_stage, multisine):
    rng = np.random.default_rng(0)
    u = 0.02 * multisine(np.arange(1, 40, 2), 2000, 3)
    stage = reference_stage(lag=1e-5, delay_fifths=0)
    u, y = stage.simulate(u, noise=coloured(rng, u.size, 1e-6))
    seen = 0
    for seed in range(8):
        shaken = y + coloured(np.random.default_rng(seed), u.size, 1e-6)
        found = fit_model(START, [Run("slow", u, shaken, 1e-3)], tuple(TRUTH)).estimate
        for name in found.at_bound:
            seen += 1
            assert found.value(name) == 0.0
            assert found.quantity(name).ci95[0] == 0.0
            assert name in found.message
    assert seen > 0


def test_noise_levels_weigh_records(reference_stage, multisine):
    good = open_loop(reference_stage, multisine, 1, rms=5e-8)
    bad = open_loop(reference_stage, multisine, 2, rms=5e-6)
    alone = fit_model(START, [good], tuple(TRUTH)).estimate
    both = fit_model(START, [good, bad], tuple(TRUTH)).estimate
    assert both.std[both.index("stiffness")] <= 1.05 * alone.std[alone.index("stiffness")]
    assert both.value("stiffness") == pytest.approx(alone.value("stiffness"), rel=1e-4)


def test_hold_out_leaves_only_noise(reference_stage, multisine):
    fitted = fit_model(START, [open_loop(reference_stage, multisine, 1)], tuple(TRUTH))
    unseen = evaluate(fitted.model, open_loop(reference_stage, multisine, 2))
    assert unseen.rms == pytest.approx(2e-7, rel=0.3)
    assert unseen.fit_percent > 99.0


def toy(simulate, samples=400, step=1e-2, **unknown):
    t = np.arange(samples) * step
    y = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(samples)
    return Problem((Unknown("a", 0.8, 1.0, **unknown),), (Run("toy", y, y, 1e-2, trend=-1),),
                   lambda i, rows: simulate(rows, t))


def test_any_callable_can_be_the_model():
    found = estimate(toy(lambda rows, t: rows[:, :1] * np.sin(t)))
    assert found.status == "converged"
    assert found.quantity("a").covers(1.0)
    assert found.quantity("a").half_width < 0.01


def test_a_trap_is_left_by_another_start():
    def simulate(rows, t):
        return np.sin(rows[:, :1] * t)

    problem = toy(simulate, step=0.1)
    stuck = estimate(Problem((Unknown("a", 4.0, 1.0),), problem.runs, problem.simulate))
    freed = estimate(Problem((Unknown("a", 4.0, 1.0),), problem.runs, problem.simulate),
                     starts=[np.array([1.1]), np.array([9.0])])
    assert abs(stuck.value("a") - 1.0) > 0.1
    assert freed.quantity("a").value == pytest.approx(1.0, abs=0.01)


def test_failures_are_values_with_a_remedy():
    found = estimate(toy(lambda rows, t: np.full((len(rows), t.size), np.nan)))
    assert found.status == "failed"
    assert not found.ok
    assert "start from others" in found.message


def test_a_model_that_ends_at_a_cliff_is_still_differentiated():
    def simulate(rows, t):
        out = rows[:, :1] * np.sin(t)
        out[rows[:, 0] > 1.0001] = np.nan
        return out

    found = estimate(toy(simulate))
    assert found.value("a") == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("change", "said"), [
    ({"noise": "pink"}, "auto or white"), ({"samples": 6}, "too few")])
def test_impossible_requests_are_refused(change, said):
    noise = change.pop("noise", "auto")
    with pytest.raises(IdentificationError, match=said):
        estimate(toy(lambda rows, t: rows[:, :1] * np.sin(t), **change), noise=noise)
