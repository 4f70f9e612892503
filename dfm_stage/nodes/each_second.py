"""What every node does each second: it looks how it is, and says so on /diagnostics.

At 5 kHz a sample has 0.2 ms, and all of this takes 0.45 ms. So it is done in pieces, and the loop
goes on between them.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.clock import Clock
from rclpy.node import Node
from rclpy.serialization import serialize_message

from dfm_stage.middleware.scheduling import LOOP_PRIORITY, RealTime
from dfm_stage.middleware.shared_memory import killed_endpoints, killed_neighbours
from dfm_stage.middleware.watch import Notices, Watch

LOCKSTEP_PATIENCE_S = 5.0
PIECES = 10
"""In a second, each of 0.1 ms or so. With more of them a round takes longer than a second."""

_END = object()


class EachSecond(Node):
    """The part of a LoopNode that looks after itself; `each_second` is extended by nodes."""

    priority: int
    lockstep: bool
    steady: Clock
    realtime: RealTime
    counters: dict[str, int]
    warnings_active: Notices
    errors_active: Notices
    waiting_for: Callable[[], tuple[str, int] | None]
    has_namesakes: Callable[[str], None]
    status: Callable[..., DiagnosticStatus]
    report: Callable[[], dict[str, Any]]
    _watch: Watch
    _config: Any
    _diagnostics: Any
    _tell_health: Callable[[], None]
    _waiting_since: tuple[tuple[str, int] | None, float]
    _broken: str
    _pieces: Iterator[object] | None = None
    _done, _begun_s = 0, -math.inf

    def _next_piece(self) -> None:
        """Do what is due by the clock: a piece if asked in time, several if asked late."""
        now = time.monotonic()
        due = (now - self._begun_s) * PIECES - 0.5
        while self._pieces and self._done < due:
            self._done += 1
            if next(self._pieces, _END) is _END:
                self._pieces = None
        if self._pieces is None and due > PIECES - 1:
            self._pieces, self._done, self._begun_s = self.each_second(), 0, now

    def each_second(self) -> Iterator[None]:
        """Do what is to be done each second, and report; in pieces, the loop goes on between."""
        now = time.monotonic()
        if not self.lockstep:
            self._watch.look(now)
        yield
        self._look_for_namesakes()
        yield
        self._broken = self._what_is_broken() if self.realtime.wanted else ""
        yield
        self._look_for_waiting(now)
        level = (DiagnosticStatus.ERROR if self.errors_active
                 else DiagnosticStatus.WARN if self.warnings_active else DiagnosticStatus.OK)
        array = DiagnosticArray(status=[self.status(
            level, "; ".join((*self.errors_active.values(), *self.warnings_active.values())),
            {**self.counters, **self.report(), "scheduling": self.realtime.words})])
        array.header.stamp = self.get_clock().now().to_msg()
        yield
        data = serialize_message(array)
        yield
        with contextlib.suppress(Exception):
            self._diagnostics.publish(data)

    def _look_for_waiting(self, now: float) -> None:
        waiting = self.waiting_for() if self.lockstep else None
        if waiting != self._waiting_since[0]:
            self._waiting_since = waiting, now
        late = now - self._waiting_since[1] >= LOCKSTEP_PATIENCE_S
        missing = f"waiting for {waiting[0]}" if waiting is not None and late else ""
        if self.warnings_active.put("waiting", missing):
            self.get_logger().warning(f"lockstep: {missing}")

    def _look_for_namesakes(self) -> None:
        before, words = self.errors_active.get("name", ""), self._namesakes()
        if self.errors_active.put("name", words):
            self.get_logger().error(words)
        if words:
            self.has_namesakes(words)
        if words != before:
            self._tell_health()

    def _namesakes(self) -> str:
        """Say that other nodes have this one's name: both obey, and both publish."""
        topic = self._config.topic_name
        if self.count_publishers(topic) < 2:  # who they are takes longer to find out
            return ""
        killed = killed_endpoints()
        alive = sum(not bytes(info.endpoint_gid).startswith(killed)
                    for info in self.get_publishers_info_by_topic(topic))
        return (f"{alive} nodes are called {self.get_fully_qualified_name()}: end all but one"
                if alive > 1 else "")

    def _what_is_broken(self) -> str:
        if self._watch.silent:
            return "a topic of the loop is silent"
        killed = ", ".join(killed_neighbours())
        return f"killed and still written to: {killed}" if killed else ""

    def _look_at_priority(self) -> None:
        if (self.realtime.wanted and self.priority >= LOOP_PRIORITY
                and self.realtime.look(time.monotonic(), self._broken)):
            self.get_logger().info(f"scheduling: {self.realtime.words}")
            self.warnings_active.put("scheduling", "" if self.realtime.held else
                                     f"no real-time priority: {self.realtime.words}")
