"""sim_plant: simulates the stage with coil and scale.

In real time it takes a sample in every period of a steady clock. Samples that are late are taken
at once and counted. In lockstep, sample k waits for the drive that answers it. Then the plant
steps and /clock advances. The drive that answers sample k is held from t_k to t_(k+1). In real
time, a drive that is late acts one sample later and is counted.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from dfm_stage.errors import DfmError
from dfm_stage.middleware.hand_over import in_a_turn, keep_time
from dfm_stage.middleware.wire import encode_clock
from dfm_stage.model import Model, load_model, model_text
from dfm_stage.nodes.base import LoopNode, Publisher
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import run_node
from dfm_stage.nodes.sample_period import SAMPLE_PERIOD

if TYPE_CHECKING:
    from dfm_stage.model.plant import Sample

_GIVE_UP_SAMPLES = 100
SEEDS_APART = 1000
"""From the seed of one axis to that of the next, where each has a plant of its own."""


class _Stage:
    """A plant, and the inputs that are to be held over the next sample."""

    def __init__(self, model: Model, seed: int) -> None:
        from dfm_stage.model import CoupledPlant  # with numba, which the help can do without

        self.plant = CoupledPlant(model, seed)
        self.inputs = [0.0] * len(self.plant.plants)
        self.samples: tuple[Sample, ...] = ()


class _Axis:
    """The wires of one axis."""

    def __init__(self, node: SimPlant, name: str, stage: _Stage, index: int) -> None:
        prefix = f"{name}/" if name else ""
        self.stage = stage
        self.plant = stage.plant.plants[index]
        self.topic = f"{prefix}sim/drive"
        self.counts: Publisher = node.link_publisher("sim/position_counts", prefix)
        self.truth: Publisher = node.link_publisher("plant", prefix)
        model = self.plant.model
        self.current = (node.link_publisher("sim/current", prefix) if model.drive == "current"
                        or "coil_resistance" in model.base else None)
        self.answered = -1
        self.driven = 0
        node.link_subscription("sim/drive", self._on_drive, prefix)
        self._node = node
        self.index = index

    def _on_drive(self, drive: Any) -> None:
        self.driven = self._node.seq
        if drive.measurement_seq == self._node.seq:
            self.answered = drive.measurement_seq
        else:
            self._node.count("late_drives")
        self.stage.inputs[self.index] = (
            drive.voltage if drive.enabled and math.isfinite(drive.voltage) else 0.0)
        if self._node.lockstep:
            self._node.step_when_answered()

    def watch(self, samples: int) -> bool:
        """Take the coil's input away after `samples` without a drive; return whether it did."""
        if not self.stage.inputs[self.index] or (
                (self._node.seq - self.driven) & 0xFFFFFFFF <= samples):
            return False
        self.stage.inputs[self.index] = 0.0
        return True


