"""The effects' hooks, chained into one compiled function each.

A chain is built by closures and never cached itself: the entry points that call it carry its
machine code. `on` is the bit mask of effects, in registry order. Effects that are off cost a test
of one bit.
"""

# ruff: noqa: ARG001
from __future__ import annotations

from collections.abc import Callable, Iterable
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

# mypy: disable-error-code="no-untyped-def"
Hook = Callable[..., Any]
Force = Callable[..., float]


@inlined
def _one(theta, at):
    return (theta[at],)


@inlined
def _two(theta, at):
    return theta[at], theta[at + 1]


@inlined
def _three(theta, at):
    return theta[at], theta[at + 1], theta[at + 2]


@inlined
def _four(theta, at):
    return theta[at], theta[at + 1], theta[at + 2], theta[at + 3]


@inlined
def _five(theta, at):
    return theta[at], theta[at + 1], theta[at + 2], theta[at + 3], theta[at + 4]


_TAKE = (_one, _two, _three, _four, _five)


def _with(hook: str) -> list[Effect]:
    return [effect for effect in EFFECTS.values() if getattr(effect, hook) is not None]


def _place(effect: Effect, hook: str) -> tuple[Hook, int, Hook, int]:
    """The compiled hook, its bit, and how to take its parameters out of theta and where."""
    shape = lean if hook == "advance" else inlined
    return (shape(getattr(effect, hook)), BIT[effect.name],
            _TAKE[len(effect.parameters) - 1], FIRST_PARAMETER[effect.name])


def _summed(hook: str, effects: Iterable[Effect] | None = None) -> Force:
    """chain(on, theta, *args) -> sum of hook(*args, p)"""
    @inlined
    def chain(on, theta, *args):
        return 0.0

    def link(before: Hook, effect: Effect) -> Hook:
        piece, bit, take, at = _place(effect, hook)

        @inlined
        def longer(on, theta, *args):
            total = before(on, theta, *args)
            if on >> bit & 1:
                total += piece(*args, take(theta, at))
            return total

        return longer

    for effect in _with(hook) if effects is None else effects:
        chain = link(chain, effect)
    return chain


def _states(hook: str, effects: Iterable[Effect]) -> Hook:
    """chain(on, layout, theta, *args): hook(*args, first, p) changes its arguments"""
    @inlined
    def chain(on, layout, theta, *args):
        pass

    def link(before: Hook, effect: Effect) -> Hook:
        piece, bit, take, at = _place(effect, hook)
        first = LAYOUT_FIXED + STATE_NAMES.index(effect.states[0])

        @inlined
        def longer(on, layout, theta, *args):
            before(on, layout, theta, *args)
            if on >> bit & 1:
                piece(*args, layout[first], take(theta, at))

        return longer

    for effect in effects:
        chain = link(chain, effect)
    return chain


def _bristle_forces() -> Force:
    """chain(on, theta, work, z, v) -> N, with the states at work[z:]"""
    @inlined
    def chain(on, theta, work, z, v):
        return 0.0

    def link(before: Hook, effect: Effect) -> Hook:
        piece, bit, take, at = _place(effect, "bristle_force")
        index = BRISTLE_NAMES.index(effect.name)

        @inlined
        def longer(on, theta, work, z, v):
            total = before(on, theta, work, z, v)
            if on >> bit & 1:
                total += piece(work[z + index], v, take(theta, at))
            return total

        return longer

    for name in BRISTLE_NAMES:
        chain = link(chain, EFFECTS[name])
    return chain


def _bristle_steps() -> Hook:
    """chain(on, theta, work, z, dx, v0, v1, after): work[after:] is work[z:] moved on by dx"""
    @inlined
    def chain(on, theta, work, z, dx, v0, v1, after):
        pass

    def link(before: Hook, effect: Effect) -> Hook:
        piece, bit, take, at = _place(effect, "advance")
        index = BRISTLE_NAMES.index(effect.name)

        @inlined
        def longer(on, theta, work, z, dx, v0, v1, after):
            before(on, theta, work, z, dx, v0, v1, after)
            if on >> bit & 1:
                work[after + index] = piece(work[z + index], dx, v0, v1, take(theta, at))

        return longer

    for name in BRISTLE_NAMES:
        chain = link(chain, EFFECTS[name])
    return chain


def _encoders() -> Hook:
    """chain(on, theta, reading, dither) -> m, the mean of the rounded reading"""
    @inlined
    def chain(on, theta, reading, dither):
        return reading

    def link(before: Hook, effect: Effect) -> Hook:
        piece, bit, take, at = _place(effect, "encode")

        @inlined
        def longer(on, theta, reading, dither):
            value = before(on, theta, reading, dither)
            if on >> bit & 1:
                value = piece(value, dither, take(theta, at))
            return value

        return longer

    for effect in _with("encode"):
        chain = link(chain, effect)
    return chain


_STAMPED = _with("stamp")
stamp_modes = _states("stamp", [e for e in _STAMPED if e.stage == "modes"])
stamp_amplifier = _states("stamp", [e for e in _STAMPED if e.stage == "amplifier"])
stamp_mechanics = _states("stamp", [e for e in _STAMPED if e.stage == "mechanics"])
start_states = _states("start", _with("start"))
point_force = _summed("force")
spring_force = _summed("force", [e for e in _with("force") if POLYNOMIAL >> BIT[e.name] & 1])
actuator_force = _summed("force", [e for e in _with("force") if e.side == "actuator"])
sense_error = _summed("sense")
other_stiffness = _summed("other_force")
bristle_force = _bristle_forces()
bristle_steps = _bristle_steps()
encode_mean = _encoders()
