"""Effects that a search may miss: large, sharp, constant or coarse; answers from closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import truth
from scipy.signal import chirp, cont2discrete, dlsim

from dfm_stage.diagnosis import diagnose, grading
from dfm_stage.diagnosis.candidates import late_splits
from dfm_stage.diagnosis.decisions import MARGIN
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.observation import Observation, observe
from dfm_stage.diagnosis.screen import Hit, Screen
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.spectra import lattice
from dfm_stage.diagnosis.verification import SurrogateTest, weights_like
from dfm_stage.identification.weights import white_weights
from dfm_stage.model import EFFECTS, Simulator
from dfm_stage.recording import Record

QUICK = [n for n in EFFECTS if n not in ("hysteresis", "presliding_friction")]


def linear(feed: np.ndarray, a: list[list[float]], b: list[float], c: list[float]) -> np.ndarray:
    """Position (N,) of a linear system from rest, the input held over each sample (scipy)."""
    system = cont2discrete((np.array(a), np.array(b)[:, None], np.array([c]), np.zeros((1, 1))),
                           truth.PERIOD)
    return dlsim(system, feed)[1][:, 0]


def creeping(feed: np.ndarray, stiffness: float, time_constant: float) -> np.ndarray:
    m, rate = truth.MASS, 1.0 / time_constant
    return linear(feed, [[0.0, 1.0, 0.0],
                         [-(truth.STIFFNESS + stiffness) / m, -truth.DAMPING / m, stiffness / m],
                         [rate, 0.0, -rate]], [0.0, truth.GAIN / m, 0.0], [1.0, 0.0, 0.0])


def two_modes(feed: np.ndarray, share: float, hertz: float, zeta: float) -> np.ndarray:
    m, w = truth.MASS, 2.0 * np.pi * hertz
    return linear(feed, [[0.0, 1.0, 0.0, 0.0],
                         [-truth.STIFFNESS / m, -truth.DAMPING / m, 0.0, 0.0],
                         [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -w * w, -2.0 * zeta * w]],
                  [0.0, truth.GAIN / m, 0.0, truth.GAIN / m], [1.0 - share, 0.0, share, 0.0])


def told(effect: object, name: str) -> tuple[float, float]:
    quantity = effect.parameters[name]  # type: ignore[attr-defined]
    return quantity.value, quantity.ci95[1] - quantity.value


def test_a_creep_of_a_sixth_of_the_spring_is_not_traded_for_it():
    train, held = truth.multisine(1), truth.scan()
    found = diagnose([truth.record(train, creeping(train, 600.0, 1.66), 21)],
                     truth.believed(), library=QUICK,
                     holdout=[truth.record(held, creeping(held, 600.0, 1.66), 22)])
    assert found.names == ("creep",)
    for name, true in (("stiffness", 600.0), ("time_constant", 1.66)):
        value, half = told(found.effects[0], name)
        assert abs(value - true) < 2.0 * half


def test_a_mode_sharper_than_any_grid_is_found_at_its_own_frequency():
    feed = chirp(truth.PERIOD * np.arange(truth.SAMPLES), 1.0, 9.0, 120.0)
    held, mode = 0.5 * feed, (0.5, 45.2, 0.002)
    found = diagnose([truth.record(feed, two_modes(feed, *mode), 23)], truth.believed(),
                     library=QUICK, holdout=[truth.record(held, two_modes(held, *mode), 24)])
    assert found.names == ("second_mode",)
    value, half = told(found.effects[0], "frequency")
    assert abs(value - 45.2) < 2.0 * half < 0.05
    assert "phase" not in found.effects[0].parameters


def two_masses(feed: np.ndarray, dashpot: float, output: int) -> np.ndarray:
    """Position of one of two masses: the stage, and 0.25 kg on it by a spring and a dashpot."""
    m, n, k, d = truth.MASS, 0.25, 20000.0, dashpot
    return linear(feed, [[0.0, 1.0, 0.0, 0.0],
                         [-(truth.STIFFNESS + k) / m, -(truth.DAMPING + d) / m, k / m, d / m],
                         [0.0, 0.0, 0.0, 1.0], [k / n, d / n, -k / n, -d / n]],
                  [0.0, truth.GAIN / m, 0.0, 0.0], [2.0 - output, 0.0, output - 1.0, 0.0])


@pytest.mark.parametrize(("output", "dashpot", "phase"), [
    (1, 0.5, -0.0202), (1, 30.0, 0.0102), (2, 5.0, -0.0056)])
def test_a_mass_on_a_spring_and_a_dashpot_is_a_second_mode_and_nothing_else(
        output, dashpot, phase):
    train, held = truth.multisine(1, top_hz=200.0), chirp(
        truth.PERIOD * np.arange(truth.SAMPLES), 1.0, 10.0, 200.0)
    found = diagnose([truth.record(train, two_masses(train, dashpot, output), 31)],
                     truth.believed(), library=QUICK,
                     holdout=[truth.record(held, two_masses(held, dashpot, output), 32)])
    assert (found.verdict, found.names) == ("named", ("second_mode",))
    assert found.gap.fit[2] == pytest.approx(truth.NOISE, rel=0.02)
    assert found.gap.held_out[2] == pytest.approx(truth.NOISE, rel=0.02)
    value, half = told(found.effects[0], "phase")
    assert value == pytest.approx(phase, abs=max(2.0 * half, 1e-4))


def test_a_refinement_that_does_not_pay_is_taken_back():
    feed = chirp(truth.PERIOD * np.arange(truth.SAMPLES), 1.0, 9.0, 120.0)
    run = observe(truth.record(feed, two_modes(feed, 0.2, 45.2, 0.01), 23), truth.believed(),
                  None, None)
    search = Search(truth.believed(), [run], ("damping", "stiffness", "force_constant"))
    search.begin()
    model = truth.believed().with_effect("second_mode", {
        "share": 0.2, "frequency": 45.2, "damping_ratio": 0.01, "phase": 0.01})
    assert "second_mode.phase" in search.parameters(model)
    free = search._fit(model, search.parameters(model), search.begin())
    taken_back = search.refined(free)
    assert "second_mode.phase" not in taken_back.system.free
    assert taken_back.model.parameters()["second_mode.phase"] == 0.0
    assert taken_back.chi2 < free.chi2 + 20.0


LOOPED = [n for n in EFFECTS if n not in ("eddy_current_damping", "quadratic_damping")]


def looped(feed: np.ndarray, rate: Callable[[float, float], float], size: float) -> np.ndarray:
    """Position (N,) of the stage pulled back by size * w, where w' = rate(w, speed)."""
    h = truth.PERIOD / truth.FINE
    x = v = w = 0.0
    out = np.empty(feed.size)

    def slope(x: float, v: float, w: float, u: float) -> tuple[float, float, float]:
        force = truth.GAIN * u - truth.DAMPING * v - truth.STIFFNESS * x - size * w
        return v, force / truth.MASS, rate(w, v)

    for k, u in enumerate(feed.tolist()):
        out[k] = x
        for _ in range(truth.FINE):
            a = slope(x, v, w, u)
            b = slope(x + 0.5 * h * a[0], v + 0.5 * h * a[1], w + 0.5 * h * a[2], u)
            c = slope(x + 0.5 * h * b[0], v + 0.5 * h * b[1], w + 0.5 * h * b[2], u)
            d = slope(x + h * c[0], v + h * c[1], w + h * c[2], u)
            x += h / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
            v += h / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
            w += h / 6.0 * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
    return out


