"""The stage's own node set: its parameters, experiments on it, and the record of them."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from dfm_interfaces.action import RunExperiment
from dfm_stage.control.parameter_file import FIXED, read_parameters
from dfm_stage.harness.node_set import HarnessError, NodeSet, RunFailedError
from dfm_stage.harness.taps import Taps
from dfm_stage.middleware.hand_over import Receiver
from dfm_stage.middleware.wire import codec
from dfm_stage.model import load_model
from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.sample_period import SAMPLE_PERIOD
from dfm_stage.nodes.sim_plant import SEEDS_APART
from dfm_stage.nodes.wiring import LINKS, LOCKSTEP_QOS, LOSSY_QOS, PUBLISHER_QOS
from dfm_stage.recording import Record, read_record
from dfm_stage.share import find_experiment
from dfm_stage.trajectory import Experiment, load_experiment

LAYOUTS = ("processes", "per_axis", "composed")
SAMPLING = ("sim_plant", "controller", "trajectory_generator")
AXIS_NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator")
STAGE_NODES = ("sim_plant", "recorder")
START_ORDER = ("recorder", "sim_plant", *AXIS_NODES)
SIMULATED_STALE_S = 0.2
SIMULATED_WATCHDOG_S = 0.5
REARM_S = 3.0
Node = tuple[str, str, Mapping[str, Any]]
"""Kind, namespace, parameters."""


@dataclass(frozen=True)
class RunResult:
    """Where one axis's experiment stands in the record: sequence numbers of its samples."""

    first_seq: int
    last_seq: int


