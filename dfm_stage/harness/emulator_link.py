"""Between an emulated device and sim_plant: the scale as a count at any time, the coil's current.

sim_plant samples on its own grid; a counter samples on another. In between, the position goes on
as the last two samples say. Everything else the device does is in its emulator, which knows no
ROS.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.executors import ExternalShutdownException

from dfm_interfaces.msg import Drive, PositionCounts
from dfm_stage.drivers.clock_map import ClockMap, Unwrap
from dfm_stage.middleware.wire import codec
from dfm_stage.nodes.process import Helper
from dfm_stage.nodes.wiring import PUBLISHER_QOS

_STEADY_GAP_S = 0.5
_LOOK_S = 0.01


class StageLink:
    """One side of one axis of sim_plant, for the emulator of one device.

    Parameters
    ----------
    namespace : str
        The axis, such as `/stage/x`.
    name : str
        Name of the node.
    sample_period_s : float
        That of the plant's model.
    resolution_m : float, optional
        Length of a count of the emulated scale; by default that of the simulated one.
    """

    def __init__(self, namespace: str, name: str, sample_period_s: float,
                 resolution_m: float = 0.0) -> None:
        self._ros = Helper(name, namespace)
        self._resolution_m = resolution_m
        self._grid = ClockMap(sample_period_s)
        self._number = Unwrap()
        self._last: tuple[int, float, float] = (0, 0.0, 0.0)
        self._heard_s = 0.0
        self._seq = 0
        self._drive: Any = None
        self._peers: Callable[[], int]
        self._encode = codec(Drive, namespace.rpartition("/")[2]).encode
        self._stopping = False
        self._thread = threading.Thread(target=self._spin, daemon=True)

    def start(self) -> None:
        """Run the ROS side in a thread of its own."""
        self._thread.start()

    def met(self, timeout_s: float, stop: Sequence[int] = ()) -> bool:
        """Wait until this side has found sim_plant, or something is in `stop`; return whether it
        has."""
        deadline = time.monotonic() + timeout_s
        while not self._peers() and not stop and time.monotonic() < deadline:
            time.sleep(_LOOK_S)
        return bool(self._peers())

    def _spin(self) -> None:
        try:
            while not self._stopping and self._ros.ok():
                self._ros.executor.spin_once(timeout_sec=0.1)
        except ExternalShutdownException:
            return

    # The scale

    def read_scale(self) -> None:
        """Listen to the simulated scale."""
        decode = codec(PositionCounts).decode
        scale = self._ros.node.create_subscription(
            PositionCounts, "sim/position_counts", lambda data: self._on_counts(decode(data)),
            PUBLISHER_QOS, raw=True)
        self._peers = scale.get_publisher_count

    def _on_counts(self, sample: Any) -> None:
        now = time.monotonic()
        if now - self._heard_s > _STEADY_GAP_S:
            self._grid.restart()
            self._number.restart()
        self._heard_s = now
        number = self._number(sample.seq)
        self._grid(number, time.monotonic_ns())
        counts = sample.counts * (
            sample.resolution / self._resolution_m if self._resolution_m else 1.0)
        last_number, last_counts, _ = self._last
        step = number - last_number
        self._last = (number, counts, (counts - last_counts) / step if 0 < step < 100 else 0.0)

    def counts(self, now_s: float) -> int:
        """Return the scale's count at a time of the steady clock, s."""
        number, counts, per_sample = self._last
        ahead = self._grid.at(int(now_s * 1e9)) - number
        return round(counts + per_sample * min(max(ahead, -2.0), 2.0))

    # The coil

    def drive_coil(self) -> None:
        """Become the one who drives the simulated coil."""
        self._drive = self._ros.node.create_publisher(Drive, "sim/drive", PUBLISHER_QOS)
        self._peers = self._drive.get_subscription_count

    def output(self, _now_s: float, current_a: float, enabled: bool) -> None:
        """Put a current into the simulated coil."""
        if self._drive is None:
            return
        self._seq += 1
        self._drive.publish(self._encode(time.time_ns(), self._seq & 0xFFFFFFFF, 0,
                                         float(current_a), bool(enabled)))

    def close(self) -> None:
        """Leave the graph."""
        self._stopping = True
        self._thread.join(5.0)
        self._ros.close()
