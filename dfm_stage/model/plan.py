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
from dfm_stage.model.registry import EFFECTS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plan:
    """A model compiled to flat arrays; see `dfm_stage.model.kernel.slots` for the addresses."""

    model: Model
    on: NDArray[np.bool_]
    layout: NDArray[np.int64]
    theta: Array
    states: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, changing: Sequence[str] = (), longest_delay: float = 0.0) -> Plan:
        """The plan of `model`, with room for base parameters `changing` from zero."""
        on = np.array([model.effect(name) is not None for name in slots.EFFECT_NAMES], dtype=bool)
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
        sizes = {slots.AT_HEAD: slots.HEAD_SIZE, slots.AT_STATE: n,
                 slots.AT_HISTORY: int(layout[slots.HISTORY]), slots.AT_A: n * (n + 1),
                 slots.AT_ROWS: slots.ROWS * (n + 1), slots.AT_DISCRETE: n * (n + 7)}
        first = 0
        for at, size in sizes.items():
            layout[at] = first
            first += size
        layout[slots.AT_TABLE] = first
        return cls(model, on, layout, theta, tuple(states))

    def work(self) -> Array:
        """A fresh work array, not prepared yet."""
        work = np.zeros(int(self.layout[slots.AT_TABLE]))
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
