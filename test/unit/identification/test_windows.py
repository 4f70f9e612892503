"""Windows with states of their own (multiple shooting): the same motion, cut."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.observation import Observation, in_windows
from dfm_stage.identification.convention import Convention
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.run import Run
from dfm_stage.identification.system import System
from dfm_stage.identification.weights import Weight
from dfm_stage.identification.windows import slope_at
from dfm_stage.model import Model, Simulator

PERIOD, SIZE, WINDOW = 1e-3, 1000, 300
SERVO = {"mass": 2.0, "damping": 6.0, "force_constant": 3.0}
FREE = ("damping", "mass")
STARTS = (0, 300, 600)


def feed(seed=3):
    """A smooth input (N,): what is band-limited is well below half the sampling rate."""
    rng = np.random.default_rng(seed)
    slow = np.fft.rfft(rng.standard_normal(SIZE))
    slow[SIZE // 20:] = 0.0
    return np.fft.irfft(slow, SIZE) + 0.4


def windowed(run, model, free=FREE):
    """A system on the run in windows, and where its states stand among the unknowns."""
    system = System(model, [replace(run, window=WINDOW)], free)
    return system, {u.name: k for k, u in enumerate(system.unknowns) if "@" in u.name}


def whole_and_in_windows(run, model, past=None):
    """Outputs (N,) of one simulation, and of windows that begin at its states."""
    values, factor, delay = (run.input, 1, 0.0) if run.drive is None else (
        run.drive.values, run.drive.factor, run.drive.delay)
    fine = model.with_parameters({"delay": model.base.get("delay", 0.0) + delay * PERIOD})
    seen = Simulator(replace(fine, sample_period=PERIOD / factor)).run(
        values, initial={"position": 1e-3, "velocity": -0.02},
        past_input=float(values[0]) if past is None else past)
    system, at = windowed(run, model)
    x = system.start.copy()
    for start in STARTS:
        x[at[f"initial.position@{start}"]] = seen.position[factor * start]
        x[at[f"initial.velocity@{start}"]] = seen.velocity[factor * start]
    return seen.position[::factor], system.simulated(0, x[None, :])[0][0]


@pytest.mark.parametrize("base", [
    SERVO, {**SERVO, "delay": 0.4 * PERIOD}, {**SERVO, "stiffness": 900.0, "delay": PERIOD}],
    ids=["servo", "delayed servo", "spring a sample late"])
def test_windows_that_begin_at_its_states_are_the_whole_run(base):
    run = Run("run", feed(), np.zeros(SIZE), PERIOD)
    whole, cut = whole_and_in_windows(run, Model("m", PERIOD, base))
    assert np.ptp(whole) > 1e-4
    assert cut == pytest.approx(whole, rel=0.0, abs=1e-12 * np.ptp(whole))


@pytest.mark.parametrize(("convention", "delay"), [
    (Convention("zero", -0.3), 0.0), (Convention("zero", -1.0), 0.5),
    (Convention("band_limited", 0.0), 0.05), (Convention("first", -0.2), 0.05)],
    ids=["held and early", "a sample early", "band-limited", "straight"])
def test_the_step_before_a_window_is_that_of_its_convention(convention, delay):
    """Within a delay the stage still feels the step before the cut, not the column's value."""
    rng = np.random.default_rng(5)
    run = Run("run", rng.standard_normal(SIZE), np.cumsum(np.cumsum(feed())), PERIOD)
    run = run.by(convention)
    assert run.drive is not None
    whole, cut = whole_and_in_windows(run, Model("m", PERIOD, {**SERVO, "delay": delay * PERIOD}))
    assert cut == pytest.approx(whole, rel=0.0, abs=1e-12 * np.ptp(whole))


def test_a_state_moves_its_own_window_and_nothing_else():
    run = Run("run", feed(), 1e-2 * feed(4), PERIOD)
    system, at = windowed(run, Model("m", PERIOD, SERVO))
    slopes = system.sensitivities(0, system.start)[0]
    time = PERIOD * np.arange(WINDOW)
    rate = SERVO["damping"] / SERVO["mass"]
    for start in STARTS:
        stop = SIZE if start == STARTS[-1] else start + WINDOW
        for name in ("position", "velocity"):
            slope = system.slope(slopes, at[f"initial.{name}@{start}"], 0)
            assert not np.any(slope[:start])
            assert not np.any(slope[stop:])
        assert system.slope(slopes, at[f"initial.position@{start}"], 0)[start:stop] \
            == pytest.approx(1.0)
        moved = system.slope(slopes, at[f"initial.velocity@{start}"], 0)[start:start + WINDOW]
        assert moved == pytest.approx(-np.expm1(-rate * time) / rate, abs=1e-7)


@pytest.mark.parametrize("polynomial", [np.ones(1), np.array([1.0, -0.6, 0.2])])
def test_the_derivative_by_entries_is_that_of_the_residual(polynomial):
    """Against differences of the residual, also where a weight's filter reaches over a cut."""
    runs = [Run(f"run {k}", feed(k), 1e-2 * feed(4 + k), PERIOD, window=WINDOW, skip=20)
            for k in range(2)]
    system = System(Model("m", PERIOD, SERVO), runs, FREE)
    criterion = Criterion(system, [(Weight(polynomial, 0.1, ""),)] * 2)
    found = criterion.derivative(system.start)
    assert found.nnz < 0.5 * found.shape[0] * found.shape[1]
    wanted = np.empty(found.shape)
    for k, scale in enumerate(system.scale):
        step = np.zeros(system.start.size)
        step[k] = 1e-4 * scale
        wanted[:, k] = (criterion.residual(system.start + step)
                        - criterion.residual(system.start - step)) / (2e-4 * scale)
    size = np.linalg.norm(wanted, axis=0)
    assert np.all(size > 0.0)
    assert found.toarray() / size == pytest.approx(wanted / size, abs=1e-4)
    assert criterion.jacobian(system.start) == pytest.approx(found.toarray())


