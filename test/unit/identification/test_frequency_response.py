"""Frequency responses against the stage they were measured on, in open and closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from dfm_stage.identification import IdentificationError, frequency_response

LINES = np.arange(1, 141, 2)


def record(reference_stage, multisine, seed, periods=8, noise=2e-7, **truth):
    stage = reference_stage(**truth)
    u = 0.05 * multisine(LINES, 2000, periods, seed)
    rng = np.random.default_rng(seed)
    u, y = stage.simulate(u, noise=noise * rng.standard_normal(u.size))
    return stage, u, y


def test_response_and_its_uncertainty(reference_stage, multisine):
    errors = []
    for seed in range(12):
        stage, u, y = record(reference_stage, multisine, seed, damping=12.0)
        found = frequency_response(u, y, 1e-3)
        assert found.method == "periods"
        assert list(found.lines) == list(LINES)
        assert found.periods_used < found.periods_total == 8
        gap = found.response - stage.response(found.omega)
        errors.append(np.abs(gap) ** 2 / found.variance)
    # |error|^2 over its variance is exponential with mean one.
    mean = np.mean(errors)
    assert mean == pytest.approx(1.0, abs=4 / np.sqrt(np.size(errors)))
    assert np.mean(np.array(errors) > 3.0) == pytest.approx(np.exp(-3.0), abs=0.03)


def test_covariance_and_control_frd(reference_stage, multisine):
    control = pytest.importorskip("control")
    _, u, y = record(reference_stage, multisine, 0)
    found = frequency_response(u, y, 1e-3)
    frd = found.to_control()
    assert isinstance(frd, control.FrequencyResponseData)
    np.testing.assert_allclose(frd.frdata[0, 0], found.response)
    np.testing.assert_allclose(frd.omega, found.omega)


def test_known_poles_give_back_the_periods_of_the_transient(reference_stage, multisine):
    stage, u, y = record(reference_stage, multisine, 1)
    poles = np.roots([1.0, 1.845 / 1.082, 650 / 1.082])
    plain = frequency_response(u, y, 1e-3)
    cleaned = frequency_response(u, y, 1e-3, poles=tuple(complex(p) for p in poles))
    assert plain.periods_used < cleaned.periods_used == 8
    gap = np.abs(cleaned.response - stage.response(cleaned.omega)) ** 2 / cleaned.variance
    assert np.mean(gap) == pytest.approx(1.0, abs=0.6)


def closed_loop(reference_stage, multisine, seed, noise=3e-6):
    """A weak reference against strong coloured noise that comes back through the controller."""
    rng = np.random.default_rng(seed)
    r = 2e-5 * multisine(LINES, 2000, 16, seed)
    v = lfilter([1.0], [1.0, -0.9], rng.standard_normal(r.size))
    state = {"last": 0.0}

    def pid(k, y):
        error = r[k] - y
        slope = (error - state["last"]) / 1e-3
        state["last"] = error
        return 300.0 * error + 6.0 * slope

    stage = reference_stage(damping=12.0)
    u, y = stage.simulate(pid, r.size, noise=noise * v / v.std())
    return stage, r, u, y


def test_feedback_does_not_bias_it(reference_stage, multisine):
    gaps = []
    for seed in range(6):
        stage, r, u, y = closed_loop(reference_stage, multisine, seed)
        found = frequency_response(u, y, 1e-3, reference=r)
        gaps.append((found.response - stage.response(found.omega)) / np.sqrt(found.variance))
    low = np.array(gaps)[:, :30]
    assert np.mean(np.abs(low) ** 2) == pytest.approx(1.0, abs=0.35)
    # Without bias the mean of six is six times smaller in power.
    assert np.mean(np.abs(low.mean(axis=0)) ** 2) == pytest.approx(1 / 6, abs=0.12)


@pytest.mark.parametrize(("power", "kind"), [(2, "even"), (3, "odd")])
def test_distortion_at_detection_lines(multisine, power, kind):
    lines = np.setdiff1d(np.arange(1, 141, 2), [9, 23, 41, 77, 101])
    u = multisine(lines, 2000, 8)
    rng = np.random.default_rng(0)
    y = lfilter([0.1], [1.0, -0.9], u) + 0.02 * u**power + 1e-3 * rng.standard_normal(u.size)
    y[:4] = y[2000:2004]
    found = frequency_response(u, y, 1e-3).distortion
    other = {"odd": "even", "even": "odd"}[kind]
    assert found.significant(kind)
    assert not found.significant(other)
    assert found.decibel(kind) > -45.0


def test_no_distortion_in_a_linear_record(reference_stage, multisine):
    lines = np.setdiff1d(LINES, [9, 23, 41, 77, 101])
    u = 0.05 * multisine(lines, 2000, 10)
    rng = np.random.default_rng(2)
    u, y = reference_stage(damping=12.0).simulate(u, noise=1e-7 * rng.standard_normal(u.size))
    found = frequency_response(u, y, 1e-3).distortion
    assert not found.significant("odd")
    assert not found.significant("even")


def test_chirp_by_local_polynomials(reference_stage):
    t = np.arange(20_000) * 1e-3
    u = 0.3 * chirp(t, 0.5, 20.0, 60.0)
    rng = np.random.default_rng(0)
    stage = reference_stage(damping=12.0)
    u, y = stage.simulate(u, noise=1e-7 * rng.standard_normal(u.size), start=(1e-4, 1e-3))
    found = frequency_response(u, y, 1e-3)
    assert found.method == "local polynomial"
    band = (found.frequency_hz > 6.0) & (found.frequency_hz < 55.0)
    gap = found.response - stage.response(found.omega)
    assert np.median(np.abs(gap / found.response)[band]) < 5e-3
    assert np.max(np.abs(gap / found.response)[band]) < 0.1
    # Where the chirp begins, a transient looks alike: that must be in the uncertainty.
    assert 0.2 < np.median(np.abs(gap) ** 2 / found.variance) < 2.0


@pytest.mark.parametrize(("change", "said"), [
    (lambda u, y: (u[:-1], y), "one length"),
    (lambda u, y: (0.0 * u, y), "never moves"),
    (lambda u, y: (u, np.where(np.arange(y.size) == 7, np.nan, y)), "not finite"),
])
def test_unusable_data_is_refused_in_one_line(reference_stage, multisine, change, said):
    _, u, y = record(reference_stage, multisine, 0, periods=3)
    with pytest.raises(IdentificationError, match=said) as caught:
        frequency_response(*change(u, y), 1e-3)
    assert "\n" not in str(caught.value)


def test_a_period_that_does_not_fit_twice_is_refused():
    noise = np.random.default_rng(0).standard_normal(1000)
    with pytest.raises(IdentificationError, match="two periods"):
        frequency_response(noise, noise, 1e-3, period=600)