@pytest.mark.parametrize(("shape", "exponent"), [(0.55, 1.8), (0.9, 1.3)])
def test_the_shape_and_the_sharpness_of_a_loop_are_found_however_they_trade(shape, exponent):
    def bouc_wen(w: float, v: float) -> float:
        return v / 2e-5 * (1.0 - abs(w) ** exponent * (
            (shape if v * w > 0.0 else -shape) + 1.0 - shape))

    train, held = truth.multisine(5), truth.scan()
    fitted, other = (truth.record(feed, looped(feed, bouc_wen, 4e-3), seed)
                     for feed, seed in ((train, 25), (held, 26)))
    found = diagnose([fitted], truth.believed(), library=LOOPED, holdout=[other])
    assert found.names == ("hysteresis",)
    for name, true in (("stiffness", 200.0), ("yield_displacement", 2e-5), ("shape", shape),
                       ("exponent", exponent)):
        value, half = told(found.effects[0], name)
        assert abs(value - true) < 2.0 * half


def test_one_loop_can_be_both_of_two_effects():
    feed, start = truth.multisine(6), {"force": 3e-3, "stiffness": 150.0}
    model = truth.believed()
    friction = model.with_effect("presliding_friction", start)
    loop = model.with_effect("hysteresis",
                             EFFECTS["presliding_friction"].twins["hysteresis"](start))
    assert EFFECTS["hysteresis"].twins["presliding_friction"](
        loop.effects[0].parameters) == pytest.approx(start)
    moved = looped(feed, lambda w, v: v / 2e-5 - abs(v) / 2e-5 * w, 3e-3)  # Dahl 1968
    first, second = (Simulator(m).run(feed).position for m in (friction, loop))
    assert second == pytest.approx(first, abs=1e-11)
    assert first == pytest.approx(moved, abs=1e-9)
    assert np.ptp(first - truth.move(feed)) > 1e-5


