"""Which effects look alike: of one equivalence class, or one a harmonic of the other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.system import MOST_DAMPED
from dfm_stage.model import EFFECTS, Model


def is_no_mode(found: Fit, names: Sequence[str]) -> bool:
    """Whether a second mode among `names` ran to the largest damping: no resonance, but creep or a
    lag in its place."""
    use = found.model.effect("second_mode") if found.ok else None
    return use is not None and "second_mode" in names and (
        use.parameters["damping_ratio"] > 0.999 * MOST_DAMPED)


def counts_in(step: float | None, period: float) -> bool:
    """Whether a periodic error is but a harmonic of the steps in which the reading counts."""
    return step is not None and _harmonic(step, period)


def same_steps(model: Model, parameters: Mapping[str, float]) -> bool:
    """Whether steps of a reading have the period of the model's periodic error."""
    use = model.effect("encoder_periodic_error")
    return use is not None and _harmonic(parameters["step"], use.parameters["period"])


def _harmonic(step: float, period: float) -> bool:
    order = step / period
    return abs(order - round(order)) < 0.02 * max(order, 1.0) and round(order) > 0


def shares_class(first: str, second: str) -> bool:
    """Whether two effects stand in one equivalence class of the library."""
    return any(second in c.members for c in EFFECTS[first].classes) or any(
        first in c.members for c in EFFECTS[second].classes)
