"""A set of nodes: brought up, waited for, spun, called, and ended without a trace."""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import json
import os
import signal
import subprocess
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter as RosParameter
from rclpy.serialization import deserialize_message

from dfm_interfaces.srv import Ready
from dfm_stage.errors import CheckFailedError, DfmError
from dfm_stage.harness.domain import claim_domain
from dfm_stage.harness.fork_server import SEVERAL, NodeProcess, shared_fork_server
from dfm_stage.middleware.discovery import loopback_alone
from dfm_stage.middleware.hand_over import handing_over
from dfm_stage.middleware.security import (
    OPERATOR,
    OVERRIDE,
    WHOLE_STAGE,
    enclave_for,
    require_what_was_asked,
)
from dfm_stage.middleware.shared_memory import PORT_LOOK_S, PortWatch, take_back_notes
from dfm_stage.nodes.base import node_class
from dfm_stage.nodes.process import (
    StopRequest,
    helper_node,
    make_executor,
    refusals_told,
    steady_interpreter,
)

_ASK_AGAIN_S = 0.5
"""Nodes that lack each other meet at their next announcement (config/fastdds.xml)."""
_ASKED_BY_ONE = 12
"""Calls by one client, so 6 s: each further client is one more for the nodes to meet."""
_LOOK_AGAIN_S = 0.01
"""Nodes that are asked without a pause have no processor left to get ready."""
_ENDING_S = 10.0
_DIAGNOSTICS = 200
"""Messages of /diagnostics that are kept: each node sends one a second."""
_DEAF = ("; this process's own port in shared memory is gone (was another process killed?): it "
         "hears nobody any more, start it again")


class HarnessError(DfmError):
    """A node set did not come up, an experiment did not finish, or a node died."""


class RunFailedError(HarnessError, CheckFailedError):
    """An experiment ran, and ended without success."""


class NotInTimeError(HarnessError):
    """Something did not come in time, as happens where nodes meet on a busy machine."""


@dataclass
class Launched:
    """A node of the set: its object where the set is composed, else its process and its log."""

    kind: str
    namespace: str
    node: Any = None
    process: NodeProcess | None = None
    log: Path | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)
    ended: bool = False

    @property
    def full_name(self) -> str:
        return f"{self.namespace}/{self.kind}"


