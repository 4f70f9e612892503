"""The controller node on a plant in the same process: modes, switching, guard, tuning."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter

from dfm_stage.control import sample_model, ultimate
from dfm_stage.errors import DfmError
from dfm_stage.model import Plant, load_model
from dfm_stage.nodes.controller import Controller


class Loop:
    """A controller whose links are cut and whose measurements come from a plant."""

    def __init__(self, context: rclpy.Context, plant: str = "paper_stage", **parameters) -> None:
        args = ["--ros-args"]
        for name, value in parameters.items():
            args += ["-p", f"{name}:={value}"]
        self.node = Controller(context=context, cli_args=args)
        self.sent: list[tuple] = []
        self.node._out.send = lambda *fields: self.sent.append(fields)
        self.plant = Plant(load_model(plant), seed=1)
        self.k, self.added, self.reference = 0, 0.0, (0.0, 0.0, 0.0)
        self.position: list[float] = []

    def run(self, samples: int, force: float = 0.0) -> np.ndarray:
        """Return the commands of these samples, V."""
        first = len(self.sent)
        for _ in range(samples):
            sample = self.plant.sample()
            self.position.append(sample.position_m)
            self.node._on_reference(SimpleNamespace(
                seq=self.k, position=self.reference[0], velocity=self.reference[1],
                acceleration=self.reference[2]))
            self.node._on_excitation(SimpleNamespace(seq=self.k, voltage=self.added))
            self.node._on_measurement(SimpleNamespace(
                seq=self.k, stamp_ns=self.k, position=sample.reading_m))
            self.k += 1
            self.plant.advance(self.sent[-1][4], external_force_n=force)
        return np.array([each[4] for each in self.sent[first:]])

    def set(self, **values) -> None:
        result = self.node.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in values.items()])
        if not result.successful:
            raise DfmError(result.reason)


@pytest.fixture
def loop():
    context = rclpy.Context()
    rclpy.init(context=context, args=[])
    made: list[Loop] = []

    def make(**options) -> Loop:
        made.append(Loop(context, **options))
        return made[-1]

    yield make
    for each in made:
        each.node.destroy_node()
    rclpy.try_shutdown(context=context)


def test_modes_change_without_a_bump_on_the_move(loop):
    stage = loop(plant="raster_bench")
    stage.set(model="raster_bench")
    speed = 2e-3
    change = []
    for block, mode in enumerate(("pid", "lqr", "pid", "lqr", "pid")):
        stage.set(mode=mode)
        for _ in range(400):
            stage.reference = (speed * stage.k * 1e-3, speed, 0.0)
            stage.run(1)
        volts = np.array([each[4] for each in stage.sent])
        if block:
            change.append(abs(volts[-400] - volts[-401]))
    assert max(change) < 0.05
    lag = speed * 573.1 / 38000.0                # what the integral needs to follow the spring
    assert stage.reference[0] - stage.position[-1] == pytest.approx(lag, rel=0.3)


def test_lqr_gets_there_to_a_count_against_a_force(loop):
    stage = loop(mode="lqr", model="paper_stage")
    stage.reference = (1e-3, 0.0, 0.0)
    stage.run(5000, force=0.3)
    assert abs(np.mean(stage.position[-500:]) - 1e-3) < 5e-8
    stage.set(lqr_integral=False)
    stage.run(4000, force=0.3)
    assert abs(np.mean(stage.position[-500:]) - 1e-3) > 2e-5
    stage.set(lqr_disturbance=True)
    stage.run(4000, force=0.3)
    assert abs(np.mean(stage.position[-500:]) - 1e-3) < 5e-8


def test_the_filter_knows_the_excitation(loop):
    stage = loop(mode="lqr", model="paper_stage")
    rng = np.random.default_rng(0)
    for _ in range(500):
        stage.added = 0.2 * float(rng.choice([-1, 1]))
        stage.run(1)
    lqg = stage.node._laws.lqg
    predicted = lqg.design.filter.c @ (lqg._next + lqg._b * lqg.output_v)
    assert predicted == pytest.approx(stage.plant.sample().position_m, abs=3e-7)


def test_lqr_without_a_model_or_with_a_bad_one_is_refused(loop):
    stage = loop()
    with pytest.raises(DfmError, match="mode lqr needs the parameter model"):
        stage.set(mode="lqr")
    with pytest.raises(DfmError, match="nowhere"):
        stage.set(model="nowhere")
    assert stage.node.settings["mode"] == "pid"
    stage.set(mode="lqr", model="xy_stage")
    assert stage.node.config()["lqr"]["modulus_margin"] > 0.3
    with pytest.raises(DfmError, match="mode lqr needs"):
        loop(mode="lqr")


@pytest.mark.parametrize(("gains", "reason"), [
    ({"kp": 3000.0, "ki": 0.0, "kd": 0.0}, "travel"),           # above the ultimate gain
    ({"kp": 3000.0, "ki": 0.0, "kd": 900.0}, "limit to limit"),  # too much derivative
    ({"kp": -3000.0, "ki": 0.0, "kd": 0.0}, "travel"),          # wrong sign
])
def test_a_diverging_loop_is_let_go_and_comes_to_rest(loop, gains, reason):
    stage = loop(**gains)
    stage.reference = (1e-3, 0.0, 0.0)
    volts = stage.run(20_000)
    assert reason in stage.node._guard.tripped
    assert stage.node.counters["guard_trips"] == 1
    assert "output is zero" in stage.node.warnings_active["guard"]
    assert not np.any(volts[-10_000:])
    assert np.max(np.abs(stage.position)) < 7.7e-3
    assert np.ptp(stage.position[-300:]) < 1e-5
    stage.set(mode="pid", kp=3100.0, ki=38000.0, kd=94.0)
    stage.run(3000)
    assert not stage.node.warnings_active
    assert stage.position[-1] == pytest.approx(1e-3, abs=2e-6)


@pytest.mark.parametrize("way", ["raise_gain", "relay"])
def test_the_ultimate_gain_is_found_on_the_loop(loop, way):
    stage = loop(tuning=way)
    while not stage.node._laws.run.ended:
        stage.run(100)
    found = stage.node.config()["tuning"]
    exact = ultimate(sample_model(load_model("paper_stage")))
    assert found["ultimate_gain_v_m"] == pytest.approx(exact.gain_v_m, rel=0.03)
    assert found["ultimate_period_s"] == pytest.approx(exact.period_s, rel=0.02)
    assert not np.any(stage.run(100))
    stage.set(tuning="none")
    stage.reference = (1e-4, 0.0, 0.0)
    stage.run(3000)
    assert stage.position[-1] == pytest.approx(1e-4, abs=1e-6)
    json.dumps(stage.node.config())


def test_the_excitation_is_the_command_in_open_loop(loop):
    stage = loop(mode="open_loop", model="paper_stage")
    stage.reference, stage.added = (1e-3, 0.0, 0.0), 0.07
    assert np.all(stage.run(50) == 0.07)
