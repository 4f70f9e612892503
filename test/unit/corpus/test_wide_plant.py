"""The uncommon effects of the corpus against DOP853, located events and closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.corpus import plant, uncommon
from benchmarks.corpus.linear import response

T = 1e-3
BASE = {"mass": 0.8, "damping": 2.0, "stiffness": 3000.0, "force_constant": 1.7}
M, C, K, KF = BASE.values()
SAMPLES = 240


def command(samples: int = SAMPLES) -> np.ndarray:
    t = T * np.arange(samples)
    return 1.5 * np.sin(2 * math.pi * 9.1 * t) + np.sin(2 * math.pi * 23.0 * t + 1.0)


def simulate(values: dict, u: np.ndarray) -> np.ndarray:
    none, out, start = np.zeros(len(u)), np.empty((6, len(u))), np.zeros(plant.STATES)
    p = plant.numbers({**BASE, **values})
    start[plant.X1] = uncommon.at_rest(p[plant.COMMON:], K) if p.size > plant.COMMON else 0.0
    plant.run(p, T, 5e-5, none, u, np.zeros(4), none, none, np.zeros(0), start, 0.0, out)
    return out


def named(name: str, *values: float) -> dict:
    return {f"{name}.{n}": v for n, v in zip(uncommon.PARAMETERS[name], values, strict=True)}


def by_dop853(u: np.ndarray, slopes, first) -> np.ndarray:
    """States (n, N) at the samples, restarted at each step of the held input."""
    state, found = np.array(first, float), []
    for k, held in enumerate(u):
        found.append(state)
        state = solve_ivp(lambda t, y, held=held: slopes(t, y, held), (k * T, (k + 1) * T), state,
                          method="DOP853", rtol=1e-9, atol=1e-13, max_step=T / 4).y[:, -1]
    return np.array(found).T


def stage(force) -> object:
    """Derivatives of position and speed with a force (t, x, v)."""
    return lambda t, y, u: [y[1], (KF * u - C * y[1] - K * y[0] + force(t, y[0], y[1])) / M]


def play(off: float, half: float) -> float:
    return off - half if off > half else off + half if off < -half else 0.0


FORCES = {
    "end_stop": ((12e3, 4e-4, 2.0), lambda t, x, v: (
        -12e3 * (x - 4e-4) * (1 + 2.0 * v) if x > 4e-4 and v > -0.5 else 0.0)),
    "backlash": ((2000.0, 6e-4, 5e-5), lambda t, x, v: -2000.0 * play(x - 5e-5, 3e-4)),
    "directional_friction": ((0.8,), lambda t, x, v: -0.8 * abs(v)),
    "cogging": ((0.1, 4e-4, 0.7), lambda t, x, v: 0.1 * math.sin(math.pi * x / 2e-4 + 0.7)),
    "gravity": ((0.3, 5e-4, -0.2), lambda t, x, v: -0.3 * math.sin(x / 5e-4 - 0.2)),
    "one_sided_cable": ((900.0, 2e-4), lambda t, x, v: -900.0 * (x - 2e-4) * (x > 2e-4)),
    "stiffness_drift": ((4000.0,), lambda t, x, v: -4000.0 * t * x)}


@pytest.mark.parametrize("name", FORCES)
def test_forces_agree_with_dop853(name: str) -> None:
    values, force = FORCES[name]
    out = simulate(named(name, *values), command())
    expected = by_dop853(command(), stage(force), (out[4, 0], 0.0))
    agree(out[2], expected[0])


def agree(found: np.ndarray, expected: np.ndarray, within: float = 2e-5) -> None:
    """Within a small part of what the effect adds to the linear motion."""
    added = np.std(expected - response(BASE, T, command(found.size)))
    assert added > 1e-3 * np.std(expected)
    assert np.max(np.abs(found - expected)) < within * added


def test_a_hard_stop_is_met_within_a_step() -> None:
    # without finer steps where the contact begins and ends the error is 1.6e-6
    u = command(140)
    expected = by_dop853(u, stage(lambda t, x, v: -6e4 * max(x - 4e-4, 0.0)), (0.0, 0.0))
    agree(simulate(named("end_stop", 6e4, 4e-4, 0.0), u)[2], expected[0], 2e-7)


def test_a_cable_on_the_other_side() -> None:
    out = simulate(named("one_sided_cable", -900.0, -2e-4), command())
    expected = by_dop853(command(), stage(
        lambda t, x, v: 900.0 * max(-2e-4 - x, 0.0)), (0.0, 0.0))
    agree(out[2], expected[0])


@pytest.mark.parametrize(("name", "values"), [
    ("cogging", (0.1, 4e-4, 0.7)), ("gravity", (0.3, 5e-4, -0.2)),
    ("one_sided_cable", (900.0, -2e-4))])
def test_a_stage_at_rest_stays_there(name: str, values: tuple) -> None:
    out = simulate(named(name, *values), np.zeros(40))
    assert abs(out[4, 0]) > 1e-6
    assert np.max(np.abs(out[4] - out[4, 0])) < 1e-12


def sag(t: float, y: np.ndarray, u: float) -> list[float]:
    return [*stage(lambda *_: 0.0)(t, y, u * max(1 - 0.2 * y[2], 0.0)), (abs(u) - y[2]) / 0.05]


def heat(t: float, y: np.ndarray, u: float) -> list[float]:
    warm = 1 + y[2]
    return [*stage(lambda *_: 0.0)(t, y, u / warm), (0.4 * u * u / warm - y[2]) / 0.1]


def loop(t: float, y: np.ndarray, u: float) -> list[float]:
    x, v, w = y
    turn = 1.5 * np.sign(v * w)
    return [*stage(lambda *_: -700.0 * 6e-4 * w)(t, [x, v], u),
            v / 6e-4 * (1 + abs(w) * (1 + 1.5 - turn))]


def loss(t: float, y: np.ndarray, u: float) -> list[float]:
    corners = 0.02 * 5.0 ** np.arange(8)
    lag = y[0] - y[2:]
    force = -2 * math.log(5) / math.pi * 200.0 * np.sum(lag)
    return [*stage(lambda *_: force)(t, y, u), *(2 * math.pi * corners * lag)]


def mount(t: float, y: np.ndarray, u: float) -> list[float]:
    w = 2 * math.pi * 60.0
    x, v, read, rate = y
    return [*stage(lambda *_: 0.0)(t, y, u), rate, -2 * 0.03 * w * (rate - v) - w * w * (read - x)]


def lag(t: float, y: np.ndarray, u: float) -> list[float]:
    return [*stage(lambda *_: 0.0)(t, y, u), (y[0] - y[2]) / 2e-3]


STATES = {"supply_sag": ((0.2, 0.05), sag, 1, 0), "coil_heating": ((0.4, 0.1), heat, 1, 0),
          "hardening_hysteresis": ((700.0, 6e-4, 1.5), loop, 1, 0),
          "structural_damping": ((200.0,), loss, 8, 0),
          "sensor_mount": ((60.0, 0.03), mount, 2, 2), "sensor_lag": ((2e-3,), lag, 1, 2)}


@pytest.mark.parametrize("name", STATES)
def test_effects_with_states_agree_with_dop853(name: str) -> None:
    values, slopes, count, row = STATES[name]
    expected = by_dop853(command(), slopes, np.zeros(2 + count))
    agree(simulate(named(name, *values), command())[2], expected[row])


def test_a_lag_far_below_a_step_delays_by_its_time_constant() -> None:
    tau = 2e-6
    out = simulate(named("sensor_lag", tau), command())
    bend = np.gradient(out[5], T)
    settled = out[4] - tau * out[5] + tau**2 * bend
    assert np.max(np.abs(out[2] - settled)[5:]) < 1e-3 * np.max(np.abs(tau * out[5]))


def test_a_slewing_output_is_ramps_and_the_command() -> None:
    # each sample in two: the ramp, and then the command
    u, rate, output, state, expected = command(), 120.0, 0.0, np.zeros(2), []
    for held in u:
        expected.append(state[0])
        taken = min(abs(held - output) / rate, T)
        sign = np.sign(held - output)
        for length, begin, slope in ((taken, output, sign * rate), (T - taken, held, 0.0)):
            if length > 0.0:
                state = solve_ivp(lambda t, y, b=begin, s=slope: stage(lambda *_: 0.0)(
                    t, y, b + s * t), (0.0, length), state, method="DOP853", rtol=1e-10,
                    atol=1e-14).y[:, -1]
        output += sign * rate * taken
    agree(simulate(named("slew_limit", rate), u)[2], np.array(expected))


def test_dead_zone_and_clipping_are_static() -> None:
    u = command()
    dead = np.where(np.abs(u) > 0.3, u - 0.3 * np.sign(u), 0.0)
    found = simulate(named("dead_zone", 0.3), u)
    assert np.max(np.abs(found[2] - response(BASE, T, dead))) < 1e-6 * np.max(np.abs(found[2]))
    assert np.array_equal(found[0], u)
    clipped = simulate(named("sensor_clipping", 3e-4, 1e-4), u)
    x = response(BASE, T, u)
    assert np.max(x) > 4e-4
    assert np.max(np.abs(clipped[2] - np.clip(x, -2e-4, 4e-4))) < 1e-9


def test_plays_follow_the_turning_points_of_the_command() -> None:
    # up to 2 the plays are at 2 - r; down to -1 at min of that and -1 + r; up to 1 at the larger
    q, plays = uncommon.packed(named("prandtl_ishlinskii", 0.4, 1.8)), np.zeros(6)
    r = 1.8 * np.arange(1, 7) / 6
    first = np.maximum(2.0 - r, 0.0)
    second = np.minimum(first, -1.0 + r)
    for u, middle in ((1.0, np.maximum(1.0 - r, 0.0)), (2.0, first), (-1.0, second),
                      (1.0, np.maximum(second, 1.0 - r))):
        expected = 0.6 * u + 0.4 * np.mean(middle)
        assert uncommon.shaped(u, plays, q) == pytest.approx(expected, abs=1e-12)


def test_a_piezo_s_force_is_that_of_its_plays() -> None:
    u, plays = command(), np.zeros(6)
    q = uncommon.packed(named("prandtl_ishlinskii", 0.4, 1.8))
    shaped = np.array([uncommon.shaped(v, plays, q) for v in u])
    found = simulate(named("prandtl_ishlinskii", 0.4, 1.8), u)[2]
    assert np.max(np.abs(found - response(BASE, T, shaped))) < 1e-6 * np.max(np.abs(found))
    assert np.std(shaped - u) > 0.05


LEVELS = {
    "stribeck_friction": ((0.15, 0.5, 0.01, 1.4), lambda x, v, u: 0.15 * (
        0.5 + 0.5 * math.exp(-(abs(v) / 0.01) ** 1.4))),
    "position_dependent_friction": ((0.15, 3e-4, 1e-4), lambda x, v, u: 0.15 * (
        1 + ((x - 1e-4) / 3e-4) ** 2)),
    "load_dependent_friction": ((0.25, 1.0), lambda x, v, u: 0.25 * (1 + abs(KF * u) / 1.0))}


@pytest.mark.parametrize("name", LEVELS)
def test_frictions_agree_with_located_events(name: str) -> None:
    values, level = LEVELS[name]
    u = 0.12 * command()
    out = simulate(named(name, *values), u)
    expected = by_events(u, level)
    added = np.std(expected - response(BASE, T, u))
    assert np.max(np.abs(out[2] - expected)) < 2e-4 * added
    assert np.mean(out[5] == 0.0) > 0.02  # it sticks at times
    assert np.mean(out[5] != 0.0) > 0.5


def by_events(u: np.ndarray, level) -> np.ndarray:
    """Slip by DOP853 up to the reversal that solve_ivp locates; stick while friction can hold."""
    state, direction, found = np.zeros(2), 0, []

    def reversal(_t: float, y: np.ndarray) -> float:
        return y[1]

    reversal.terminal = True
    for held in u:
        found.append(state[0])
        at = 0.0
        while at < T - 1e-12:
            if direction == 0:
                pull = KF * held - K * state[0]
                if abs(pull) <= level(state[0], 0.0, held):
                    break
                direction = int(np.sign(pull))
            reversal.direction = -direction
            solved = solve_ivp(
                lambda t, y, held=held, d=direction: stage(
                    lambda t, x, v: -d * level(x, v, held))(t, y, held),
                (at, T), state, method="DOP853", events=reversal, rtol=1e-9, atol=1e-13)
            state, at = solved.y[:, -1], float(solved.t[-1])
            if solved.status == 1:
                state, direction = np.array([state[0], 0.0]), 0
    return np.array(found)


def test_states_are_told_by_name_and_a_wrong_one_is_refused() -> None:
    assert plant.numbers(BASE).size == plant.COMMON
    with pytest.raises(ValueError, match="not in tuple"):
        plant.numbers({**BASE, "cogging.strength": 1.0})