def test_a_constant_force_is_named_where_the_zero_is_trusted():
    train, held = truth.multisine(3), truth.multisine(4)

    def push(x: float, v: float) -> float:
        return 2e-3

    found = diagnose([truth.record(train, truth.move(train, push), 25)],
                     truth.believed(encoder_zero=0.0), library=QUICK,
                     holdout=[truth.record(held, truth.move(held, push), 26)])
    assert found.names == ("force_offset",)
    assert told(found.effects[0], "force")[0] == pytest.approx(2e-3, rel=0.01)


def test_a_constant_is_judged_by_what_it_lowers():
    assert SurrogateTest(1e4, 100.0, 1e4, np.inf).passed(per_run=False)
    assert not SurrogateTest(1e4, 100.0, 110.0, np.inf).passed(per_run=False)
    assert SurrogateTest(0.0, 100.0, 100.0, np.inf).passed(per_run=False) is None  # not exercised


def test_an_effect_that_raises_the_held_out_gap_does_not_pass():
    """Though its shifted selves do still worse."""
    assert not SurrogateTest(1.4e4, 3.1e4, 2.3e4, 3.6e4).passed(per_run=False)
    assert SurrogateTest(1.4e4, 2.1e4, 2.3e4, 3.6e4).passed(per_run=False)


def test_the_step_of_a_reading_that_is_rounded_once_more():
    step, rng = 7.396876e-7, np.random.default_rng(5)
    counts = np.unique(np.rint(np.cumsum(rng.exponential(20.0, 400))))
    seen = lattice(np.repeat(np.rint(counts * step / 5e-9) * 5e-9, 3))
    assert seen == pytest.approx(step, rel=2e-6)  # a hundredth of a step over 4900


@pytest.mark.parametrize("resolution", [4e-6, 1e-9])
def test_what_rounding_adds_along_the_scale_is_no_error_of_the_encoder(resolution):
    """The reading counts 4 um with a fifth of it as noise before: the mean error is a sine of
    0.6 um over one count (Widrow and Kollar 2008), whether or not the model gives the step."""
    step, rng = 4e-6, np.random.default_rng(61)

    def counted(feed: np.ndarray, seed: int) -> Record:
        before = truth.move(feed) + 0.2 * step * rng.standard_normal(feed.size)
        made = truth.record(feed, before, seed)
        return replace(made, axes={"x": replace(made.axes["x"],
                                                position=step * np.rint(before / step))})

    found = diagnose([counted(truth.multisine(7), 1)],
                     truth.believed(encoder_resolution=resolution),
                     library=["encoder_quantization", "encoder_periodic_error"],
                     holdout=[counted(truth.scan(), 2)])
    assert "encoder_periodic_error" not in found.names


def test_the_screen_starts_from_the_fitted_motion():
    feed = truth.multisine(6)
    run = observe(truth.record(feed, truth.move(feed), 27), truth.believed(), "x", "run")
    rough = white_weights([[run.output[run.skip:]]])
    found = fit(truth.believed(stiffness=4600.0, damping=2.0), [run],
                ("stiffness", "damping", "force_constant"), rough)
    screen = Screen(found, [run], rough, 0.0)
    assert screen.plain is not None
    moved = run.output[run.skip:] - found.residuals[0][0]
    np.testing.assert_allclose(screen.plain, rough[0][0].apply(moved), rtol=1e-6, atol=1e-9)


def test_lateness_of_next_to_nothing_is_shared_out_within_limits():
    model = truth.believed(delay=1e-10).with_effect("amplifier_bandwidth",
                                                    {"time_constant": 1e-9})
    names = ("delay", "amplifier_bandwidth.time_constant")
    splits = late_splits(model, names)
    assert len(splits) == 2
    for values in splits:
        assert model.with_parameters(values).parameters().items() >= values.items()


