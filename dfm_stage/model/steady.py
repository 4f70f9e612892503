"""The periodic motion of a model under a periodic input."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.record import run
from dfm_stage.model.kernel.setup import restart
from dfm_stage.model.kernel.slots import Array, Layout
from dfm_stage.model.plan import Plan

SETTLED, DRIFTS, UNSETTLED = 0, 1, 2
PERIODS = 400
TOLERANCE = 1e-10
MEMORY = 6
LARGEST_CONDITION = 1e12
_NOWHERE = np.full(len(slots.SIGNALS), -1)


def settle(plan: Plan, theta: Array, work: Array, inputs: Array, force: Array,
           other: Array) -> int:
    """Set the state in a prepared `work` to that of the periodic motion under one period.

    Linear models: exactly, from the period's response to zero and the power of the propagator.
    Others: from there by repeating the period, with Anderson acceleration (J. ACM 12 (1965) 547).
    Returns SETTLED, DRIFTS (there is no spring, and no such motion) or UNSETTLED.
    """
    layout, n = plan.layout, int(plan.layout[slots.ORDER])
    curved = bool(layout[slots.CURVED])
    back = int(work[layout[slots.AT_HEAD] + slots.WHOLE]) + 1
    past = inputs[np.arange(-back, 0) % len(inputs)]
    at_state, at_history = layout[slots.AT_STATE], layout[slots.AT_HISTORY]
    registers = work[layout[slots.AT_REGISTERS]:layout[slots.AT_A]]
    nothing = np.empty((0, len(inputs)))

    def after_period(point: Array, which: Layout) -> Array:
        work[at_state:at_state + len(point)] = point
        work[at_history:at_history + back] = past
        work[layout[slots.AT_HEAD] + slots.SAMPLE] = 0.0
        restart(layout, work)
        run(which, theta, work, inputs, force, other, _NOWHERE, nothing)
        reached: Array = work[at_state:at_state + len(point)].copy()
        return reached

    straight = layout.copy()
    straight[slots.CURVED] = 0
    if registers.size:
        def remembered(point: Array) -> Array:
            registers[:] = point
            run(straight, theta, work, inputs, force, other, _NOWHERE, nothing)
            return np.array(registers)

        if _fixed_point(remembered, np.array(registers)) is None:
            return UNSETTLED
        past = work[at_history:at_history + back].copy()
    forced = after_period(np.zeros(n), straight)
    first = layout[slots.AT_DISCRETE]
    propagator = work[first:first + n * (n + 7)].reshape(n, n + 7)[:, :n]
    left = np.eye(n) - np.linalg.matrix_power(propagator, len(inputs))
    outcome, begin = SETTLED, np.zeros(n + int(layout[slots.BRISTLES]))
    largest = np.abs(left).max(axis=1, keepdims=True)
    if np.all(np.isfinite(left)) and np.all(largest > 0.0) \
            and np.linalg.cond(left / largest) < LARGEST_CONDITION:
        begin[:n] = np.linalg.solve(left, forced)
    elif not curved:
        outcome = DRIFTS
    if curved:
        found = _fixed_point(lambda point: after_period(point, layout), begin)
        outcome = UNSETTLED if found is None else SETTLED
        begin = begin if found is None else found
    work[at_state:at_state + len(begin)] = begin
    work[at_history:at_history + back] = past
    work[layout[slots.AT_HEAD] + slots.SAMPLE] = 0.0
    restart(layout, work)
    return outcome


def _fixed_point(period: Callable[[Array], Array], point: Array) -> Array | None:
    """The point that `period` maps to itself, or None if repeating it does not arrive there."""
    points: list[Array] = []
    misses: list[Array] = []
    scale, best = np.full(len(point), 1e-100), np.inf
    for _ in range(PERIODS):
        image = period(point)
        scale = np.maximum(scale, np.abs(image))
        miss = image - point
        error = float(np.max(np.abs(miss) / scale))
        if error < TOLERANCE:
            return point
        if not np.isfinite(error):
            return None
        if error > 10.0 * best:
            points, misses = [], []
        best = min(best, error)
        points, misses = [*points[1 - MEMORY:], point], [*misses[1 - MEMORY:], miss]
        point = image
        if len(points) > 1:
            slopes = np.array([(miss - old) / scale for old in misses[:-1]]).T
            weights = np.linalg.lstsq(slopes, miss / scale, rcond=1e-10)[0]
            for weight, old_point, old_miss in zip(weights, points, misses, strict=False):
                point = point - weight * (image - old_point - old_miss)
    return None