class SimPlant(LoopNode):
    """Publishes `sim/position_counts` and `plant`, obeys `sim/drive`."""

    kind = "sim_plant"
    example = "-p model:=xy_stage -r __ns:=/stage    # two axes: /stage/x and /stage/y"
    settings_table = (
        Setting("model", "paper_stage", "model.yaml to simulate: a path or a name in "
                "config/models"),
        Setting("axes", "", "axes to simulate, such as 'x y', each in its own sub-namespace; "
                "empty: all axes of the model; one without a name stays in the node's namespace"),
        replace(SAMPLE_PERIOD, default=0.0, low=0.0, description="sampling period of the "
                "simulated scale; 0 = that of the model"),
        Setting("seed", 0, "fixes the noise", "", 0, 2**31),
        Setting("drive_watchdog_s", 0.0, "real time: without a drive for this long the coil has "
                "no current, as behind a hardware watchdog relay; 0 = it keeps the last, as a "
                "Copley drive does", "s", 0.0, 60.0),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        model = load_model(self.settings["model"])
        period_s = self.settings[SAMPLE_PERIOD.name] or model.sample_period
        self._model = model if period_s == model.sample_period else replace(
            model, sample_period=period_s, document=None)
        names = self.settings["axes"].split() or list(self._model.axis_names) or [""]
        self._period_ns = round(self._model.sample_period * 1e9)
        self.seq = 0
        self._published = False
        self._clock_out = self.side_sender("/clock")
        self._axes = self._wire(names)
        self._stages = list({id(axis.stage): axis.stage for axis in self._axes}.values())
        self._due_ns = 0  # when the sample that is out was due; 0: none is
        self._watchdog = (0 if self.lockstep else
                          round(self.settings["drive_watchdog_s"] / self._model.sample_period))
        if self.lockstep:
            self._first = self.create_timer(0.02, self._publish_first, clock=self.steady)
        else:
            self._timer = self.create_timer(
                self._model.sample_period, in_a_turn(self, self._on_timer), clock=self.steady)
        self.begin()

    def _wire(self, names: list[str]) -> list[_Axis]:
        """Connect each named axis to its place in a plant; axes of one model share one plant."""
        known = self._model.axis_names
        seed = self.settings["seed"]
        if not known:
            return [_Axis(self, name, _Stage(self._model, seed + SEEDS_APART * index), 0)
                    for index, name in enumerate(names)]
        for name in names:
            if name not in known:
                raise DfmError(f"model {self._model.name} has the axes {' '.join(known)}, "
                               f"not {name!r}; set the parameter axes")
        stage = _Stage(self._model, seed)
        return [_Axis(self, name, stage, known.index(name)) for name in names]

    def config(self) -> dict[str, Any]:
        """Return the model that is simulated."""
        return {"model_yaml": model_text(self._model), "model": self._model.name}

    # Lockstep

    def _publish_first(self) -> None:
        self._first.cancel()
        self._publish_samples(0)

    def step_when_answered(self) -> None:
        """Step once every axis has answered the sample that is out."""
        for axis in self._axes:
            if axis.answered != self.seq:
                return
        self._advance()
        self._publish_samples(self.seq * self._period_ns)

    # Real time

    def _on_timer(self) -> None:
        """Take what is due. After its first sample a fast plant in one process with others keeps
        the time without the timer."""
        if self._due_ns:
            self._tick()
        elif self.links_open:
            self._due_ns = self._first_due_ns()
            self._publish_samples(self.now_ns())
            if keep_time(self, self._tick, self._model.sample_period):
                self._timer.cancel()

    def _tick(self) -> float:
        """Take the samples that are due; return when the next is (steady clock, s)."""
        now = time.monotonic_ns()
        period_ns = self._timer.timer_period_ns  # not always the nearest whole number
        due = (now - self._due_ns) // period_ns
        self._due_ns += due * period_ns
        left_out = due > _GIVE_UP_SAMPLES
        if left_out:
            self.get_logger().warning(f"held up for {due} samples; they are left out",
                                      throttle_duration_sec=1.0)
            # an amplifier that sees no samples for so long has put its output to zero
            for stage in self._stages if self._watchdog else ():
                stage.inputs = [0.0] * len(stage.inputs)
        if due > 1:
            self.count("deadlines_missed", due if left_out else due - 1)
        for k in range(1, due + 1):
            self._advance()
            if k == due or not left_out:
                self._publish_samples(self.now_ns())
        return 1e-9 * (self._due_ns + period_ns)

    def _first_due_ns(self) -> int:
        """Return when the timer was due, by its own time and not that of its call, which may be
        late. Then all other samples would come early by that, and some by so much that two are
        taken for one. What passes between the two clocks would make all of them late: the two
        that were read closest to each other count."""
        read = []
        for _ in range(5):
            now = time.monotonic_ns()
            left_ns = self._timer.time_until_next_call()
            read.append((time.monotonic_ns() - now, now + left_ns))
        now = time.monotonic_ns()
        return now - (now - min(read)[1]) % self._timer.timer_period_ns

    # Both

    def _advance(self) -> None:
        if self._watchdog:
            for axis in self._axes:
                if axis.watch(self._watchdog):
                    self.count("watchdog_trips")
                    self.get_logger().warning(f"nothing on {axis.topic}: the coil is cut off")
        for stage in self._stages:
            stage.plant.advance(stage.inputs)
        self.seq = (self.seq + 1) & 0xFFFFFFFF

    def _publish_samples(self, stamp_ns: int) -> None:
        self._published = True
        self.counters["samples"] = self.seq
        for stage in self._stages:
            stage.samples = stage.plant.sample()
        samples = [axis.stage.samples[axis.index] for axis in self._axes]
        for axis, sample in zip(self._axes, samples, strict=True):
            axis.counts.send(stamp_ns, self.seq, sample.counts, axis.plant.count_size_m)
            if axis.current is not None:
                axis.current.send(stamp_ns, self.seq, sample.current)
        if self.lockstep and self.seq:  # after what the loop waits for
            self._clock_out.put(encode_clock(stamp_ns))
        for axis, sample in zip(self._axes, samples, strict=True):
            axis.truth.send(stamp_ns, self.seq, sample.position_m, sample.velocity,
                            sample.current, sample.force_n)

    def waiting_for(self) -> tuple[str, int] | None:
        """Return the drive that has not come."""
        return next(((axis.topic, self.seq) for axis in self._axes
                     if self._published and axis.answered != self.seq), None)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(SimPlant, args)
