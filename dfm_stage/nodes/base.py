"""What every loop node has in common: settings, links, readiness, diagnostics, a main().

A node reports itself in three ways. `~/config` (latched) carries its parameters, its version and
what it loaded, so that a bag is complete in itself. `/diagnostics` says once a second in words and
numbers how it is doing. `~/ready` answers whether it is connected to the nodes that it is asked
about, and in lockstep whether all it published has arrived there; the harness waits for that.
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String

import dfm_stage
from dfm_interfaces.srv import Ready
from dfm_stage.errors import DfmError
from dfm_stage.nodes.discovery import keep_to_this_machine
from dfm_stage.nodes.parameters import Setting, Settings
from dfm_stage.nodes.security import require_what_was_asked
from dfm_stage.nodes.watch import Input, Watch
from dfm_stage.nodes.wire import codec
from dfm_stage.nodes.wiring import (
    DEFAULT_NAMESPACE,
    LATCHED_QOS,
    LINKS,
    RECORDER_TAP,
    publisher_qos,
    subscriber_qos,
)

keep_to_this_machine()

LOCKSTEP_PATIENCE_S = 5.0
_EVENTS_PER_LOOK = 64
COMMON = (
    Setting("lockstep", False, "wait for the sample's answer instead of the clock: "
            "deterministic, faster than real time"),
    Setting("wait_for_recorder", False, "hold the first sample until a recorder is subscribed"),
)


class Publisher:
    """A typed publisher of one link that takes fields instead of a message object."""

    def __init__(self, node: LoopNode, topic: str, prefix: str = "") -> None:
        self.link = LINKS[topic]
        self._codec = codec(self.link.type, prefix.strip("/") or node.axis)
        self.ros = node.create_publisher(self.link.type, prefix + topic,
                                         publisher_qos(node.lockstep))
        self._node = node
        self._publish = self.ros.handle.publish_raw
        self._encode = self._codec.encode
        self._open = False
        self._held: list[bytes] = []

    def send(self, stamp_ns: int, *fields: Any) -> None:
        """Publish one message; where the history is full, wait for the slowest reader.

        Before everyone who must not miss it listens, a lockstep message is held back and a
        real-time one, of no use to anybody, is dropped.
        """
        data = self._encode(stamp_ns, *fields)
        if not self._open and not self.open():
            if self._node.lockstep:
                self._held.append(data)
            return
        try:
            self._publish(data)
        except RuntimeError:
            self._insist(data)

    def release(self) -> bool:
        """Publish what was held back, if everyone listens by now; return whether it is open."""
        if self.open():
            while self._held:
                self._insist(self._held.pop(0))
        return self._open

    def _insist(self, data: bytes) -> None:
        deadline = time.monotonic() + LOCKSTEP_PATIENCE_S
        while self._node.context.ok():
            try:
                self._publish(data)
            except RuntimeError as error:
                if time.monotonic() > deadline:
                    raise DfmError(f"{self.ros.topic_name}: cannot publish for "
                                   f"{LOCKSTEP_PATIENCE_S:g} s, a subscriber does not keep up "
                                   f"({error})") from error
            else:
                return

    def missing(self, nodes: Sequence[str]) -> list[str]:
        """Return the names out of `nodes` that do not subscribe yet."""
        here = self._node.get_subscriptions_info_by_topic(self.ros.topic_name)
        present = {info.node_name for info in here}
        missing = [name for name in nodes if name not in present]
        if not missing and self.ros.get_subscription_count() < len(here):
            missing = ["a subscriber that is still being matched"]
        return missing

    def delivered(self) -> bool:
        """Return whether every reliable subscriber has received everything."""
        return bool(self.ros.wait_for_all_acked(Duration(nanoseconds=0)))

    def open(self) -> bool:
        """Return whether the first message may go out: everyone who must not miss it listens."""
        if not self._open:
            wanted: list[str] = []
            if self._node.settings["wait_for_recorder"]:
                wanted.append(RECORDER_TAP)
            if self._node.lockstep:
                wanted += self.link.subscribers
            self._open = not wanted or not self.missing(wanted)
        return self._open


class LoopNode(Node):
    """Base of the nodes on the loop of one axis.

    Parameters of the constructor are those of rclpy.node.Node that composition needs.
    """

    kind = ""
    settings_table: tuple[Setting, ...] = ()

    def __init__(self, *, context: Any = None, cli_args: list[str] | None = None) -> None:
        super().__init__(self.kind, namespace=DEFAULT_NAMESPACE, context=context,
                         cli_args=cli_args, use_global_arguments=cli_args is None)
        self.settings = Settings(self, (*COMMON, *self.settings_table), self.check_settings,
                                 self.settings_applied)
        self.lockstep: bool = self.settings["lockstep"]
        self.axis = self.get_namespace().rpartition("/")[2]
        self.counters: dict[str, int] = {}
        self.warnings_active: dict[str, str] = {}
        self.errors_active: dict[str, str] = {}
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.publishers_of_links: list[Publisher] = []
        self._config = self.create_publisher(String, "~/config", LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_service(Ready, "~/ready", self._on_ready)
        self._watch = Watch(self.warnings_active, self.count, self.get_logger().warning,
                            time.monotonic())
        self.create_timer(1.0, self._every_second, clock=self.steady)
        self._opening = self.create_timer(0.02, self._open_links, clock=self.steady)

    # What a node may override

    def check_settings(self, values: dict[str, Any]) -> None:
        """Refuse a combination of parameter values by raising DfmError."""

    def settings_applied(self, names: set[str]) -> None:
        """React to parameters that changed at run time."""

    def config(self) -> dict[str, Any]:
        """Return what the bag should know about this node besides its parameters."""
        return {}

    def report(self) -> dict[str, Any]:
        """Return what diagnostics say once a second besides the counters."""
        return {}

    def waiting_for(self) -> tuple[str, int] | None:
        """Return which topic a lockstep sample is waiting for and its number, or None."""
        return None

    def not_ready(self) -> str | None:
        """Return why the node cannot work yet, apart from its links, or None."""
        return None

    # Tools for the nodes

    def link_publisher(self, topic: str, prefix: str = "") -> Publisher:
        """Create the publisher of a loop topic."""
        publisher = Publisher(self, topic, prefix)
        self.publishers_of_links.append(publisher)
        return publisher

    def link_subscription(self, topic: str, callback: Callable[[Any], None],
                          prefix: str = "") -> None:
        """Subscribe to a loop topic; `callback` gets the decoded fields."""
        link = LINKS[topic]
        decode = codec(link.type).decode
        heard = Input(prefix + topic, link.publisher)
        self._watch.inputs.append(heard)

        def decoded(data: bytes) -> None:
            heard.received += 1
            callback(decode(data))

        self.create_subscription(link.type, prefix + topic, decoded,
                                 subscriber_qos(link, self.kind, self.lockstep), raw=True)

    def publish_config(self) -> None:
        """Publish the latched description of this node."""
        content = {"node": self.get_fully_qualified_name(), "kind": self.kind,
                   "dfm_stage": dfm_stage.__version__, "parameters": self.settings.values,
                   **self.config()}
        self._config.publish(String(data=json.dumps(content, sort_keys=True, default=list)))

    def count(self, what: str, by: int = 1) -> None:
        """Count an event that diagnostics report."""
        self.counters[what] = self.counters.get(what, 0) + by

    def now_ns(self) -> int:
        """Return the system time in ns."""
        return time.time_ns()

    # Readiness and diagnostics

    def _open_links(self) -> None:
        if all(publisher.release() for publisher in self.publishers_of_links):
            self._opening.cancel()

    def _on_ready(self, request: Ready.Request, response: Ready.Response) -> Ready.Response:
        reasons = []
        kinds = {name.rpartition("/")[2] for name in request.nodes}
        for publisher in self.publishers_of_links:
            wanted = [kind for kind in publisher.link.subscribers if kind in kinds]
            wanted += [RECORDER_TAP] if "recorder" in kinds else []
            missing = publisher.missing(wanted)
            if missing:
                reasons.append(f"{publisher.ros.topic_name} has no {', '.join(missing)}")
            elif self.lockstep and not publisher.delivered():
                reasons.append(f"{publisher.ros.topic_name} is still being delivered")
        own = self.not_ready()
        if own:
            reasons.append(own)
        response.ready = not reasons
        response.message = "; ".join(reasons)
        return response

    _waiting_since: tuple[tuple[str, int], float] | None = None

    def _every_second(self) -> None:
        if not self.lockstep:
            self._watch.look(time.monotonic())
        waiting = self.waiting_for() if self.lockstep else None
        if waiting is None:
            self._waiting_since = None
            self.warnings_active.pop("waiting", None)
        elif self._waiting_since is None or self._waiting_since[0] != waiting:
            self._waiting_since = (waiting, time.monotonic())
        elif time.monotonic() - self._waiting_since[1] >= LOCKSTEP_PATIENCE_S:
            if "waiting" not in self.warnings_active:
                self.get_logger().warning(f"lockstep: waiting for {waiting[0]}")
            self.warnings_active["waiting"] = f"waiting for {waiting[0]}"
        values = {**self.counters, **self.report()}
        level = (DiagnosticStatus.ERROR if self.errors_active
                 else DiagnosticStatus.WARN if self.warnings_active else DiagnosticStatus.OK)
        words = [*self.errors_active.values(), *self.warnings_active.values()]
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), hardware_id=self.axis,
            message="; ".join(words) or "running",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        with contextlib.suppress(Exception):
            self._diagnostics.publish(array)


def make_executor(context: Any) -> Any:
    """Return the executor: rclpy's EventsExecutor, or with DFM_EXECUTOR=default the default one.

    The default one needs more than twice the processor; it is there for comparison and as a way
    out should a later rclpy break the experimental one.
    """
    if os.environ.get("DFM_EXECUTOR", "events") == "default":
        return SingleThreadedExecutor(context=context)
    return EventsExecutor(context=context)


def quiet_collector() -> None:
    """Keep the garbage collector away from what is there at start."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


