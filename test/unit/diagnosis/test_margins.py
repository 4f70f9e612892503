"""Comparisons by blocks: what can be said of powers, constancy and intervals in closed form."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from dfm_stage.diagnosis.decisions import (
    BLOCKS,
    LONGEST_VELOCITY,
    NOISE_IN_VELOCITY,
    OTHER_FORM,
    SHORTEST_BLOCK,
    SHORTEST_WINDOW,
)
from dfm_stage.diagnosis.fit import fit
from dfm_stage.diagnosis.margins import (
    constancy,
    cuts,
    margin,
    power,
    powers,
    score_by_blocks,
    score_with_remainder,
    velocity_lag,
)
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.weights import Weight
from dfm_stage.model import Model

# -- blocks --------------------------------------------------------------------------------------

@pytest.mark.parametrize("sizes", [
    (24_000,), (10_000, 500, 3_777), (400, 400), (99,), (150, 20_000), (1,) * 3])
def test_blocks_cover_every_sample_once(sizes):
    found = cuts(sizes)
    assert len(found) == len(sizes)
    for size, parts in zip(sizes, found, strict=True):
        seen = np.zeros(size)
        for part in parts:
            seen[part] += 1.0
        assert np.all(seen == 1.0)
    lengths = [part.stop - part.start for parts in found for part in parts]
    assert sum(len(parts) for parts in found) <= BLOCKS + len(sizes)
    assert min(lengths) >= min(SHORTEST_BLOCK, *sizes)


def test_a_long_record_has_all_blocks_and_a_short_one_fewer():
    assert len(cuts([24_000])[0]) == BLOCKS
    assert len(cuts([5 * SHORTEST_BLOCK])[0]) == 5
    assert len(cuts([SHORTEST_BLOCK])[0]) == 1


def stepped(levels, length=SHORTEST_BLOCK):
    """A residual whose blocks have the RMS `levels`."""
    wave = math.sqrt(2.0) * np.sin(2.0 * np.pi * np.arange(length) / length)
    return np.concatenate([level * wave for level in levels])


def test_powers_are_the_mean_squares_of_blocks_and_of_all():
    levels = np.array([1.0, 3.0, 2.0, 5.0])
    residual = stepped(levels)
    assert powers([[residual]]) == pytest.approx(levels**2)
    assert power([[residual]]) == pytest.approx(np.mean(levels**2))
    two = [[stepped(levels[:1])], [stepped(levels[1:])]]
    assert powers(two) == pytest.approx(levels**2)
    assert power(two) == pytest.approx(np.mean(levels**2))


def test_only_the_output_is_judged_and_not_the_current():
    residual = stepped([1.0, 3.0])
    assert powers([[residual, 1e3 * residual]]) == pytest.approx([1.0, 9.0])
    assert power([[residual, 1e3 * residual]]) == pytest.approx(5.0)


def test_a_drift_weighs_little_in_velocity():
    """A ramp of a thousand noises leaves white noise of twice the power as its change."""
    noise = np.random.default_rng(0).standard_normal(40_000)
    drifting = noise + np.linspace(0.0, 1000.0, noise.size)
    assert power([[drifting]]) > 1e5
    assert power([[drifting]], 1) == pytest.approx(2.0, rel=0.02)
    assert np.mean(powers([[drifting]], 1)) == pytest.approx(2.0, rel=0.02)


def test_velocity_is_judged_over_as_few_samples_as_leave_its_noise_small():
    """A sine of amplitude A changes by 2 A^2 sin^2(w L / 2) over L samples, white noise by twice
    its power."""
    noise = np.random.default_rng(1).standard_normal(40_000)
    amplitude, omega = 120.0, np.pi / 200.0
    left = [[noise + amplitude * np.sin(omega * np.arange(noise.size))]]
    change = {lag: 2.0 * amplitude**2 * np.sin(0.5 * omega * lag) ** 2 for lag in (4, 8)}
    assert power(left, 8) == pytest.approx(change[8] + 2.0, rel=0.02)
    assert 2.0 / (change[8] + 2.0) < NOISE_IN_VELOCITY < 2.0 / (change[4] + 2.0)
    assert velocity_lag(left, 1.0) == 8
    assert velocity_lag(left, 0.0) == 1


def test_noise_alone_is_judged_over_the_longest_while_that_crosses_few_edges():
    noise = np.random.default_rng(2).standard_normal(40_000)
    assert velocity_lag([[noise]], 1.0) == LONGEST_VELOCITY
    assert min(SHORTEST_BLOCK, SHORTEST_WINDOW) > 6 * LONGEST_VELOCITY


# -- margins -------------------------------------------------------------------------------------

def test_a_margin_is_the_mean_log_ratio_in_its_standard_errors():
    own = np.array([1.0, 10.0, 0.1, 3.0])
    logs = np.array([0.5, 1.5, 0.5, 1.5])
    assert margin(own * np.exp(logs), own) == pytest.approx(1.0 / (logs.std(ddof=1) / 2.0))
    assert margin(own, own * np.exp(logs)) == pytest.approx(-1.0 / (logs.std(ddof=1) / 2.0))


def test_the_largest_block_does_not_decide_alone():
    own = np.ones(24)
    rival = np.exp(np.random.default_rng(1).normal(0.3, 0.1, 24))
    rival[0] = 1e-4
    assert np.sum(rival) > np.sum(own)
    huge = own.copy()
    huge[0] = 1e6
    assert margin(rival * huge, huge) == pytest.approx(margin(rival, own))


def test_the_ratio_found_lies_within_its_errors_as_often_as_it_should():
    rng = np.random.default_rng(2)
    seen = [margin(np.exp(rng.normal(0.0, 1.0, 24)), np.ones(24)) for _ in range(2000)]
    assert np.std(seen) == pytest.approx(math.sqrt(23.0 / 21.0), rel=0.06)  # Student's t


def test_blocks_in_which_nothing_differs_say_nothing():
    rng = np.random.default_rng(3)
    own, apart = np.ones(24), np.zeros(24)
    rival = np.exp(rng.normal(0.0, 0.01, 24))
    rival[:5] *= 1e3  # an effect that acts in a fifth of the blocks, and is plain there
    apart[:5] = rival[:5]
    assert margin(rival, own) < 3.0
    assert margin(rival, own, apart) > 5.0
    assert margin(own, rival, apart) == pytest.approx(-margin(rival, own, apart))
    assert margin(rival, own, np.zeros(24)) == 0.0


@pytest.mark.parametrize("telling", [3, 6, 12])
def test_few_blocks_err_no_more_often_than_all(telling):
    rng = np.random.default_rng(4)
    apart = np.where(np.arange(24) < telling, 1.0, 0.0)
    seen = [margin(np.exp(rng.normal(0.0, 1.0, 24)), np.ones(24), apart) for _ in range(4000)]
    wrong = 2.0 * stats.t.sf(2.0, 23)
    assert np.mean(np.abs(seen) > 2.0) == pytest.approx(wrong, abs=3.5 * math.sqrt(wrong / 4000))


def test_margins_of_what_cannot_be_simulated_and_of_one_block():
    finite, none = np.array([1.0, 2.0]), powers([])
    assert np.isinf(none).all()
    assert power([]) == math.inf
    assert margin(none, finite) == math.inf
    assert margin(finite, none) == -math.inf
    assert margin(np.array([2.0]), np.array([1.0])) == 0.0
    assert margin(finite, finite) == 0.0
    assert math.isfinite(margin(finite, np.zeros(2)))


# -- constancy -----------------------------------------------------------------------------------

BLOCK = 200


def hand_made(target, columns, motion, order=0, current=None):
    """A linear fit of `target` (N,) by `columns` (N, n), as `Fit` holds it; `current` is a second
    signal, (M,) and (M, n)."""
    rows = columns if current is None else np.vstack((columns, current[1]))
    wanted = target if current is None else np.concatenate((target, current[0]))
    x = np.linalg.lstsq(rows, wanted, rcond=None)[0]
    white = wanted - rows @ x
    names = tuple(f"p{k}" for k in range(columns.shape[1]))
    run = SimpleNamespace(output=np.concatenate((np.zeros(order), motion)), skip=0, window=0)
    residuals, weights = [np.concatenate((np.zeros(order), white[:target.size]))], [order]
    if current is not None:
        residuals.append(white[target.size:])
        weights.append(0)
    run.measured = tuple(residuals)
    system = SimpleNamespace(runs=[run], free=names, count=len(names), drifts=False,
                             unknowns=[SimpleNamespace(name=n, run=None) for n in names])
    return SimpleNamespace(system=system, residuals=[residuals], white=white, jacobian=-rows,
                           weights=((*(Weight(np.eye(1, n + 1)[0], 1.0, "") for n in weights),),),
                           chi2=float(white @ white), ok=True)


def swings(seed=0, blocks=24):
    """Motion (N,) whose amplitude differs from block to block, a factor five apart."""
    rng = np.random.default_rng(seed)
    sizes = rng.permutation(np.repeat([0.2, 0.5, 1.0], blocks // 3))
    phase = 2.0 * np.pi * np.arange(blocks * BLOCK) / 40.0
    return np.repeat(sizes, BLOCK) * np.sin(phase), rng


@pytest.mark.parametrize("order", [0, 7])
def test_the_right_law_needs_no_other_size_for_other_motion(order):
    x, rng = swings()
    target = 3.0 * x**3 + 0.3 * x + 0.05 * rng.standard_normal(x.size)
    found = constancy(hand_made(target, np.column_stack((x, x**3)), x, order), ["p1"])
    assert abs(found.gain) < 0.01
    assert abs(found.gain) < 3.0 * found.se + 1e-3


def test_a_stand_in_needs_another_size_for_every_motion():
    """A line for a cubic: its slope over blocks of amplitude a is 3/4 a^2, so that what is left is
    a share of the cubic that a split takes away but for the third harmonic."""
    x, rng = swings()
    found = constancy(hand_made(x**3 + 1e-3 * rng.standard_normal(x.size), x[:, None], x), ["p0"])
    assert found.share > OTHER_FORM
    a = np.array([0.2, 0.5, 1.0])
    slope = 0.75 * float(np.sum(a**4)) / float(np.sum(a**2))
    third = a**6 / 32.0 + 1e-6  # mean square of a^3 sin^3 but for its line, and the noise
    left = 0.5 * a**2 * (0.75 * a**2 - slope) ** 2 + third
    assert found.gain == pytest.approx(float(np.mean(0.5 * np.log(left / third))), rel=0.05)


def test_a_remainder_of_another_kind_is_no_inconstancy():
    x, rng = swings()
    wave = np.sin(2.0 * np.pi * np.arange(x.size) / 37.3)
    target = x**3 + 0.05 * wave + 1e-3 * rng.standard_normal(x.size)
    found = constancy(hand_made(target, np.column_stack((x, x**3)), x), ["p1"])
    assert abs(found.gain) < 0.02


def test_constancy_is_not_told_of_what_is_unknown_or_short_or_in_windows():
    x, _ = swings()
    found = hand_made(x**3, np.column_stack((x, 0.0 * x)), x)
    assert constancy(found, ["p0"]) is not None
    assert constancy(found, ["other"]) is None
    assert constancy(found, ["p1"]) is None  # does nothing here
    found.system.runs[0].window = 300
    assert constancy(found, ["p0"]) is None
    short = slice(0, 5 * SHORTEST_BLOCK)
    assert constancy(hand_made(x[short]**3, x[short, None], x[short]), ["p0"]) is None


# -- the score by blocks -------------------------------------------------------------------------

def test_independent_samples_have_the_usual_covariance():
    """The middle of a sandwich is sigma^2 J'J; without the jackknife 0.79 of it."""
    ratios = []
    for seed in range(100):
        x, rng = swings(seed)
        columns = np.column_stack((x, x**3, np.cos(np.arange(x.size)), np.ones(x.size)))
        middle, dof = score_by_blocks(hand_made(rng.standard_normal(x.size), columns, x))
        assert dof == 7.0
        ratios.append(np.diag(middle) / np.diag(columns.T @ columns))
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=0.1)


