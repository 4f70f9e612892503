"""Which effects look alike: of one class, or one a limit or a harmonic of the other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import combinations

from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.search_decisions import AT_END, DRY
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.description import EffectUse
from dfm_stage.model.effect import reads


def at_upper_end(found: Fit, names: Sequence[str]) -> bool:
    """Whether an effect among `names` ran to the upper end of the range in which it is itself: a
    resonance that is damped away is creep or a lag, a reading that falls while the stage advances
    is no error of a scale."""
    if not found.ok:
        return False
    for use in found.model.effects:
        if use.name in names and folds(use):
            return True
        for parameter, value in use.parameters.items() if use.name in names else ():
            if value > AT_END * use.effect.search_range(parameter, found.system.at)[1]:
                return True
    return False


def is_dry(found: Fit, names: Sequence[str]) -> bool:
    """Whether an effect among `names` yields at the end of the range of its distance that the
    noise hides: it is dry friction there, which has effects of its own."""
    return found.ok and any(
        use.effect.yields_within(use.parameters)
        <= DRY * use.effect.search_range(use.effect.distance, found.system.at)[0]
        for use in found.model.effects if use.name in names and use.effect.distance)


def folds(use: EffectUse) -> bool:
    """Whether a wave along the scale is so steep that the reading falls while the stage
    advances."""
    wave = use.effect.wave
    if wave is None or wave.over != "position" or use.effect.sense is None:
        return False
    return 2.0 * math.pi * use.parameters[use.effect.sizes[0]] > use.parameters[wave.parameter]


def same_rounding(model: Model, hit: Hit) -> bool:
    """Whether a hit rounds the reading to steps of which an error in the model is a harmonic."""
    step = next(iter(hit.parameters.values()))
    return EFFECTS[hit.name].rounds and any(
        use.effect.is_rounding(use.parameters, step) for use in model.effects)


def shares_class(first: str, second: str) -> bool:
    """Whether two effects stand in one equivalence class of the library."""
    return any(second in c.members for c in EFFECTS[first].classes) or any(
        first in c.members for c in EFFECTS[second].classes)


def kinds(names: Iterable[str]) -> int:
    """How many kinds of effect are among some: the most of which no two stand in one equivalence
    class. One more name never makes fewer kinds."""
    known = sorted(set(names))
    return next((n for n in range(len(known), 0, -1) for some in combinations(known, n)
                 if not any(shares_class(a, b) for a, b in combinations(some, 2))), 0)


def gives_way(one: str, other: str) -> bool:
    """Whether few machines have the one effect, and many the other, which looks like it."""
    return other in EFFECTS[one].gives_way_to


def laws_of_speed(names: Iterable[str]) -> tuple[str, ...]:
    """Those of some effects that are a force against the motion that depends on speed alone."""
    return tuple(n for n in names if (e := EFFECTS[n]).parity == "odd" and (
        e.brakes is not None or any(hook is not None and not reads(hook, 0) and not reads(hook, 2)
                                    for hook in (e.force, e.friction))))
