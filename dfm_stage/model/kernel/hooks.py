"""The effects' hooks, compiled one by one and called by the address of their machine code.

The kernel is compiled once and holds no effect. `layout` has a table for each kind of hook with
one entry for each effect that is on: the address, where its parameters begin in `theta`, and its
first state. Each hook is machine code of its own, kept on disk under a hash of all it is made of,
so that an effect costs the same however many others there are.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import carray, types
from numpy.typing import NDArray

from dfm_stage.model.effect import Effect
from dfm_stage.model.kernel.compiled import callback, inlined, lean
from dfm_stage.model.kernel.memory import POINTER, at, caller, pointer, values_at
from dfm_stage.model.kernel.slots import (
    ACTUATOR_FORCES,
    BRISTLE_STEPS,
    CODE,
    ENCODES,
    ENTRY,
    FIRST,
    FORCES,
    OTHER_FORCES,
    OWN,
    ROWS,
    SENSES,
    STARTS,
)

Array = NDArray[np.float64]
Layout = NDArray[np.int64]
Hook = Callable[..., Any]
_number, _index = types.float64, types.int64
_FORCE = _number(_number, _number, _number, POINTER)
_BRISTLE = _number(_number, _number, _number, _number, POINTER, POINTER)
_STAMP = types.void(POINTER, POINTER, _index, _index, POINTER)
_START = types.void(POINTER, _index, _index, POINTER)
_ENCODE = _number(_number, _number, POINTER)
_OTHER = _number(POINTER)


def _force(hook: Hook, values: Hook) -> Hook:
    def force(x: float, v: float, actuator: float, p: Any) -> float:
        return float(hook(x, v, actuator, values(p)))

    return force


def _bristle(hook: Hook, force: Hook, values: Hook) -> Hook:
    def step(z: float, dx: float, v0: float, v1: float, p: Any, total: Any) -> float:
        """Move z on by dx, add the force then to `total` (N), return z."""
        own = values(p)
        if dx != 0.0:
            z = hook(z, dx, v0, v1, own)
        total[0] += force(z, v1, own)
        return z

    return step


def _stamp(hook: Hook, values: Hook) -> Hook:
    def stamp(a: Any, rows: Any, n: int, first: int, p: Any) -> None:
        hook(carray(a, (n, n + 1)), carray(rows, (ROWS, n + 1)), first, values(p))

    return stamp


def _start(hook: Hook, values: Hook) -> Hook:
    def start(state: Any, n: int, first: int, p: Any) -> None:
        hook(carray(state, (n,)), first, values(p))

    return start


def _encode(hook: Hook, values: Hook) -> Hook:
    def encode(reading: float, dither: float, p: Any) -> float:
        return float(hook(reading, dither, values(p)))

    return encode


def _other_force(hook: Hook, values: Hook) -> Hook:
    def other_force(p: Any) -> float:
        return float(hook(values(p)))

    return other_force


_MADE: dict[str, tuple[Any, Callable[..., Hook]]] = {
    "force": (_FORCE, _force), "sense": (_FORCE, _force), "advance": (_BRISTLE, _bristle),
    "stamp": (_STAMP, _stamp), "start": (_START, _start), "encode": (_ENCODE, _encode),
    "other_force": (_OTHER, _other_force)}


def address(effect: Effect, kind: str) -> int:
    """The address of the machine code of one hook of an effect; compiled when first asked for."""
    hooks = [getattr(effect, kind)]
    if kind == "advance":
        hooks.append(effect.bristle_force)
    return int(_code(kind, len(effect.parameters), *hooks).address)


@lru_cache(maxsize=None)
def _code(kind: str, parameters: int, *hooks: Hook) -> Any:
    signature, make = _MADE[kind]
    return callback(make(*(lean(hook) for hook in hooks), values_at(parameters)), signature,
                    (kind, parameters, hooks))


call_force = caller(_FORCE)
call_bristle = caller(_BRISTLE)
call_stamp = caller(_STAMP)
call_start = caller(_START)
call_encode = caller(_ENCODE)
call_other = caller(_OTHER)


@inlined
def _summed(layout: Layout, theta: Array, table: int, x: float, y: float, d: float) -> float:
    """The sum of what the hooks of a table return for three numbers."""
    total = 0.0
    for entry in range(at(layout, table), at(layout, table + 1), ENTRY):
        total += call_force(at(layout, entry + CODE),
                            (x, y, d, pointer(theta, at(layout, entry + OWN))))
    return total


@inlined
def point_force(layout: Layout, theta: Array, x: float, v: float, d: float) -> float:
    """The smooth forces on the driven point, N; `d` is the actuator's."""
    return _summed(layout, theta, FORCES, x, v, d)