def test_the_held_out_records_part_two_effects_that_fit_the_fitted_ones_alike():
    def hardening(feed: np.ndarray) -> np.ndarray:
        return truth.move(feed, lambda x, _: -1e7 * x**3)

    time = truth.PERIOD * np.arange(truth.SAMPLES)
    slow = np.minimum(time / 5.0, 1.0) ** 2 * np.sin(np.pi * time)  # k3 x^3 and droop x^2 F alike
    lively = truth.multisine(3, 2.0)
    model = truth.believed()
    alike, apart = (observe(truth.record(feed, hardening(feed), seed), model, None, None)
                    for feed, seed in ((slow, 71), (lively, 72)))
    names = ("force_constant_droop", "cubic_stiffness")
    search = Search(model, [alike], ("damping", "stiffness", "force_constant"), library=names)
    bare = search.begin()
    hits = {hit.name: hit for hit in search.screened(bare, ())[1]}
    droop, cubic = (search.fitted((name,), bare, [hits[name]]) for name in names)
    rival = Rival("cubic_stiffness", cubic.chi2 - droop.chi2, cubic)
    assert abs(rival.cost) < MARGIN

    def chosen(held: Observation) -> tuple[str, ...]:
        trial = Trial(search, [held], held_weights=weights_like([held], search.weights))
        return trial.exchange_rival(Hypothesis(names[:1], droop, bare, {names[0]: [rival]})).names

    assert chosen(alike) == ("force_constant_droop",)
    assert chosen(apart) == ("cubic_stiffness",)


def test_a_model_that_cannot_be_simulated_without_an_effect_has_no_rivals_and_no_other_valley():
    """In a far valley the fit without an effect may fail; then there is nothing to screen."""
    feed = truth.multisine(6)
    run = observe(truth.record(feed, truth.move(feed, lambda x, _: -1e7 * x**3), 31),
                     truth.believed(), "x", "run")
    names = ("damping", "stiffness", "force_constant")
    search = Search(truth.believed(), [run], names, library=("quadratic_stiffness",))
    linear_fit = search.begin()
    failed = fit(truth.believed(), [run], names, search.weights, allowance=-1.0)
    assert linear_fit.ok
    assert not failed.ok
    wrong = search.fitted(("quadratic_stiffness",), linear_fit)
    search.keep((), failed)
    assert search.restarted(("quadratic_stiffness",), wrong) is None
    assert search._rivals("quadratic_stiffness", (), wrong) == []


def test_rivals_that_keep_taking_turns_are_all_compared_with_the_last_of_them(monkeypatch):
    """Each weighing of the noise may prefer the other one; whoever comes last has rivals, too."""
    feed = truth.multisine(6)
    run = observe(truth.record(feed, truth.move(feed, lambda x, _: -1e5 * x**3), 31),
                     truth.believed(), "x", "run")
    names = ("cubic_stiffness", "force_constant_droop")
    search = Search(truth.believed(), [run], ("damping", "stiffness"), library=names)
    both = {name: search.fitted((name,), search.begin()) for name in names}
    others = dict(zip(names, reversed(names), strict=True))
    monkeypatch.setattr(search, "_rivals", lambda name, rest, current: [
        Rival(others[name], -1.0, both[others[name]])])
    monkeypatch.setattr(search, "fitted", lambda chosen, *_: both[chosen[0]])
    turns = iter(range(1000))
    monkeypatch.setattr(search, "score", lambda _: float(next(turns)))
    last, _, rivals = search.compare(names[:1], both[names[0]])
    assert set(rivals) == set(last)


@pytest.mark.parametrize("ratio", [1.0, 1.1])
def test_friction_without_a_stribeck_term_has_no_parameters_of_it_to_lose_an_interval(ratio):
    """At its bound the breakaway force leaves nothing to depend on the Stribeck speed, and at the
    lowest Stribeck speed nothing depends on the breakaway force."""
    def dahl(w: float, v: float) -> float:
        return v / 2e-5 - abs(v) / 2e-5 * w

    feed, effect = truth.multisine(6), EFFECTS["presliding_friction"]
    run = observe(truth.record(feed, looped(feed, dahl, 3e-3), 25), truth.believed(), None, None)
    search = Search(truth.believed(), [run], ("damping", "stiffness", "force_constant"),
                    library=("presliding_friction",))
    model = truth.believed().with_effect("presliding_friction", {
        "force": 3e-3, "stiffness": 150.0, "breakaway_ratio": 1.1, "stribeck_velocity": 1e-7})
    started = search.parameters(model)
    found = search._fit(model.with_parameters({
        "presliding_friction.breakaway_ratio": ratio,
        "presliding_friction.stribeck_velocity": 1e-9}), started, search.begin())
    own = found.model.effects[0].parameters
    assert own["breakaway_ratio"] == 1.0
    assert {*started} - {*found.system.free} == {
        "presliding_friction.breakaway_ratio", "presliding_friction.stribeck_velocity"}
    assert search.parameters(found.model) == found.system.free
    assert effect.told(own) == ("force", "stiffness", "damping")
    assert effect.told({**own, "breakaway_ratio": 1.2}) == tuple(p.name for p in effect.parameters)
    assert all(np.all(np.isfinite(q.ci95)) for q in found.quantities.values())


