"""What is missing is named from a measured velocity or acceleration as from a position."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dfm_stage.diagnosis import DiagnosisError, diagnose
from dfm_stage.diagnosis.candidates import excluded
from dfm_stage.diagnosis.observation import observe
from dfm_stage.diagnosis.witness import witness
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.recording import AxisRecord, Provenance, Record

PERIOD = 2e-3
BELIEVED = Model("stage", PERIOD, {"mass": 1.0, "damping": 2.5, "stiffness": 2400.0,
                                   "force_constant": 1.0})
K3 = 4e7


def record(feed, output, what, seed, share=1e-3, **more):
    rng = np.random.default_rng(seed)
    noise = share * np.std(output) * rng.standard_normal(feed.size)
    return Record(PERIOD * np.arange(feed.size), PERIOD, {"x": AxisRecord(
        feed, output + noise, measures=what, **more)}, Provenance(f"r{seed}", "csv"))


def multisine(seed, lines, count=3000):
    rng, time = np.random.default_rng(seed), PERIOD * np.arange(count)
    waves = [np.sin(0.5 * np.pi * k * time + p) for k, p in
             zip(lines, rng.uniform(0.0, 6.28, len(lines)), strict=True)]
    return 2.0 * np.sum(waves, axis=0) / np.sqrt(0.5 * len(lines))


def hardening(feed):
    """Position and velocity (N, 2) of a stage with a cubic spring, by scipy."""
    state, found = np.zeros(2), []
    for u in feed:
        found.append(state)
        state = solve_ivp(lambda t, s, u: [s[1], u - 3.0 * s[1] - 2500.0 * s[0] - K3 * s[0]**3],
                          (0.0, PERIOD), state, args=(u,), rtol=1e-9, atol=1e-13).y[:, -1]
    return np.array(found)


@pytest.fixture(scope="module")
def springs():
    feeds = [multisine(seed, range(1, 60)) for seed in (1, 2)]
    return [(feed, hardening(feed)) for feed in feeds]


def test_a_cubic_spring_by_velocity_alone(springs):
    records = [record(f, s[:, 1], "velocity", k) for k, (f, s) in enumerate(springs)]
    found = diagnose(records[:1], BELIEVED, holdout=records[1:])
    assert (found.verdict, found.names) == ("named", ("cubic_stiffness",))
    assert found.effects[0].parameters["k3"].covers(K3)
    assert found.gap.unit == "m/s"
    noise = 1e-3 * np.std(springs[1][1][:, 1])
    assert found.gap.held_out[2] < 1.3 * noise
    assert found.comparisons[0].measures == "velocity"


def test_the_force_domain_agrees_on_a_velocity(springs):
    feed, states = springs[0]
    run = observe(record(feed, states[:, 1], "velocity", 3), BELIEVED)
    found = witness([run], BELIEVED, tuple(EFFECTS))
    assert found.best.names == ("cubic_stiffness",)
    assert found.best.parameters["cubic_stiffness.k3"] == pytest.approx(K3, rel=0.02)
    assert found.best.parameters["stiffness"] == pytest.approx(2500.0, rel=0.01)
    with pytest.raises(DiagnosisError, match="needs a measured position or velocity"):
        witness([replace(run, measures="acceleration")], BELIEVED, tuple(EFFECTS))


def servo(seed, friction=8.0, count=6000, fine=20):
    """Input and velocity of a body with friction and no spring in a loop of position and speed;
    it stops where its speed changes sign and friction can hold it."""
    rng, time = np.random.default_rng(seed), PERIOD * np.arange(count)
    phases = rng.uniform(0.0, 6.28, 4)
    wanted = sum(0.03 * np.sin(2.0 * np.pi * f * time + p) for f, p in
                 zip((0.3, 0.8, 1.3, 2.3), phases, strict=True))
    x, v, found, h = 0.0, 0.0, [], PERIOD / fine
    for target in wanted:
        u = 60.0 * (target - x) - 12.0 * v
        found.append((u, v))
        for _ in range(fine):
            force = 5.0 * u
            side = np.sign(v) or np.sign(force)
            held = v == 0.0 and abs(force) <= friction
            after = 0.0 if held else v + h * (force - 20.0 * v - friction * side) / 10.0 \
                * (1.0 - h)
            if v * after < 0.0:
                after = 0.0
            x, v = x + 0.5 * h * (v + after), after
    return np.array(found).T


def test_friction_of_a_servo_by_velocity_alone():
    records = [record(*servo(seed), "velocity", seed, 2e-3) for seed in (1, 2)]
    model = Model("servo", PERIOD, {"mass": 10.0, "damping": 15.0, "force_constant": 5.0})
    found = diagnose(records[:1], model, holdout=records[1:])
    assert found.names == ("coulomb_friction",)
    assert found.effects[0].parameters["force"].value == pytest.approx(8.0, rel=0.02)
    assert found.gap.judged == "velocity"
    assert found.gap.held_out[2] < 0.1 * found.gap.held_out[1]


def test_two_modes_by_acceleration():
    w = 2.0 * np.pi * 60.0
    coupling, loss, lag = 0.15 * w * w, 0.15 * 0.04 * w, 1e-3
    a = np.zeros((6, 6))
    a[0, 1], a[2, 3], a[1, 4] = 1.0, 1.0, 1.0
    a[1, :4] = -(2500.0 + coupling), -(3.0 + loss), coupling, loss
    a[3, :4] = np.array([coupling, loss, -coupling, -loss]) / 0.15
    a[4, 4], a[4, 5] = -1.0 / lag, 1.0 / lag
    step, records = expm(a * PERIOD), []
    for seed in (1, 2):
        feed, state, moved = multisine(seed, range(1, 480), 6000), np.zeros(6), []
        for u in feed:
            moved.append((a @ state)[1])
            state[5] = u
            state = step @ state
        records.append(record(feed, np.array(moved), "acceleration", seed, 2e-3))
    model = BELIEVED.with_parameters({"amplifier_time_constant": lag})
    found = diagnose(records[:1], model, holdout=records[1:])
    assert found.names == ("second_mode",)
    own = np.sort(np.abs(np.linalg.eigvals(a[:4, :4])))[-1] / (2.0 * np.pi)
    assert found.effects[0].parameters["frequency"].value == pytest.approx(own, rel=1e-3)
    assert found.gap.unit == "m/s^2"


def test_effects_of_an_encoder_are_no_candidates():
    rng = np.random.default_rng(0)
    seen = observe(record(rng.standard_normal(1000), rng.standard_normal(1000), "velocity", 0),
                   BELIEVED)
    at = Conditions.of(BELIEVED.base, BELIEVED.drive, [seen], 0.0)
    for name in ("encoder_quantization", "encoder_periodic_error", "thermal_drift"):
        assert "reading of a position" in str(excluded(name, BELIEVED, at))
    assert excluded("cubic_stiffness", BELIEVED, at) is None


def test_a_weight_is_looked_for_at_the_measured_angle_itself():
    angle = 2.0 * np.sin(3.0 * PERIOD * np.arange(3000))
    seen = observe(record(angle, angle, "position", 0), BELIEVED)
    lengths = [{s["length"] for s in EFFECTS["gravity"].starts(Conditions.of(
        BELIEVED.base, BELIEVED.drive, [seen], 0.0, unit))} for unit in ("m", "rad")]
    assert 1.0 not in lengths[0]
    assert lengths[1] == lengths[0] | {1.0}


def test_speed_is_that_of_a_motor_that_never_turns_back():
    speed = 100.0 + np.random.default_rng(0).standard_normal(3000)
    seen = observe(record(speed, speed, "velocity", 0), BELIEVED)
    assert Conditions.of(BELIEVED.base, BELIEVED.drive, [seen], 0.0).speed == pytest.approx(
        100.0, rel=1e-3)


def test_records_of_different_signals_are_refused(springs):
    feed, states = springs[0]
    records = [record(feed, states[:, k], what, k) for k, what in
               enumerate(("position", "velocity"))]
    with pytest.raises(DiagnosisError, match="r1: the output is a velocity, that of r0 a pos"):
        diagnose(records, BELIEVED)


def test_a_velocity_beside_the_position_is_compared_where_all_records_have_it(springs):
    records = [record(f, s[:, 0], "position", k, velocity=s[:, 1] + 1e-4 * np.random.default_rng(
        9).standard_normal(f.size)) for k, (f, s) in enumerate(springs)]
    both = diagnose(records[:1], BELIEVED, holdout=records[1:])
    bare = replace(records[1], axes={"x": replace(records[1].axes["x"], velocity=None)})
    alone = diagnose(records[:1], BELIEVED, holdout=[bare])
    for found in (both, alone):
        assert found.names == ("cubic_stiffness",)
        assert found.effects[0].parameters["k3"].covers(K3)
    widths = [f.effects[0].parameters["k3"].half_width for f in (both, alone)]
    assert widths[0] < 0.9 * widths[1]