def test_a_parameter_that_drifts_over_blocks_is_as_unsure_as_it_drifts():
    """y = (1 + d_b) u with d_b for each long block: the estimate is the mean of d_b."""
    rng = np.random.default_rng(3)
    u = rng.standard_normal(24 * BLOCK)
    drift = np.repeat(rng.normal(0.0, 0.2, 8), 3)
    target = (1.0 + np.repeat(drift, BLOCK)) * u + 0.05 * rng.standard_normal(u.size)
    found = hand_made(target, u[:, None], u)
    gram = float(u @ u)
    sandwich = math.sqrt(float(score_by_blocks(found)[0][0, 0])) / gram
    assert sandwich == pytest.approx(float(np.std(drift[::3], ddof=1)) / math.sqrt(8.0), rel=0.15)
    white = float(np.std(found.white)) / math.sqrt(gram)
    assert sandwich > 5.0 * white


def test_a_measured_current_takes_part_in_the_score():
    """Two signals that say as much each: half the variance, not a quarter."""
    ratios = []
    for seed in range(30):
        x, rng = swings(seed)
        noise = rng.standard_normal((2, x.size))
        middle, _ = score_by_blocks(hand_made(noise[0], x[:, None], x,
                                              current=(noise[1], x[:, None])))
        ratios.append(float(middle[0, 0]) / (2.0 * float(x @ x)))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.15)