def test_a_twin_to_which_the_data_give_no_size_begins_where_it_is_the_same_loop(monkeypatch):
    monkeypatch.setattr("dfm_stage.diagnosis.effect_fits.starts", lambda name, at: [])
    feed = np.zeros(3000)
    feed[:200] = 1.0
    out = truth.move(feed)[200:]
    search = Search(truth.believed(), [observe(truth.record(feed[200:], out, 3, "decay"),
                                               truth.believed())], ("damping", "stiffness"),
                    library=("hysteresis", "presliding_friction"))
    first = search.begin()
    looped = search.fitted(("hysteresis",), first, [Hit.at("hysteresis", {
        **EFFECTS["hysteresis"].defaults, "stiffness": 40.0, "yield_displacement": 1e-5})])
    assert looped.ok
    assert search.in_place_of("hysteresis", "presliding_friction", ("presliding_friction",),
                              looped).ok


def test_a_range_that_ends_on_one_side_only_is_found_though_its_middle_is_not_known():
    def cut(feed: np.ndarray, seed: int) -> Record:
        made = truth.record(feed, truth.move(feed), seed)
        reading = np.minimum(made.axes["x"].position, 2.0e-4)
        return replace(made, axes={"x": replace(made.axes["x"], position=reading)})

    feed = truth.scan() + 0.3
    found = diagnose([cut(feed, 1)], truth.believed(), holdout=[cut(feed[::-1], 2)],
                     library=["sensor_clipping", "cubic_stiffness", "saturation"])
    assert found.names == ("sensor_clipping",)
    limit, centre = (found.effects[0].parameters[n] for n in ("limit", "centre"))
    assert limit.value + centre.value == pytest.approx(2.0e-4, rel=1e-2)
    assert limit.ci95 is centre.ci95 is None


@pytest.mark.parametrize("allowance", [535_000.0, math.inf])
def test_a_fit_goes_on_where_an_effect_has_grown_until_it_bends_the_slopes_of_the_base(
        allowance):
    """Begun at a small amplitude, the base's slopes are those without the effect; with these the
    fit ended with an RMS of 61 times the noise."""
    feed = truth.scan()
    position = truth.move(feed, lambda x, v: -0.3 * np.sin(2.0 * np.pi * x / 8e-4 + 0.3))
    search = Search(truth.believed(), [observe(truth.record(feed, position, 1, "run"),
                                               truth.believed())],
                    ("damping", "stiffness", "force_constant"), library=("cogging",))
    bare = search.begin()
    model = bare.model.with_effect("cogging", {"amplitude": 0.006, "period": 9.2e-4,
                                               "phase": 0.0})
    found = fit(model, search.runs, search.parameters(model), search.weights,
                earlier=bare.locals, noise=search.noise, allowance=allowance)
    assert found.ok                         # also where the work allowed ends in between
    if allowance == math.inf:
        assert found.chi2 < 1.02 * found.white.size
        assert found.model.effect("cogging").parameters["amplitude"] == pytest.approx(0.3,
                                                                                      rel=1e-3)


def test_a_vibration_that_bends_the_base_is_found_beside_the_base_as_given():
    """It shakes a stage near its resonance: re-estimated, the stage rings by itself, and beside
    that the vibration hardly shows. Damping that grows with deflection stays as a remainder."""
    amplitude, hertz, feed = 2.0, 10.4, 0.1 * truth.multisine(1)
    shaken = feed + amplitude / truth.GAIN * np.sin(
        2.0 * np.pi * hertz * truth.PERIOD * np.arange(truth.SAMPLES))
    position = truth.move(shaken, lambda x, v: -3e6 * x * x * v, damping=20.0)
    model = truth.believed().with_parameters({"damping": 20.0})
    search = Search(model, [observe(truth.record(feed, position, 31), model)],
                    ("damping", "stiffness", "force_constant"), library=("periodic_disturbance",))
    bare = search.begin()
    _, hits = search.screened(bare, ())
    begun = search.once(("periodic_disturbance",), bare, hits[:1])
    names, found = grading._as_given(search, bare, (), bare)
    assert names == ("periodic_disturbance",)
    assert found.chi2 < 0.2 * begun.chi2
    assert found.model.parameters()["periodic_disturbance.amplitude"] == pytest.approx(
        amplitude, rel=0.1)
    assert found.model.parameters()["periodic_disturbance.frequency"] == pytest.approx(
        hertz, rel=1e-3)
    assert search.once(names, bare) is found
    worse = search.once_of(hits[0], bare, bare)
    assert worse is found
