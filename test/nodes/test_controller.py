"""The controller node on a plant in the same process: modes, switching, guard, tuning."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from rclpy.parameter import Parameter

from dfm_stage.control import sample_model, ultimate
from dfm_stage.errors import DfmError
from dfm_stage.model import Plant, load_model
from dfm_stage.nodes.controller import Controller

MODELS = Path(__file__).parents[2] / "config" / "models"


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
            self.node._on_ahead(self.node._references, SimpleNamespace(
                seq=self.k, position=self.reference[0], velocity=self.reference[1],
                acceleration=self.reference[2]))
            self.node._on_ahead(self.node._excitations, SimpleNamespace(
                seq=self.k, voltage=self.added))
            self.node._on_measurement(SimpleNamespace(
                seq=self.k, stamp_ns=1000 * len(self.position), position=sample.reading_m))
            self.k += 1
            self.plant.advance(self.sent[-1][4], external_force_n=force)
        return np.array([each[4] for each in self.sent[first:]])

    def set(self, **values) -> None:
        result = self.node.set_parameters_atomically(
            [Parameter(name, value=value) for name, value in values.items()])
        if not result.successful:
            raise DfmError(result.reason)


@pytest.fixture
def loop(ros):
    context = ros()
    made: list[Loop] = []

    def make(**options) -> Loop:
        made.append(Loop(context, **options))
        return made[-1]

    yield make
    for each in made:
        each.node.destroy_node()


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
    lqg = stage.node._laws.by_name["lqr"]
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


def test_all_modes_change_without_a_bump_through_the_node(loop):
    stage = loop(plant="raster_bench")
    stage.set(model="raster_bench")
    stage.reference = (1e-3, 0.0, 0.0)
    volts = [stage.run(3000)]
    for mode in ("lqr", "open_loop", "pid", "open_loop", "lqr", "pid"):
        held = stage.sent[-1][4]
        stage.set(mode=mode)
        volts.append(stage.run(600))
        first = volts[-1][0]
        assert abs(first - held) < 0.03, mode
        if mode == "open_loop":
            assert abs(held) > 0.1 or mode
            assert not np.any(volts[-1][200:])       # then it is the excitation alone
            assert np.max(np.abs(np.diff(volts[-1]))) < 0.02


@pytest.fixture
def lead_lag(tmp_path) -> Path:
    """The law of docs/add_controller.md, in a file outside the package."""
    page = (Path(__file__).parents[2] / "docs/add_controller.md").read_text(encoding="utf-8")
    file = tmp_path / "lead_lag.py"
    file.write_text(re.search(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)[1],
                    encoding="utf-8")
    return file


def test_a_law_from_a_file_takes_over_live_in_lockstep(loop, lead_lag):
    stage = loop(law_files=lead_lag, lockstep="true")
    described = stage.node.describe_parameter("lead_lag_gain")
    assert "[V/m]" in described.description
    assert described.floating_point_range[0].to_value == 1e7
    stage.reference = (1e-3, 0.0, 0.0)
    stage.run(1500)
    for change in ({"mode": "lead_lag"}, {"lead_lag_gain": 3e3}, {"mode": "pid"},
                   {"mode": "lead_lag"}):
        held = stage.sent[-1][4]
        stage.set(**change)
        volts = stage.run(1500)
        assert abs(held) > 0.4                                  # what holds 1 mm on the spring
        assert abs(volts[0] - held) < 0.02, change
        assert stage.position[-1] == pytest.approx(1e-3, abs=2e-6)
    assert stage.node.settings["mode"] == "lead_lag"
    with pytest.raises(DfmError, match="lead_lag_gain out of range"):
        stage.set(lead_lag_gain=-1.0)
    with pytest.raises(DfmError, match="mode must be one of open_loop, pid, lqr, lead_lag, not"):
        stage.set(mode="lead")


def test_a_law_from_a_file_is_given_up_to_one_that_is_limited(loop, lead_lag):
    """Told that the amplifier gives 0.3 V at most, its integral does not wind up."""
    stage = loop(law_files=lead_lag, mode="lead_lag", output_limit_v=0.3)
    stage.reference = (1e-3, 0.0, 0.0)                          # 0.6 V would hold it
    stage.run(3000)
    stage.reference = (0.2e-3, 0.0, 0.0)
    stage.run(700)
    assert stage.position[-1] == pytest.approx(0.2e-3, abs=2e-5)


def test_a_file_without_a_law_is_refused_in_one_line(loop, tmp_path):
    (tmp_path / "none.py").write_text("x = 1\n", encoding="utf-8")
    with pytest.raises(DfmError, match=r"none\.py: defines no class derived from Law"):
        loop(law_files=tmp_path / "none.py")


def amplifier(stage: Loop, limit: float) -> None:
    """Let an amplifier answer each command, with less than it asks for beyond a limit."""
    send = stage.node._out.send

    def answered(*fields) -> None:
        send(*fields)
        given = min(limit, max(-limit, fields[4]))
        stage.sent[-1] = (*fields[:4], given, *fields[5:])
        stage.node._on_amplifier(SimpleNamespace(measurement_seq=fields[2], voltage=given))

    stage.node._out.send = answered


@pytest.mark.parametrize("mode", ["pid", "lqr"])
def test_what_the_amplifier_gave_keeps_the_integral_from_winding_up(loop, mode):
    late = {}
    for told in (True, False):
        stage = loop(plant="raster_bench", mode=mode, model="raster_bench",
                     amplifier_feedback=str(told).lower())
        amplifier(stage, 1.0)
        if not told:
            stage.node._on_amplifier = lambda state: None
        stage.reference = (4e-3, 0.0, 0.0)              # 2.3 V would hold it
        stage.run(3000)
        stage.reference = (0.5e-3, 0.0, 0.0)
        stage.run(3000)
        late[told] = np.sum(np.abs(np.array(stage.position[3000:]) - 0.5e-3)) * 1e-3
        assert stage.node.counters.get("amplifier_gave_less", 0) > 1000 or not told
    assert late[True] < 0.7 * late[False]


def test_a_saturation_of_the_model_is_the_outputs_limit(loop, tmp_path):
    from dfm_stage.model import save_model

    path = tmp_path / "saturated.yaml"
    save_model(load_model("raster_bench").with_effect("saturation", {"limit": 1.0}), path)
    stage = loop(plant=str(path), model=str(path))
    stage.reference = (4e-3, 0.0, 0.0)
    assert np.max(np.abs(stage.run(2000))) == 1.0
    stage.reference = (0.5e-3, 0.0, 0.0)
    stage.run(2500)
    assert stage.position[-1] == pytest.approx(0.5e-3, abs=2e-6)


@pytest.mark.parametrize("replaced", ["raster_bench", "rubbish", "gone"])
def test_a_replaced_model_file_changes_nothing_until_model_is_set(loop, tmp_path, replaced):
    path = tmp_path / "model.yaml"
    known = (MODELS / "paper_stage.yaml").read_text()
    path.write_text(known)
    stage = loop(mode="lqr", model=str(path))
    gain = stage.node.settings.plan.laws["lqr"].design
    if replaced == "gone":
        path.unlink()
    else:
        path.write_text("- [" if replaced == "rubbish" else
                        (MODELS / f"{replaced}.yaml").read_text())
    stage.set(mode="pid", kp=1234.0)
    stage.set(mode="lqr")
    assert stage.node.settings.plan.laws["lqr"].design is gain
    if replaced == "raster_bench":
        stage.set(model=str(path))
        assert stage.node.settings.plan.laws["lqr"].design is not gain
    else:
        with pytest.raises(DfmError, match=re.escape(str(path))):
            stage.set(model=str(path))


def test_the_guard_watches_in_open_loop_too(loop):
    stage = loop(mode="open_loop")
    for _ in range(8000):                              # 0.5 V at resonance: 12 mm unguarded
        stage.added = 0.5 * np.sin(24.5 * stage.k * 1e-3)
        stage.run(1)
    assert np.max(np.abs(stage.position)) < 7.7e-3
    assert "travel" in stage.node._guard.tripped
    assert "output is zero" in stage.node.warnings_active["guard"]
    assert not np.any([each[4] for each in stage.sent[-1000:]])
    stage.added = 0.0
    stage.run(4000)
    assert np.ptp(stage.position[-300:]) < 1e-4


def test_feedforward_notch_and_shaper_come_from_the_model(loop):
    stage = loop(plant="raster_bench", model="raster_bench")
    stage.set(feedforward="model", notch="model")
    assert stage.node._laws.by_name["pid"].gains.notch_hz == pytest.approx(16.02, rel=1e-12)
    with pytest.raises(DfmError, match="feedforward model needs the parameter model"):
        stage.set(model="")


def test_measurements_that_come_again_are_not_answered(loop):
    """As from two encoders of one name, one of them a little behind."""
    stage = loop(model="paper_stage")
    stage.reference = (2e-4, 0.0, 0.0)
    late = []
    for _ in range(2000):
        stage.run(1)
        late.append(SimpleNamespace(seq=stage.k - 1, stamp_ns=1000 * len(stage.position),
                                    position=stage.position[-1]))
        stage.node._on_measurement(late[-min(len(late), 1 + stage.k % 40)])
    assert len(stage.sent) == 2000
    assert stage.node.counters["measurements_late"] == 2000


def test_a_shaped_step_does_not_wake_the_mode_of_the_model(loop):
    vibration = {}
    for kind in ("none", "zv", "zvd"):
        stage = loop(plant="paper_stage", model="paper_stage", feedforward="model", shaper=kind,
                     kp=0.0, ki=0.0, kd=0.0)
        stage.run(10)
        stage.reference = (1e-3, 0.0, 0.0)
        stage.run(3000)
        vibration[kind] = np.ptp(stage.position[-2000:])
    assert vibration["zv"] < 0.02 * vibration["none"]
    assert vibration["zvd"] < 0.02 * vibration["none"]


@pytest.mark.parametrize("mode", ["pid", "lqr"])
@pytest.mark.parametrize(("then", "missed"), [(0, 0), (-300, 0), (4, 4), (0x7FFFFFFF, 0)])
def test_numbers_that_repeat_begin_anew_or_leave_out_do_not_upset_the_loop(
        loop, mode, then, missed):
    stage = loop(model="paper_stage", mode=mode)
    stage.reference = (2e-4, 0.0, 0.0)
    stage.run(500)
    stage.k += then - 1 if then <= 0 else then
    stage.run(1)
    assert stage.node.counters.get("samples_missed", 0) == missed
    stage.run(3000)
    assert np.max(np.abs(np.array(stage.position[-500:]) - 2e-4)) < 2e-6
    assert np.all(np.isfinite([each[4] for each in stage.sent]))