def half_widths(found, score):
    """Halves of the 95 % intervals of the parameters (n,)."""
    middle, dof = score
    bread = np.linalg.inv(found.jacobian.T @ found.jacobian)
    return stats.t.ppf(0.975, dof) * np.sqrt(np.diag(bread @ middle @ bread))


@pytest.mark.parametrize("missing", ["two sines", "noise"])
def test_what_hides_alike_in_all_blocks_is_in_the_intervals(missing):
    """Friction, a spring, a damper beside a force drawn from all other polynomials up to the third
    degree: it moves each by the same in every block, and blocks alone miss that."""
    time, rng = np.arange(24 * BLOCK), np.random.default_rng(5)
    x = np.sin(0.031 * time) + 0.7 * np.sin(0.0523 * time + 1.0)
    if missing == "noise":
        x = np.convolve(rng.standard_normal(time.size), np.hanning(60), "same")
        x /= np.std(x)
    v = np.gradient(x) / np.std(np.gradient(x))
    terms = [x**i * v**j for i in range(4) for j in range(4 - i) if i + j > 1]
    terms = np.column_stack([t / np.sqrt(np.mean(t**2)) for t in terms])
    columns = np.column_stack((np.sign(v), x, v, np.ones(x.size)))
    held = []
    for _ in range(100):
        target = 3.0 * columns[:, 0] + 0.3 * terms @ rng.standard_normal(terms.shape[1])
        found = hand_made(target + 0.05 * rng.standard_normal(x.size), columns, x)
        off = np.abs(np.linalg.lstsq(columns, target, rcond=None)[0] - [3.0, 0.0, 0.0, 0.0])
        held.append([off < half_widths(found, score(found))
                     for score in (score_by_blocks, score_with_remainder)])
    blocks, remainder = np.mean(held, axis=0)
    assert np.mean(blocks) < 0.35
    assert np.mean(remainder) > 0.7
    assert remainder[0] > 0.9


