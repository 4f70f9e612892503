"""Bring up a set of nodes from Python, run experiments on it, get the record, leave nothing.

>>> with StageGraph(model="paper_stage", lockstep=True, composed=True, bag="bags/a") as graph:
...     graph.run("multisine")
>>> record = graph.record()

`composed=True` puts every node into the calling process, on one executor that `run` spins;
otherwise each node is a process of its own. Every graph has a ROS domain of its own, unless one is
given, so two at once do not see each other. Nodes are waited for by asking them, not by sleeping.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.parameter import Parameter as RosParameter
from std_srvs.srv import Trigger

from dfm_interfaces.action import RunExperiment
from dfm_interfaces.srv import Ready
from dfm_stage.control.parameter_file import FIXED, read_parameters
from dfm_stage.domain import claim_domain
from dfm_stage.errors import DfmError
from dfm_stage.nodes.base import StopRequest, make_executor, quiet_collector
from dfm_stage.nodes.share import find_experiment
from dfm_stage.nodes.wire import codec
from dfm_stage.nodes.wiring import LINKS, LOCKSTEP_QOS, PUBLISHER_QOS
from dfm_stage.trajectory import Experiment, load_experiment

if TYPE_CHECKING:
    from dfm_stage.recording import Record

__all__ = ["AXIS_NODES", "STAGE_NODES", "HarnessError", "RunResult", "StageGraph",
           "find_experiment"]

AXIS_NODES = ("encoder_driver", "amplifier_driver", "controller", "trajectory_generator")
STAGE_NODES = ("sim_plant", "recorder")
_PR_SET_PDEATHSIG = 1
SIMULATED_STALE_S = 0.2
REARM_S = 3.0


class HarnessError(DfmError):
    """A node set did not come up, an experiment did not finish, or a node died."""


@dataclass(frozen=True)
class RunResult:
    """Where one axis's experiment stands in the record: sequence numbers of its samples."""

    first_seq: int
    last_seq: int


@dataclass
class _Launched:
    kind: str
    namespace: str
    node: Any = None
    process: subprocess.Popen[bytes] | None = None
    log: Path | None = None

    @property
    def full_name(self) -> str:
        return f"{self.namespace}/{self.kind}"


