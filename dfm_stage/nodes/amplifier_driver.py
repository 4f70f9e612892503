"""amplifier_driver: passes commands to the coil, and takes the output to zero if they stop.

Every cause that takes the output to zero latches (see dfm_stage.drivers.interlock): it stays at
zero, disarmed, until `clear` and `arm` are called. With hardware, one thread talks to the drive.
It notices by itself when commands stop.
"""

from __future__ import annotations

import math
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.serialization import serialize_message

from dfm_stage.drivers.device import AmplifierStatus, create_amplifier, names
from dfm_stage.drivers.errors import DriverError, RefusedError
from dfm_stage.drivers.interlock import Cause, Interlock
from dfm_stage.drivers.threads import AmplifierWorker
from dfm_stage.errors import DfmError
from dfm_stage.nodes.base import LOOP_HEALTH, Publisher
from dfm_stage.nodes.managed import ManagedNode, device_settings
from dfm_stage.nodes.parameters import Setting
from dfm_stage.nodes.process import run_node

_NO_SAMPLE = 0
_PUBLISHERS_PERIOD_S = 0.25
_MEASURED_MARGIN = 1.1
_MEASURED_MARGIN_A = 0.02
_LATCHED = "output"
_HELD_UP_S = 0.5
_TELL_PERIOD_S = 0.1


