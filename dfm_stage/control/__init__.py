"""Controllers, one sample per call, and the methods that choose their parameters."""

from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PID_PARAMETERS, PidGains
from dfm_stage.control.pid import Pid
from dfm_stage.control.placement import PidDesign, pid_for, pid_with_margin
from dfm_stage.control.riccati import algebraic, feedback_gain, finite_horizon
from dfm_stage.control.sampled import Margins, Sampled, margins, sample_stage

__all__ = [
    "PID_PARAMETERS", "ControlError", "Margins", "Pid", "PidDesign", "PidGains", "Sampled",
    "algebraic", "feedback_gain", "finite_horizon", "margins", "pid_for", "pid_with_margin",
    "sample_stage",
]