class StopRequest:
    """SIGINT and SIGTERM as a flag instead of an exception.

    An exception could be raised in the middle of anything, a C++ destructor or the closing of a
    bag included; where it was, the process aborted. True once asked to stop. As a context manager
    it puts the handlers back at the end; a process that is to end anyway calls `install`, so that
    a second signal finds no moment to strike in.
    """

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __bool__(self) -> bool:
        return self.asked

    def _ask(self, _number: int, _frame: Any) -> None:
        self.asked = True

    def install(self) -> None:
        """Take the signals; only the main thread can."""
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask)
                            for number in (signal.SIGINT, signal.SIGTERM)}

    def __enter__(self) -> StopRequest:
        self.install()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None,
                 traceback: TracebackType | None) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def run_node(make: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until it is interrupted; return the exit code.

    A parameter or file that cannot be used is one line on stderr and exit code 2.
    """
    stop = StopRequest()
    stop.install()
    given = list(sys.argv[1:] if args is None else args)
    try:
        require_what_was_asked()
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        foreign = remove_ros_args(["", *given])[1:]
    except (RuntimeError, DfmError) as error:
        print(f"error: {_one_line(error)}", file=sys.stderr)
        return 2
    if foreign:
        rclpy.try_shutdown()
        print(f"error: unknown arguments {' '.join(foreign)}: write parameters as "
              "--ros-args -p name:=value", file=sys.stderr)
        return 2
    node: Node | None = None
    try:
        node = make()
        executor = make_executor(node.context)
        executor.add_node(node)
        quiet_collector()
        while rclpy.ok():
            # spin() of this executor forgets timers while no message comes
            for _ in range(_EVENTS_PER_LOOK):
                executor.spin_once(0.1)
                if stop.asked:
                    return 0
    except ExternalShutdownException:
        pass
    except (DfmError, InvalidParameterTypeException) as error:
        print(f"error: {_one_line(error)}", file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).partition(", at /")[0].split())