class StageGraph(NodeSet):
    """A running stage; a context manager.

    Parameters
    ----------
    axes : sequence of str
        One or more axis names; each gets the four nodes of the loop in `/stage/<axis>`.
    model : str
        model.yaml the plant runs: a path or a name in config/models.
    lockstep : bool
        Deterministic instead of paced by the clock.
    layout : str
        `processes`: one for each node. `per_axis`: one for the nodes of each axis, and one for
        the recorder. `composed`: all nodes in this process. In `per_axis` each axis has a plant
        of its own, `/stage/<axis>/sim_plant`; where the model couples axes, or lockstep gives
        them one clock, `/stage/sim_plant` is in the process of the first.
    composed : bool
        The same as layout="composed".
    bag : path, optional
        Folder of the new bag; without it nothing is recorded.
    parameters : mapping, optional
        Per node kind, further ROS parameters: `{"controller": {"kp": 2000.0}}`.
    nodes : sequence of str, optional
        Only these kinds, for instance without the controller.
    sample_period_s : float, optional
        Sampling period that every node gets; by default that of the model.
    domain_id : int, optional
        A ROS domain to join instead of one's own.
    start_timeout_s : float
        How long the set may take to come up.

    Raises
    ------
    HarnessError
        If there is no such layout; on entering, if a node does not come up: the message names
        it and its own last words.
    """

    def __init__(self, *, axes: Sequence[str] = ("x",), model: str = "paper_stage",
                 lockstep: bool = False, composed: bool = False, layout: str = "processes",
                 bag: str | os.PathLike[str] | None = None,
                 parameters: Mapping[str, Mapping[str, Any]] | None = None,
                 nodes: Sequence[str] | None = None, seed: int = 0,
                 domain_id: int | None = None, start_timeout_s: float = 60.0,
                 sample_period_s: float | None = None) -> None:
        if layout not in LAYOUTS:
            raise HarnessError(f"layout {layout!r}: choose one of {', '.join(LAYOUTS)}")
        super().__init__(composed or layout == "composed", domain_id, start_timeout_s)
        self._per_axis = layout == "per_axis" and not composed
        self.axes = tuple(axes)
        self.lockstep = lockstep
        self.bag = Path(bag) if bag is not None else None
        kinds = tuple(nodes) if nodes is not None else (*STAGE_NODES, *AXIS_NODES)
        self._kinds = [kind for kind in kinds if kind != "recorder" or self.bag is not None]
        self._sample_period_s = sample_period_s
        self._parameters = self._node_parameters(model, seed, parameters or {})
        self._goals: dict[str, Any] = {}
        self._taps: Taps | None = None

    def _node_parameters(self, model: str, seed: int,
                         extra: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        out: dict[str, dict[str, Any]] = {
            kind: {"lockstep": self.lockstep, "wait_for_recorder": "recorder" in self._kinds}
            for kind in self._kinds}
        if "recorder" in out:
            out["recorder"] |= {"bag": str(self.bag), "wait_for_recorder": False}
        if "sim_plant" in out:
            out["sim_plant"] |= {"model": model, "axes": " ".join(self.axes), "seed": seed}
        if "trajectory_generator" in out:
            out["trajectory_generator"]["autostart"] = False
        if "amplifier_driver" in out and "device" not in extra.get("amplifier_driver", {}):
            # a machine that stands still for a moment does a simulated coil no harm
            out["amplifier_driver"]["stale_timeout_s"] = SIMULATED_STALE_S
            if "sim_plant" in out:
                out["sim_plant"]["drive_watchdog_s"] = SIMULATED_WATCHDOG_S
        for kind, values in extra.items():
            if kind not in out:
                raise HarnessError(f"parameters for {kind}, which is not among the nodes: "
                                   f"{', '.join(out)}")
            out[kind] |= values
        return out

    def __enter__(self) -> StageGraph:
        self.bring_up()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start_nodes(self) -> None:
        """Launch the nodes and wait until they have met and experiments can be asked for."""
        if "sim_plant" in self._kinds:  # before the recorder has a bag
            model = load_model(self._parameters["sim_plant"]["model"])
            self._sample_period_s = self._sample_period_s or model.sample_period
        for kind in self._kinds:
            self._parameters[kind] = {**self._sampling(kind), **self._parameters[kind]}
        deadline = time.monotonic() + self._start_timeout_s
        nodes = [(kind, namespace, self._parameters[kind])
                 for kind in sorted(self._kinds, key=START_ORDER.index)
                 for namespace in (["/stage"] if kind in STAGE_NODES else [
                     f"/stage/{axis}" for axis in self.axes])]
        if self._per_axis:
            for group in self._by_axis(nodes):
                self.launch_together(group)
        else:
            for node in nodes:
                self.launch(*node)
        self._goals = {axis: ActionClient(self._client_node, RunExperiment,
                                          f"/stage/{axis}/trajectory_generator/run_experiment")
                       for axis in self.axes if "trajectory_generator" in self._kinds}
        self._wait_connected(deadline)
        for axis, client in self._goals.items():
            self.spin_until(client.server_is_ready, deadline - time.monotonic(),
                            f"the action server of /stage/{axis}/trajectory_generator")

    def _by_axis(self, nodes: Sequence[Node]) -> list[list[Node]]:
        """Return the nodes of each process; where axes need no common plant, with one each."""
        groups: dict[str, list[Node]] = {f"/stage/{axis}": [] for axis in self.axes}
        alone: list[list[Node]] = []
        for kind, namespace, parameters in nodes:
            if kind == "recorder":
                alone.append([(kind, namespace, parameters)])
            elif kind != "sim_plant":
                groups[namespace].append((kind, namespace, parameters))
            elif len(self.axes) == 1 or self.lockstep or load_model(
                    parameters["model"]).axis_names:
                groups[f"/stage/{self.axes[0]}"].append((kind, namespace, parameters))
            else:
                for index, (own, group) in enumerate(groups.items()):
                    group.append((kind, own, {
                        **parameters, "axes": "",
                        "seed": parameters["seed"] + SEEDS_APART * index}))
        return [*alone, *filter(None, groups.values())]

    def add(self, make: type[LoopNode], axis: str = "x",
            parameters: Mapping[str, Any] | None = None) -> Any:
        """Add a node of one's own to the running graph, in this process, and return it.

        Parameters
        ----------
        make : subclass of LoopNode
            Its `kind` is the node's name.
        axis : str
            Whose namespace it lives in.
        parameters : mapping, optional
            ROS parameters, besides `lockstep`, `wait_for_recorder` and `sample_period_s`, which
            are the graph's.
        """
        return self.launch(make.kind, f"/stage/{axis}", {
            "lockstep": self.lockstep, "wait_for_recorder": "recorder" in self._kinds,
            **self._sampling("controller"), **(parameters or {})}, make).node

    def _sampling(self, kind: str) -> dict[str, float]:
        """Return the one sampling period for a kind of node that has one."""
        if kind not in SAMPLING or self._sample_period_s is None:
            return {}
        if kind == "sim_plant" and self._on_hardware("encoder_driver"):
            return {}  # a counter samples by its own clock
        return {SAMPLE_PERIOD.name: self._sample_period_s}

    def _wait_connected(self, deadline: float) -> None:
        by_wire = [kind for kind in self._kinds if self._on_hardware(kind)]
        self.wait_connected({"sim_plant": by_wire}, deadline)

    def restart_node(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a node that `signal_node` ended again, and wait until it is connected.

        `parameters` are set besides those it had; a recorder needs a new `bag`.

        Raises
        ------
        HarnessError
            If the node still runs, or does not come up.
        """
        self.launch_again(name, parameters)
        started = self.launched[-1]
        if started.kind == "recorder":
            self.bag = Path(started.parameters["bag"])
        self._wait_connected(time.monotonic() + self._start_timeout_s)

    def before_end(self) -> None:
        """Close the bag."""
        if any(each.kind == "recorder" and not each.ended for each in self.launched):
            with contextlib.suppress(HarnessError):
                self.stop_recording()
        for client in self._goals.values():
            client.destroy()
        self._goals = {}
        if self._taps is not None:
            self._taps.close()
            self._taps = None

    def _on_hardware(self, kind: str) -> bool:
        return bool(self._parameters.get(kind, {}).get("device", "sim") != "sim")

    def run(self, experiment: str | os.PathLike[str] | Mapping[str, Any] | Experiment, *,
            timeout_s: float | None = None,
            progress: Callable[[float], None] | None = None) -> dict[str, RunResult]:
        """Run one experiment on every axis it names and wait for its end.

        Parameters
        ----------
        experiment : name, path, mapping or Experiment
            A name in config/experiments, a YAML file, or the same content as a mapping.
        timeout_s : float, optional
            Wall time it may take; by default ten times its duration plus a minute.
        progress : callable, optional
            Called with the fraction done.

        Raises
        ------
        HarnessError
            If it is refused, or does not end in time.
        RunFailedError
            If it ran without success: the output was off, the reference not followed.
        """
        source, loaded = self._experiment(experiment)
        for axis in loaded.axes:
            if axis not in self._goals:
                raise HarnessError(f"experiment {loaded.name!r} wants axis {axis}, the graph has "
                                   f"{', '.join(self._goals)}")
            if "controller" in self._kinds:
                self._set_controller(loaded, axis)
            self._rearm(axis)
        limit = timeout_s or 60.0 + 10.0 * loaded.duration_s
        done = dict.fromkeys(loaded.axes, 0.0)

        def feedback(axis: str) -> Callable[[Any], None]:
            def update(message: Any) -> None:
                done[axis] = message.feedback.elapsed / message.feedback.duration
                if progress is not None:
                    progress(min(done.values()))
            return update

        futures = {axis: self._goals[axis].send_goal_async(
            RunExperiment.Goal(experiment=str(source)), feedback_callback=feedback(axis))
            for axis in loaded.axes}
        results = {}
        deadline = time.monotonic() + limit
        for axis, future in futures.items():
            self.spin_until(future.done, deadline - time.monotonic(), f"{axis}: acceptance")
            futures[axis] = future.result().get_result_async()
        for axis, future in futures.items():
            self.spin_until(future.done, deadline - time.monotonic(),
                            f"the end of {loaded.name!r} on axis {axis}")
            result = future.result().result
            if not result.success:
                ran = result.last_seq != result.first_seq
                raise (RunFailedError if ran else HarnessError)(
                    f"{loaded.name} on axis {axis}: {result.message}")
            results[axis] = RunResult(result.first_seq, result.last_seq)
        if progress is not None:
            progress(1.0)
        return results

    def _rearm(self, axis: str) -> None:
        """Arm a simulated output that arms by itself: what an earlier run left latched is over."""
        settings = self._parameters.get("amplifier_driver", {"autoarm": False})
        if self._on_hardware("amplifier_driver") or not (
                settings.get("autoarm", True) and settings.get("autostart", True)):
            return
        node = f"/stage/{axis}/amplifier_driver"
        deadline = time.monotonic() + REARM_S
        while not (armed := self.call(Trigger, f"{node}/arm", Trigger.Request())).success:
            if time.monotonic() > deadline:
                raise HarnessError(f"{node} cannot be armed: {armed.message}")
            self.call(Trigger, f"{node}/clear", Trigger.Request())

    def _set_controller(self, experiment: Experiment, axis: str) -> None:
        """Set what the experiment asks of the controller, from its mapping or parameter file."""
        values: dict[str, Any] = {}
        if isinstance(experiment.controller, Mapping):
            values = dict(experiment.controller)
        elif experiment.controller:
            if not (values := read_parameters(experiment.controller, axis)):
                raise HarnessError(f"{experiment.controller}: this parameter file has nothing for "
                                   f"/stage/{axis}/controller")
            if ahead := read_parameters(experiment.controller, axis, "trajectory_generator"):
                self.set_parameters(f"/stage/{axis}/trajectory_generator", ahead)
        self.set_parameters(f"/stage/{axis}/controller", {
            **{name: value for name, value in values.items() if name not in FIXED},
            "mode": experiment.mode})

    def listen(self, axis: str, topic: str, lossy: bool = False) -> list[Any]:
        """Return a list that every message of a loop topic is put into from now on, decoded.

        `topic` is a name in `dfm_stage.nodes.wiring.LINKS`, such as `measurement`. With `lossy`
        it listens best effort, and fetches what came every few milliseconds: where this process
        is too slow it misses messages, instead of having the node send them again; not in
        lockstep, where every sample counts.
        """
        link, heard = LINKS[topic], []
        qos = LOCKSTEP_QOS if self.lockstep else LOSSY_QOS if lossy else PUBLISHER_QOS
        decode = codec(link.type).decode
        name = f"/stage/{axis}/{topic}"
        ears = (self._lossy().add(link.type, name, lambda data: heard.append(decode(data)), qos)
                if lossy and not self.lockstep else
                Receiver(self._client_node, link.type, name, heard.append, qos, decode=decode))
        self.spin_until(lambda: ears.ros.get_publisher_count() > 0,
                        self._start_timeout_s, f"a publisher of {topic}")
        return heard

    def _lossy(self) -> Taps:
        if self._taps is None:
            self._taps = Taps(self._client_node)
        return self._taps

    def _experiment(self, given: Any) -> tuple[Path, Experiment]:
        if isinstance(given, Experiment):
            if not given.source:
                raise HarnessError(f"experiment {given.name!r} has no file; pass its mapping")
            return Path(given.source), given
        if isinstance(given, Mapping):
            loaded = load_experiment(given)
            path = self.folder / f"experiment_{time.monotonic_ns()}.yaml"
            path.write_text(json.dumps(given))
            return path, loaded
        path = find_experiment(os.fspath(given)).resolve()
        return path, load_experiment(path)

    def stop_recording(self, timeout_s: float = 20.0) -> str:
        """Close the bag and return what the recorder says of it.

        In lockstep everything that was published is in it.

        Raises
        ------
        HarnessError
            If the bag is not complete or the recorder does not answer.
        """
        deadline = time.monotonic() + timeout_s
        if self.lockstep:
            self._wait_connected(deadline)
        answer = self.call(Trigger, "/stage/recorder/stop", Trigger.Request(), timeout_s)
        if not answer.success:
            raise HarnessError(f"recorder: {answer.message}")
        return str(answer.message)

    def record(self, axis: str | None = None) -> Record:
        """Return the record of the bag, which must be closed (after the `with` block).

        Raises
        ------
        DfmError
            If nothing was recorded or the bag cannot be read.
        """
        if self.bag is None:
            raise HarnessError("nothing was recorded: give StageGraph a bag folder")
        return read_record(self.bag, axis=axis)