class AmplifierDriver(ManagedNode):
    """Answers every `command` with a drive and publishes `amplifier`."""

    kind = "amplifier_driver"
    example = "-p current_limit_a:=2.0 -p autoarm:=false    # simulated, armed by hand"
    settings_table = (
        *device_settings(names("amplifiers"), "what drives the coil"),
        Setting("voltage_limit_v", 10.0, "a command beyond this (V, or A with a current drive) "
                "is refused, the output is zero", "V", 0.0, 100.0),
        Setting("stale_timeout_s", 0.02, "without a command for this long the output is zero",
                "s", 0.001, 10.0),
        Setting("divergence_window_s", 0.5, "six saturated commands of alternating sign within "
                "this are a diverging loop; 0 = never", "s", 0.0, 100.0),
        Setting("current_limit_a", 0.0, "output and measured current beyond this are refused; "
                "0 = no limit, only in simulation", "A", 0.0, 100.0),
        Setting("autoarm", True, "arm at start; only in simulation"),
        Setting("baud", 115200, "hardware: rate of the line", "", 9600, 115200),
        Setting("amperes_per_volt", 1.0, "hardware: output per unit of command; 1 = commands are "
                "amperes, as with a model of drive: current", "A/V", -100.0, 100.0),
        Setting("continuous_limit_a", 0.0, "hardware: continuous limit that must be set in the "
                "drive; 0 = current_limit_a", "A", 0.0, 100.0),
        Setting("peak_time_s", 1.0, "hardware: longest peak time that may be set in the drive",
                "s", 0.0, 10.0),
        Setting("ramp_a_per_s", 0.0, "hardware: slope of the output in the drive; 0 = step",
                "A/s", 0.0, 1e6),
        Setting("reply_timeout_s", 0.01, "hardware: how long the drive may take to answer, three "
                "times, besides the time on the wire", "s", 0.001, 1.0),
        Setting("soft_start_s", 0.2, "hardware: commands grow to their full size over this time "
                "after arming", "s", 0.001, 10.0),
        Setting("shape_last_count", True, "hardware: spread what a current step leaves over "
                "(sigma-delta) instead of rounding"),
        Setting("measurement_timeout_s", 0.02, "a command that answers an older measurement goes "
                "out as zero, and latches: with hardware at once, in simulation where it lasts "
                "for stale_timeout_s; 0 = any age, only in simulation", "s", 0.0, 10.0),
        Setting("require_reference", True, "hardware: refuse to arm without a referenced "
                "encoder"),
        Setting("question_period_s", 0.02, "hardware: how often the drive is asked how it is; "
                "one exchange each", "s", 0.002, 10.0),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._limit_a: float = self.settings["current_limit_a"]
        self._gain: float = self.settings["amperes_per_volt"]
        self._interlock = self._new_interlock()
        self._off_bits = int(Cause.DISARMED)
        self._seq = 0
        self.counters |= {"commands": 0, "commands_too_old": 0}
        self._answered = _NO_SAMPLE
        self._checked_s = time.monotonic()
        self._armed_s = 0.0
        self._easing = False
        self._current = math.nan
        self._encoder: DiagnosticStatus | None = None
        self._loop: dict[str, DiagnosticStatus] = {}
        self._worker: AmplifierWorker | None = None
        self._drive: Publisher | None = None
        self._status_words: dict[str, str] = {}
        self._told: tuple[tuple[bytes, str], bytes] | None = None
        self._state = self.link_publisher("amplifier")
        self._health = self.side_publisher("amplifier_health")
        if self.simulated:
            self._drive = self.link_publisher("sim/drive")
            self.link_subscription("sim/current", self._on_current)
        self._commands = self.link_subscription("command", self._on_command)
        self.trigger_service("~/arm", self._arm)
        self.trigger_service("~/disarm", self._disarm)
        self.trigger_service("~/clear", self._clear)
        if not self.lockstep:
            self.side_subscription("encoder_health", self._on_health)
            self.side_subscription(LOOP_HEALTH, self._on_loop_health)
            self.beside_the_loop(_PUBLISHERS_PERIOD_S, self._check_publishers)
            self.beside_the_loop(_TELL_PERIOD_S, self._tell)
            if self.simulated:
                self.create_timer(self._interlock.stale_s / 4, self._check_stale,
                                  clock=self.steady)
        self.begin()
        self._tell()

    def _new_interlock(self) -> Interlock:
        limit, stale_s = self.settings["voltage_limit_v"], self.settings["stale_timeout_s"]
        if self._limit_a and not self.simulated and self._gain:
            limit = min(limit, self._limit_a / abs(self._gain))
        clocked = 0.0 if self.lockstep else 1.0
        return Interlock(
            limit, clocked * stale_s, clocked * self.settings["measurement_timeout_s"],
            clocked * self.settings["divergence_window_s"],
            stale_s if self.simulated else 0.0, self._on_trip)

    # Life cycle

    def configure(self) -> None:
        """Open the drive, its output at zero and off."""
        if self.simulated:
            return
        if not self._limit_a:
            raise DfmError("amplifier_driver: set current_limit_a to what the coil bears")
        if not self.settings["measurement_timeout_s"]:
            raise DfmError("amplifier_driver: set measurement_timeout_s; 0 is for simulation")
        self._device = create_amplifier(
            self.settings["device"], self.settings["port"], baud=self.settings["baud"],
            peak_limit_a=self._limit_a,
            continuous_limit_a=self.settings["continuous_limit_a"] or self._limit_a,
            peak_time_s=self.settings["peak_time_s"],
            ramp_a_per_s=self.settings["ramp_a_per_s"],
            reply_s=self.settings["reply_timeout_s"])
        self._status_words["device"] = self._device.open()
        self.get_logger().info(f"{self._status_words['device']} on {self.settings['port']}, "
                               "output off")

    def activate(self) -> None:
        """Listen to commands; in simulation with `autoarm` obey them, too."""
        if self._device is not None:
            self._worker = AmplifierWorker(
                self._device, self._interlock, self,
                current_limit_a=_MEASURED_MARGIN * self._limit_a + _MEASURED_MARGIN_A,
                shaped=self.settings["shape_last_count"],
                question_period_s=self.settings["question_period_s"],
                retry_s=self.settings["retry_s"])
            self._worker.start()
        elif self.settings["autoarm"]:
            self._interlock.arm()
            self._tell()

    def deactivate(self) -> None:
        """Zero and off."""
        self._interlock.disarm()
        self._off_bits = int(self._interlock.causes) or int(Cause.DISARMED)
        self._tell()
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        elif self._seq and self.context.ok():
            self._apply(self.now_ns(), 0.0, self._off_bits)

    # Commands

    def _on_command(self, command: Any) -> None:
        if not self.active:
            return
        interlock = self._interlock
        self._answered = command.measurement_seq
        stamp = command.stamp_ns if self.lockstep else time.time_ns()
        value = interlock.accept(command, time.monotonic(), stamp)
        self.counters["commands"] += 1
        self.counters["commands_too_old"] = interlock.too_old
        if self._worker is None:
            self._apply(stamp, value, 0 if interlock.armed else self._off_bits)
        elif interlock.armed:
            self._worker.command(value * self._gain * self._eased_in(), command.measurement_seq)

    def _eased_in(self) -> float:
        """Share of a command that goes out: a controller may have wound up while it was off."""
        if not self._easing:
            return 1.0
        share = (time.monotonic() - self._armed_s) / self.settings["soft_start_s"]
        if share >= 1.0:
            self._easing = False
        return min(1.0, share)

    def _check_stale(self) -> None:
        """Simulation: look for commands; a short hold-up of this process is not their absence."""
        now = time.monotonic()
        gap, self._checked_s = now - self._checked_s, now
        if math.isfinite(self._interlock.last_command_s) and (
                gap > max(_HELD_UP_S, self._interlock.stale_s)):
            self._trip(Cause.STALE_COMMAND, f"this process stood still for {gap:.2f} s")
        elif gap <= self._interlock.stale_s / 2 and self._interlock.stale(now):
            self._apply(self.now_ns(), 0.0, self._off_bits)

    def _apply(self, stamp_ns: int, value: float, faults: int) -> None:
        self._seq = (self._seq + 1) & 0xFFFFFFFF
        enabled = self._interlock.armed
        if self._drive is not None:
            self._drive.send(stamp_ns, self._seq, self._answered, value, enabled)
        if not self.lockstep:
            stamp_ns = time.time_ns()
        self._state.send(stamp_ns, self._seq, self._answered, value, self._current, enabled,
                         faults)

    def on_output(self, counts: int, answered: Any) -> None:
        """Publish what the drive has acknowledged; in the worker's thread."""
        if answered is not None:
            self._answered = answered
        value = counts * (self._device.count_a if self._device is not None else 0.0)
        self._apply(self.now_ns(), value / self._gain if self._gain else 0.0,
                    0 if self._interlock.armed else self._off_bits)

    # What takes the output to zero

    def _on_trip(self, cause: Cause, why: str) -> None:
        """Latch; in whatever thread found it."""
        self._off_bits = int(self._interlock.causes)
        name = str(cause.name).lower()
        self.count(f"trips_{name}")
        self.errors_active[_LATCHED] = self._tell()
        if self._worker is not None:
            self._worker.nudge()
        self.get_logger().error(f"output to zero: {name}: {why}")

    def _tell(self) -> str:
        """Say whether the output is on; return why it is not."""
        interlock, level, words = self._interlock, DiagnosticStatus.OK, ""
        if interlock.causes:
            level = DiagnosticStatus.ERROR
            words = f"output at zero until clear and arm: {interlock.words()}"
        elif not interlock.armed:
            level, words = DiagnosticStatus.WARN, "the output is disarmed"
        told = self._told       # another thread may tell another thing meanwhile
        if told is None or told[0] != (level, words):
            self._told = told = (level, words), serialize_message(self.status(level, words))
        if self.context.ok():
            self._health.publish(told[1])
        return words

    def _trip(self, cause: Cause, why: str) -> None:
        """Latch a cause that no command brought, and act on it now."""
        if self._interlock.armed:
            self._interlock.trip(cause, why)
            if self._drive is not None:
                self._apply(self.now_ns(), 0.0, self._off_bits)

    def _on_current(self, sample: Any) -> None:
        self._current = current = sample.current
        if self._limit_a and abs(current) > self._limit_a and not self.lockstep:
            self._trip(Cause.CURRENT, f"{current:.4g} A measured, the limit is "
                       f"{self._limit_a:g} A")

    def on_status(self, status: AmplifierStatus) -> None:
        """Take over what the drive said; in the worker's thread."""
        if status.current_a is not None:
            self._current = status.current_a
        if status.notes:
            self._status_words |= status.notes

    def _on_health(self, health: DiagnosticStatus) -> None:
        self._encoder = health
        if trouble := self._encoder_trouble():
            self._trip(Cause.TRAVEL if any(value.value == "travel" for value in health.values)
                       else Cause.ENCODER, trouble)

    def _on_loop_health(self, health: DiagnosticStatus) -> None:
        self._loop[health.name] = health
        if health.level == DiagnosticStatus.ERROR:
            self._trip(Cause.ENCODER, health.message)

    def _trouble(self) -> str:
        """Return why the output must not be on, as far as encoder and sampling period go."""
        if self.lockstep:
            return ""
        refused = (DiagnosticStatus.ERROR,) if self.simulated else (
            DiagnosticStatus.ERROR, DiagnosticStatus.WARN)
        return self._encoder_trouble() or "; ".join(
            each.message for each in self._loop.values() if each.level in refused)

    def _encoder_trouble(self) -> str:
        if self._encoder is None:
            return "" if self.simulated else "nothing is heard of an encoder_driver"
        if self._encoder.level == DiagnosticStatus.ERROR:
            return str(self._encoder.message)
        if self._encoder.level == DiagnosticStatus.WARN and not self.simulated and self.settings[
                "require_reference"]:
            return f"the encoder is {self._encoder.message}"
        return ""

    def has_namesakes(self, words: str) -> None:
        """Both drive the coil."""
        if not self.lockstep:
            self._trip(Cause.OTHER_PUBLISHER, words)

    def _check_publishers(self) -> None:
        """One node is to send commands; two of one name are told apart by their numbers."""
        if not self._interlock.armed or self._commands.ros.get_publisher_count() < 2:
            return  # who they are takes long to find out
        senders = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in
                   self.get_publishers_info_by_topic(self._commands.ros.topic_name)
                   if not info.node_name.startswith("_")}
        if len(senders) > 1:
            self._trip(Cause.OTHER_PUBLISHER, f"{len(senders)} nodes send commands: "
                       f"{', '.join(sorted(senders))}")

    # The operator

    def _arm(self) -> str:
        if not self.active:
            raise RefusedError(f"the driver is {self.life_cycle_state()}: activate it first")
        if self._interlock.armed:
            return "armed"
        if trouble := self._trouble():
            raise RefusedError(f"refused: {trouble}")
        try:
            if self._worker is None:
                self._interlock.arm()
            else:
                self._armed_s, self._easing = time.monotonic(), True
                self._worker.arm()
                self._armed_s = time.monotonic()
        except DriverError as error:
            raise RefusedError(f"refused: {error}") from error
        self._tell()
        if trouble := self._trouble():
            self._trip(Cause.ENCODER, trouble)
        return "armed"

    def _disarm(self) -> str:
        self._off_bits = int(self._interlock.causes) or int(Cause.DISARMED)
        if self._worker is not None:
            self._worker.disarm()
        else:
            self._interlock.disarm()
            if not self.lockstep and self.active:
                self._apply(self.now_ns(), 0.0, self._off_bits)
        self._tell()
        return "disarmed, output at zero"

    def _clear(self) -> str:
        """Forget what was latched; leaves the output disarmed."""
        if not self._interlock.causes and self._worker is None:
            return "nothing was latched"
        was = self._worker.clear() if self._worker is not None else (
            f"cleared: {self._interlock.clear()}")
        self._off_bits = int(Cause.DISARMED)
        self.errors_active.pop(_LATCHED, None)
        self._tell()
        return f"{was}; disarmed"

    # Reports

    def report(self) -> dict[str, Any]:
        """Return rate, ages, limits and what the drive says."""
        interlock, worker, device = self._interlock, self._worker, self._device
        age = time.monotonic() - interlock.last_command_s
        out: dict[str, Any] = {
            "state": self.life_cycle_state(), "armed": interlock.armed,
            "latched": interlock.words() or "nothing",
            "command rate": self.rate("commands", self.counters.get("commands", 0)),
            "command limit": f"{interlock.limit:g}",
            "stale after": f"{interlock.stale_s * 1e3:g} ms",
            "age of last command": f"{age * 1e3:.2f} ms"
            if math.isfinite(age) and not self.lockstep else None,
            "current": f"{self._current:.4g} A" if math.isfinite(self._current) else None,
            "current limit": f"{self._limit_a:g} A" if self._limit_a else None,
            "encoder": self._encoder.message if self._encoder is not None else None}
        if worker is not None:
            out |= {"connected": worker.connected, "reconnect attempts": worker.reconnects,
                    "output rate": self.rate("outputs", worker.outputs)}
            self.warnings_active.put("link", "" if worker.connected else
                                     "the drive does not answer")
        if device is not None:
            out |= {**self._status_words, **device.counters}
        return {key: value for key, value in out.items() if value is not None}

    def waiting_for(self) -> tuple[str, int] | None:
        """Without a command there is nothing to drive."""
        return None if self._seq else ("command", 0)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(AmplifierDriver, args)
