"""The force that an effect would have along a motion that is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.description import Model
from dfm_stage.model.effect import Effect
from dfm_stage.model.kernel import along
from dfm_stage.model.kernel.hooks import address


@dataclass(frozen=True)
class Motion:
    """Position (m), speed (m/s) and actuator force (N) of the driven point, (N,) each, `period` s
    apart from `begins` (s) on. `gain` is the force constant (N/V, or N/A), `resistance` that of
    the coil (ohm), or 1.
    """

    position: Array
    speed: Array
    actuator: Array
    period: float
    gain: float
    resistance: float
    begins: float = 0.0

    @classmethod
    def of(cls, model: Model, position: Array, speed: Array, actuator: Array, period: float,
           begins: float = 0.0) -> Motion:
        """A motion of a one-axis `model`. Without a force constant, or with one of zero, an
        actuator's force is taken for the current."""
        return cls(position, speed, actuator, period, model.base.get("force_constant", 1.0) or 1.0,
                   model.base.get("coil_resistance", 0.0) or 1.0, begins)

    @property
    def per_newton(self) -> float:
        """The current (A, or V without a resistance) per newton of the actuator."""
        return 1.0 / (self.gain * self.resistance)


def force_along(effect: Effect, values: Array, motion: Motion) -> Array:
    """The force (N,) of all hooks of an effect that give one at once, with memory, or with states
    of their own, with its parameters `values` (p,); in N. Memory is relaxed at the first sample,
    and states begin at zero. For the command of a hook `flow` stands what moves the actuator."""
    x, v, d = motion.position, motion.speed, motion.actuator
    total, out = np.zeros(x.size), np.zeros(x.size)
    if effect.force is not None:
        drive = motion.per_newton * d if effect.by_current else d
        along.forces_along(address("force", [(effect, 0)]), values, x, v, drive, out)
        total += out
    if effect.advance is not None:
        along.bristles_along(address("advance", [(effect, 0)]), values, x, v, out)
        total += out
    if effect.flow is not None:
        along.flows_along(address("flow", [(effect, 0)]), values, len(effect.states), x, v, d,
                          d / motion.gain, motion.per_newton, motion.period, motion.begins, out)
        total += out
    return total


def friction_along(effect: Effect, values: Array, motion: Motion) -> Array:
    """The size (N,) that the dry friction of an effect would have, in N; zero where it has
    none."""
    size = np.zeros(motion.position.size)
    if effect.friction is not None:
        along.forces_along(address("friction", [(effect, 0)]), values, motion.position,
                           motion.speed, motion.actuator, size)
    return size + values[0] if effect.adds_to == "dry_friction" else size
