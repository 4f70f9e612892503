"""Managed (life-cycle) nodes: configured, activated, and in simulation started by themselves.

rclpy swallows what a transition's callback raises, and manages nothing but publishers. So here
every transition reports why it failed, in the log and in diagnostics, and a node looks at
`active` before it lets anything out.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from dfm_stage.errors import DfmError
from dfm_stage.nodes.base import LoopNode
from dfm_stage.nodes.parameters import Setting

SIM = "sim"
_LIFE_CYCLE = "life cycle"


def device_settings(devices: tuple[str, ...], what: str) -> tuple[Setting, ...]:
    """Return the parameters that every driver has."""
    return (
        Setting("device", SIM, what, choices=(SIM, *devices)),
        Setting("port", "", "serial port of the device, such as /dev/serial/by-id/..."),
        Setting("retry_s", 1.0, "how often a device that was lost is looked for", "s", 0.01,
                60.0),
        Setting("autostart", True, "configure and activate at start; only in simulation: "
                "hardware waits for configure and activate"),
    )


class ManagedNode(LifecycleNodeMixin, LoopNode):
    """A node between one device and the loop."""

    def __init__(self, **kwargs: Any) -> None:
        LoopNode.__init__(self, **kwargs)
        self.simulated: bool = self.settings["device"] == SIM
        self.active = False
        self._device: Any = None
        self._counted: dict[str, float] = {}

    def check_settings(self, values: dict[str, Any]) -> None:
        """Refuse hardware in lockstep."""
        if values["lockstep"] and values["device"] != SIM:
            raise DfmError(f"{self.get_name()}: device {values['device']} cannot run in lockstep, "
                           "which stops time; set lockstep to false")

    # What a node does in a transition; raising DfmError refuses it

    def configure(self) -> None:
        """Open and check the device; nothing is energised."""

    def activate(self) -> None:
        """Start to work."""

    def deactivate(self) -> None:
        """Stop, and leave the device safe."""

    def cleanup(self) -> None:
        """Give the device back."""
        if self._device is not None:
            self._device.close()
            self._device = None

    # Life cycle

    def start_work(self) -> None:
        """Become a managed node; in simulation with `autostart` an active one."""
        LifecycleNodeMixin.__init__(self)
        change = self._service_change_state.callback

        def guarded(request: Any, response: Any) -> Any:
            try:
                return change(request, response)
            except Exception as error:  # noqa: BLE001 a transition that is not there ends no node
                self.get_logger().warning(f"transition refused in state "
                                          f"{self.life_cycle_state()}: {error}".split("\n")[0])
                response.success = False
                return response

        self._service_change_state.callback = guarded
        if self.simulated and self.settings["autostart"]:
            self.trigger_configure()
            self.trigger_activate()
            if not self.active:
                raise DfmError(f"{self.get_name()}: {self.errors_active.get(_LIFE_CYCLE, '')}")

    def _transition(self, name: str, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except DfmError as error:
            self.errors_active.put(_LIFE_CYCLE, f"{name} failed: {error}")
            self.get_logger().error(self.errors_active[_LIFE_CYCLE])
            return TransitionCallbackReturn.FAILURE
        except Exception as error:  # noqa: BLE001 rclpy would swallow it
            self.errors_active.put(_LIFE_CYCLE, f"{name} failed: {error!r}")
            self.get_logger().error(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        self.errors_active.put(_LIFE_CYCLE, "")
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Open the device."""
        return self._transition("configure", self.configure)

    def on_activate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Start to work."""
        result = self._transition("activate", self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop."""
        self.active = False
        return self._transition("deactivate", self.deactivate)

    def on_cleanup(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Give the device back."""
        return self._transition("cleanup", self.cleanup)

    def on_shutdown(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """Stop and give the device back."""
        return self._transition("shutdown", self._end)

    def on_error(self, _state: LifecycleState) -> TransitionCallbackReturn:
        """After an unexpected error: safe, given back, unconfigured."""
        return self._transition("shutdown after an error", self._end)

    def _end(self) -> None:
        was_active, self.active = self.active, False
        try:
            if was_active:
                self.deactivate()
        finally:
            self.cleanup()

    def destroy_node(self) -> None:
        """Leave the device safe, whatever ended the node."""
        self._transition("shutdown", self._end)
        self._state_machine.destroy_when_not_in_use()  # it keeps the participant
        super().destroy_node()

    # Diagnostics

    def rate(self, name: str, total: float) -> str:
        """Return how fast a count rises, since the last call, in words."""
        now = time.monotonic()
        before, when = self._counted.get(name, total), self._counted.get(f"{name} at", now)
        self._counted[name], self._counted[f"{name} at"] = total, now
        return f"{(total - before) / (now - when):.1f} Hz" if now > when else "0.0 Hz"

    def life_cycle_state(self) -> str:
        """Return the name of the life-cycle state."""
        return str(self._state_machine.current_state[1])
