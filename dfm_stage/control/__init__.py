"""Controllers, one sample per call, and the methods that choose their parameters."""

from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PID_PARAMETERS, PidGains
from dfm_stage.control.pid import Pid

__all__ = ["PID_PARAMETERS", "ControlError", "Pid", "PidGains"]
