"""The effects' hooks, chained into one compiled function each.

A chain is built by closures and never cached itself; the entry points that call it carry its
machine code. `on` is an array of flags in registry order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dfm_stage.model.effect import Effect
from dfm_stage.model.kernel.compiled import compiled
from dfm_stage.model.kernel.slots import (
    FIRST_PARAMETER,
    LAYOUT_FIXED,
    STATE_NAMES,
)
from dfm_stage.model.registry import EFFECTS

Hook = Callable[..., Any]
_INDEX = {name: index for index, name in enumerate(EFFECTS)}


def _span(effect: Effect) -> tuple[int, int]:
    first = FIRST_PARAMETER[effect.name]
    return first, first + len(effect.parameters)


def _stamps(stage: str) -> Hook:
    @compiled
    def chain(on, layout, a, rows, theta):  # type: ignore[no-untyped-def]
        pass

    for effect in EFFECTS.values():
        if effect.stamp is not None and effect.stage == stage:
            chain = _link_stamp(chain, effect)
    return chain


def _link_stamp(before: Hook, effect: Effect) -> Hook:
    index, (low, high) = _INDEX[effect.name], _span(effect)
    state = LAYOUT_FIXED + STATE_NAMES.index(effect.states[0])
    assert effect.stamp is not None
    stamp = compiled(effect.stamp)

    @compiled
    def chain(on, layout, a, rows, theta):  # type: ignore[no-untyped-def]
        before(on, layout, a, rows, theta)
        if on[index]:
            stamp(a, rows, layout[state], theta[low:high], theta)

    return chain


stamp_modes = _stamps("modes")
stamp_amplifier = _stamps("amplifier")
stamp_mechanics = _stamps("mechanics")