@pytest.mark.parametrize("polynomial", [[1.0], [1.0, -0.995]])
def test_noise_hides_nothing(polynomial):
    """In a position and in its change."""
    ratios = []
    for seed in range(100):
        x, rng = swings(seed)
        sigma = 0.05 * float(np.linalg.norm(polynomial))
        noise = 0.05 * rng.standard_normal(x.size)
        columns = np.convolve(x, polynomial, "valid")[:, None] / sigma
        order = len(polynomial) - 1
        found = hand_made(np.convolve(3.0 * x + noise, polynomial, "valid") / sigma, columns,
                          x[order:], order)
        found.residuals = [[noise]]
        found.weights = ((Weight(np.array(polynomial), sigma, ""),),)
        ratios.append(float(half_widths(found, score_with_remainder(found))[0]
                            / half_widths(found, score_by_blocks(found))[0]))
    assert np.quantile(ratios, 0.9) < 1.5


# -- on real fits --------------------------------------------------------------------------------

PERIOD = 1e-3


def spring(seed, cubic, size=9600):
    """A mass on a spring with a cubic term in fine steps, amplitudes a factor four apart."""
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.permutation(np.repeat([0.5, 1.0, 2.0], 8)), size // 24)
    time = PERIOD * np.arange(size)
    u = level * (np.sin(2 * np.pi * 7.0 * time) + np.sin(2 * np.pi * 11.3 * time + 1.0))
    x = v = 0.0
    out, fine = np.empty(size), 10
    for k, force in enumerate(u):
        out[k] = x
        for _ in range(fine):  # symplectic Euler
            v += PERIOD / fine * (force - 8.0 * v - 4000.0 * x - cubic * x**3)
            x += PERIOD / fine * v
    return Observation(f"run {seed}", u, out + 1e-7 * rng.standard_normal(size), PERIOD)


