"""Controllers, one sample per call, and the methods that choose their parameters."""

from dfm_stage.control.errors import ControlError
from dfm_stage.control.feedforward import (
    EffectInput,
    feedforward_gains,
    inverse_input,
    inverse_of,
    periodic_input,
)
from dfm_stage.control.gains import PID_PARAMETERS, PidGains
from dfm_stage.control.guard import GUARD_PARAMETERS, Guard
from dfm_stage.control.law import Law, Setup
from dfm_stage.control.laws import DEFAULT_LAW, LAWS, OPEN_LOOP, Lqg, Pid, laws_with, modes
from dfm_stage.control.learning import Learner, LearningDesign, design_learning, neighbours
from dfm_stage.control.lqr import (
    LQR_PARAMETERS,
    KalmanDesign,
    LqrDesign,
    LqrSpec,
    design_lqr,
    kalman,
)
from dfm_stage.control.parameter_file import parameter_text, read_parameters, write_text
from dfm_stage.control.pid_design import (
    Oscillation,
    PidDesign,
    Ultimate,
    oscillation,
    pid_for,
    pid_with_margin,
    ultimate,
    ultimate_from_relays,
    ziegler_nichols,
)
from dfm_stage.control.riccati import algebraic, feedback_gain, finite_horizon
from dfm_stage.control.shaping import Notch, ReferenceShaper, shape, shaper
from dfm_stage.control.stage import (
    LinearStage,
    Margins,
    Sampled,
    highest_mode,
    linear_stage,
    loop_margins,
    margins,
    sample_model,
    sample_stage,
)
from dfm_stage.control.switching import (
    AXIS_PARAMETERS,
    SHAPER_PARAMETERS,
    LawSet,
    Plan,
    Point,
    law_of,
    plan_laws,
)
from dfm_stage.control.systems import model_of, state_space
from dfm_stage.control.tuning import (
    Tuned,
    loop_of,
    predicted_errors,
    run_on_model,
    tune_lqr,
    tune_pid,
    tune_ziegler_nichols,
)
from dfm_stage.control.tuning_runs import TUNING_PARAMETERS, GainRaising, RelayRun, TuningRun

__all__ = [
    "AXIS_PARAMETERS", "DEFAULT_LAW", "GUARD_PARAMETERS", "LAWS", "LQR_PARAMETERS", "OPEN_LOOP",
    "PID_PARAMETERS", "SHAPER_PARAMETERS", "TUNING_PARAMETERS", "ControlError", "EffectInput",
    "GainRaising", "Guard", "KalmanDesign", "Law", "LawSet", "Learner", "LearningDesign",
    "LinearStage", "Lqg", "LqrDesign", "LqrSpec", "Margins", "Notch", "Oscillation", "Pid",
    "PidDesign", "PidGains", "Plan", "Point", "ReferenceShaper", "RelayRun", "Sampled", "Setup",
    "Tuned", "TuningRun", "Ultimate", "algebraic", "design_learning", "design_lqr",
    "feedback_gain", "feedforward_gains", "finite_horizon", "highest_mode", "inverse_input",
    "inverse_of", "kalman", "law_of", "laws_with", "linear_stage", "loop_margins", "loop_of",
    "margins", "model_of", "modes", "neighbours", "oscillation", "parameter_text",
    "periodic_input", "pid_for", "pid_with_margin", "plan_laws", "predicted_errors",
    "read_parameters", "run_on_model", "sample_model", "sample_stage", "shape", "shaper",
    "state_space", "tune_lqr", "tune_pid", "tune_ziegler_nichols", "ultimate",
    "ultimate_from_relays", "write_text", "ziegler_nichols",
]
