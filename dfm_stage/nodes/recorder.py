"""recorder: every topic into a rosbag2-compatible MCAP bag, with what the nodes say of themselves.

Messages are written byte by byte as they came. Nodes of the same process leave them in a list,
with the time. Those of other processes stay in subscriptions that no executor watches, which know
when each came. The recorder fetches both every few milliseconds: waking up for each of ten
thousand messages a second would cost more than all else, and take that time from the loop. If the
bag cannot be created, the node ends. If it can no longer be written (full disk), the node reports
it and everything else continues.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import platform
import re
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)

import dfm_stage
from dfm_stage.errors import DfmError
from dfm_stage.middleware.hand_over import Receiver, hands_over
from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import BEGUN_ANEW, run_node
from dfm_stage.nodes.wiring import RECORDER_TAP
from dfm_stage.recording import (
    MODEL_ATTACHMENT,
    PARAMETERS_ATTACHMENT,
    VERSIONS_ATTACHMENT,
    BagWriteError,
    QosProfile,
    definition_text,
)

_FETCH_PERIOD_S = 0.01
"""How often each subscription is asked. It keeps what comes meanwhile."""
_SHARES = 5
"""Shares in which that is done beside a loop in the same process, and what came given to the bag
writer: at 5 kHz a sample has 0.2 ms. Elsewhere to wake up costs more."""
_CHUNK_BYTES = 1 << 18
"""Beside a loop in real time: a chunk is laid out in the same process, and samples are late
meanwhile."""
_LOOK_PERIODS_S = (0.1, 0.5)
_SETTLED_S = 1.0
_DRAIN_S = 0.05
_REPAIR_S = 0.25
"""A message that got lost on its way is missed at the next heartbeat (config/fastdds.xml)."""


class Recorder(LoopNode):
    """Records until it is stopped; `~/stop` closes the bag and answers when it is complete."""

    kind = "recorder"
    listens_to = "every topic whose full name `topics` matches and `exclude` does not"
    example = "-p bag:=bags/first -p exclude:='/parameter_events|.*/sim/.*'"
    priority = 10
    niceness = 5
    """It gives way to the loop it records: its buffers are deep."""
    settings_table = (
        Setting("bag", "", "folder of the new bag; empty: bags/<date and time>"),
        Setting("topics", ".*", "regular expression of the full topic names to record"),
        Setting("exclude", "/parameter_events", "regular expression of full names to leave out"),
        Setting("compression", "zstd", "compression of the file", choices=("zstd", "lz4", "none")),
    )

    def __init__(self, **kwargs: Any) -> None:
        from dfm_stage.recording.bag_writer import (  # numba, which the help can do without
            CHUNK_BYTES,
            BagWriter,
        )

        super().__init__(**kwargs)
        self._wanted = _pattern("topics", self.settings["topics"])
        self._unwanted = _pattern("exclude", self.settings["exclude"])
        folder = self.settings["bag"] or f"bags/{datetime.now().astimezone():%Y%m%d_%H%M%S}"
        if BEGUN_ANEW in os.environ and self.settings["bag"]:
            folder = f"{folder}_{os.environ[BEGUN_ANEW]}"  # the first one was closed
        in_real_time = hands_over(self) and not self.lockstep
        self._bag = BagWriter(folder, compression=self.settings["compression"],
                              chunk_bytes=_CHUNK_BYTES if in_real_time else CHUNK_BYTES,
                              log_stamps=self.lockstep)
        self._bag.attach(VERSIONS_ATTACHMENT, "application/json",
                         json.dumps(versions(), sort_keys=True).encode())
        self._topics: dict[str, Receiver] = {}
        self._taps: list[tuple[Callable[..., Any], Any, Receiver, bool]] = []
        self._arrivals: list[tuple[int, bytes, int]] = []
        self._share, self._shares = 0, _SHARES if hands_over(self) else 1
        self._refused: set[str] = set()
        self._configs: dict[str, Any] = {}
        self._model_attached = False
        self._open = True
        self._tap = Node(RECORDER_TAP, namespace=self.get_namespace(), context=self.context,
                         use_global_arguments=False, enable_rosout=False,
                         start_parameter_services=False)
        self.trigger_service("~/stop", self.finish)
        self._look_for_topics()
        for job in (self._fetch_share, self._write):
            self.beside_the_loop(_FETCH_PERIOD_S / self._shares, job)
        self._last_new_s = time.monotonic()
        self._looking = self.beside_the_loop(_LOOK_PERIODS_S[0], self._look_now_and_then)
        self.begin()
        self.get_logger().info(f"recording to {folder}")

    # Topics

    def _look_now_and_then(self) -> None:
        """Look often while topics appear; each look takes a millisecond from the loop."""
        known = len(self._topics)
        self._look_for_topics()
        if len(self._topics) > known:
            self._last_new_s = time.monotonic()
        elif time.monotonic() - self._last_new_s > _SETTLED_S and self._looking is not None:
            self._looking.cancel()
            self._looking = None
            self.beside_the_loop(_LOOK_PERIODS_S[1], self._look_for_topics)

    def _look_for_topics(self) -> None:
        if not self._open:
            return
        for name, types in self.get_topic_names_and_types():
            # with /_ it is hidden, as ROS 2 calls it: the inner topics of actions
            if ("/_" not in name and name not in self._topics and name not in self._refused
                    and len(types) == 1 and self._wanted.fullmatch(name)
                    and not self._unwanted.fullmatch(name)
                    and (offers := self.get_publishers_info_by_topic(name))):
                self._record(name, types[0], offers)

    def _record(self, name: str, type_name: str, offers: list[Any]) -> None:
        profiles = [each.qos_profile for each in offers]
        try:
            package, _, kind = type_name.partition("/msg/")
            message_type = getattr(importlib.import_module(f"{package}.msg"), kind)
            first = next(iter(message_type.get_fields_and_field_types().values()), "")
            number = self._bag.add_topic(
                name, type_name, [_offer(each) for each in profiles],
                str(offers[0].topic_type_hash), definition_text(type_name),
                stamped=first == "std_msgs/Header")
        except (ImportError, AttributeError, DfmError) as error:
            self._refused.add(name)
            self.count("topics_refused")
            self.get_logger().warning(f"{name} ({type_name}) is not recorded: {error}")
            return
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_ALL,
            reliability=ReliabilityPolicy.RELIABLE
            if all(each.reliability == ReliabilityPolicy.RELIABLE for each in profiles)
            else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL
            if all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in profiles)
            else DurabilityPolicy.VOLATILE)
        is_config = type_name == "std_msgs/msg/String" and name.endswith("/config")
        self._topics[name] = tap = Receiver(self._tap, message_type, name, _nobody_calls, qos,
                                            spun_with=self, arrivals=self._arrivals,
                                            number=number)
        self._taps.append((tap.ros.handle.take_message, message_type, tap, is_config))

    def _fetch_share(self) -> None:
        self._share = (self._share + 1) % self._shares
        self._fetch(self._taps[self._share::self._shares])

    def _fetch(self, taps: Sequence[tuple[Callable[..., Any], Any, Receiver, bool]]) -> None:
        """Take what has come by DDS since the last time."""
        for take, message_type, tap, is_config in taps:
            while (taken := take(message_type, True)) is not None:
                data, about = taken
                if not (tap.echoes and tap.was_handed_over(data)):
                    came_ns = about["received_timestamp"] or time.time_ns()  # 0: not known
                    self._arrivals.append((tap.number, data, came_ns))
                if is_config:  # always by DDS
                    self._on_config(data)

    def _write(self) -> None:
        """Give the bag writer what has come since the last time."""
        arrived = self._arrivals[:]  # a thread of a driver may add more meanwhile
        del self._arrivals[:len(arrived)]
        if arrived and self._open:
            try:
                self._bag.write_arrived(arrived)
            except BagWriteError as error:
                self._failed(error)

    def _on_config(self, data: bytes) -> None:
        try:
            config = json.loads(data[8:].rstrip(b"\0"))
            self._configs[config["node"]] = config
        except (ValueError, KeyError, TypeError):
            return
        model = config.get("model_yaml")
        if model and not self._model_attached:
            self._model_attached = True
            try:
                self._bag.attach(MODEL_ATTACHMENT, "application/yaml", model.encode())
            except BagWriteError as error:
                self._failed(error)

    # State

    def _failed(self, error: BagWriteError) -> None:
        if self.warnings_active.put("bag", str(error)):
            self.get_logger().error(str(error))

    def each_second(self) -> Iterator[None]:
        """Say how the bag is."""
        self.counters["messages"] = self._bag.message_count
        self.counters["messages_not_recorded"] = self._bag.lost
        if self._open and self._bag.error is not None:
            self._failed(self._bag.error)
        yield
        yield from super().each_second()

    def not_ready(self) -> str | None:
        """Every topic that is there must be subscribed and matched with all its publishers."""
        self._look_for_topics()
        for name, tap in self._topics.items():
            if tap.ros.get_publisher_count() < self.count_publishers(name):
                return f"recorder is not matched with {name} yet"
        return None

    def finish(self) -> str:
        """Close the bag; return what is in it.

        Raises
        ------
        BagWriteError
            If it is not complete.
        """
        if not self._open:
            return "closed before"
        until = time.monotonic() + (_DRAIN_S if self.lockstep else _REPAIR_S)
        self._fetch(self._taps)
        while time.monotonic() < until:  # what is still on its way was published before
            time.sleep(_FETCH_PERIOD_S)
            self._fetch(self._taps)
        self._write()
        self._open = False
        # what still comes is taken, so that nobody waits for us, and dropped
        try:
            for config in self._configs.values():
                for name, text in config.pop("attachments", {}).items():
                    self._bag.attach(name, "text/csv", text.encode())
            if self._configs and self._bag.error is None:
                self._bag.attach(PARAMETERS_ATTACHMENT, "application/yaml",
                                 json.dumps(self._configs, sort_keys=True, indent=1).encode())
            self._bag.close()
        except BagWriteError as error:
            self.get_logger().error(str(error))
            raise
        return f"{self._bag.message_count} messages in {self._bag.directory}"

    def destroy_node(self) -> None:
        """Close the bag, then the node."""
        with contextlib.suppress(BagWriteError):  # it is in the log
            self.finish()
        self._taps.clear()
        for tap in self._topics.values():
            tap.leave()
        self._tap.destroy_node()
        super().destroy_node()


def _nobody_calls(_data: bytes) -> None:
    """Stand for the callback of a subscription that is asked instead."""


def versions() -> dict[str, str]:
    """Return the versions of everything that can change a result."""
    out = {"dfm_stage": dfm_stage.__version__, "python": platform.python_version(),
           "system": platform.platform()}
    for package in ("numpy", "scipy", "numba", "control", "filterpy", "mcap", "rclpy",
                    "ros-rclpy"):
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            continue
    return out


def _pattern(name: str, text: str) -> re.Pattern[str]:
    try:
        return re.compile(text)
    except re.error as error:
        raise DfmError(f"recorder: parameter {name} = {text!r} is not a regular expression: "
                       f"{error}") from None


def _offer(qos: QoSProfile) -> QosProfile:
    return QosProfile(
        history=HistoryPolicy(qos.history).short_key, depth=qos.depth,
        reliability=ReliabilityPolicy(qos.reliability).short_key,
        durability=DurabilityPolicy(qos.durability).short_key,
        deadline_ns=qos.deadline.nanoseconds, lifespan_ns=qos.lifespan.nanoseconds,
        liveliness=LivelinessPolicy(qos.liveliness).short_key,
        liveliness_lease_duration_ns=qos.liveliness_lease_duration.nanoseconds,
        avoid_ros_namespace_conventions=qos.avoid_ros_namespace_conventions)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Recorder, args)
