"""Which effects look alike: of one class, or one a limit or a harmonic of the other."""

from __future__ import annotations

from collections.abc import Sequence

from dfm_stage.diagnosis.decisions import AT_END
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.model import EFFECTS, Model


def at_upper_end(found: Fit, names: Sequence[str]) -> bool:
    """Whether an effect among `names` ran to the upper end of the range in which it is itself: a
    resonance that is damped away is creep or a lag."""
    if not found.ok:
        return False
    for use in found.model.effects:
        for parameter, value in use.parameters.items() if use.name in names else ():
            if value > AT_END * use.effect.search_range(parameter, found.system.at)[1]:
                return True
    return False


def same_rounding(model: Model, hit: Hit) -> bool:
    """Whether a hit rounds the reading to steps of which an error in the model is a harmonic."""
    step = next(iter(hit.parameters.values()))
    return EFFECTS[hit.name].rounds and any(
        use.effect.is_rounding(use.parameters, step) for use in model.effects)


def shares_class(first: str, second: str) -> bool:
    """Whether two effects stand in one equivalence class of the library."""
    return any(second in c.members for c in EFFECTS[first].classes) or any(
        first in c.members for c in EFFECTS[second].classes)
