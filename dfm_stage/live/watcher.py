"""The ROS side of the live view: finds the axes, listens, and passes the operator's wishes on."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from dfm_interfaces.msg import AmplifierState
from dfm_stage.live.trace import Trace
from dfm_stage.middleware.wire import codec
from dfm_stage.nodes.process import Helper
from dfm_stage.nodes.wiring import LINKS

MEASUREMENT = "dfm_interfaces/msg/Measurement"
# best effort: whoever watches never holds the loop up
QOS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=2000,
                 reliability=ReliabilityPolicy.BEST_EFFORT)
FAULTS = {getattr(AmplifierState, name): name.removeprefix("FAULT_").replace("_", " ").lower()
          for name in dir(AmplifierState) if name.startswith("FAULT_")}
WISHES = {"arm": "amplifier_driver/arm", "disarm": "amplifier_driver/disarm",
          "clear": "amplifier_driver/clear", "stop": "trajectory_generator/stop"}
LOOK_PERIOD_S = 0.5
ANSWER_S = 2.0
SILENT_S = 0.5
Answer = Callable[[str], None]


class Watcher:
    """Listens in a thread of its own from `start` to `close`."""

    def __init__(self) -> None:
        self._ros = Helper("view", "/stage")
        self._ros.node.create_subscription(DiagnosticArray, "/diagnostics",
                                           self._on_diagnostics, 50)
        self._clients: dict[str, Any] = {}
        self._lock = threading.Lock()
        self._traces: dict[str, Trace] = {}
        self._rates: dict[str, tuple[float, int, float, float]] = {}
        self._nodes: dict[str, dict[str, Any]] = {}
        self._wishes: SimpleQueue[tuple[str, Answer]] = SimpleQueue()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)

    def start(self) -> None:
        """Begin to listen."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node."""
        self._ending.set()
        if self._thread.is_alive():
            self._thread.join()
        self._ros.close()

    def wish(self, what: str, axis: str, answer: Answer) -> None:
        """Ask for one of WISHES on an axis; `answer` gets the node's words, in another thread."""
        self._wishes.put((f"{axis}/{WISHES[what]}", answer))

    def look(self) -> dict[str, Any]:
        """Return what is new since the last look, as plain data for JSON."""
        now = time.monotonic()
        with self._lock:
            return {"axes": {name: self._axis(name, trace, now)
                             for name, trace in self._traces.items()},
                    "nodes": list(self._nodes.values())}

    def _axis(self, name: str, trace: Trace, now: float) -> dict[str, Any]:
        since, before, rate, last = self._rates.get(name, (now, trace.heard, 0.0, now))
        if now - since > LOOK_PERIOD_S:
            rate, since, before = (trace.heard - before) / (now - since), now, trace.heard
        rows = trace.rows(everything=now - last > SILENT_S)
        last = now if rows else last
        self._rates[name] = since, before, rate, last
        said = trace.amplifier
        return {"rows": rows, "every": trace.every, "rate_hz": rate,
                "silent": now - last > 2.0 * SILENT_S, "flags": trace.flags,
                "enabled": None if said is None else said.enabled,
                "faults": [] if said is None else [
                    text for bit, text in FAULTS.items() if said.faults & bit]}

    # In the thread

    def _run(self) -> None:
        looked = -math.inf
        while not self._ending.is_set():
            if time.monotonic() - looked > LOOK_PERIOD_S:
                looked = time.monotonic()
                self._find_axes()
            for _ in range(64):
                self._ros.executor.spin_once(0.01)
                if not self._wishes.empty() or self._ending.is_set():
                    break
            self._pass_on()

    def _find_axes(self) -> None:
        for name, types in self._ros.node.get_topic_names_and_types():
            axis, _, topic = name.rpartition("/")
            if topic == "measurement" and MEASUREMENT in types and axis not in self._traces:
                trace = Trace()
                for part, take in (("measurement", trace.on_measurement),
                                   ("reference", trace.on_reference),
                                   ("amplifier", trace.on_amplifier)):
                    self._listen(f"{axis}/{part}", LINKS[part].type, take)
                with self._lock:
                    self._traces[axis] = trace

    def _listen(self, topic: str, kind: Any, take: Callable[[Any], None]) -> None:
        decode = codec(kind).decode

        def heard(data: bytes) -> None:
            message = decode(data)
            with self._lock:
                take(message)

        self._ros.node.create_subscription(kind, topic, heard, QOS, raw=True)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        with self._lock:
            for status in array.status:
                self._nodes[status.name] = {
                    "name": status.name, "level": status.level[0], "message": status.message,
                    "values": [[each.key, each.value] for each in status.values]}

    def _pass_on(self) -> None:
        while True:
            try:
                service, answer = self._wishes.get_nowait()
            except Empty:
                return
            if service not in self._clients:  # kept, as by NodeSet
                self._clients[service] = self._ros.node.create_client(Trigger, service)
            client = self._clients[service]
            deadline = time.monotonic() + ANSWER_S
            future, said = None, f"no answer within {ANSWER_S:g} s"
            while time.monotonic() < deadline and not self._ending.is_set():
                if future is None and client.service_is_ready():
                    future = client.call_async(Trigger.Request())
                self._ros.executor.spin_once(0.01)
                if future is not None and future.done():
                    said = future.result().message
                    break
            answer(f"{service}: {said}")
