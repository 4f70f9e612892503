"""controller: one command for every measurement, by the law that `mode` names, plus excitation.

In lockstep it waits for reference and excitation of the same sample. In real time it answers at
once with the reference that was sent ahead for this sample, or, where that is late, with the last
one (counted).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from dfm_stage.control import PID_PARAMETERS, Pid, PidGains
from dfm_stage.control.gains import ANTI_WINDUP
from dfm_stage.nodes.base import LoopNode, run_node
from dfm_stage.nodes.parameters import Setting

_MODES = ("open_loop", "pid")


class _AtZero(NamedTuple):
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0


_AT_ZERO = _AtZero()


class Controller(LoopNode):
    """Answers every `measurement` with a `command`."""

    kind = "controller"
    settings_table = (
        Setting("mode", "pid", "control law; open_loop passes the excitation on as it is",
                choices=_MODES, live=True),
        Setting("sample_period_s", 0.001, "sample period of the loop", "s", 1e-5, 1.0),
        *(Setting.of(parameter, live=True) for parameter in PID_PARAMETERS),
        Setting("anti_windup", "back_calculation", "what keeps the integral from winding up",
                choices=ANTI_WINDUP, live=True),
    )

    def __init__(self, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self._period: float = self.settings["sample_period_s"]
        self._pid = Pid(self._gains(self.settings.values), self._period)
        self._mode: str = self.settings["mode"]
        self._limit: float = self.settings["output_limit_v"]
        self._seq = 0
        self._last_seq: int | None = None
        self._last_voltage = 0.0
        self._measurement: Any = None
        self._reference: Any = None
        self._next_reference: Any = None
        self._excitation: Any = None
        self._next_excitation: Any = None
        self._out = self.link_publisher("command")
        self.link_subscription("measurement", self._on_measurement)
        self.link_subscription("reference", self._on_reference)
        self.link_subscription("excitation", self._on_excitation)
        self.publish_config()

    # Parameters

    @staticmethod
    def _gains(values: dict[str, Any]) -> PidGains:
        names = [parameter.name for parameter in PID_PARAMETERS] + ["anti_windup"]
        return PidGains(**{name: values[name] for name in names})

    def check_settings(self, values: dict[str, Any]) -> None:
        """Refuse gains that the law cannot work with."""
        self._gains(values)

    def settings_applied(self, names: set[str]) -> None:
        """Take over new gains and modes without a bump."""
        self._limit = self.settings["output_limit_v"]
        self._pid.set_gains(self._gains(self.settings.values))
        mode = self.settings["mode"]
        if mode != self._mode and mode == "pid":
            self._pid.reset()
            if self._measurement is not None:
                reference = self._reference.position if self._reference is not None else 0.0
                self._pid.track(self._last_voltage, reference, self._measurement.position)
        self._mode = mode
        self.publish_config()

    # The loop

    def _on_measurement(self, measurement: Any) -> None:
        self._measurement = measurement
        if self.lockstep:
            self._answer_when_complete()
            return
        self._reference = self._due(self._reference, self._next_reference, measurement.seq)
        self._excitation = self._due(self._excitation, self._next_excitation, measurement.seq)
        self._answer(measurement)

    def _due(self, last: Any, ahead: Any, seq: int) -> Any:
        if ahead is None or ahead is last:
            return last
        if ahead.seq == seq:
            return ahead
        self.count("reference_late")
        return ahead if last is None or (seq - ahead.seq) & 0x80000000 == 0 else last

    def _on_reference(self, reference: Any) -> None:
        self._next_reference = reference
        if self.lockstep:
            self._reference = reference
            self._answer_when_complete()

    def _on_excitation(self, excitation: Any) -> None:
        self._next_excitation = excitation
        if self.lockstep:
            self._excitation = excitation
            self._answer_when_complete()

    def _answer_when_complete(self) -> None:
        measurement, reference, excitation = self._measurement, self._reference, self._excitation
        if (measurement is not None and reference is not None and excitation is not None
                and reference.seq == measurement.seq == excitation.seq
                and self._last_seq != measurement.seq):
            self._answer(measurement)

    def _answer(self, measurement: Any) -> None:
        samples = 1 if self._last_seq is None else (measurement.seq - self._last_seq) & 0xFFFFFFFF
        self._last_seq = measurement.seq
        if samples != 1:
            self.count("samples_missed", samples - 1)
        added = self._excitation.voltage if self._excitation is not None else 0.0
        wanted = added
        if self._mode == "pid":
            reference = self._reference or _AT_ZERO
            wanted += self._pid.step(reference.position, measurement.position,
                                     reference.velocity, reference.acceleration,
                                     samples * self._period)
        voltage = min(max(wanted, -self._limit), self._limit)
        saturated = voltage != wanted
        if not math.isfinite(wanted):
            voltage, saturated = 0.0, True
            self.count("not_finite")
        if self._mode == "pid":
            saturated = saturated or self._pid.saturated
            if voltage != wanted:
                self._pid.applied(voltage - added)
        if saturated:
            self.count("saturated")
        self._last_voltage = voltage
        self._seq += 1
        stamp = measurement.stamp_ns if self.lockstep else self.now_ns()
        self._out.send(stamp, self._seq, measurement.seq, measurement.stamp_ns, voltage,
                       saturated)

    def waiting_for(self) -> tuple[str, int] | None:
        """Return which part of the answer is missing."""
        measurement = self._measurement
        if measurement is None:
            return "measurement", 0
        if self._last_seq == measurement.seq:
            return None
        for name, part in (("reference", self._reference), ("excitation", self._excitation)):
            if part is None or part.seq != measurement.seq:
                return f"{name} (or for an experiment to start)", measurement.seq
        return None


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(Controller, args)
