"""What the stage is asked to do: movements, excitations, experiments, and their limits."""

from dfm_stage.model.parameter import Option
from dfm_stage.trajectory.errors import LimitError, TrajectoryError
from dfm_stage.trajectory.experiment import AxisSpec, Experiment, load_experiment
from dfm_stage.trajectory.kind import Kind
from dfm_stage.trajectory.limits import (
    LIMIT_PARAMETERS,
    Limits,
    Violation,
    check_limits,
    check_run,
    require_run_within,
)
from dfm_stage.trajectory.outcome import Bounds, Outcome
from dfm_stage.trajectory.signals import (
    EXCITATION_KINDS,
    REFERENCE_KINDS,
    Excitation,
    Reference,
    make_excitation,
    make_reference,
)
from dfm_stage.trajectory.waveform import Segment

__all__ = [
    "EXCITATION_KINDS", "LIMIT_PARAMETERS", "REFERENCE_KINDS", "AxisSpec", "Bounds",
    "Excitation", "Experiment", "Kind", "LimitError", "Limits", "Option", "Outcome", "Reference",
    "Segment", "TrajectoryError", "Violation", "check_limits", "check_run", "load_experiment",
    "make_excitation", "make_reference", "require_run_within",
]
