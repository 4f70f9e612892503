"""The effects' hooks along a motion that is known: what each would give where the stage was."""

from __future__ import annotations

import numpy as np

from dfm_stage.model.kernel.collocated import STAGES, SWEEPS
from dfm_stage.model.kernel.compiled import entry, inlined, pointer
from dfm_stage.model.kernel.hooks import (
    ONE,
    THREE,
    call_added,
    call_bristle,
    call_flow,
    call_force,
    call_sense,
)
from dfm_stage.model.kernel.slots import Array
from dfm_stage.model.kernel.tables import POINT_1, POINT_2

FINEST = 0.5**10
"""Part of a sample below which states are not followed."""


@entry
def forces_along(code: int, p: Array, x: Array, v: Array, d: Array, out: Array) -> None:
    """out (N,) is the force (N) of a hook `force` at positions, speeds and actuator forces."""
    own = pointer(p, 0)
    for k in range(x.shape[0]):
        out[k] = call_force(code, (x[k], 0.0, 0.0, v[k], 0.0, 0.0, d[k], 0.0, 0.0, own, own, ONE))


@entry
def bristles_along(code: int, p: Array, x: Array, v: Array, out: Array) -> None:
    """out (N,) is the force (N) of a force with memory that is relaxed at the first sample.

    Between samples the path is taken as straight: a reversal is seen at the next sample.
    """
    own, z = pointer(p, 0), 0.0
    for k in range(x.shape[0]):
        before = k - 1 if k > 0 else 0
        z = call_bristle(code, (z, x[k] - x[before], 0.0, 0.0, v[before], v[k], 0.0, 0.0, own,
                                pointer(out, k), ONE))


@entry
def senses_along(code: int, p: Array, x: Array, period: float, other: Array, out: Array) -> None:
    """out (N,) is what a hook `sense` adds to the readings of positions (m); `other` (N,) is
    where the neighbour is, or empty."""
    stride = 1 if other.shape[0] > 0 else 0
    call_sense(code, (pointer(x, 0), pointer(out, 0), x.shape[0], 0, period, pointer(other, 0),
                      stride, pointer(p, 0)))


@entry
def flows_along(code: int, p: Array, states: int, x: Array, v: Array, d: Array, u: Array,
                per: float, period: float, begins: float, out: Array) -> None:
    """out (N,) is the force (N) of a hook `flow` whose states begin at zero, at the time `begins`
    (s); `d` are the actuator's forces (N), `per` amperes per newton of them, and `u` the commands.

    A sample that its rates are too fast for is taken in halves, down to its FINEST part.
    """
    z, moved, stages = np.zeros(states + 1), np.zeros(states + 1), np.zeros(STAGES * states + 1)
    forces = np.zeros(3)
    own, first = pointer(p, 0), pointer(z, 0)
    for k in range(x.shape[0]):
        done, size = 0.0, 1.0
        while done < 1.0:
            x0, v0, d0 = _on(x, k, done), _on(v, k, done), _on(d, k, done)
            t0 = begins + (k + done) * period
            now = call_flow(code, (
                t0, 0.0, x0, x0, x0, x0, v0, v0, v0, v0, d0, d0, d0, d0, u[k],
                per, first, first, pointer(stages, 0), own, pointer(forces, 0), ONE, 0))
            if done == 0.0:
                out[k] = now
            if states == 0 or k + 1 == x.shape[0]:
                break
            r1, r2, r3 = done + POINT_1 * size, done + POINT_2 * size, done + size
            call_flow(code, (
                t0, size * period, x0, _on(x, k, r1), _on(x, k, r2),
                _on(x, k, r3), v0, _on(v, k, r1), _on(v, k, r2), _on(v, k, r3), d0,
                _on(d, k, r1), _on(d, k, r2), _on(d, k, r3), u[k], per, first,
                pointer(moved, 0), pointer(stages, 0), own, pointer(forces, 0), THREE, -SWEEPS))
            if np.isnan(forces[2]) and size > FINEST:
                size *= 0.5
                continue
            done += size
            for j in range(states):
                z[j] = moved[j]


@inlined
def _on(signal: Array, k: int, part: float) -> float:
    """A signal (N,) at a part of the interval after sample k, on the straight line."""
    if part == 0.0:
        return float(signal[k])
    return float(signal[k] + part * (signal[k + 1] - signal[k]))


@entry
def additions_along(code: int, p: Array, period: float, u: Array) -> None:
    """Add to the commands u (N,) what a hook `command` adds."""
    call_added(code, (pointer(u, 0), u.shape[0], 0, period, pointer(p, 0)))
