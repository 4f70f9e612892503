"""What every loop node has in common: settings, links, readiness, diagnostics.

A node reports itself in three ways. `~/config` (latched) carries its parameters, its version and
what it loaded, so that a bag is complete in itself. `/diagnostics` says once a second in words and
numbers how it is doing. `~/ready` answers whether it is connected to the nodes that it is asked
about, and in lockstep whether all it published has arrived there; the harness waits for that.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from std_msgs.msg import String
from std_srvs.srv import Trigger

import dfm_stage
from dfm_interfaces.srv import Ready
from dfm_stage.errors import DfmError
from dfm_stage.middleware.hand_over import (
    Receiver,
    Sender,
    forget,
    in_spare_time,
    look_anew,
)
from dfm_stage.middleware.scheduling import LOOK_S, LOOP_PRIORITY, RealTime
from dfm_stage.middleware.shared_memory import killed_endpoints
from dfm_stage.middleware.watch import Input, Notices, Watch
from dfm_stage.middleware.wire import codec
from dfm_stage.nodes.each_second import LOCKSTEP_PATIENCE_S, PIECES, EachSecond
from dfm_stage.nodes.parameters import Setting, Settings
from dfm_stage.nodes.sample_period import SAMPLE_PERIOD, PeriodCheck, SamplePeriodError
from dfm_stage.nodes.wiring import (
    DEFAULT_NAMESPACE,
    LINKS,
    LOCKSTEP_QOS,
    PUBLISHER_QOS,
    RECORDER_TAP,
    TOPICS,
    interface,
    subscriber_qos,
)

COMMON = (
    Setting("lockstep", False, "wait for the sample's answer instead of the clock: "
            "deterministic, faster than real time"),
    Setting("wait_for_recorder", False, "hold the first sample until a recorder is subscribed"),
)
LOOP_HEALTH = "loop_health"
PRIORITY = Setting(
    "realtime_priority", LOOP_PRIORITY, "SCHED_RR priority of the node's process (recorder: 10) "
    "where the user has the right to it (rtprio in limits.conf); 0 = none; of nodes that share a "
    "process, the first that is no recorder sets it; not in the process of a program", "", 0, 99)
_OPENING_S = 0.02
"""How often a node looks whether everyone listens who must not miss its first message."""


class Publisher(Sender):
    """A typed publisher of one link that takes fields instead of a message object."""

    def __init__(self, node: LoopNode, topic: str, prefix: str = "") -> None:
        self.link = LINKS[topic]
        super().__init__(node, self.link.type, prefix + topic,
                         LOCKSTEP_QOS if node.lockstep else PUBLISHER_QOS)
        self._node = node
        self._pair = codec(self.link.type, prefix.strip("/") or node.axis).pair
        self._wanted = [*([RECORDER_TAP] if node.settings["wait_for_recorder"] else []),
                        *(self.link.subscribers if node.lockstep else [])]
        self.is_open = not self._wanted
        self._held: list[tuple[bytes, Any]] = []

    def send(self, stamp_ns: int, *fields: Any) -> None:
        """Publish one message; where the history is full, wait for the slowest reader.

        Before everyone who must not miss it listens, a lockstep message is held back and a
        real-time one, of no use to anybody, is dropped. `release` looks who listens, not this: a
        look takes about a millisecond, and one a sample takes the processor that the recorder
        needs to begin to listen.
        """
        data, named = self._pair(stamp_ns, *fields)
        if self.is_open:
            self.put(data, named)
        elif self._node.lockstep:
            self._held.append((data, named))

    def release(self) -> bool:
        """Publish what was held back, if everyone who must not miss the first message listens by
        now; return whether they do."""
        if not self.is_open and not self.missing(self._wanted):
            self.is_open = True
            while self._held:
                self.put(*self._held.pop(0))
        return self.is_open

    def to_dds(self, data: bytes) -> None:
        """Publish; where the history is full, wait for the slowest reader."""
        try:
            super().to_dds(data)
        except RuntimeError:
            self._insist(data)

    def _insist(self, data: bytes) -> None:
        deadline = time.monotonic() + LOCKSTEP_PATIENCE_S
        while self._node.context.ok():
            try:
                super().to_dds(data)
            except RuntimeError as error:
                if time.monotonic() > deadline:
                    raise DfmError(f"{self.ros.topic_name}: cannot publish for "
                                   f"{LOCKSTEP_PATIENCE_S:g} s, a subscriber does not keep up "
                                   f"({error})") from error
            else:
                return

    def missing(self, nodes: Sequence[str]) -> list[str]:
        """Return the names out of `nodes` that do not subscribe yet; the killed do not count."""
        here = self._node.get_subscriptions_info_by_topic(self.ros.topic_name)
        killed = killed_endpoints()
        present = {info.node_name for info in here
                   if not bytes(info.endpoint_gid).startswith(killed)}
        missing = [name for name in nodes if name not in present]
        if not missing and self.ros.get_subscription_count() < len(here):
            missing = ["a subscriber that is still being matched"]
        return missing


def node_class(kind: str) -> type[LoopNode]:
    """Return the class of one of the package's nodes by its name on the command line."""
    return getattr(importlib.import_module(f"dfm_stage.nodes.{kind}"),
                   "".join(map(str.capitalize, kind.split("_"))))


