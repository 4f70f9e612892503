"""amplifier_driver: commands to the coil, checked; zero when they stop, are wrong or unwanted."""

from __future__ import annotations

import math
import time
from typing import Any

from std_srvs.srv import Trigger

from dfm_interfaces.msg import AmplifierState
from dfm_stage.nodes.base import LoopNode, run_node
from dfm_stage.nodes.parameters import Setting

_NO_SAMPLE = 0


class AmplifierDriver(LoopNode):
    """Answers every `command` with a drive and publishes `amplifier`."""

    kind = "amplifier_driver"
    settings_table = (
        Setting("device", "sim", "what drives the coil", choices=("sim",)),
        Setting("voltage_limit_v", 10.0, "a command beyond this is refused, the output is zero",
                "V", 0.0, 100.0),
        Setting("stale_timeout_s", 0.02, "without a command for this long the output is zero",
                "s", 0.001, 10.0),
        Setting("autoarm", True, "arm at start; only in simulation"),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._limit: float = self.settings["voltage_limit_v"]
        self._stale_s: float = self.settings["stale_timeout_s"]
        self._armed: bool = self.settings["autoarm"]
        self._seq = 0
        self._answered = _NO_SAMPLE
        self._last_command_s = math.inf
        self._voltage = 0.0
        self._current = math.nan
        self._drive = self.link_publisher("sim/drive")
        self._state = self.link_publisher("amplifier")
        self.link_subscription("command", self._on_command)
        self.link_subscription("sim/current", self._on_current)
        self.create_service(Trigger, "~/arm", self._on_arm)
        self.create_service(Trigger, "~/disarm", self._on_disarm)
        if not self.lockstep:
            self.create_timer(self._stale_s / 4, self._check_stale, clock=self.steady)
        self.publish_config()

    def _on_current(self, sample: Any) -> None:
        self._current = sample.current

    def _on_command(self, command: Any) -> None:
        voltage = command.voltage
        faults = 0
        if not math.isfinite(voltage):
            faults |= AmplifierState.FAULT_NOT_FINITE
            self.count("commands_not_finite")
        elif abs(voltage) > self._limit:
            faults |= AmplifierState.FAULT_OUT_OF_RANGE
            self.count("commands_out_of_range")
        if not self._armed:
            faults |= AmplifierState.FAULT_DISARMED
        self._last_command_s = time.monotonic()
        self._answered = command.measurement_seq
        stamp = command.stamp_ns if self.lockstep else self.now_ns()
        self._apply(stamp, 0.0 if faults else voltage, faults)
        self.count("commands")

    def _check_stale(self) -> None:
        age = time.monotonic() - self._last_command_s
        if age > self._stale_s:
            self._last_command_s = math.inf
            self.count("stale")
            self.warnings_active["stale"] = (
                f"no command for {self._stale_s * 1e3:g} ms: output at zero")
            self._apply(self.now_ns(), 0.0, AmplifierState.FAULT_STALE_COMMAND)
        elif age >= 0.0:
            self.warnings_active.pop("stale", None)

    def _apply(self, stamp_ns: int, voltage: float, faults: int) -> None:
        self._seq += 1
        self._voltage = voltage
        self._drive.send(stamp_ns, self._seq, self._answered, voltage, self._armed)
        if not self.lockstep:
            stamp_ns = self.now_ns()
        self._state.send(stamp_ns, self._seq, self._answered, voltage, self._current, self._armed,
                         faults)

    def _on_arm(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._armed = True
        response.success, response.message = True, "armed"
        return response

    def _on_disarm(self, _request: Trigger.Request,
                   response: Trigger.Response) -> Trigger.Response:
        self._armed = False
        if not self.lockstep:
            self._apply(self.now_ns(), 0.0, AmplifierState.FAULT_DISARMED)
        response.success, response.message = True, "disarmed, output at zero"
        return response

    def waiting_for(self) -> tuple[str, int] | None:
        """Without a command there is nothing to drive."""
        return None if self._seq else ("command", 0)


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(AmplifierDriver, args)