@pytest.fixture(scope="module")
def fits():
    """The same cubic spring fitted by a cubic and by what stands in for it."""
    runs = [spring(1, 2e8)]
    weights = ((Weight(np.ones(1), 1e-6, ""),),)
    model = Model("m", PERIOD, {"mass": 1.0, "damping": 8.0, "stiffness": 4000.0})
    free = ("damping", "stiffness")
    right = fit(model.with_effect("cubic_stiffness", {"k3": 1e8}), runs,
                (*free, "cubic_stiffness.k3"), weights)
    return right, fit(model, runs, free, weights)


def test_a_cubic_spring_is_constant_and_a_line_for_it_is_not(fits):
    right, line = fits
    told = constancy(right, ["cubic_stiffness.k3"])
    assert told.gain < 0.05
    assert constancy(line, "stiffness").share > 0.3


def score_of(found, factor):
    """The score by blocks, its covariance so many times as large."""
    middle, dof = score_by_blocks(found)
    return factor * middle, dof


def test_intervals_over_blocks_are_never_narrower(fits):
    for found in fits:
        for factor in (1e-9, 1.0, 100.0):
            told = found.quantities_over(*score_of(found, factor))
            assert set(told) == set(found.quantities)
            for name, own in found.quantities.items():
                assert told[name].value == own.value
                assert np.ptp(told[name].ci95) >= np.ptp(own.ci95)
    line = fits[1]
    wide = line.quantities_over(*score_of(line, 1.0))["stiffness"]
    assert np.ptp(wide.ci95) > 1.5 * np.ptp(line.quantities["stiffness"].ci95)
    twice = line.quantities_over(*score_of(line, 4.0))["stiffness"]
    assert np.ptp(twice.ci95) == pytest.approx(2.0 * np.ptp(wide.ci95), rel=1e-6)


def test_an_interval_over_blocks_is_that_of_the_sandwich(fits):
    line = fits[1]
    middle, dof = score_by_blocks(line)
    scale = np.diag(1.0 / np.linalg.norm(line.jacobian, axis=0))
    bread = scale @ np.linalg.inv(scale @ line.jacobian.T @ line.jacobian @ scale) @ scale
    place = line.system.free.index("stiffness")
    half = stats.t.ppf(0.975, dof) * math.sqrt((bread @ middle @ bread)[place, place])
    told = line.quantities_over(middle, dof)["stiffness"]
    assert np.ptp(told.ci95) == pytest.approx(2.0 * half, rel=1e-3)
