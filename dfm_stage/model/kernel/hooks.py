"""The effects' hooks, compiled and called by the address of their machine code.

The kernel is compiled once and holds no effect. `layout` has a table for each kind of hook with
one entry for each effect that is on: the address, where its parameters begin in `theta`, and its
first state. Each hook is machine code of its own, kept on disk under a hash of all it is made of,
so that an effect costs the same however many others there are. Only the smooth forces that are on
together share one entry, the code of their sum: they are called most, and a call costs as much as
a force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numba

from dfm_stage.model.effect import Effect
from dfm_stage.model.kernel.collocated import collocated
from dfm_stage.model.kernel.compiled import (
    POINTER,
    at,
    callback,
    caller,
    inlined,
    lean,
    pointer,
    types,
    values_at,
)
from dfm_stage.model.kernel.slots import (
    ADDED,
    AT_REGISTERS,
    BRISTLE_STEPS,
    CODE,
    COMMANDS,
    ENCODES,
    ENTRY,
    FIRST,
    FORCE_CONSTANT,
    OTHER_FORCES,
    OWN,
    RESISTANCE,
    ROWS,
    SENSES,
    STARTS,
    Array,
    Layout,
)
from dfm_stage.model.parameter import BASE_PARAMETERS

Hook = Callable[..., Any]
_numba: Any = numba
carray = _numba.carray
_number, _index = types.float64, types.int64
ONE, THREE = 1, 3


def _alone(hook: Hook, values: Hook, slots: Hook | None) -> Hook:
    """A force at one point; `slots` loads force constant and resistance where it is of the
    current."""
    if slots is None:
        @inlined
        def own(x: float, v: float, d: float, p: Any) -> float:
            return float(hook(x, v, d, values(p)))
    else:
        @inlined
        def own(x: float, v: float, d: float, p: Any) -> float:
            base = slots(p)
            gain = base[FORCE_CONSTANT]
            if base[RESISTANCE] > 0.0:
                gain *= base[RESISTANCE]
            return float(hook(x, v, d / gain if gain != 0.0 else 0.0, values(p)))

    return own


def _sum(*parts: tuple[Hook, Hook, Hook | None]) -> Hook:
    """The sum of forces at one point, as part of the code of whoever calls it."""
    *others, last = parts
    own = _alone(*last)
    if not others:
        return own
    before = _sum(*others)

    @inlined
    def both(x: float, v: float, d: float, p: Any) -> float:
        return float(before(x, v, d, p) + own(x, v, d, p))

    return both


def _force(*parts: tuple[Hook, Hook, Hook | None]) -> Hook:
    total = _sum(*parts)

    def force(x1: float, x2: float, x3: float, v1: float, v2: float, v3: float, d1: float,
              d2: float, d3: float, p: Any, out: Any, count: int) -> float:
        """Return the force at the first point; of THREE points, the others go to `out`, N."""
        first: float = total(x1, v1, d1, p)
        if count == THREE:      # all before they are stored, so that p is read once
            out[0], out[1] = total(x2, v2, d2, p), total(x3, v3, d3, p)
        return first

    return force


def _bristle(advance: Hook, force: Hook, values: Hook) -> Hook:
    def step(z: float, dx1: float, dx2: float, dx3: float, v0: float, v1: float, v2: float,
             v3: float, p: Any, out: Any, count: int) -> float:
        """Move z on by dx1, or by THREE distances; return it. The forces then go to `out`, N."""
        own = values(p)
        if dx1 != 0.0:
            z = advance(z, dx1, v0, v1, own)
        out[0] = force(z, v1, own)
        if count == THREE:
            if dx2 != 0.0:
                z = advance(z, dx2, v1, v2, own)
            out[1] = force(z, v2, own)
            if dx3 != 0.0:
                z = advance(z, dx3, v2, v3, own)
            out[2] = force(z, v3, own)
        return z

    return step


def one_side(*_: Any) -> float:
    """The side of kinks for a flow that has none."""
    return 0.0


def _stamp(hook: Hook, values: Hook) -> Hook:
    def stamp(a: Any, rows: Any, n: int, first: int, p: Any) -> None:
        hook(carray(a, (n, n + 1)), carray(rows, (ROWS, n + 1)), first, values(p))

    return stamp


def _start(hook: Hook, values: Hook) -> Hook:
    def start(state: Any, n: int, first: int, p: Any) -> None:
        hook(carray(state, (n,)), first, values(p))

    return start


def _sense(hook: Hook, values: Hook) -> Hook:
    def sense(x: Any, reading: Any, count: int, first: int, period: float, other: Any,
              stride: int, p: Any) -> None:
        """Add to `count` readings; other[stride k] is where the neighbour is, if there is one."""
        own = values(p)
        for k in range(count):
            neighbour = other[stride * k] if stride > 0 else 0.0
            reading[k] += hook(x[k], (first + k) * period, neighbour, own)

    return sense


def _encode(hook: Hook, values: Hook) -> Hook:
    def encode(reading: Any, count: int, dither: float, p: Any) -> None:
        own = values(p)
        for k in range(count):
            reading[k] = hook(reading[k], dither, own)

    return encode


def _added(hook: Hook, values: Hook) -> Hook:
    def added(u: Any, count: int, first: int, period: float, p: Any) -> None:
        """Add to `count` commands, the first of which was given at sample `first`."""
        own = values(p)
        for k in range(count):
            u[k] += hook(u[k], max(first + k, 0) * period, own)

    return added


def _command(hook: Hook, values: Hook, registers: int) -> Hook:
    def command(u: Any, count: int, period: float, z: Any, p: Any) -> None:
        """Replace `count` commands that last a period (s) each."""
        own, kept = values(p), carray(z, (registers,))
        for k in range(count):
            u[k] = hook(u[k], kept, period, own)

    return command


def _other_force(hook: Hook, values: Hook) -> Hook:
    def other_force(p: Any) -> float:
        return float(hook(values(p)))

    return other_force


_KINDS: dict[str, tuple[Any, Callable[..., Hook]]] = {
    "force": (_number(*[_number] * 9, POINTER, POINTER, _index), _force),
    "friction": (_number(*[_number] * 9, POINTER, POINTER, _index), _force),
    "advance": (_number(*[_number] * 8, POINTER, POINTER, _index), _bristle),
    "stamp": (types.void(POINTER, POINTER, _index, _index, POINTER), _stamp),
    "start": (types.void(POINTER, _index, _index, POINTER), _start),
    "sense": (types.void(POINTER, POINTER, _index, _index, _number, POINTER, _index, POINTER),
              _sense),
    "encode": (types.void(POINTER, _index, _number, POINTER), _encode),
    "other_force": (_number(POINTER), _other_force),
    "flow": (_number(*[_number] * 16, *[POINTER] * 5, _index, _index), collocated),
    "added": (types.void(POINTER, _index, _index, _number, POINTER), _added),
    "command": (types.void(POINTER, _index, _number, POINTER, POINTER), _command)}
"""Kind of hook -> the signature of its machine code, and what makes that of hooks."""
SUMMED = ("force", "friction")
"""Kinds whose hooks share one entry, the code of their sum."""


def address(kind: str, uses: Sequence[tuple[Effect, int]]) -> int:
    """The address of the machine code of a hook; compiled when first asked for.

    `uses` is an effect and where its parameters begin in `theta`; of forces any number of them,
    whose sum it is. What calls it passes the first one's parameters. Where nothing stands before
    these, as along a measured motion, a force of the current is given the current itself.
    """
    begin = uses[0][1]
    return int(_code(kind, *(
        ((getattr(effect, kind), *([effect.bristle_force] if kind == "advance" else []),
          *([effect.side_of_kinks or one_side] if kind == "flow" else [])),
         first - begin, len(effect.parameters), len(effect.states) if kind == "flow" else
         effect.registers if kind == "command" else -begin if effect.by_current and begin else 0)
        for effect, first in uses)).address)


@cache
def _code(kind: str, *parts: tuple[tuple[Hook, ...], int, int, int]) -> Any:
    signature, make = _KINDS[kind]
    ready = [(*(lean(hook) for hook in hooks), values_at(first, count))
             for hooks, first, count, _ in parts]
    further = [each[-1] for each in parts]
    if kind in SUMMED:
        made = make(*((*each, values_at(at, len(BASE_PARAMETERS)) if at else None)
                      for each, at in zip(ready, further, strict=True)))
    else:
        made = make(*ready[0], *(further if kind in ("flow", "command") else []))
    return callback(made, signature, (kind, parts))


call_force, call_bristle, call_stamp, call_start, call_sense, call_encode, call_other, \
    call_flow, call_added, call_command = (caller(_KINDS[kind][0]) for kind in (
        "force", "advance", "stamp", "start", "sense", "encode", "other_force", "flow",
        "added", "command"))


@inlined
def point_force(layout: Layout, theta: Array, table: int, x: float, v: float, d: float) -> float:
    """The sum of the forces of a table at one point, N; `d` is the actuator's."""
    total = 0.0
    for entry in range(at(layout, table), at(layout, table + 1), ENTRY):
        own = pointer(theta, at(layout, entry + OWN))
        total += call_force(at(layout, entry + CODE),
                            (x, 0.0, 0.0, v, 0.0, 0.0, d, 0.0, 0.0, own, own, ONE))
    return total


