"""What a small force of an effect adds to the motion of a linear model.

To first order in its size this is the response of the model to the force that the effect would
have along the model's own motion: one simulation of the force's impulse response serves for all
effects. At a finite size an effect bends its own response, and dry friction takes many steps to
follow.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.identification.system import System
from dfm_stage.model import EFFECTS
from dfm_stage.model.along import Motion, force_along, friction_along
from dfm_stage.model.effect import Parameters, reads
from dfm_stage.transforms import longer_length

PARTS = 4
"""Parts of a sample over which a force is averaged: it may change within one."""


class ForceResponse:
    """The responses of a linear system, at its unknowns `x` (n,), to forces along its motion."""

    def __init__(self, system: System, x: Array) -> None:
        self.system = system
        self.runs = [_RunResponse(system, index, x) for index in range(len(system.runs))]

    @staticmethod
    def serves(system: System) -> bool:
        """Whether the response to a force does not depend on the motion: nothing curves it, no
        error of the reading does, and no window begins anew."""
        uses = system.model.effects
        return not system.nonlinear and not any(run.window for run in system.runs) and not any(
            use.effect.rounds or reads(use.effect.sense, 0) for use in uses)

    def changes(self, name: str, parameters: Parameters) -> list[list[Array]]:
        """What an effect adds to the signals compared of each run, (N - skip,) each; NaN where
        there is no such motion."""
        values = np.array([parameters.get(n, d) for n, d in EFFECTS[name].defaults.items()])
        return [run.changes(name, values) for run in self.runs]


class _RunResponse:
    """One run: the motion, and what one newton held for a sample adds to its signals."""

    def __init__(self, system: System, index: int, x: Array) -> None:
        run, base = system.runs[index], system.model.base
        self.run, self.parts = run, 1
        x_along, v_along, d_along = system.motion(index, x, PARTS)
        self.parts = x_along.size // run.input.size
        period = run.sample_period / self.parts
        self.motion = Motion(x_along, v_along, d_along, period,
                             base.get("force_constant", 1.0) or 1.0,
                             base.get("coil_resistance", 0.0) or 1.0)
        stiffness = base.get("stiffness", 0.0)
        within = math.sqrt(base["mass"] / stiffness) if stiffness > 0.0 else period
        self.stops = within / base["mass"]
        """Speed (m/s) per newton of dry friction below which it brings the point to rest."""
        self.periodic = run.start == "periodic" and run.period is not None
        self.size = run.period if self.periodic and run.period else run.input.size
        self.length = self.size if self.periodic else longer_length(2 * self.size)
        push = np.zeros(run.input.size)
        push[::self.size] = base["mass"] * max(float(np.std(v_along)), 1e-300) / run.sample_period
        plain = system.pushed(index, x, np.zeros_like(push))
        self.spectra: list[Complex] = [
            np.fft.rfft(((a - b) / push[0])[:self.size], self.length)
            for a, b in zip(system.pushed(index, x, push), plain, strict=True)]

    def changes(self, name: str, values: Array) -> list[Array]:
        """What an effect adds to each signal, (N - skip,)."""
        if self.periodic and EFFECTS[name].on_the_clock:
            return [np.full(self.run.input.size - self.run.skip, math.nan) for _ in self.spectra]
        force = np.fft.rfft(self._force(name, values), self.length)
        found = [np.fft.irfft(h * force, self.length)[:self.size] for h in self.spectra]
        return [np.tile(y, self.run.input.size // self.size)[self.run.skip:] for y in found]

    def _force(self, name: str, values: Array) -> Array:
        """The mean force (N,) of an effect over each sample, in N; of a periodic motion the last
        period of it, when what has memory has settled."""
        effect = EFFECTS[name]
        force = force_along(effect, values, self.motion)
        friction = friction_along(effect, values, self.motion)
        dry = friction > 0.0
        force[dry] -= friction[dry] * np.clip(
            self.motion.speed[dry] / (self.stops * friction[dry]), -1.0, 1.0)
        return np.asarray(force.reshape(-1, self.parts).mean(axis=1)[-self.size:])
