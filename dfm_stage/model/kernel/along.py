"""The effects' hooks along a motion that is known: what each would give where the stage was."""

from __future__ import annotations

from dfm_stage.model.kernel.compiled import entry, pointer
from dfm_stage.model.kernel.hooks import ONE, call_bristle, call_force, call_sense
from dfm_stage.model.kernel.slots import Array


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