def test_what_all_windows_share_is_felt_in_each():
    run = Run("run", feed(), np.zeros(SIZE), PERIOD)
    system, _ = windowed(run, Model("m", PERIOD, SERVO))
    slope = system.sensitivities(0, system.start)[0][system.free.index("mass")]
    assert min(np.ptp(slope[part]) for part in system.runs[0].windows) > 0.0


@pytest.mark.parametrize(("size", "ends"), [
    (1000, [300, 600, 1000]), (900, [300, 600, 900]), (899, [300, 899]), (600, [300, 600]),
    (300, [300]), (299, [299])])
def test_the_last_window_is_not_shorter(size, ends):
    run = Run("run", np.zeros(size), np.zeros(size), PERIOD, window=300)
    assert [part.stop for part in run.windows] == ends
    assert [part.start for part in run.windows] == [0, *ends[:-1]]


def test_only_a_free_state_begins_anew():
    """At rest, or in a periodic motion, is what a run is at its beginning, not in its middle."""
    u = feed()
    model = Model("m", PERIOD, {**SERVO, "stiffness": 900.0})
    for given in ({"start": "rest"}, {"start": "periodic", "period": SIZE // 2}):
        whole = Run("run", np.resize(u[:SIZE // 2], SIZE), u, PERIOD, **given)
        cut = replace(whole, window=200)
        assert len(cut.windows) == 1
        seen = [System(model, [run], FREE) for run in (whole, cut)]
        assert [u.name for u in seen[1].unknowns] == [u.name for u in seen[0].unknowns]
        a, b = (s.simulated(0, s.start[None, :])[0] for s in seen)
        assert np.array_equal(a, b)


@pytest.mark.parametrize(("size", "window", "count"), [
    (24_841, 331, 75), (40_000, 533, 75), (3_000, 200, 15), (450, 200, 2), (399, 200, 1)])
def test_a_record_is_cut_into_so_many_windows(size, window, count):
    run = in_windows(Observation("run", np.zeros(size), np.zeros(size), PERIOD))
    assert run.window == window
    assert len(run.windows) == count
    assert min(part.stop - part.start for part in run.windows) >= min(window, size)


def servo(size, seed):
    """A pushed body in fine steps of explicit Euler: the record and its mass and damping."""
    u, fine = np.resize(feed(seed), size), 50
    x = v = 0.0
    out = np.empty(size)
    for k, force in enumerate(3.0 * u + 0.5):  # half a newton that the model has not
        out[k] = x
        for _ in range(fine):
            v += PERIOD / fine * (force - 6.0 * v) / 2.0
            x += PERIOD / fine * v
    return Run(f"run {seed}", u, out, PERIOD)


def test_runs_of_different_lengths_keep_their_states_apart():
    model = Model("m", PERIOD, {**SERVO, "mass": 2.3})
    runs = [replace(servo(size, seed), window=window, skip=5)
            for size, seed, window in ((1000, 1, 250), (620, 2, 200), (400, 3, 0))]
    system = System(model, runs, FREE)
    own = [[u.name for u in system.unknowns if u.run == k] for k in range(3)]
    assert [len(names) for names in own] == [8, 6, 2]
    assert own[2] == ["initial.position", "initial.velocity"]
    weights = tuple((Weight(np.ones(1), 1e-6, ""),) for _ in runs)
    free = ("mass", "damping", "force_offset.force")
    found = fit(model.with_effect("force_offset", {"force": 0.1}), runs, free, weights)
    values = found.model.parameters()
    assert [values[n] for n in free] == pytest.approx([2.0, 6.0, 0.5], rel=2e-3)
    assert [parts[0].size for parts in found.residuals] == [995, 615, 395]


def test_what_a_model_misses_carries_a_free_body_away_but_not_its_windows():
    run = servo(SIZE, 1)
    model = Model("m", PERIOD, {**SERVO, "damping": 9.0}).with_effect(
        "force_offset", {"force": 0.5})
    weights = ((Weight(np.ones(1), 1e-6, ""),),)
    whole, cut = (fit(model, [each], (), weights).rms for each in (
        run, replace(run, window=100)))
    assert cut < 0.03 * whole


@pytest.mark.parametrize("at", [0, 3, 50, 97, 99])
def test_a_window_begins_with_the_speed_that_a_bent_motion_has_there(at: int) -> None:
    k = np.arange(100.0)
    assert slope_at(3.0 - 2.0 * k + 0.4 * k**2, at) == pytest.approx(-2.0 + 0.8 * at)


@pytest.mark.parametrize(("output", "slope"), [([5.0], 0.0), ([5.0, 7.0], 2.0)])
def test_a_record_of_a_sample_or_two_has_the_slope_it_shows(output, slope) -> None:
    assert slope_at(np.array(output), 0) == pytest.approx(slope)
