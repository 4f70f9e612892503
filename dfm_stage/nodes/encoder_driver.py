"""encoder_driver: converts counts to metres, with time stamp and number, and checks them.

The counts come from the simulated scale, or from a serial counter that a thread reads. If they are
lost, implausible or beyond the travel, `encoder_health` (latched) reports it at once. Then
amplifier_driver takes the output to zero, whatever the controller does.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from dfm_interfaces.msg import Measurement
from dfm_stage.drivers.device import EncoderSample, create_encoder, names
from dfm_stage.drivers.errors import RefusedError
from dfm_stage.drivers.threads import EncoderReader
from dfm_stage.errors import DfmError
from dfm_stage.middleware.wire import encode_joint_state
from dfm_stage.nodes.managed import ManagedNode, device_settings
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import run_node

_JOINT_STATE_PERIOD_S = 0.05
_SHORTEST_STEP_S = 1e-3
_BACKWARDS = 0x80000000
_TWO_SOURCES_NS = 10**9
_REFERENCED = Measurement.FLAG_REFERENCED


class EncoderDriver(ManagedNode):
    """Publishes `measurement` for every sample of the device."""

    kind = "encoder_driver"
    example = "-p travel_limit_m:=0.005 -r __ns:=/stage/y    # the simulated scale of axis y"
    settings_table = (
        *device_settings(names("encoders"), "where the counts come from"),
        Setting("resolution_m", 0.0, "length of one count; 0 takes what the simulation says", "m",
                0.0, 1e-3),
        Setting("reversed", False, "the scale counts against the positive direction"),
        Setting("zero_counts", 0, "counts at position zero", "counts", -2**53, 2**53),
        Setting("travel_limit_m", 7.7e-3, "a position beyond this is an alarm", "m", 0.0, 1.0),
        Setting("velocity_limit_m_per_s", 1.0,
                "a faster step between samples is implausible, an alarm", "m/s", 0.0, 1e3),
        Setting("stream_interval", 1, "qsb_d: time between samples in 1/512 s", "", 1, 65534),
        Setting("encoder_timeout_s", 0.02, "hardware: without a sample for this long the encoder "
                "is lost", "s", 0.001, 10.0),
        Setting("reference", "operator", "what home does: here is zero, or the next index mark "
                "is", choices=("operator", "index")),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._sign = -1 if self.settings["reversed"] else 1
        self._zero: int = self.settings["zero_counts"]
        self._resolution: float = self.settings["resolution_m"]
        self._travel: float = self.settings["travel_limit_m"]
        self._speed: float = self.settings["velocity_limit_m_per_s"]
        self.counters["samples"] = 0
        self._last_seq: int | None = None
        self._seq_base = self._next_seq = 0
        self._last_stamp_ns = 0
        self._restarted_ns = -_TWO_SOURCES_NS
        self._last_counts = 0
        self._last_position = 0.0
        self._flags = _REFERENCED if self.simulated else 0
        self._reader: EncoderReader | None = None
        self._identity = ""
        self._alarms: dict[str, str] = {}
        self._raised: set[str] = set()
        self._out = self.link_publisher("measurement")
        self._health = self.side_publisher("encoder_health")
        self._joint_states = self.side_sender("joint_states")
        self.beside_the_loop(_JOINT_STATE_PERIOD_S, self._publish_joint_state)
        self.trigger_service("~/home", self._home)
        if self.simulated:
            self.link_subscription("sim/position_counts", self._on_counts)
        self.begin()
        self._publish_health()

    # Life cycle

    def configure(self) -> None:
        """Open the counter and check that it is what it should be."""
        if self.simulated:
            return
        if not self._resolution:
            raise DfmError("encoder_driver: a counter does not know the scale; set resolution_m "
                           "to the length of one count")
        self._device = create_encoder(self.settings["device"], self.settings["port"],
                                      stream_interval=self.settings["stream_interval"])
        self._identity = self._device.open()
        self.get_logger().info(f"{self._identity} on {self.settings['port']}, not referenced")
        self._unreference()

    def activate(self) -> None:
        """Start the stream."""
        self._last_seq = None
        if self._device is not None:
            self._reader = EncoderReader(self._device, self, self.settings["encoder_timeout_s"],
                                         self.settings["retry_s"])
            self._reader.start()

    def deactivate(self) -> None:
        """Stop the stream; what is not watched is not referenced."""
        if self._reader is not None:
            self._reader.stop()
            self._reader = None
            self._unreference()

    def config(self) -> dict[str, Any]:
        """Return what answered at the port."""
        return {"identity": self._identity} if self._identity else {}

    # Samples

    def _on_counts(self, sample: Any) -> None:
        if self.active:
            self._emit(sample.seq, sample.stamp_ns, sample.counts,
                       (sample.stamp_ns - self._last_stamp_ns) * 1e-9,
                       self._resolution or sample.resolution)

    def on_sample(self, sample: EncoderSample) -> None:
        """Pass a sample on, numbered on past restarts of the device; in the reader's thread."""
        if self._last_seq is None:
            self._seq_base = self._next_seq - sample.seq
        seq = (sample.seq + self._seq_base) & 0xFFFFFFFF
        self._next_seq = seq + 1
        self._emit(seq, sample.stamp_ns, sample.counts, sample.elapsed_s,
                   self._resolution)

    def _emit(self, seq: int, stamp_ns: int, raw: int, elapsed_s: float,
              resolution: float) -> None:
        counts = self._sign * raw - self._zero
        position = counts * resolution
        flags = self._flags
        if abs(position) > self._travel and flags & _REFERENCED:
            flags |= Measurement.FLAG_OUT_OF_TRAVEL
            self.count("out_of_travel")
            self._alarm("travel", f"at {position * 1e3:.4g} mm, beyond the travel of "
                        f"{self._travel * 1e3:.4g} mm")
        if self._last_seq is not None:
            lost = (seq - self._last_seq - 1) & 0xFFFFFFFF
            if lost >= _BACKWARDS:
                self._on_restart(stamp_ns)
            elif lost:
                flags |= Measurement.FLAG_SAMPLES_LOST
                self.count("samples_lost", lost)
            step = abs(raw - self._last_counts) * resolution
            # a late plant makes up for samples in no time
            if step > self._speed * max(elapsed_s, _SHORTEST_STEP_S):
                flags |= Measurement.FLAG_IMPLAUSIBLE
                self.count("implausible")
                if flags & _REFERENCED:  # on the way to the index the count is allowed to jump
                    self._alarm("implausible", f"moved {step * 1e3:.4g} mm in "
                                f"{elapsed_s * 1e3:.4g} ms")
        self._last_seq = seq
        self._last_stamp_ns = stamp_ns
        self._last_counts = raw
        self._last_position = position
        if "sources" not in self._alarms:  # the positions of two stages in turn are of no use
            self._out.send(stamp_ns, seq, position, counts, flags)
        self.counters["samples"] += 1

    # Loss and return, in the reader's thread

    def on_lost(self, why: str) -> None:
        """Say at once that there are no samples any more."""
        self.count("encoder_losses")
        self._flags = 0
        self._last_seq = None
        self._alarm("lost", f"encoder lost: {why}")

    def on_back(self, identity: str) -> None:
        """A counter that comes back has lost its zero."""
        self._identity = identity
        self._alarms.pop("lost", None)
        self._unreference()

    def _unreference(self) -> None:
        self._flags = 0
        self._last_seq = None
        self.warnings_active["reference"] = ("not referenced: bring the stage to its zero and "
                                             "call home")
        self._publish_health()

    def has_namesakes(self, words: str) -> None:
        """Each measurement comes twice, or two stages take turns."""
        self._alarm("name", words)

    def _on_restart(self, stamp_ns: int) -> None:
        """Count a source that numbers anew; one that does so twice in a second is two sources."""
        self.count("source_restarts")
        before, self._restarted_ns = self._restarted_ns, stamp_ns
        if 0 <= stamp_ns - before < _TWO_SOURCES_NS:
            self._alarm("sources", "the samples come from two sources: end one")

    def _alarm(self, kind: str, text: str) -> None:
        """Publish a trouble the moment it comes up; it stays up for a second at least."""
        self._raised.add(kind)
        if kind not in self._alarms:
            self._alarms[kind] = self.errors_active[kind] = text
            self._publish_health()

    def _publish_health(self) -> None:
        level, words = DiagnosticStatus.OK, ""
        alarms = dict(self._alarms)
        cause = "travel" if list(alarms) == ["travel"] else "encoder" if alarms else ""
        if alarms:
            level, words = DiagnosticStatus.ERROR, "; ".join(alarms.values())
        elif not (self.active and self._flags & _REFERENCED):
            level = DiagnosticStatus.WARN
            words = "not active" if self._flags & _REFERENCED else "not referenced"
        self._health.publish(self.status(level, words, {"cause": cause}))

    # Referencing

    def _home(self) -> str:
        if not self.active or self._last_seq is None:
            raise RefusedError("there are no samples: activate the driver first")
        if self.settings["reference"] == "operator":
            self._zero = self._sign * self._last_counts
            self._referenced()
            return "zero is here"
        if self._reader is None:
            raise RefusedError("the simulated scale has no index: set reference to operator")
        self._unreference()
        self._reader.seek_index()
        return "looking for the index: move the stage over it by hand"

    def on_index(self) -> None:
        """The index was passed: the counter's own zero, plus zero_counts, is position zero."""
        self._zero = self.settings["zero_counts"]
        self._last_seq = None
        self._referenced()
        self.get_logger().info("the index is found, the position referenced")

    def _referenced(self) -> None:
        self._flags = _REFERENCED
        self.warnings_active.pop("reference", None)
        self._publish_health()

    # Reports

    def each_second(self) -> Iterator[None]:
        """Forget alarms that are over."""
        over = [kind for kind in self._alarms if kind not in self._raised and kind != "lost"]
        self._raised.clear()
        for kind in over:
            self._alarms.pop(kind, None)
        for kind in ("travel", "implausible", "lost", "sources"):
            if kind not in self._alarms:
                self.errors_active.pop(kind, None)
        if over:
            self._publish_health()
        yield
        yield from super().each_second()

    def report(self) -> dict[str, Any]:
        """Return rate, age and what the line did."""
        age = f"{(self.now_ns() - self._last_stamp_ns) * 1e-6:.2f} ms"
        device, reader = self._device, self._reader
        return {"state": self.life_cycle_state(), "referenced": bool(self._flags & _REFERENCED),
                "sample rate": self.rate("samples", self.counters["samples"]),
                "travel limit": f"{self._travel * 1e3:g} mm",
                "velocity limit": f"{self._speed:g} m/s",
                **({"age of last sample": age}
                   if self._last_seq is not None and not self.lockstep else {}),
                **({"device": self._identity, **device.counters} if device is not None else {}),
                **({"reconnect attempts": reader.reconnects} if reader is not None else {})}

    def _publish_joint_state(self) -> None:
        if self._last_seq is not None:
            self._joint_states.put(encode_joint_state(
                self._last_stamp_ns, self.axis.encode(), self._last_position))

    def waiting_for(self) -> tuple[str, int] | None:
        """Without a first sample there is nothing to answer."""
        return None if self._last_seq is not None else ("sim/position_counts", 0)

    def not_ready(self) -> str | None:
        """The simulated scale must be there."""
        if not self.simulated or self.count_publishers("sim/position_counts"):
            return None
        return "no sim_plant"


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(EncoderDriver, args)
