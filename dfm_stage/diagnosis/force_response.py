"""What a small force of an effect adds to the motion of a linear model.

To first order in its size this is the response of the model to the force that the effect would
have along the model's own motion. One simulation of the response to a push serves for all effects,
so none is simulated at a size: there it bends its own response, and dry friction is slow.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.system import System
from dfm_stage.model import EFFECTS
from dfm_stage.model.along import Motion, force_along, friction_along
from dfm_stage.model.effect import Effect, Parameters, reads
from dfm_stage.transforms import longer_length

PARTS = 4
"""Parts of a sample over which a force is averaged: it may change within one."""


class ForceResponse:
    """The responses of a linear system, at its unknowns `x` (n,), to forces along its motion."""

    def __init__(self, system: System, x: Array) -> None:
        self.runs = [_RunResponse(system, index, x) for index in range(len(system.runs))]

    @staticmethod
    def serves(system: System) -> bool:
        """Whether the response to a force does not depend on the motion: nothing curves it, no
        error of the reading does, and no window or period begins anew. An acceleration jumps with
        the force, inside a sample."""
        return not system.nonlinear and not any(
            run.window or run.start == "periodic" or run.order > 1 for run in system.runs
        ) and not any(use.effect.rounds or reads(use.effect.sense, 0)
                      for use in system.model.effects)

    @staticmethod
    def tells(effect: Effect) -> bool:
        """Whether the motion tells the force of an effect: not where it reads the command."""
        return effect.curves and not reads(effect.flow, 3)

    def changes(self, name: str, parameters: Parameters) -> list[list[Array]]:
        """What an effect adds to the signals compared of each run, (N - skip,) each."""
        values = np.array([parameters.get(n, d) for n, d in EFFECTS[name].defaults.items()])
        return [run.changes(EFFECTS[name], values) for run in self.runs]


class _RunResponse:
    """One run: the motion, and what one newton held for a sample adds to its signals."""

    def __init__(self, system: System, index: int, x: Array) -> None:
        run, base = system.runs[index], system.model.base
        self.size, self.skip = run.input.size, run.skip
        position, speed, actuator = system.motion(index, x, PARTS)
        self.parts = position.size // self.size
        part = run.sample_period / self.parts
        self.motion = Motion.of(system.model, position, speed, actuator, part, 0.5 * part)
        stiffness = base.get("stiffness", 0.0)
        stopping_time = math.sqrt(base["mass"] / stiffness) if stiffness > 0.0 else part
        self.stops = stopping_time / base["mass"]
        """Speed (m/s) per newton of dry friction below which this brings the point to rest: it is
        taken as viscous there."""
        self.length = longer_length(2 * self.size)
        push = np.zeros(self.size)
        push[0] = base["mass"] * max(float(np.sqrt(np.mean(speed**2))), 1e-300) / run.sample_period
        plain = system.pushed(index, x, np.zeros_like(push))
        self.spectra: list[Complex] = [
            np.fft.rfft((a - b) / push[0], self.length)
            for a, b in zip(system.pushed(index, x, push), plain, strict=True)]

    def changes(self, effect: Effect, values: Array) -> list[Array]:
        """What an effect adds to each signal, (N - skip,)."""
        force = np.fft.rfft(self._force(effect, values), self.length)
        return [np.fft.irfft(response * force, self.length)[self.skip:self.size]
                for response in self.spectra]

    def _force(self, effect: Effect, values: Array) -> Array:
        """The mean force (N,) of an effect over each sample, in N."""
        force = force_along(effect, values, self.motion)
        friction = friction_along(effect, values, self.motion)
        dry = friction > 0.0
        force[dry] -= friction[dry] * np.clip(
            self.motion.speed[dry] / (self.stops * friction[dry]), -1.0, 1.0)
        return np.asarray(force.reshape(-1, self.parts).mean(axis=1))