@inlined
def bristle_steps(layout: Layout, theta: Array, work: Array, z: int, dx: float, v0: float,
                  v1: float, after: int, forces: int) -> float:
    """work[after:] is work[z:] moved on by dx; returns the force then, N. `forces` is scratch."""
    total = 0.0
    for entry in range(at(layout, BRISTLE_STEPS), at(layout, BRISTLE_STEPS + 1), ENTRY):
        own = at(layout, entry + FIRST)
        work[after + own] = call_bristle(
            at(layout, entry + CODE), (at(work, z + own), dx, 0.0, 0.0, v0, v1, 0.0, 0.0,
                                       pointer(theta, at(layout, entry + OWN)),
                                       pointer(work, forces), ONE))
        total += at(work, forces)
    return total


@lean
def stamp(layout: Layout, theta: Array, table: int, a: Array, rows: Array) -> None:
    """Let the effects of one stage change the linear part; see `kernel.setup`."""
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
def sense_errors(layout: Layout, theta: Array, x: Array, first: int, period: float, other: Array,
                 reading: Array) -> None:
    """Add to the readings of the positions x, the first of which is sample `first`, m."""
    stride = 4 if other.shape[0] > 0 else 0
    for entry in range(layout[SENSES], layout[SENSES + 1], ENTRY):
        call_sense(layout[entry + CODE], (
            pointer(x, 0), pointer(reading, 0), x.shape[0], first, period, pointer(other, 0),
            stride, pointer(theta, layout[entry + OWN])))