STUCK_S = 3.0
"""How long a process that ends may be kept by its middleware, s. Seldom, Fast DDS waits for ever
for a callback of a participant that it closes; bags and devices are safe by then, and the system
ends the process."""


@contextlib.contextmanager
def _ended_if_stuck() -> Iterator[None]:
    """Have the system end this process (SIGALRM) where what is done takes longer than STUCK_S."""
    before = signal.setitimer(signal.ITIMER_REAL, STUCK_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, *before)


class LoopNode(EachSecond):
    """Base of the nodes on the loop of one axis.

    Parameters of the constructor are those of rclpy.node.Node that composition needs.
    """

    kind = ""
    settings_table: tuple[Setting, ...] = ()
    priority = PRIORITY.default
    """A node below the loop waits for it as a matter of course, and is not judged by that."""
    niceness = 0
    """By how much its process gives way to others, where it has the process to itself."""
    leaving_s = 0.0
    """How long a node that ends may wait until its last messages have arrived, s."""
    ends_process = False
    """Whether it is the last node of a process that ends with it."""
    listens_to = ""
    """What it subscribes to besides what the tables of `wiring` say, in words."""
    example = ""
    """Arguments to start it with, and a word on what that does, for its help."""

    def __init__(self, *, context: Any = None, cli_args: list[str] | None = None) -> None:
        super().__init__(self.kind, namespace=DEFAULT_NAMESPACE, context=context,
                         cli_args=cli_args, use_global_arguments=cli_args is None)
        self.settings = Settings(self, self.all_settings(self._parameter_overrides))
        self.lockstep: bool = self.settings["lockstep"]
        self.axis = self.get_namespace().rpartition("/")[2]
        self.counters: dict[str, int] = {}
        self.realtime = RealTime()
        self.warnings_active, self.errors_active = Notices(), Notices()
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.publishers_of_links: list[Publisher] = []
        self._receivers: list[Receiver] = []
        self._begun = False
        self._tell_health: Callable[[], None] = lambda: None
        self._waiting_since: tuple[tuple[str, int] | None, float] = None, 0.0
        self._config = self.side_publisher("~/config")
        self._diagnostics = self.side_publisher("/diagnostics")
        self.create_service(Ready, "~/ready", self._on_ready)
        self._watch = Watch(self.warnings_active, self.count, self.get_logger().warning,
                            time.monotonic())
        self._broken = ""
        self.beside_the_loop(1.0 / PIECES, self._next_piece)
        self.beside_the_loop(LOOK_S, self._look_at_priority)
        self._opening = self.create_timer(_OPENING_S, self._open_links, clock=self.steady)

    def begin(self) -> None:
        """Check the parameters as a whole and start to work; once the node is complete.

        Whoever makes a node calls it; a node may do so itself at the end of its constructor.

        Raises
        ------
        DfmError
            If it cannot work with its parameters.
        """
        if not self._begun:
            self._begun = True
            self.settings.follow(self.check_settings, self.settings_applied)
            self.start_work()
            self.publish_config()

    # What a node may override

    @classmethod
    def all_settings(cls, overrides: Mapping[str, Any]) -> tuple[Setting, ...]:
        """Return the settings that the node declares, given its parameter overrides."""
        return (*COMMON, replace(PRIORITY, default=cls.priority), *cls.settings_for(overrides))

    @classmethod
    def settings_for(cls, _overrides: Mapping[str, Any]) -> tuple[Setting, ...]:
        """Return the settings to declare, where these depend on parameter overrides."""
        return cls.settings_table

    def start_work(self) -> None:
        """Do what needs the complete node and parameters that were checked."""

    def check_settings(self, values: dict[str, Any]) -> object:
        """Refuse a combination of parameter values by raising DfmError, and change nothing.

        What it returns, made of these values, is `settings.plan` once they are in force.
        """

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

    def has_namesakes(self, words: str) -> None:
        """React to other nodes of this one's name; `words` say so. Called each second."""

    # Tools for the nodes

    def link_publisher(self, topic: str, prefix: str = "") -> Publisher:
        """Create the publisher of a loop topic."""
        publisher = Publisher(self, topic, prefix)
        self.publishers_of_links.append(publisher)
        return publisher

    def link_subscription(self, topic: str, callback: Callable[[Any], None],
                          prefix: str = "") -> Receiver:
        """Subscribe to a loop topic; `callback` gets the decoded fields."""
        link = LINKS[topic]
        if topic == "measurement" and SAMPLE_PERIOD.name in self.settings.values:
            callback = self._comparing_period(callback)
        receiver = Receiver(self, link.type, prefix + topic, callback,
                            subscriber_qos(link, self.kind, self.lockstep),
                            decode=codec(link.type).decode)
        self._receivers.append(receiver)
        self._watch.inputs.append(Input(prefix + topic, link.publisher, receiver))
        return receiver

    def side_publisher(self, topic: str) -> Any:
        """Create the publisher of a topic beside the loop, as `wiring.TOPICS` has it."""
        entry = TOPICS[topic]
        return self.create_publisher(interface(entry.type), topic, entry.qos)

    def side_sender(self, topic: str) -> Sender:
        """Create the publisher of a topic beside the loop that takes serialised messages."""
        entry = TOPICS[topic]
        return Sender(self, interface(entry.type), topic, entry.qos)

    def side_subscription(self, topic: str, callback: Callable[[Any], None],
                          raw: bool = False) -> None:
        """Subscribe to a topic beside the loop, as `wiring.TOPICS` has it."""
        entry = TOPICS[topic]
        self.create_subscription(interface(entry.type), topic, callback,
                                 entry.subscriber_qos or entry.qos, raw=raw)

    def beside_the_loop(self, period_s: float, job: Callable[[], object]) -> Any:
        """Create a timer for what need not be done at the moment it is due."""
        return self.create_timer(period_s, in_spare_time(self, job), clock=self.steady)

    def trigger_service(self, name: str, action: Callable[[], str]) -> None:
        """Offer a std_srvs/Trigger: `action` returns what to say, or refuses with a DfmError."""
        def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = action(), True
            except DfmError as error:
                response.message, response.success = str(error), False
            return response

        self.create_service(Trigger, name, answer)

    def _comparing_period(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Hold the stamps of the measurements against the node's sampling period.

        `loop_health` (latched) tells amplifier_driver, which does not arm before it agrees. In
        lockstep, where nothing can be harmed, the node ends.
        """
        check = PeriodCheck(self.settings[SAMPLE_PERIOD.name], exact=self.lockstep)
        health = self.side_publisher(LOOP_HEALTH)

        def say() -> None:
            self.errors_active.put(SAMPLE_PERIOD.name, check.complaint)
            complaint = check.complaint or self.errors_active.get("name")
            health.publish(
                self.status(DiagnosticStatus.ERROR, f"{self.kind}: {complaint}")
                if complaint else self.status(
                    DiagnosticStatus.WARN,
                    f"{self.kind} still compares its sampling period with the measurements")
                if check.measured_s is None else self.status(DiagnosticStatus.OK))

        def compared(measurement: Any) -> None:
            if check.heard(measurement.seq, measurement.stamp_ns):
                if self.lockstep and check.complaint:
                    raise SamplePeriodError(f"{self.kind}: {check.complaint}")
                say()
            callback(measurement)

        say()
        self._tell_health = say
        return compared

    def destroy_node(self) -> None:
        """End the node when its last messages have arrived, or had `leaving_s` to."""
        deadline = time.monotonic() + self.leaving_s
        with contextlib.suppress(RuntimeError):  # the context is gone already
            for publisher in self.publishers_of_links if self.leaving_s else ():
                publisher.delivered(deadline - time.monotonic())
        for receiver in self._receivers:
            receiver.leave()
        forget(self)
        with _ended_if_stuck() if self.ends_process else contextlib.nullcontext():
            super().destroy_node()

    def an_endpoint(self) -> Sequence[int]:
        """Return the global identifier of one of this node's endpoints.

        A killed node of the same name may still be listed. Fast DDS writes the number of the
        process into bytes 4 and 5, which tells the two apart.
        """
        number = (os.getpid() & 0xFFFF).to_bytes(2, "little")
        found = [list(info.endpoint_gid) for info in
                 self.get_publishers_info_by_topic(self._config.topic_name)]
        return next((each for each in found if bytes(each[4:6]) == number), found[0])

    def status(self, level: bytes, words: str = "",
               values: Mapping[str, Any] | None = None) -> DiagnosticStatus:
        """Return a message about this node."""
        return DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), hardware_id=self.axis,
            message=words or "running",
            values=[KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()])

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

    @property
    def links_open(self) -> bool:
        """Whether everyone who must not miss the first message was there, and it may go out."""
        return all(publisher.is_open for publisher in self.publishers_of_links)

    def _open_links(self) -> None:
        opened = [each.release() for each in self.publishers_of_links]  # none waits for another
        if all(opened):
            self._opening.cancel()

    def _on_ready(self, request: Ready.Request, response: Ready.Response) -> Ready.Response:
        look_anew(self)     # who asks may have just joined
        reasons = [self.not_ready(), self._unknown(request.nodes)]
        kinds = {name.rpartition("/")[2] for name in request.nodes}
        for publisher in self.publishers_of_links:
            if missing := publisher.missing([
                    *(kind for kind in publisher.link.subscribers if kind in kinds),
                    *([RECORDER_TAP] if "recorder" in kinds else [])]):
                reasons.append(f"{publisher.ros.topic_name} has no {', '.join(missing)}")
            elif self.lockstep and not publisher.delivered():
                reasons.append(f"{publisher.ros.topic_name} is still being delivered")
        response.message = "; ".join(filter(None, reasons))
        response.ready = not response.message
        return response

    def _unknown(self, names: Sequence[str]) -> str:
        """Say which nodes are not there; a name without `/` is one in this namespace."""
        here = {f"{space.rstrip('/')}/{name}"
                for name, space in self.get_node_names_and_namespaces()}
        missing = [name for name in names
                   if (name if "/" in name else f"{self.get_namespace()}/{name}") not in here]
        return f"there is no {', '.join(missing)}" if missing else ""