@inlined
def actuator_force(layout: Layout, theta: Array, x: float, v: float, d: float) -> float:
    """What the actuator gives beyond `d`, that of a constant force constant, N."""
    return _summed(layout, theta, ACTUATOR_FORCES, x, v, d)


@inlined
def sense_error(layout: Layout, theta: Array, x: float, t: float, other: float) -> float:
    """What is added to the reading, m."""
    return _summed(layout, theta, SENSES, x, t, other)


@inlined
def bristle_steps(layout: Layout, theta: Array, work: Array, z: int, dx: float, v0: float,
                  v1: float, after: int, total: int) -> float:
    """work[after:] is work[z:] moved on by dx; returns the force then, N. `total` is scratch."""
    work[total] = 0.0
    for entry in range(at(layout, BRISTLE_STEPS), at(layout, BRISTLE_STEPS + 1), ENTRY):
        own = at(layout, entry + FIRST)
        work[after + own] = call_bristle(
            at(layout, entry + CODE), (at(work, z + own), dx, v0, v1,
                                       pointer(theta, at(layout, entry + OWN)),
                                       pointer(work, total)))
    return at(work, total)


@inlined
def bristle_force(layout: Layout, theta: Array, work: Array, z: int, v: float,
                  total: int) -> float:
    """The force of the states at work[z:], N."""
    work[total] = 0.0
    for entry in range(at(layout, BRISTLE_STEPS), at(layout, BRISTLE_STEPS + 1), ENTRY):
        call_bristle(at(layout, entry + CODE), (at(work, z + at(layout, entry + FIRST)), 0.0, v, v,
                                                pointer(theta, at(layout, entry + OWN)),
                                                pointer(work, total)))
    return at(work, total)


@lean
def stamp(layout: Layout, theta: Array, table: int, a: Array, rows: Array) -> None:
    """Let the effects of one stage change the linear part; see `kernel.assemble`."""
    for entry in range(layout[table], layout[table + 1], ENTRY):
        call_stamp(layout[entry + CODE], (
            pointer(a, 0), pointer(rows, 0), a.shape[0], layout[entry + FIRST],
            pointer(theta, layout[entry + OWN])))


@lean
def start_states(layout: Layout, theta: Array, state: Array) -> None:
    """Let the effects set their own states at the beginning."""
    for entry in range(layout[STARTS], layout[STARTS + 1], ENTRY):
        call_start(layout[entry + CODE], (pointer(state, 0), state.shape[0],
                                          layout[entry + FIRST],
                                          pointer(theta, layout[entry + OWN])))


@lean
def encode_mean(layout: Layout, theta: Array, reading: float, dither: float) -> float:
    """The mean of the rounded reading, m."""
    for entry in range(layout[ENCODES], layout[ENCODES + 1], ENTRY):
        reading = call_encode(layout[entry + CODE], (reading, dither,
                                                     pointer(theta, layout[entry + OWN])))
    return reading


@lean
def other_stiffness(layout: Layout, theta: Array) -> float:
    """The force per metre of the neighbouring axis, N/m."""
    total = 0.0
    for entry in range(layout[OTHER_FORCES], layout[OTHER_FORCES + 1], ENTRY):
        total += call_other(layout[entry + CODE], (pointer(theta, layout[entry + OWN]),))
    return total