@lean
def encode_means(layout: Layout, theta: Array, dither: float, reading: Array) -> None:
    """Replace the readings by the means of the rounded ones, m."""
    for entry in range(layout[ENCODES], layout[ENCODES + 1], ENTRY):
        call_encode(layout[entry + CODE], (pointer(reading, 0), reading.shape[0], dither,
                                           pointer(theta, layout[entry + OWN])))


@lean
def other_stiffness(layout: Layout, theta: Array) -> float:
    """The force per metre of the neighbouring axis, N/m."""
    total = 0.0
    for entry in range(layout[OTHER_FORCES], layout[OTHER_FORCES + 1], ENTRY):
        total += call_other(layout[entry + CODE], (pointer(theta, layout[entry + OWN]),))
    return total


@lean
def add_to_commands(layout: Layout, theta: Array, applied: Array, first: int,
                    period: float) -> None:
    """Add to the commands (N,) that act, the first of which was given at sample `first`."""
    for entry in range(layout[ADDED], layout[ADDED + 1], ENTRY):
        call_added(layout[entry + CODE], (pointer(applied, 0), applied.shape[0], first, period,
                                            pointer(theta, layout[entry + OWN])))


@lean
def command_inputs(layout: Layout, theta: Array, work: Array, inputs: Array,
                   period: float) -> None:
    """Replace commands that last a period (s) each by what the effects make of them, V or A."""
    for entry in range(layout[COMMANDS], layout[COMMANDS + 1], ENTRY):
        call_command(layout[entry + CODE], (
            pointer(inputs, 0), inputs.shape[0], period,
            pointer(work, layout[AT_REGISTERS] + layout[entry + FIRST]),
            pointer(theta, layout[entry + OWN])))
