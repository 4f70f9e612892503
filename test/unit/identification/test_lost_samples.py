"""Samples that a logger dropped: records of a stage made by `scipy`, some of them thinned out."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, ss2tf

from dfm_stage.identification.lost_samples import find_lost, put_in

SIZE, DT = 8000, 1e-3
TIME = DT * np.arange(SIZE)
NOISE = 1e-7


def inputs(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 200)
    spectrum = np.zeros(1001, complex)
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    wave = np.resize(np.fft.irfft(spectrum, 2000), SIZE)
    return {"multisine": wave / np.std(wave), "white": rng.standard_normal(SIZE),
            "steps": np.repeat(rng.uniform(-1.0, 1.0, SIZE // 400), 400),
            "levels": np.repeat(rng.choice([-1.0, 1.0], SIZE // 20), 20),
            "chirp": np.sin(2 * np.pi * (0.3 + 3.0 * TIME) * TIME)}


def stage(feed: np.ndarray, seed: int) -> np.ndarray:
    """The position of a resonance at 10 Hz from rest, with white noise."""
    a, b = np.array([[0.0, 1.0], [-4000.0, -4.0]]), np.array([[0.0], [1.0]])
    held = cont2discrete((a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1))), DT)
    above, below = ss2tf(*held[:4])
    return lfilter(above[0], below, feed) \
        + NOISE * np.random.default_rng(seed).standard_normal(SIZE)


@pytest.mark.parametrize("kind", ["multisine", "white", "levels", "chirp"])
@pytest.mark.parametrize("seed", range(2))
def test_dropped_samples_are_found_and_put_in(kind, seed):
    feed = inputs(seed)[kind]
    position = stage(feed, 50 + seed)
    keep = np.random.default_rng(seed).random(SIZE) > 1e-3
    keep[:20] = keep[-20:] = True
    dropped = np.flatnonzero(~keep)
    losses = find_lost(feed[keep], position[keep])
    assert [loss.input.size for loss in losses] == [1] * len(losses)
    wanted = dropped - np.arange(dropped.size)
    speed = np.abs(np.gradient(position))[dropped]
    found = {loss.at for loss in losses}
    assert found <= {int(k) + d for k in wanted for d in (-1, 0, 1)}  # no false alarm
    missed = [v for k, v in zip(wanted, speed, strict=True)
              if not found & {int(k) + d for d in (-1, 0, 1)}]
    assert max(missed, default=0.0) < 30.0 * NOISE  # by so little it does no harm
    if not missed:
        whole = put_in(position[keep], losses, [loss.output for loss in losses])
        assert whole == pytest.approx(position, abs=0.05 * np.std(position))


@pytest.mark.parametrize("seed", range(4))
def test_a_healthy_record_lacks_nothing(seed):
    spikes = 30.0 * NOISE * (np.random.default_rng(seed).random(SIZE) < 2e-3)
    for feed in inputs(seed).values():
        position = stage(feed, 60 + seed)
        assert find_lost(feed, position) == []
        assert find_lost(feed, position + spikes) == []
        assert find_lost(feed, 5e-7 * np.rint(position / 5e-7)) == []
        stale = position.copy()
        stale[1000::1000] = stale[999:-1:1000]
        assert find_lost(feed, stale) == []


@pytest.mark.parametrize("early", [0, 1])
@pytest.mark.parametrize("gap", [1e-12, 5e-7])
def test_a_controllers_law_is_no_predictor(gap, early):
    """A controller computes its input from the reading without an error of its own. Where the
    acceleration of the reference steps, its law alone seems broken."""
    held = cont2discrete((np.array([[0.0, 1.0], [-4000.0, -4.0]]), np.array([[0.0], [1.0]]),
                          np.eye(2), np.zeros((2, 1))), DT)
    push = 0.05 * np.select([(TIME // 0.05) % 20 == 0, (TIME // 0.05) % 20 == 10], [1.0, -1.0])
    wanted = np.cumsum(np.cumsum(push)) * DT**2
    noise = NOISE * np.random.default_rng(3).standard_normal(SIZE)
    state, total, feed, read = np.zeros(2), 0.0, np.zeros(SIZE), np.zeros(SIZE)
    for k in range(SIZE):
        read[k] = gap * np.rint((state[0] + noise[k]) / gap)
        error = wanted[k] - read[k]
        total += 200.0 * error
        feed[k] = 4e4 * error - 100.0 * (read[k] - read[k - 1]) / DT + total
        state = held[0] @ state + held[1][:, 0] * feed[k]
    assert find_lost(feed[early:], read[:SIZE - early]) == []


def test_three_samples_in_a_row_are_found():
    feed = inputs(1)["multisine"]
    position = stage(feed, 51)
    keep = np.ones(SIZE, bool)
    keep[[3000, 3001, 3002, 5000, 5001]] = False
    assert [(loss.at, loss.input.size) for loss in find_lost(feed[keep], position[keep])] == [
        (3000, 3), (4997, 2)]


def test_a_record_at_rest_or_too_short_shows_nothing():
    assert find_lost(np.zeros(500), np.zeros(500)) == []
    assert find_lost(np.arange(50.0), np.arange(50.0)) == []


def test_a_stage_that_friction_brings_to_rest_lacks_nothing():
    """A step there and back of a spring with dry friction, in closed form, that creeps by a count
    where it comes to rest, read in whole counts."""
    period, friction, omega = 8.85e-3, 30.0, 2.0 * np.pi * 1.7
    time, place, parts = period * np.arange(339), 0.0, []
    for target in (-300.0, 0.0):
        away, begin, path = place - target, 0.0, np.full(time.size, np.nan)
        while abs(away) > friction:     # half a swing about a centre that friction moves
            centre = np.sign(away) * friction
            swing = (time >= begin) & (time < begin + np.pi / omega)
            path[swing] = target + centre + (away - centre) * np.cos(omega * (time - begin)[swing])
            away, begin = 2.0 * centre - away, begin + np.pi / omega
        place = target + away
        crept = 1.2 * (1.0 - np.exp((begin - time) / 0.05))
        path[np.isnan(path)] = (place + crept)[np.isnan(path)]
        parts.append(path)
    feed = np.repeat([0.5, 0.0], time.size)
    assert find_lost(feed, np.round(np.concatenate(parts))) == []
