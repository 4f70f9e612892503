"""From a one-axis model to the arrays of the compiled simulator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.base import BASE_BY_NAME
from dfm_stage.model.description import Model, unknown_name
from dfm_stage.model.errors import ModelError
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.events import TERMS
from dfm_stage.model.registry import EFFECTS

Array = NDArray[np.float64]


DIRECTED_LEVELS, SMOOTH_LEVELS = 19, 9


@dataclass(frozen=True)
class Plan:
    """A model compiled to flat arrays; see `dfm_stage.model.kernel.slots` for the addresses."""

    model: Model
    on: int
    layout: NDArray[np.int64]
    theta: Array
    states: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, changing: Sequence[str] = (), longest_delay: float = 0.0) -> Plan:
        """The plan of `model`, with room for base parameters `changing` from zero."""
        on = sum(1 << slots.BIT[use.name] for use in model.effects)
        theta = theta_of(model)
        layout = np.full(slots.LAYOUT_FIXED + len(slots.STATE_NAMES), -1, dtype=np.int64)
        states = ["position", "velocity"]
        if theta[slots.AMPLIFIER] > 0.0 or "amplifier_time_constant" in changing:
            states.append("amplifier")
        if theta[slots.INDUCTANCE] > 0.0 or "coil_inductance" in changing:
            states.append("coil")
        for use in model.effects:
            states.extend(EFFECTS[use.name].states)
        n = len(states)
        for index, name in enumerate(states):
            layout[slots.LAYOUT_FIXED + slots.STATE_NAMES.index(name)] = index
        delay = max(theta[slots.DELAY], longest_delay)
        layout[slots.ORDER] = n
        layout[slots.HISTORY] = math.floor(delay / model.sample_period + 1e-9) + 2
        layout[slots.CURVED] = on & slots.FORCED != 0
        layout[slots.DIRECTED] = on & slots.REVERSING != 0
        layout[slots.LEVELS] = levels = (
            0 if not layout[slots.CURVED] else
            DIRECTED_LEVELS if layout[slots.DIRECTED] else SMOOTH_LEVELS)
        sticks = levels if layout[slots.DIRECTED] else 0
        sizes = {slots.AT_HEAD: slots.HEAD_SIZE, slots.AT_STATE: n,
                 slots.AT_BRISTLE: slots.BRISTLES,
                 slots.AT_HISTORY: int(layout[slots.HISTORY]), slots.AT_A: n * (n + 1),
                 slots.AT_ROWS: slots.ROWS * (n + 1), slots.AT_DISCRETE: n * (n + 7),
                 slots.AT_HELD: n * (n + 1), slots.AT_NODE: 18 * levels * (n + 5),
                 slots.AT_END: 2 * levels * n * (n + 5),
                 slots.AT_STICK_NODE: 12 * sticks * (n + 1),
                 slots.AT_STICK_END: 2 * sticks * n * (n + 1),
                 slots.AT_SCRATCH: n + 3 * slots.BRISTLES + (n + 1) * TERMS}
        first = 0
        for at, size in sizes.items():
            layout[at] = first
            first += size
        layout[slots.WORK_SIZE] = first
        kept = [use.name for use in model.effects if use.name in slots.BRISTLE_NAMES]
        return cls(model, on, layout, theta, (*states, *kept))

    def work(self) -> Array:
        """A fresh work array, not prepared yet."""
        work = np.zeros(int(self.layout[slots.WORK_SIZE]))
        work[self.layout[slots.AT_HEAD] + slots.PERIOD] = self.model.sample_period
        return work


def theta_of(model: Model) -> Array:
    """All parameters of a one-axis model at their places."""
    theta = np.zeros(slots.THETA_SIZE)
    theta[slots.LIMIT] = np.inf
    theta[slots.FORCE_CONSTANT] = 1.0
    for name, value in model.base.items():
        theta[slots.SLOT_NAMES.index(name)] = value
    for use in model.effects:
        effect = EFFECTS[use.name]
        first = slots.FIRST_PARAMETER[use.name]
        for offset, parameter in enumerate(effect.parameters):
            theta[first + offset] = use.parameters[parameter.name]
    apply_slots(model, theta)
    return theta


def apply_slots(model: Model, theta: Array) -> None:
    """Add the effects that are terms of a slot to it; `theta` has shape (..., THETA_SIZE)."""
    for use in model.effects:
        slot = EFFECTS[use.name].adds_to
        if slot is None:
            continue
        index, own = slots.SLOT_NAMES.index(slot), slots.FIRST_PARAMETER[use.name]
        if slot == "command_limit":
            theta[..., index] = theta[..., own]
        else:
            theta[..., index] += theta[..., own]


def addresses(model: Model, states: Sequence[str]) -> dict[str, int]:
    """Address of a free parameter -> its place in theta."""
    found = {name: slots.SLOT_NAMES.index(name) for name in BASE_BY_NAME}
    for use in model.effects:
        for offset, parameter in enumerate(EFFECTS[use.name].parameters):
            found[f"{use.name}.{parameter.name}"] = slots.FIRST_PARAMETER[use.name] + offset
    for name in states:
        found[f"initial.{name}"] = slots.FIRST_INITIAL + slots.STATE_NAMES.index(name)
    return found


def place(model: Model, states: Sequence[str], address: str) -> int:
    """The place of one free parameter in theta.

    Raises
    ------
    ModelError
        If the model has no such parameter.
    """
    known = addresses(model, states)
    if address not in known:
        raise ModelError(unknown_name("parameter", address, known))
    return known[address]


def parameter_table(plan: Plan, names: Sequence[str], matrix: Array) -> tuple[Plan, Array]:
    """A plan with room for the changing parameters, and theta for each row of `matrix`.

    Raises
    ------
    ModelError
        If a name is not known.
    """
    model = plan.model
    places = [place(model, plan.states, name) for name in names]
    longest = sum((float(matrix[:, column].max(initial=0.0)) for column, name in enumerate(names)
                   if name in ("delay", "transport_delay.delay")), plan.theta[slots.DELAY])
    wide = Plan.of(model, names, longest)
    base = wide.theta.copy()
    for use in model.effects:
        slot = EFFECTS[use.name].adds_to
        if slot is not None:
            base[slots.SLOT_NAMES.index(slot)] = model.base.get(slot, 0.0)
    table = np.tile(base, (len(matrix), 1))
    for column, index in enumerate(places):
        table[:, index] = matrix[:, column]
    apply_slots(model, table)
    return wide, table