class NodeSet:
    """Nodes in processes of their own or, `composed`, all in this one.

    A subclass launches them in `start_nodes`; on the way out every one of them ends.

    Parameters
    ----------
    composed : bool
        All on one executor of this process, which only `spin`, `spin_until` and `call` spin.
    domain_id : int, optional
        A ROS domain to join instead of one's own.
    start_timeout_s : float
        How long the set may take to come up.
    """

    def __init__(self, composed: bool, domain_id: int | None, start_timeout_s: float) -> None:
        self.composed = composed
        self.launched: list[Launched] = []
        self._start_timeout_s = start_timeout_s
        self._domain_id = domain_id
        self._diagnostics: deque[bytes] = deque(maxlen=_DIAGNOSTICS)
        self._context: Any = None
        self._executor: Any = None
        self._client_node: Any = None
        self._clients: dict[str, Any] = {}
        self._closing = False
        self._own_ports: PortWatch | None = None
        self._looked = 0.0
        self._deaf = False
        self._cleanup = contextlib.ExitStack()
        self._ros_arguments = ["--ros-args", "--enclave", WHOLE_STAGE if composed else OPERATOR]

    @property
    def domain_id(self) -> int:
        """The set's ROS domain."""
        assert self._domain_id is not None  # noqa: S101 it is there once the set is up
        return self._domain_id

    def start_nodes(self) -> None:
        """Launch the nodes and wait until they are ready."""
        raise NotImplementedError

    def before_end(self) -> None:
        """Do what has to be done while the nodes are still there."""

    def bring_up(self) -> None:
        """Start the nodes; when that fails nothing is left of them."""
        try:
            self._open()
            if self.composed:
                gc.collect()  # before nodes run: it may take half a second
                steady_interpreter()
            self.start_nodes()
            if self.composed:
                gc.freeze()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        if not self.composed:
            shared_fork_server().loaded()
        if self._domain_id is None:
            self._domain_id = self._cleanup.enter_context(claim_domain()).number
        self.folder = Path(self._cleanup.enter_context(
            tempfile.TemporaryDirectory(prefix="dfm_stage_")))
        require_what_was_asked(self._ros_arguments)
        # our participant leaves first: one that hears the others' endpoints go can lock up
        self._cleanup.callback(self._end_processes)
        self._context = rclpy.Context()
        with loopback_alone():
            rclpy.init(context=self._context, domain_id=self._domain_id, args=self._ros_arguments)
        self._cleanup.callback(self._let_go)
        self._cleanup.callback(self._context.try_shutdown)
        self._executor = make_executor(self._context)
        self._cleanup.enter_context(handing_over(self._context, self._executor))
        self._client_node = helper_node("harness", "/stage", self._context, self._ros_arguments)
        self._own_ports = PortWatch()
        self._client_node.create_subscription(DiagnosticArray, "/diagnostics",
                                              self._on_diagnostics, 50, raw=True)
        self._executor.add_node(self._client_node)
        self._cleanup.callback(self._client_node.destroy_node)
        self._cleanup.callback(self._end_composed)
        self._cleanup.callback(self.before_end)
        atexit.register(self.close)

    def launch(self, kind: str, namespace: str, parameters: Mapping[str, Any],
               make: Callable[..., Any] | None = None) -> Launched:
        """Start one node of the set; one that `make` returns is always in this process."""
        if self.composed and make is None:
            make = node_class(kind)
        if make is None:
            return self.launch_together([(kind, namespace, parameters)])[0]
        launched = Launched(kind, namespace, parameters=dict(parameters))
        with refusals_told(launched.full_name, self._ros_arguments):
            launched.node = make(context=self._context, cli_args=[
                "--ros-args", "-r", f"__ns:={namespace}", "--params-file",
                str(self._parameter_file([launched]))])
        self.launched.append(launched)
        self._executor.add_node(launched.node)
        launched.node.begin()
        return launched

    def launch_together(self, nodes: Sequence[tuple[str, str, Mapping[str, Any]]]
                        ) -> list[Launched]:
        """Start nodes, each kind, namespace and parameters, in one process of their own."""
        group = [Launched(kind, namespace, parameters=dict(parameters))
                 for kind, namespace, parameters in nodes]
        file = self._parameter_file(group)
        ros_args = ["--ros-args", "--params-file", str(file), "--enclave",
                    enclave_for([each.full_name for each in group])]
        one = len(group) == 1
        process = shared_fork_server().start(
            group[0].kind if one else SEVERAL,
            [*ros_args, "-r", f"__ns:={group[0].namespace}"] if one else
            [*(each.full_name for each in group), *ros_args], file.with_suffix(".log"), {
                **{name: value for name, value in os.environ.items() if name != OVERRIDE},
                "ROS_DOMAIN_ID": str(self._domain_id)})
        for each in group:
            each.process, each.log = process, file.with_suffix(".log")
        self.launched += group
        return group

    def _parameter_file(self, group: Sequence[Launched]) -> Path:
        name = group[0].full_name.strip("/").replace("/", "_")
        file = self.folder / f"{name}.yaml"
        file.write_text(json.dumps({
            each.full_name: {"ros__parameters": each.parameters} for each in group}))
        return file

    def _together(self, launched: Launched) -> list[Launched]:
        """Return the nodes that share a node's process, itself included."""
        return [each for each in self.launched if each.process is launched.process]

    def wait_connected(self, apart: Mapping[str, Sequence[str]], deadline: float) -> None:
        """Wait until every node has met every other one.

        `apart` lists, by the kind of a node, the kinds that it has nothing to do with.

        Raises
        ------
        HarnessError
            If one has not by the deadline (steady clock), with its reason.
        """
        for launched in self.launched:
            others = [each.full_name for each in self.launched
                      if each.kind not in apart.get(launched.kind, ())]
            while not (answer := self.call(
                    Ready, f"{launched.full_name}/ready", Ready.Request(nodes=others),
                    max(deadline - time.monotonic(), 1.0))).ready:
                if time.monotonic() > deadline:
                    raise NotInTimeError(f"{launched.full_name} is not ready: {answer.message}")
                self.spin(_LOOK_AGAIN_S)

    def _on_diagnostics(self, data: bytes) -> None:
        self._diagnostics.append(data)

    def _complaints(self) -> str:
        """Return what nodes complained of last; read only now, it would take the loop's time."""
        last = {status.name: "" if status.level == b"\x00" else status.message
                for data in self._diagnostics
                for status in deserialize_message(data, DiagnosticArray).status}
        return "".join(f"; {name} says: {text}" for name, text in last.items() if text)

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
                    self._look_at_port(now)
                    if now > deadline:
                        said = self._complaints() + (_DEAF if self._deaf else "")
                        raise NotInTimeError(f"{what}: not there after {timeout_s:.3g} s{said}")
        if interrupted and not self._closing:
            raise KeyboardInterrupt

    def spin(self, duration_s: float) -> None:
        """Let the graph run for a time (composed nodes only run while something spins)."""
        end = time.monotonic() + duration_s
        self.spin_until(lambda: time.monotonic() >= end, duration_s + 60.0, "the end of spin()")

    def signal_node(self, name: str, number: int) -> None:
        """Send a signal to the process of a node, such as `/stage/x/controller`, and so to all
        nodes that share it.

        One that ends the process is waited for, and its end is not held against the set:
        `launch_again` starts the node anew.

        Raises
        ------
        HarnessError
            If there is no such process, or it does not end on SIGINT, SIGTERM or SIGKILL.
        """
        launched = self._process_of(name)
        assert launched.process is not None  # noqa: S101 _process_of looked
        launched.process.send_signal(number)
        if number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            for each in self._together(launched):
                each.ended = True
            try:
                launched.process.wait(_ENDING_S)
            except subprocess.TimeoutExpired:
                raise HarnessError(f"{name} does not end on signal {number}") from None

    def launch_again(self, name: str, parameters: Mapping[str, Any] | None = None) -> None:
        """Start a node that `signal_node` ended, with `parameters` besides those it had, and all
        that shared its process.

        Raises
        ------
        HarnessError
            If the node still runs.
        """
        launched = self._process_of(name)
        if not launched.ended:
            raise HarnessError(f"{name} still runs: end it with signal_node first")
        group = self._together(launched)
        self.launched = [each for each in self.launched if each not in group]
        self.launch_together([(each.kind, each.namespace, {
            **each.parameters, **((parameters or {}) if each is launched else {})})
            for each in group])

    def _process_of(self, name: str) -> Launched:
        for launched in self.launched:
            if launched.full_name == name and launched.process is not None:
                return launched
        raise HarnessError(f"{name} is no process of this graph")

    def watch_diagnostics(self, callback: Callable[[DiagnosticArray], None]) -> None:
        """Have `callback` called with every message of /diagnostics while something spins."""
        self._client_node.create_subscription(DiagnosticArray, "/diagnostics", callback, 50)

    def _look_at_port(self, now: float) -> None:
        if now - self._looked > PORT_LOOK_S and self._own_ports is not None:
            self._looked = now
            self._deaf |= self._own_ports.lost()

    def _check_alive(self) -> None:
        for launched in self.launched:
            if launched.process is not None and not launched.ended and (
                    launched.process.poll() is not None):
                raise HarnessError(f"{launched.full_name} ended with code "
                                   f"{launched.process.returncode}: {self.last_words(launched)}")

    @staticmethod
    def last_words(launched: Launched) -> str:
        """Return the last line a node process wrote."""
        text = launched.log.read_text(errors="replace").strip() if launched.log else ""
        return text.split("\n")[-1].strip() or "it said nothing"

    def call(self, kind: Any, name: str, request: Any, timeout_s: float = 20.0,
             again_s: float = _ASK_AGAIN_S) -> Any:
        """Call a service of a node, again where no answer came within `again_s`; return the
        response.

        Raises
        ------
        HarnessError
            If it does not answer in time.
        """
        deadline = time.monotonic() + timeout_s
        asked: list[Any] = []
        while True:
            # An answer is lost where the node has not met the client yet: ask again. Where a node
            # of this name was killed a client may never meet the next: take a new one. All are
            # kept until the end. To destroy one is not harmless: Fast DDS 2.14 in the other
            # process may lock up if it checks a lease while it takes leave of the client
            # (`check_remote_participant_liveliness` against `removeWriterProxyData`), and then
            # hears nobody any more.
            if name not in self._clients or (asked and len(asked) % _ASKED_BY_ONE == 0):
                self._clients[name] = self._client_node.create_client(kind, name)
            client = self._clients[name]
            self.spin_until(client.service_is_ready, timeout_s, f"service {name}")
            asked.append(client.call_async(request))
            self.spin_until(functools.partial(_answered, asked, min(
                time.monotonic() + again_s, deadline)), again_s + 60.0, "an answer")
            for future in asked:
                if future.done():
                    return future.result()
            if time.monotonic() >= deadline:
                raise NotInTimeError(f"service {name} does not answer within {timeout_s:g} s")

    def set_parameters(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a running node, all or none.

        Raises
        ------
        HarnessError
            With the node's reason if it refuses.
        """
        result = self.call(
            SetParametersAtomically, f"{node}/set_parameters_atomically",
            SetParametersAtomically.Request(parameters=[
                RosParameter(name, value=value).to_parameter_msg()
                for name, value in values.items()])).result
        if not result.successful:
            raise HarnessError(f"{node}: {result.reason} (setting {', '.join(values)})")

    def cpu_seconds(self) -> float:
        """Return the processor time that the node processes have used so far, s."""
        stats = [Path(f"/proc/{pid}/stat").read_text() for pid in {
            launched.process.pid for launched in self.launched
            if launched.process is not None and not launched.ended}]
        return sum(int(ticks) for stat in stats for ticks in stat.rpartition(")")[2].split()[11:13]
                   ) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        """End every node and give everything back. Safe to call twice."""
        atexit.unregister(self.close)
        with StopRequest():
            self._closing = True
            self._cleanup.close()

    def _let_go(self) -> None:
        """Drop every handle: only then does the middleware end the participant's threads."""
        context, self._context = self._context, None
        self._executor = self._client_node = None
        self._clients.clear()
        gc.unfreeze()
        gc.collect()
        context.destroy()
        take_back_notes()

    def _end_composed(self) -> None:
        for launched in self.launched:
            if launched.node is not None:
                self._executor.remove_node(launched.node)
                launched.node.destroy_node()
                launched.node = None

    def _end_processes(self) -> None:
        processes = list({each.process.pid: each.process for each in self.launched
                          if each.process is not None}.values())
        for process in processes:
            process.send_signal(signal.SIGINT)  # nothing, where it has ended
        deadline = time.monotonic() + 5.0
        for process in processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.05, deadline - time.monotonic()))
            process.kill()
            process.wait()
        self.launched.clear()


def _answered(asked: Sequence[Any], until: float) -> bool:
    """Whether one of the futures is done, or there is no more time to wait for it."""
    return any(future.done() for future in asked) or time.monotonic() > until
