"""The parameters of the PID controller: names, units, ranges, and what they must be together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from difflib import get_close_matches
from typing import Any

from dfm_stage.control.errors import ControlError
from dfm_stage.model.parameter import Parameter, ParameterError

ANTI_WINDUP = ("back_calculation", "clamping", "none")

# The defaults are `pid_for` at 8 Hz on the paper's stage with 1 ms of delay and of amplifier lag.
PID_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("kp", 3100.0, "V/m", "proportional gain"),
    Parameter("ki", 38000.0, "V/(m s)", "integral gain", 0.0),
    Parameter("kd", 94.0, "V s/m", "derivative gain", 0.0),
    Parameter("derivative_filter_s", 2.5e-3, "s", "time constant of the derivative's filter", 0.0,
              1e3),
    Parameter("output_limit_v", 10.0, "V", "largest absolute output", 1e-9, 1e6),
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
_TABLE = {parameter.name: parameter for parameter in PID_PARAMETERS}


@dataclass(frozen=True)
class PidGains:
    """Checked parameters of `Pid`; names and units as in `PID_PARAMETERS`.

    `anti_windup` is one of "back_calculation", "clamping" (conditional integration), "none".

    Raises
    ------
    ControlError
        If a value is not a finite number in its range; the message names it.
    """

    kp: float = _TABLE["kp"].default
    ki: float = _TABLE["ki"].default
    kd: float = _TABLE["kd"].default
    derivative_filter_s: float = _TABLE["derivative_filter_s"].default
    output_limit_v: float = _TABLE["output_limit_v"].default
    slew_limit_v_s: float = 0.0
    setpoint_weight: float = 1.0
    derivative_weight: float = 0.0
    tracking_time_s: float = 0.0
    feedforward_position: float = 0.0
    feedforward_velocity: float = 0.0
    feedforward_acceleration: float = 0.0
    notch_hz: float = 0.0
    notch_depth_damping: float = _TABLE["notch_depth_damping"].default
    notch_width_damping: float = _TABLE["notch_width_damping"].default
    anti_windup: str = "back_calculation"

    def __post_init__(self) -> None:
        for name, parameter in _TABLE.items():
            try:
                object.__setattr__(self, name, parameter.checked(getattr(self, name), "pid"))
            except ParameterError as error:
                raise ControlError(str(error)) from None
        if self.anti_windup not in ANTI_WINDUP:
            raise ControlError(f"pid: anti_windup must be one of {', '.join(ANTI_WINDUP)}, "
                               f"not {self.anti_windup!r}")

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
        names = [field.name for field in fields(self)]
        for name in values:
            if name not in names:
                close = get_close_matches(str(name), names, n=1)
                hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(names)}"
                raise ControlError(f"{where}: there is no parameter {name!r}, {hint}")
        return replace(self, **values)

    def without_feedforward(self) -> PidGains:
        """Return these gains with the three feedforward gains at zero."""
        return replace(self, feedforward_position=0.0, feedforward_velocity=0.0,
                       feedforward_acceleration=0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return all parameters by name."""
        return asdict(self)

    def back_calculation_time_s(self, sample_period_s: float) -> float:
        """Return the tracking time constant in force, never below one sample."""
        if self.tracking_time_s > 0.0:
            chosen = self.tracking_time_s
        elif self.ki > 0.0 and self.kd > 0.0:
            chosen = math.sqrt(self.kd / self.ki)
        elif self.ki > 0.0:
            chosen = abs(self.kp) / self.ki
        else:
            chosen = 0.1
        return max(chosen, sample_period_s)
