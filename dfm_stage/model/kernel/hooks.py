"""The effects' hooks, chained into one compiled function each.

A chain is written out as text, one line per effect, compiled when it is first needed and never
cached itself: the entry points that call it carry its machine code. `on` is the bit mask of
effects, in registry order. Effects that are off cost a test of one bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Any

from dfm_stage.model.effect import Effect
from dfm_stage.model.kernel.compiled import inlined, lean
from dfm_stage.model.kernel.slots import (
    BIT,
    BRISTLE_NAMES,
    FIRST_PARAMETER,
    LAYOUT_FIXED,
    POLYNOMIAL,
    STATE_NAMES,
)
from dfm_stage.model.registry import EFFECTS

Hook = Callable[..., Any]
Force = Callable[..., float]


def _with(hook: str) -> list[Effect]:
    return [effect for effect in EFFECTS.values() if getattr(effect, hook) is not None]


@lru_cache
def _compiled(effect: str, hook: str) -> Hook:
    function: Hook = getattr(EFFECTS[effect], hook)
    return lean(function) if hook == "advance" else inlined(function)


def _chain(arguments: str, hook: str, effects: Iterable[Effect], step: Callable[[Effect], str],
           start: str = "", result: str = "") -> Hook:
    """A function of `arguments` that does `step` for every effect that is on.

    In the text of a step, HOOK stands for the effect's hook and P for its parameters.
    """
    lines, scope = [f"def chain({arguments}):", f"    {start or 'pass'}"], {}
    for effect in effects:
        first = FIRST_PARAMETER[effect.name]
        taken = "".join(f"theta[{first + i}], " for i in range(len(effect.parameters)))
        text = step(effect).replace("HOOK", effect.name).replace("P)", f"({taken}))")
        lines += [f"    if on >> {BIT[effect.name]} & 1:", f"        {text}"]
        scope[effect.name] = _compiled(effect.name, hook)
    exec("\n".join([*lines, f"    return {result}"]), scope)  # noqa: S102 (text of our own)
    return inlined(scope["chain"])


def _summed(hook: str, arguments: str, effects: Iterable[Effect]) -> Force:
    """chain(on, theta, *arguments) -> sum of hook(*arguments, p)"""
    return _chain(f"on, theta, {arguments}", hook, effects,
                  lambda _: f"total += HOOK({arguments}, P)", "total = 0.0", "total")


def _states(hook: str, arguments: str, effects: Iterable[Effect]) -> Hook:
    """chain(on, layout, theta, *arguments): hook(*arguments, first, p) changes its arguments"""
    def step(effect: Effect) -> str:
        first = LAYOUT_FIXED + STATE_NAMES.index(effect.states[0])
        return f"HOOK({arguments}, layout[{first}], P)"

    return _chain(f"on, layout, theta, {arguments}", hook, effects, step)


_STAMPED = _with("stamp")
_BRISTLED = [EFFECTS[name] for name in BRISTLE_NAMES]
_FORCES = _with("force")
stamp_modes = _states("stamp", "a, rows", [e for e in _STAMPED if e.stage == "modes"])
stamp_amplifier = _states("stamp", "a, rows", [e for e in _STAMPED if e.stage == "amplifier"])
stamp_mechanics = _states("stamp", "a, rows", [e for e in _STAMPED if e.stage == "mechanics"])
start_states = _states("start", "state", _with("start"))
point_force = _summed("force", "x, v, d", _FORCES)
spring_force = _summed("force", "x, v, d", [e for e in _FORCES if POLYNOMIAL >> BIT[e.name] & 1])
actuator_force = _summed("force", "x, v, d", [e for e in _FORCES if e.side == "actuator"])
sense_error = _summed("sense", "x, t, other", _with("sense"))
other_stiffness: Force = _chain("on, theta", "other_force", _with("other_force"),
                                lambda _: "total += HOOK(P)", "total = 0.0", "total")

bristle_force: Force = _chain(
    "on, theta, work, z, v", "bristle_force", _BRISTLED,
    lambda e: f"total += HOOK(work[z + {BRISTLE_NAMES.index(e.name)}], v, P)",
    "total = 0.0", "total")
"""chain(on, theta, work, z, v) -> N, with the states at work[z:]"""

bristle_steps = _chain(
    "on, theta, work, z, dx, v0, v1, after", "advance", _BRISTLED,
    lambda e: (f"work[after + {(i := BRISTLE_NAMES.index(e.name))}] = "
               f"HOOK(work[z + {i}], dx, v0, v1, P)"))
"""chain(on, theta, work, z, dx, v0, v1, after): work[after:] is work[z:] moved on by dx"""

encode_mean: Force = _chain("on, theta, reading, dither", "encode", _with("encode"),
                            lambda _: "reading = HOOK(reading, dither, P)", "",
                            "reading")
"""chain(on, theta, reading, dither) -> m, the mean of the rounded reading"""
