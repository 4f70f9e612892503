"""trajectory_generator: the reference and the excitation of one axis, sample by sample.

When it sees measurement k it sends reference and excitation of k + 1, so that the controller has
them when measurement k + 1 arrives. Between experiments it holds the last position. In lockstep it
then sends nothing, and time does not advance: a run begins with the sample that waits for it. A
movement beyond a limit (`limits.*`) is refused before it starts.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.action import ActionServer, CancelResponse
from rclpy.serialization import deserialize_message

from dfm_interfaces.action import RunExperiment
from dfm_stage.control import inverse_of
from dfm_stage.errors import DfmError
from dfm_stage.middleware.watch import HELD_UP_S, SILENT_S
from dfm_stage.model import Model, load_model
from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import run_node
from dfm_stage.nodes.sample_period import SAMPLE_PERIOD
from dfm_stage.nodes.signal_settings import KINDS, signal_settings, specification
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import (
    LIMIT_PARAMETERS,
    Bounds,
    Excitation,
    Limits,
    Outcome,
    Reference,
    load_experiment,
    make_excitation,
    make_reference,
    require_run_within,
)

RECORDER_SILENT_S = 2.5
_BACKWARDS = 0x80000000
_FEEDBACK_PERIOD_S = 0.5


class Signals(NamedTuple):
    """What a run asks for; `voltage` has the model's inverse in it, too."""

    name: str
    reference: Reference
    excitation: Excitation
    voltage: memoryview
    bounds: Bounds
    open_loop: bool


@dataclass
class ActiveRun:
    """An experiment under way; `first_seq` is set by the first sample, `over_s` after the last."""

    name: str
    position: memoryview
    velocity: memoryview
    acceleration: memoryview
    voltage: memoryview
    metadata: dict[str, Any]
    files: dict[str, str]
    outcome: Outcome
    goal: Any = None
    cancelled: bool = False
    first_seq: int | None = None
    done: int = 0
    over_s: float | None = None

    def __post_init__(self) -> None:
        self.count = len(self.position)


