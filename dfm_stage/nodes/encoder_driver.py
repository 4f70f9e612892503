"""encoder_driver: counts of the scale to metres, dated, numbered and checked for plausibility."""

from __future__ import annotations

from typing import Any

from sensor_msgs.msg import JointState

from dfm_interfaces.msg import Measurement
from dfm_stage.nodes.base import LoopNode, run_node
from dfm_stage.nodes.parameters import Setting

_JOINT_STATE_PERIOD_S = 0.05


class EncoderDriver(LoopNode):
    """Publishes `measurement` for every sample of the device."""

    kind = "encoder_driver"
    settings_table = (
        Setting("device", "sim", "where the counts come from", choices=("sim",)),
        Setting("resolution_m", 0.0, "length of one count; 0 takes what the device says", "m",
                0.0, 1e-3),
        Setting("reversed", False, "the scale counts against the positive direction"),
        Setting("zero_counts", 0, "counts at position zero", "counts", -2**53, 2**53),
        Setting("travel_limit_m", 7.7e-3, "positions beyond this are flagged", "m", 0.0, 1.0),
        Setting("velocity_limit_m_per_s", 1.0,
                "a faster step between samples is flagged as implausible", "m/s", 0.0, 1e3),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._sign = -1 if self.settings["reversed"] else 1
        self._zero: int = self.settings["zero_counts"]
        self._resolution: float = self.settings["resolution_m"]
        self._travel: float = self.settings["travel_limit_m"]
        self._speed: float = self.settings["velocity_limit_m_per_s"]
        self._last: Any = None
        self._last_position = 0.0
        self._out = self.link_publisher("measurement")
        self._joint_states = self.create_publisher(JointState, "joint_states", 10)
        self.create_timer(_JOINT_STATE_PERIOD_S, self._publish_joint_state, clock=self.steady)
        self.link_subscription("sim/position_counts", self._on_counts)
        self.publish_config()

    def _on_counts(self, sample: Any) -> None:
        resolution = self._resolution or sample.resolution
        counts = self._sign * sample.counts - self._zero
        position = counts * resolution
        flags = Measurement.FLAG_REFERENCED
        if abs(position) > self._travel:
            flags |= Measurement.FLAG_OUT_OF_TRAVEL
            self.count("out_of_travel")
        last = self._last
        if last is not None:
            lost = (sample.seq - last.seq - 1) & 0xFFFFFFFF
            if lost:
                flags |= Measurement.FLAG_SAMPLES_LOST
                self.count("samples_lost", lost)
            elapsed = (sample.stamp_ns - last.stamp_ns) * 1e-9
            if elapsed > 0.0 and abs(position - self._last_position) > self._speed * elapsed:
                flags |= Measurement.FLAG_IMPLAUSIBLE
                self.count("implausible")
        self._last = sample
        self._last_position = position
        self._out.send(sample.stamp_ns, sample.seq, position, counts, flags)
        self.count("samples")

    def _publish_joint_state(self) -> None:
        if self._last is None:
            return
        sec, nanosec = divmod(self._last.stamp_ns, 1_000_000_000)
        state = JointState(name=[self.axis], position=[self._last_position])
        state.header.stamp.sec, state.header.stamp.nanosec = sec, nanosec
        self._joint_states.publish(state)

    def waiting_for(self) -> tuple[str, int] | None:
        """Without a first sample there is nothing to answer."""
        return None if self._last is not None else ("sim/position_counts", 0)

    def not_ready(self) -> str | None:
        """The scale must be there."""
        return None if self.count_publishers("sim/position_counts") else "no sim_plant"


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(EncoderDriver, args)