class StageGraph:
    """A running node set.

    Parameters
    ----------
    axes : sequence of str
        One or more axis names; each gets the four nodes of the loop in `/stage/<axis>`.
    model : str
        model.yaml the plant runs: a path or a name in config/models.
    lockstep, composed : bool
        Deterministic instead of paced by the clock; in this process instead of one each.
    bag : path, optional
        Folder of the new bag; without it nothing is recorded.
    parameters : mapping, optional
        Per node kind, further ROS parameters: `{"controller": {"kp": 2000.0}}`.
    nodes : sequence of str, optional
        Only these kinds, for instance without the controller.
    domain_id : int, optional
        A ROS domain to join instead of one's own.
    start_timeout_s : float
        How long the set may take to come up.

    Raises
    ------
    HarnessError
        On entering, if a node does not come up; the message names it and its own last words.
    """

    def __init__(self, *, axes: Sequence[str] = ("x",), model: str = "paper_stage",
                 lockstep: bool = False, composed: bool = False,
                 bag: str | os.PathLike[str] | None = None,
                 parameters: Mapping[str, Mapping[str, Any]] | None = None,
                 nodes: Sequence[str] | None = None, seed: int = 0,
                 domain_id: int | None = None, start_timeout_s: float = 30.0) -> None:
        self.axes = tuple(axes)
        self.lockstep = lockstep
        self.composed = composed
        self.bag = Path(bag) if bag is not None else None
        kinds = tuple(nodes) if nodes is not None else (*STAGE_NODES, *AXIS_NODES)
        self._kinds = [kind for kind in kinds if kind != "recorder" or self.bag is not None]
        self._parameters = self._node_parameters(model, seed, parameters or {})
        self._domain_id = domain_id
        self._start_timeout_s = start_timeout_s
        self._launched: list[_Launched] = []
        self._complaints: dict[str, str] = {}
        self._context: Any = None
        self._executor: Any = None
        self._client_node: Any = None
        self._goals: dict[str, Any] = {}
        self._closing = False
        self._cleanup = contextlib.ExitStack()

    def _node_parameters(self, model: str, seed: int,
                         extra: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
        common = {"lockstep": self.lockstep, "wait_for_recorder": "recorder" in self._kinds}
        out: dict[str, dict[str, Any]] = {kind: dict(common) for kind in self._kinds}
        if "recorder" in out:
            out["recorder"] |= {"bag": str(self.bag), "wait_for_recorder": False}
        if "sim_plant" in out:
            out["sim_plant"] |= {"model": model, "axes": " ".join(self.axes), "seed": seed}
        if "trajectory_generator" in out:
            out["trajectory_generator"]["autostart"] = False
        if "amplifier_driver" in out and "device" not in extra.get("amplifier_driver", {}):
            # a machine that stands still for a moment does a simulated coil no harm
            out["amplifier_driver"]["stale_timeout_s"] = SIMULATED_STALE_S
        for kind, values in extra.items():
            if kind not in out:
                raise HarnessError(f"parameters for {kind}, which is not among the nodes: "
                                   f"{', '.join(out)}")
            out[kind] |= values
        return out

    # Coming up

    def __enter__(self) -> StageGraph:
        try:
            self._bring_up()
        except BaseException:
            self.close()
            raise
        return self

    def _bring_up(self) -> None:
        if self._domain_id is None:
            self._domain_id = self._cleanup.enter_context(claim_domain()).number
        folder = Path(self._cleanup.enter_context(
            tempfile.TemporaryDirectory(prefix="dfm_stage_")))
        self._folder = folder
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=self._domain_id, args=[])
        self._cleanup.callback(self._context.try_shutdown)
        self._executor = make_executor(self._context)
        self._client_node = rclpy.create_node(
            "harness", namespace="/stage", context=self._context, use_global_arguments=False,
            start_parameter_services=False, enable_rosout=False)
        self._client_node.create_subscription(DiagnosticArray, "/diagnostics",
                                              self._on_diagnostics, 50)
        self._executor.add_node(self._client_node)
        self._cleanup.callback(self._client_node.destroy_node)
        self._cleanup.callback(self._end_nodes)
        atexit.register(self.close)
        if "sim_plant" in self._kinds and not self.composed:
            compile_simulator()
        order = ["recorder", "sim_plant", *AXIS_NODES]
        for kind in sorted(self._kinds, key=order.index):
            namespaces = ["/stage"] if kind in STAGE_NODES else [
                f"/stage/{axis}" for axis in self.axes]
            for namespace in namespaces:
                self._launch(kind, namespace)
        self._goals = {axis: ActionClient(self._client_node, RunExperiment,
                                          f"/stage/{axis}/trajectory_generator/run_experiment")
                       for axis in self.axes if "trajectory_generator" in self._kinds}
        for client in self._goals.values():
            self._cleanup.callback(client.destroy)
        self._wait_ready()
        if self.composed:
            quiet_collector()

    def _launch(self, kind: str, namespace: str) -> None:
        launched = _Launched(kind, namespace)
        file = self._folder / f"{launched.full_name.strip('/').replace('/', '_')}.yaml"
        file.write_text(json.dumps(
            {launched.full_name: {"ros__parameters": self._parameters[kind]}}))
        ros_args = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(file)]
        if self.composed:
            module = importlib.import_module(f"dfm_stage.nodes.{kind}")
            make = getattr(module, "".join(part.capitalize() for part in kind.split("_")))
            launched.node = make(context=self._context, cli_args=ros_args)
            self._launched.append(launched)
            self._executor.add_node(launched.node)
            return
        launched.log = file.with_suffix(".log")
        with launched.log.open("wb") as log:
            launched.process = subprocess.Popen(
                [sys.executable, "-m", "dfm_stage", kind, *ros_args], stdin=subprocess.DEVNULL,
                stdout=log, stderr=log, start_new_session=True,
                preexec_fn=_die_with_parent,  # noqa: PLW1509 nothing but a system call
                env={**os.environ, "ROS_DOMAIN_ID": str(self._domain_id)})
        self._launched.append(launched)

    def _wait_ready(self) -> None:
        deadline = time.monotonic() + self._start_timeout_s
        self._wait_connected(deadline)
        for axis, client in self._goals.items():
            self.spin_until(client.server_is_ready, deadline - time.monotonic(),
                            f"the action server of /stage/{axis}/trajectory_generator")

    def _wait_connected(self, deadline: float) -> None:
        everyone = [each.full_name for each in self._launched]
        by_wire = [name for name in everyone if self._on_hardware(name.rpartition("/")[2])]
        for launched in self._launched:
            names = everyone
            if launched.kind == "sim_plant":
                names = [name for name in everyone if name not in by_wire]
            reason = "it does not answer"
            while True:
                answer = self._call(Ready, f"{launched.full_name}/ready",
                                    Ready.Request(nodes=names), deadline)
                if answer is not None and answer.ready:
                    break
                reason = answer.message if answer is not None else reason
                if time.monotonic() > deadline:
                    raise HarnessError(f"{launched.full_name} is not ready: {reason}")

    def _on_hardware(self, kind: str) -> bool:
        return bool(self._parameters.get(kind, {}).get("device", "sim") != "sim")

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self._complaints[status.name] = "" if status.level == b"\x00" else status.message

    # Spinning and calling

    def spin_until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> None:
        """Spin until `condition` holds.

        Raises
        ------
        HarnessError
            After `timeout_s`, naming `what` was waited for, or when a node died meanwhile.
        """
        deadline = time.monotonic() + timeout_s
        checked = 0.0
        with StopRequest() as interrupted:
            while not condition():
                self._executor.spin_once(timeout_sec=0.01)
                now = time.monotonic()
                if now - checked > 0.1:
                    checked = now
                    if interrupted:
                        break
                    self._check_alive()
                    if now > deadline:
                        said = "".join(f"; {name} says: {text}"
                                       for name, text in self._complaints.items() if text)
                        raise HarnessError(f"{what}: not there after {timeout_s:.3g} s{said}")
        if interrupted and not self._closing:
            raise KeyboardInterrupt

    def spin(self, duration_s: float) -> None:
        """Let the graph run for a time (composed nodes only run while something spins)."""
        end = time.monotonic() + duration_s
        self.spin_until(lambda: time.monotonic() >= end, duration_s + 60.0, "the end of spin()")

    def _check_alive(self) -> None:
        for launched in self._launched:
            if launched.process is not None and launched.process.poll() is not None:
                raise HarnessError(f"{launched.full_name} ended with code "
                                   f"{launched.process.returncode}: {self.last_words(launched)}")

    @staticmethod
    def last_words(launched: _Launched) -> str:
        """Return the last line a node process wrote."""
        lines = launched.log.read_text(errors="replace").split("\n") if launched.log else []
        lines = [line.strip() for line in lines if line.strip()]
        return lines[-1] if lines else "it said nothing"

    def _call(self, kind: Any, name: str, request: Any, deadline: float) -> Any:
        """Call a service; None when it does not answer in a second or by the deadline."""
        client = self._client_node.create_client(kind, name)
        try:
            self.spin_until(client.service_is_ready, deadline - time.monotonic() + 1.0,
                            f"service {name}")
            future = client.call_async(request)
            with contextlib.suppress(HarnessError):
                self.spin_until(future.done, 1.0, name)
            self._check_alive()
            return future.result() if future.done() else None
        finally:
            self._client_node.destroy_client(client)

    def call(self, kind: Any, name: str, request: Any, timeout_s: float = 5.0) -> Any:
        """Call a service of a node and return the response.

        Raises
        ------
        HarnessError
            If it does not answer in time.
        """
        deadline = time.monotonic() + timeout_s
        while time.monotonic() < deadline:
            answer = self._call(kind, name, request, deadline)
            if answer is not None:
                return answer
        raise HarnessError(f"service {name} does not answer within {timeout_s:g} s")

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a running node, all or none.

        Raises
        ------
        HarnessError
            With the node's reason if it refuses.
        """
        request = SetParametersAtomically.Request(parameters=[
            RosParameter(name, value=value).to_parameter_msg() for name, value in values.items()])
        result = self.call(SetParametersAtomically, f"{node}/set_parameters_atomically",
                           request).result
        if not result.successful:
            names = ", ".join(values)
            if "undeclared" in result.reason:
                raise HarnessError(f"{node} lacks one of the parameters {names}")
            raise HarnessError(f"{node}: {result.reason} (setting {names})")

    # Running

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
            If it is refused, fails, or does not end in time.
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
        handles = {}
        for axis, future in futures.items():
            self.spin_until(future.done, deadline - time.monotonic(), f"{axis}: acceptance")
            handles[axis] = future.result().get_result_async()
        for axis, future in handles.items():
            self.spin_until(future.done, deadline - time.monotonic(),
                            f"the end of {loaded.name!r} on axis {axis}")
            result = future.result().result
            if not result.success:
                raise HarnessError(f"{loaded.name} on axis {axis}: {result.message}")
            results[axis] = RunResult(result.first_seq, result.last_seq)
        if progress is not None:
            progress(1.0)
        return results

    def _rearm(self, axis: str) -> None:
        """In simulation, what an earlier run left latched does not spoil the next."""
        if "amplifier_driver" not in self._kinds or self._on_hardware("amplifier_driver"):
            return
        node = f"/stage/{axis}/amplifier_driver"
        answer = self.call(Trigger, f"{node}/clear", Trigger.Request())
        deadline = time.monotonic() + REARM_S
        while answer.message.startswith("cleared"):
            armed = self.call(Trigger, f"{node}/arm", Trigger.Request())
            if armed.success:
                return
            if time.monotonic() > deadline:
                raise HarnessError(f"{node} cannot be armed again: {armed.message}")

    def _set_controller(self, experiment: Experiment, axis: str) -> None:
        """Set what the experiment asks of the controller, from its mapping or parameter file."""
        values: dict[str, Any] = {}
        if isinstance(experiment.controller, Mapping):
            values = dict(experiment.controller)
        elif experiment.controller:
            values = read_parameters(experiment.controller, axis)
            if not values:
                raise HarnessError(f"{experiment.controller}: this parameter file has nothing for "
                                   f"/stage/{axis}/controller")
            ahead = read_parameters(experiment.controller, axis, "trajectory_generator")
            if ahead:
                self.set_parameters(f"/stage/{axis}/trajectory_generator", ahead)
        values = {name: value for name, value in values.items() if name not in FIXED}
        self.set_parameters(f"/stage/{axis}/controller", {**values, "mode": experiment.mode})

    def listen(self, axis: str, topic: str) -> list[Any]:
        """Return a list that every message of a loop topic is put into from now on, decoded.

        `topic` is a name in `dfm_stage.nodes.wiring.LINKS`, such as `measurement`.
        """
        link, heard = LINKS[topic], []
        decode = codec(link.type).decode
        subscription = self._client_node.create_subscription(
            link.type, f"/stage/{axis}/{topic}", lambda data: heard.append(decode(data)),
            LOCKSTEP_QOS if self.lockstep else PUBLISHER_QOS, raw=True)
        self.spin_until(lambda: subscription.get_publisher_count() > 0,
                        self._start_timeout_s, f"a publisher of {topic}")
        return heard

    def _experiment(self, given: Any) -> tuple[Path, Experiment]:
        if isinstance(given, Experiment):
            if not given.source:
                raise HarnessError(f"experiment {given.name!r} has no file; pass its mapping")
            return Path(given.source), given
        if isinstance(given, Mapping):
            loaded = load_experiment(given)
            path = self._folder / f"experiment_{time.monotonic_ns()}.yaml"
            path.write_text(json.dumps(given))
            return path, loaded
        path = find_experiment(os.fspath(given)).resolve()
        return path, load_experiment(path)

    def cpu_seconds(self) -> float:
        """Return the processor time that the node processes have used so far, s."""
        ticks = 0
        for launched in self._launched:
            if launched.process is not None:
                stat = Path(f"/proc/{launched.process.pid}/stat").read_text()
                ticks += sum(map(int, stat.rpartition(")")[2].split()[11:13]))
        return ticks / os.sysconf("SC_CLK_TCK")

    # Going down

    def close(self) -> None:
        """Close the bag, end every node and give everything back. Safe to call twice."""
        atexit.unregister(self.close)
        with StopRequest():
            self._closing = True
            self._cleanup.close()
            self._let_go()

    def _let_go(self) -> None:
        """Drop every handle: only then does the middleware end the participant's threads."""
        context, self._context = self._context, None
        if context is None:
            return
        self._executor = self._client_node = None
        self._goals = {}
        gc.unfreeze()
        gc.collect()
        context.destroy()

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None,
                 traceback: TracebackType | None) -> None:
        self.close()

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

    def _end_nodes(self) -> None:
        if any(each.kind == "recorder" for each in self._launched):
            with contextlib.suppress(HarnessError):
                self.stop_recording()
        for launched in self._launched:
            if launched.node is not None:
                self._executor.remove_node(launched.node)
                launched.node.destroy_node()
            if launched.process is not None and launched.process.poll() is None:
                launched.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + 5.0
        for launched in self._launched:
            if launched.process is not None:
                try:
                    launched.process.wait(max(0.05, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    launched.process.kill()
                    launched.process.wait()
        self._launched.clear()

    def record(self, axis: str | None = None) -> Record:
        """Return the record of the bag, which must be closed (after the `with` block).

        Raises
        ------
        DfmError
            If nothing was recorded or the bag cannot be read.
        """
        from dfm_stage.recording import read_record

        if self.bag is None:
            raise HarnessError("nothing was recorded: give StageGraph a bag folder")
        return read_record(self.bag, axis=axis)


def compile_simulator() -> None:
    """Have all compiled code made and kept on disk, which takes half a minute the first time.

    A sim_plant started afterwards is there in a second or two.
    """
    from dfm_stage.compile_all import compile_all

    compile_all()


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
