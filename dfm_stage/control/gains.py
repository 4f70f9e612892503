"""The parameters of the PID controller: names, units, ranges, and what they must be together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from dfm_stage.control.law import OUTPUT_LIMIT, Entry, checked, require_known
from dfm_stage.control.shaping import Notch
from dfm_stage.model.parameter import Option, Parameter

# The defaults are `pid_for` at 8 Hz on the paper's stage with 1 ms of delay and of amplifier lag.
PID_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("kp", 3100.0, "V/m", "proportional gain"),
    Parameter("ki", 38000.0, "V/(m s)", "integral gain", 0.0),
    Parameter("kd", 94.0, "V s/m", "derivative gain", 0.0),
    Parameter("derivative_filter_s", 2.5e-3, "s", "time constant of the derivative's filter", 0.0,
              1e3),
    OUTPUT_LIMIT,
    Parameter("slew_limit_v_s", 0.0, "V/s", "largest change of the output; 0 = no limit", 0.0),
    Parameter("setpoint_weight", 1.0, "", "share b of the reference in the proportional part",
              0.0, 2.0),
    Parameter("derivative_weight", 0.0, "",
              "share c of the reference in the derivative part; 0 = derivative of the measurement",
              0.0, 2.0),
    Parameter("tracking_time_s", 0.0, "s",
              "time constant of back-calculation; 0 = sqrt(kd / ki), or kp / ki without kd", 0.0),
    Parameter("feedforward_position", 0.0, "V/m", "output per reference position"),
    Parameter("feedforward_velocity", 0.0, "V s/m", "output per reference velocity"),
    Parameter("feedforward_acceleration", 0.0, "V s^2/m", "output per reference acceleration"),
    Parameter("notch_hz", 0.0, "Hz", "frequency taken out of what the feedback gives; 0 = none",
              0.0, 1e6),
    Parameter("notch_depth_damping", 0.01, "", "damping ratio of the notch's zeros", 0.0, 10.0),
    Parameter("notch_width_damping", 0.3, "", "damping ratio of its poles: how wide it is", 1e-3,
              10.0),
)
ANTI_WINDUP = Option("anti_windup", "back_calculation", "what keeps the integral from winding up",
                     ("back_calculation", "clamping", "none"))
GAIN_PARAMETERS: tuple[Entry, ...] = (*PID_PARAMETERS, ANTI_WINDUP)
_TABLE = {each.name: each for each in GAIN_PARAMETERS}
_DEFAULT: dict[str, Any] = {name: each.default for name, each in _TABLE.items()}


@dataclass(frozen=True)
class PidGains:
    """Checked parameters of `Pid`; names and units as in `PID_PARAMETERS`.

    `anti_windup` is one of "back_calculation", "clamping" (conditional integration), "none".

    Raises
    ------
    ControlError
        If a value is not a finite number in its range; the message names it.
    """

    kp: float = _DEFAULT["kp"]
    ki: float = _DEFAULT["ki"]
    kd: float = _DEFAULT["kd"]
    derivative_filter_s: float = _DEFAULT["derivative_filter_s"]
    output_limit_v: float = OUTPUT_LIMIT.default
    slew_limit_v_s: float = 0.0
    setpoint_weight: float = 1.0
    derivative_weight: float = 0.0
    tracking_time_s: float = 0.0
    feedforward_position: float = 0.0
    feedforward_velocity: float = 0.0
    feedforward_acceleration: float = 0.0
    notch_hz: float = 0.0
    notch_depth_damping: float = _DEFAULT["notch_depth_damping"]
    notch_width_damping: float = _DEFAULT["notch_width_damping"]
    anti_windup: str = _DEFAULT["anti_windup"]

    def __post_init__(self) -> None:
        for name, value in checked(_TABLE.values(), vars(self), "pid").items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], where: str = "pid") -> PidGains:
        """Return the gains in a mapping such as a controller's parameter file.

        Raises
        ------
        ControlError
            If a name is unknown (with the nearest one there is) or a value is unusable.
        """
        return cls().changed(values, where)

    def changed(self, values: Mapping[str, Any], where: str = "pid") -> PidGains:
        """Return these gains with some of them replaced; errors as in `from_mapping`."""
        require_known(values, _TABLE, where)
        return replace(self, **values)

    def notch(self, sample_period_s: float) -> Notch | None:
        """Return the notch of these gains, None if there is none.

        Raises
        ------
        ControlError
            If its frequency is not below half the rate.
        """
        return Notch(self.notch_hz, sample_period_s, self.notch_depth_damping,
                     self.notch_width_damping) if self.notch_hz else None

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name."""
        return asdict(self)

    def back_calculation_time_s(self, sample_period_s: float) -> float:
        """Return the tracking time constant in force, never below one sample."""
        if self.tracking_time_s > 0.0:
            chosen = self.tracking_time_s
        elif self.ki > 0.0:
            chosen = math.sqrt(self.kd / self.ki) if self.kd > 0.0 else abs(self.kp) / self.ki
        else:
            chosen = 0.1
        return max(chosen, sample_period_s)
