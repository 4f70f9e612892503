"""From a one-axis model to the arrays of the compiled simulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from dfm_stage.model.description import Model, unknown_name
from dfm_stage.model.effect import Effect, reads
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.collocated import STAGES
from dfm_stage.model.kernel.events import TERMS
from dfm_stage.model.kernel.hooks import SUMMED, address
from dfm_stage.model.kernel.setup import SMOOTH_LEVELS
from dfm_stage.model.kernel.slots import Array, Layout
from dfm_stage.model.parameter import BASE_BY_NAME, ModelError

STEPS_ALLOWED = 512.0
"""Integration steps a sample above which a force is too stiff to follow."""
SHARP_LEVELS = 19
"""Levels of halving where reversals or kinks are to be located."""
_LAGS = (("amplifier", slots.AMPLIFIER, slots.AMPLIFIER_STATE),
         ("coil", slots.INDUCTANCE, slots.COIL_STATE))
"""State, the slot that makes it, and where `layout` has its index."""
_TABLES: dict[int, tuple[str, Callable[[Effect], bool]]] = {
    slots.MODE_STAMPS: ("stamp", lambda effect: effect.stage == "modes"),
    slots.AMPLIFIER_STAMPS: ("stamp", lambda effect: effect.stage == "amplifier"),
    slots.MECHANICS_STAMPS: ("stamp", lambda effect: effect.stage == "mechanics"),
    slots.SENSOR_STAMPS: ("stamp", lambda effect: effect.stage == "sensor"),
    slots.STARTS: ("start", lambda _: True),
    slots.FORCES: ("force", lambda _: True),
    slots.ACTUATOR_FORCES: ("force", lambda effect: effect.side == "actuator"),
    slots.FRICTIONS: ("friction", lambda _: True),
    slots.BRISTLE_STEPS: ("advance", lambda _: True),
    slots.SENSES: ("sense", lambda _: True),
    slots.ENCODES: ("encode", lambda _: True),
    slots.OTHER_FORCES: ("other_force", lambda _: True),
    slots.FLOWS: ("flow", lambda _: True),
    slots.ADDED: ("added", lambda _: True),
    slots.COMMANDS: ("command", lambda _: True)}
"""Table of hooks -> the hook, and which of the effects that have it stand in the table."""


@dataclass(frozen=True)
class Plan:
    """A model compiled to flat arrays; see `dfm_stage.model.kernel.slots` for the addresses."""

    model: Model
    layout: Layout
    theta: Array
    states: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, changing: Sequence[str] = (), longest_delay: float = 0.0) -> Plan:
        """The plan of `model`, with room for parameters `changing` from zero."""
        changed = _slots_touched(model, changing)
        effects = [use.effect for use in model.effects]
        theta = np.array([*_slot_values(model.effective_base()), *(
            value for use in model.effects for value in use.parameters.values())])
        dry = any(e.adds_to == "dry_friction" or e.friction is not None for e in effects)
        bristles = [effect for effect in effects if effect.advance is not None]
        memory = [*bristles, *(e for e in effects if e.flow is not None and e.states)]
        forces = [hook for effect in effects for hook in (effect.force, effect.friction)]
        states = ["position", "velocity"]
        head = [-1] * slots.LAYOUT_FIXED
        for state, slot, at in _LAGS:
            if theta[slot] > 0.0 or slots.SLOT_NAMES[slot] in changed:
                head[at] = len(states)
                states.append(state)
        for effect in effects:
            if effect not in memory:
                states.extend(effect.state_names)
        head[slots.ORDER] = len(states)
        head[slots.HISTORY] = _history(model, max(theta[slots.DELAY], longest_delay))
        head[slots.CURVED] = any(effect.curves for effect in effects)
        head[slots.DIRECTED] = directed = dry or bool(memory)
        sharp = directed or any(effect.side_of_kinks for effect in effects)
        head[slots.LEVELS] = (0 if not head[slots.CURVED] else
                              SHARP_LEVELS if sharp else SMOOTH_LEVELS)
        head[slots.BRISTLES] = sum(len(effect.state_names) for effect in memory)
        head[slots.KEPT] = len(bristles)
        head[slots.USES_SPEED] = directed or any(reads(force, 1) for force in forces) \
            or any(reads(effect.flow, 2) for effect in effects)
        head[slots.USES_DRIVE] = any(reads(force, 2) for force in forces) \
            or any(reads(effect.flow, 4) for effect in effects)
        states.extend(name for effect in memory for name in effect.state_names)
        _place_blocks(head, sum(effect.registers for effect in effects))
        head[slots.AT_INITIAL] = len(theta)
        entries = _hook_tables(effects, states, head)
        return cls(model, np.array(head + entries, dtype=np.int64),
                   np.append(theta, np.zeros(len(states))), tuple(states))

    def work(self) -> Array:
        """A fresh work array, not prepared yet."""
        work = np.zeros(int(self.layout[slots.WORK_SIZE]))
        work[self.layout[slots.AT_HEAD] + slots.PERIOD] = self.model.sample_period
        work[self.layout[slots.AT_HEAD] + slots.ALLOWED] = STEPS_ALLOWED
        return work

    @cached_property
    def addresses(self) -> dict[str, int]:
        """Address of a free parameter -> its place in theta."""
        names = [*slots.SLOT_NAMES, *(f"{use.name}.{name}" for use in self.model.effects
                                      for name in use.parameters),
                 *(f"initial.{name}" for name in self.states)]
        return {name: place for place, name in enumerate(names)
                if name in BASE_BY_NAME or place >= len(slots.SLOT_NAMES)}

    def place(self, address: str) -> int:
        """The place of one free parameter in theta.

        Raises
        ------
        ModelError
            If the model has no such parameter.
        """
        if address not in self.addresses:
            raise ModelError(unknown_name("parameter", address, self.addresses))
        return self.addresses[address]


def _place_blocks(head: list[int], registers: int) -> None:
    """Give each block of `work` its first index."""
    n, levels, bristles = head[slots.ORDER], head[slots.LEVELS], head[slots.BRISTLES]
    sticks = levels if head[slots.DIRECTED] else 0
    sizes = {slots.AT_HEAD: slots.HEAD_SIZE, slots.AT_STATE: n, slots.AT_BRISTLE: bristles,
             slots.AT_HISTORY: head[slots.HISTORY], slots.AT_REGISTERS: registers,
             slots.AT_A: n * (n + 1), slots.AT_ROWS: slots.ROWS * (n + 1),
             slots.AT_DISCRETE: n * (n + 7), slots.AT_HELD: n * (n + 1),
             slots.AT_NODE: 18 * levels * (n + 5),
             slots.AT_END: 2 * levels * n * (n + 5), slots.AT_STICK_NODE: 12 * sticks * (n + 1),
             slots.AT_STICK_END: 2 * sticks * n * (n + 1),
             slots.AT_SCRATCH: n + bristles + (n + 1) * TERMS,
             slots.AT_STAGES: STAGES * bristles, slots.WORK_SIZE: 0}
    for at, first in zip(sizes, accumulate(sizes.values(), initial=0), strict=False):
        head[at] = first


def _hook_tables(effects: Sequence[Effect], states: Sequence[str], head: list[int]) -> list[int]:
    """The entries of all tables; where each table begins goes to `head`."""
    sizes = (len(effect.parameters) for effect in effects)
    own = [*accumulate(sizes, initial=len(slots.SLOT_NAMES))]
    kept = [*accumulate((effect.registers for effect in effects), initial=0)]
    entries: list[int] = []
    for table, (hook, belongs) in _TABLES.items():
        head[table] = slots.LAYOUT_FIXED + len(entries)
        uses = [(effect, first) for effect, first in zip(effects, own, strict=False)
                if getattr(effect, hook) is not None and belongs(effect)]
        for entry in [uses] if hook in SUMMED and uses else [[use] for use in uses]:
            effect, first = entry[0]
            state = states.index(effect.state_names[0]) if effect.state_names else 0
            if state >= head[slots.ORDER]:          # behind the linear ones
                state -= head[slots.ORDER]
            if hook == "command":
                state = kept[effects.index(effect)]
            entries += [address(hook, entry), first, state]
    head[slots.TABLES_END] = slots.LAYOUT_FIXED + len(entries)
    return entries


def _slot_values(given: Mapping[str, float]) -> list[float]:
    return [given.get(name, slots.ABSENT.get(name, 0.0)) for name in slots.SLOT_NAMES]


def _history(model: Model, delay: float) -> int:
    """How many inputs are kept for a delay, s."""
    return math.floor(delay / model.sample_period + 1e-9) + 2


def _slots_touched(model: Model, names: Sequence[str]) -> list[str]:
    """The slot that each free parameter is a term of, or its own name."""
    terms = {f"{use.name}.{effect.parameters[0].name}": effect.adds_to for use in model.effects
             for effect in [use.effect]}
    return [terms.get(name) or name for name in names]


def apply_slots(model: Model, theta: Array) -> None:
    """Add the effects that are terms of a slot to it; `theta` has shape (..., size)."""
    own = len(slots.SLOT_NAMES)
    for use in model.effects:
        effect = use.effect
        if effect.adds_to is not None:
            index = slots.SLOT_NAMES.index(effect.adds_to)
            combine = np.minimum if index == slots.LIMIT else np.add
            theta[..., index] = combine(theta[..., index], theta[..., own])
        own += len(effect.parameters)


def parameter_table(plan: Plan, names: Sequence[str], matrix: Array) -> tuple[Plan, Array]:
    """A plan with room for the changing parameters, and theta for each row of `matrix`.

    Raises
    ------
    ModelError
        If a name is not known.
    """
    model = plan.model
    places = [plan.place(name) for name in names]
    touched = _slots_touched(model, names)
    longest = sum((float(matrix[:, column].max(initial=0.0)) for column, slot in enumerate(touched)
                   if slot == "delay"), plan.theta[slots.DELAY])
    if _history(model, longest) > plan.layout[slots.HISTORY] or any(
            plan.layout[at] < 0 and slots.SLOT_NAMES[slot] in touched for _, slot, at in _LAGS):
        plan = Plan.of(model, names, longest)
        places = [plan.place(name) for name in names]
    table = np.tile(plan.theta, (len(matrix), 1))
    table[:, :len(slots.SLOT_NAMES)] = _slot_values(model.base)
    for column, index in enumerate(places):
        table[:, index] = matrix[:, column]
    apply_slots(model, table)
    return plan, table