class TrajectoryGenerator(LoopNode):
    """Publishes `reference` and `excitation`; runs experiments through an action."""

    kind = "trajectory_generator"
    example = "-p experiment:=scan    # runs it as soon as the controller listens"
    settings_table = (
        SAMPLE_PERIOD,
        Setting("experiment", "", "experiment to run: a name in config/experiments or a YAML "
                "file; empty runs the reference and excitation given here", live=True),
        Setting("duration_s", 10.0, "how long reference and excitation last", "s", 0.001, 1e6,
                live=True),
        Setting("seed", 0, "fixes random phases", "", 0, 2**31, live=True),
        Setting("repeat", False, "start again when the signal ends (real time)", live=True),
        Setting("autostart", True, "run as soon as the controller listens, where an experiment "
                "or a signal other than hold is given"),
        *(Setting.of(parameter, prefix="limits.", live=True) for parameter in LIMIT_PARAMETERS),
        Setting("limits.model", "", "model.yaml, a path or a name in config/models, that says "
                "what force and current a movement takes and where an excitation in open loop "
                "drives the stage; empty = that of the experiment, for force and current",
                live=True),
        Setting("inverse_model", "", "model.yaml whose inverse is added to the excitation: the "
                "voltage that moves it along the reference, which is known ahead; empty = none",
                live=True),
        *signal_settings(),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._run: ActiveRun | None = None
        self._asked_for: Any = None
        self._pending: Any = None
        self._sent_seq: int | None = None
        self._hold = 0.0
        self._asked_s = time.monotonic()
        self._said: dict[str, Any] = {}
        self._sound: tuple[dict[str, Any], set[str]] | None = None
        self._output_heard_s = -math.inf
        self._output_said, self._output_off = b"", ""
        self._reference = self.link_publisher("reference")
        self._excitation = self.link_publisher("excitation")
        self.link_subscription("measurement", self._on_measurement)
        self.trigger_service("~/start", self._start)
        self.trigger_service("~/stop", self._stop)
        self._action = ActionServer(
            self, RunExperiment, "~/run_experiment", lambda _goal: RunExperiment.Result(),
            handle_accepted_callback=self._on_goal,
            cancel_callback=self._on_cancel)
        self.beside_the_loop(_FEEDBACK_PERIOD_S, self._report)
        self.side_subscription("amplifier_health", self._on_output, raw=True)
        self._recorder_heard_s = math.inf
        self._waits_for_recorder = self.settings["wait_for_recorder"] and not self.lockstep
        if self._waits_for_recorder:
            self.side_subscription("/diagnostics", self._on_diagnostics, raw=True)
        self.begin()

    def start_work(self) -> None:
        """Refuse an experiment that cannot be run; start it where that is wanted."""
        self._make_run()
        values = self.settings.values
        if values["autostart"] and (values["experiment"] or any(
                values[f"{part}.kind"] != "hold" for part in KINDS)):
            self._autostart = self.create_timer(0.05, self._start_when_open, clock=self.steady)

    # Parameters

    def check_settings(self, values: dict[str, Any]) -> None:
        """Refuse a signal that cannot be made. What was found sound is not made again: settings
        that come faster than they are checked would keep an operator waiting."""
        given = self.settings.given | {
            name for name, value in values.items() if value != self.settings[name]}
        if not values["experiment"] and (values, given) != self._sound:
            self._signals(values, given)
            self._sound = dict(values), given

    def _signals(self, values: dict[str, Any], given: set[str],
                 experiment: str = "") -> Signals:
        """Return what is to be run, all within the limits.

        Raises
        ------
        DfmError
            If there is no such experiment or signal, or it would leave a limit.
        """
        period = values[SAMPLE_PERIOD.name]
        name, named, bounds = "parameters", values["limits.model"], Bounds()
        experiment = experiment or values["experiment"]
        if experiment:
            loaded = load_experiment(find_experiment(experiment))
            reference = loaded.reference(self.axis, period)
            excitation = loaded.excitation(self.axis, period)
            name, open_loop, bounds = loaded.name, loaded.mode == "open_loop", loaded.bounds
        else:
            common = {"sample_period_s": period, "duration_s": values["duration_s"],
                      "seed": values["seed"]}
            reference = make_reference(specification("reference", values, given),
                                       where="reference", **common)
            excitation = make_excitation(specification("excitation", values, given),
                                         where="excitation", **common)
            open_loop = values["reference.kind"] == "hold"
        limits = Limits.from_mapping({each.name: values[f"limits.{each.name}"]
                                      for each in LIMIT_PARAMETERS})
        if not named and experiment and limits.need_a_model:
            named = loaded.model
        voltage = excitation.voltage
        if values["inverse_model"] and not open_loop:
            voltage = voltage + inverse_of(self._model(values["inverse_model"]),
                                            reference.position, reference.velocity,
                                            reference.acceleration)
        require_run_within(reference, replace(excitation, voltage=voltage), limits,
                           self._model(named) if named else None, open_loop=open_loop,
                           where=name if experiment else "")
        return Signals(name, reference, excitation, voltage.data, bounds, open_loop)

    def _model(self, name: str) -> Model:
        model = load_model(name)
        return model.axis(self.axis) if model.axes else model

    def _make_run(self, experiment: str = "", goal: Any = None) -> ActiveRun:
        name, reference, excitation, voltage, bounds, open_loop = self._signals(
            self.settings.values, self.settings.given, experiment)
        return ActiveRun(name, reference.position.data, reference.velocity.data,
                         reference.acceleration.data, voltage,
                         {"experiment": name, "reference": reference.metadata(),
                          "excitation": excitation.metadata()}, self._files(excitation),
                         Outcome(reference.position, self._hold, bounds, open_loop), goal)

    def _files(self, excitation: Excitation) -> dict[str, str]:
        """Return what the recorder is to attach to the bag: a voltage that came from a file."""
        if excitation.kind != "csv":
            return {}
        return {f"{self.axis}_excitation.csv": "time_s,excitation_v\n" + "".join(
            f"{k * excitation.sample_period_s:.9g},{volts!r}\n"
            for k, volts in enumerate(excitation.voltage.tolist()))}

    def config(self) -> dict[str, Any]:
        """Return what signal is, or was last, running, where in the record it starts, and what
        came of it."""
        run = self._run
        return self._description(run) if run is not None else self._said

    def _description(self, run: ActiveRun) -> dict[str, Any]:
        return {"run": {**run.metadata, "first_seq": run.first_seq},
                **({"attachments": run.files} if run.files else {})}

    # Starting and stopping

    def _on_goal(self, goal: Any) -> None:
        """Make the run of a goal, and begin it. In real time a thread makes it: a scan of 10 s at
        5 kHz would hold up the loop for 50 samples."""
        try:
            self._require_idle()
        except DfmError as error:
            self._conclude(goal, "abort", str(error))
            return
        self._asked_for = goal
        if self.lockstep:
            self._begin_made(goal, self._made(goal))
        else:
            threading.Thread(target=self._make_aside, args=(goal,), daemon=True).start()

    def _make_aside(self, goal: Any) -> None:
        made, executor = self._made(goal), self.executor
        if executor is not None:
            executor.create_task(self._begin_made, goal, made)

    def _made(self, goal: Any) -> ActiveRun | Exception:
        try:
            return self._make_run(goal.request.experiment, goal)
        except Exception as error:  # noqa: BLE001 (raised by the executor, not in a thread)
            return error

    def _begin_made(self, goal: Any, made: ActiveRun | Exception) -> None:
        if self._asked_for is not goal:
            self._conclude(goal, "canceled" if goal.is_cancel_requested else "abort",
                           "stopped before it began")
            return
        self._asked_for = None
        if isinstance(made, ActiveRun):
            self._begin(made)
        elif isinstance(made, DfmError):
            self._conclude(goal, "abort", str(made))
        else:
            raise made

    def _on_cancel(self, goal: Any) -> CancelResponse:
        """Have the run end with its next sample, or not begin."""
        if self._asked_for is goal:
            self._asked_for = None
        if self._run is not None and self._run.goal is goal:
            self._run.cancelled = True
        return CancelResponse.ACCEPT

    def _conclude(self, goal: Any, how: str, message: str = "",
                  run: ActiveRun | None = None) -> None:
        def execute(handle: Any) -> RunExperiment.Result:
            getattr(handle, how)()
            result = RunExperiment.Result(success=how == "succeed", message=message)
            if run is not None and run.first_seq is not None:
                result.first_seq = run.first_seq
                result.last_seq = (run.first_seq + max(0, run.done - 1)) & 0xFFFFFFFF
            return result

        goal.execute(execute)

    def _require_idle(self) -> None:
        if self._run is not None:
            raise DfmError(f"{self._run.name} is still running; cancel it first")
        if self._asked_for is not None:
            raise DfmError("an experiment is about to begin; cancel it first")

    def _begin_run(self) -> int:
        """Start what the parameters say; return its number of samples."""
        self._require_idle()
        return self._begin(self._make_run())

    def _begin(self, run: ActiveRun) -> int:
        self._run = run
        self.warnings_active.pop("run", None)
        self.publish_config()
        self._answer_pending()
        return run.count

    def _answer_pending(self) -> None:
        """In lockstep, go on with the measurement that waits for a run, or for what the amplifier
        says of its output: a short run would be over before that is heard."""
        if self._pending is not None and self._run is not None and (
                self._output_heard_s > -math.inf or not self.count_publishers("amplifier_health")):
            pending, self._pending = self._pending, None
            self._answer(pending.seq, pending.stamp_ns)
            self._answer_ahead(pending)

    def _start_when_open(self) -> None:
        if (self._run is self._asked_for is None
                and not self._reference.missing(["controller"])):
            self._autostart.cancel()
            self._begin_run()

    def _start(self) -> str:
        return f"{self._begin_run()} samples"

    def _stop(self) -> str:
        if self._asked_for is not None:
            self._asked_for = None
            return "stopped"
        if self._run is None:
            raise DfmError("nothing is running")
        self._end("abort", "stopped", asked_for=True)
        return "stopped"

    def _end(self, how: str, message: str = "", asked_for: bool = False) -> None:
        run, self._run = self._run, None
        if run is None:
            return
        self.count("experiments")
        if how == "succeed" and (message := self._complaint(run)):
            how = "abort"
        self._said = self._description(run)
        self._said["run"] |= {"success": how == "succeed", "message": message}
        self.publish_config()
        if how == "abort":
            self.get_logger().warning(f"{run.name} is over: {message}")
            if not asked_for:
                self.warnings_active["run"] = f"{run.name} is over: {message}"
        if run.goal is not None:
            self._conclude(run.goal, how, message, run)

    # What comes of a run

    def _on_output(self, data: bytes) -> None:
        """Note whether the amplifier's output is on; read only what is not said again."""
        self._output_heard_s = time.monotonic()
        if data != self._output_said:
            self._output_said, health = data, deserialize_message(data, DiagnosticStatus)
            self._output_off = "" if health.level == DiagnosticStatus.OK else str(health.message)
        if self._run is not None and self._run.first_seq is not None:
            self._run.outcome.output(self._output_off)
        self._answer_pending()

    def _follow(self, measurement: Any) -> None:
        """Compare a measurement with the reference; the first one after the run ends it."""
        run = self._run
        if run is None or run.first_seq is None:
            return
        index = (measurement.seq - run.first_seq) & 0xFFFFFFFF
        if index < run.count:
            run.outcome.measured(measurement.position, run.position[index])
        elif index < _BACKWARDS and (self.lockstep or self._output_was_on(run)):
            self._end("succeed")

    def _output_was_on(self, run: ActiveRun) -> bool:
        """Return whether it is known if the output was on to the end: an amplifier that was killed
        says no more."""
        if run.over_s is None:
            run.over_s = self._asked_s
        return (self._output_heard_s >= run.over_s or self._output_heard_s == -math.inf
                or self._asked_s - run.over_s > SILENT_S)

    def _look_for_output(self, run: ActiveRun) -> None:
        silent_s = self._asked_s - self._output_heard_s
        if SILENT_S < silent_s < math.inf:
            run.outcome.output(f"nothing is heard of the amplifier for {silent_s:.1f} s")

    def _complaint(self, run: ActiveRun) -> str:
        """Return why a run that came to its end does not count."""
        # an amplifier that is no node of ours does not say how it is
        if self._output_heard_s == -math.inf and not self.count_publishers("amplifier"):
            run.outcome.output("there is no amplifier")
        return run.outcome.complaint()

    # The loop

    def _on_measurement(self, measurement: Any) -> None:
        run = self._run
        if not self.lockstep:
            now = time.monotonic()
            gap, self._asked_s = now - self._asked_s, now
            if run is not None and run.done > 0:
                if gap > HELD_UP_S and run.done < run.count:
                    self.count("runs_held_up")
                    self._end("abort", f"no measurement for {gap:.2f} s in the middle of it")
                self._look_for_output(run)
        self._follow(measurement)
        if self.lockstep and measurement.seq != self._sent_seq:
            self._pending = measurement
            self._answer_pending()
        else:
            self._answer_ahead(measurement)

    def _answer_ahead(self, measurement: Any) -> None:
        """Send what is for the sample after this one."""
        self._answer((measurement.seq + 1) & 0xFFFFFFFF,
                     measurement.stamp_ns + round(self.settings[SAMPLE_PERIOD.name] * 1e9))

    def _answer(self, seq: int, stamp_ns: int) -> None:
        run = self._run
        if run is None:
            if not self.lockstep:
                self._reference.send(stamp_ns, seq, self._hold, 0.0, 0.0)
                self._excitation.send(stamp_ns, seq, 0.0)
            return
        if run.first_seq is None:
            run.first_seq = seq
            run.outcome.output(self._output_off)
            self.publish_config()
        index = (seq - run.first_seq) & 0xFFFFFFFF
        if index >= _BACKWARDS:
            self.count("source_restarts")
            self._end("abort", "the measurements started anew in the middle of it")
            return
        if index < run.count:
            run.done, self._sent_seq = index + 1, seq
            self._hold = run.position[index]
            self._reference.send(stamp_ns, seq, run.position[index], run.velocity[index],
                                 run.acceleration[index])
            self._excitation.send(stamp_ns, seq, run.voltage[index])
            if run.cancelled:
                self._end("canceled", "cancelled")
                return
            if (index == run.count - 1 and self.settings["repeat"] and not self.lockstep
                    and run.goal is None):
                run.first_seq = (seq + 1) & 0xFFFFFFFF
        elif not self.lockstep:
            self._reference.send(stamp_ns, seq, self._hold, 0.0, 0.0)
            self._excitation.send(stamp_ns, seq, 0.0)

    def _report(self) -> None:
        run = self._run
        if run is not None and run.goal is not None:
            period = self.settings[SAMPLE_PERIOD.name]
            run.goal.publish_feedback(RunExperiment.Feedback(
                elapsed=run.done * period, duration=run.count * period))

    def _on_diagnostics(self, data: bytes) -> None:
        if b"/recorder\0" in data:
            self._recorder_heard_s = time.monotonic()

    def each_second(self) -> Iterator[None]:
        """Look whether the recorder is still there."""
        if self._waits_for_recorder and self.links_open and math.isinf(self._recorder_heard_s):
            self._recorder_heard_s = time.monotonic()  # it was there: it may die unheard
        silent = time.monotonic() - self._recorder_heard_s
        self.warnings_active.put("recorder", "" if silent <= RECORDER_SILENT_S else
                                 f"nothing is heard of the recorder for {silent:.0f} s: this is "
                                 "not recorded")
        yield
        yield from super().each_second()

    def destroy_node(self) -> None:
        """End the action, which keeps the participant, then the node."""
        self._action.destroy()
        super().destroy_node()

    def not_ready(self) -> str | None:
        """Measurements must be on their way."""
        return None if self.count_publishers("measurement") else "no encoder_driver"


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(TrajectoryGenerator, args)
