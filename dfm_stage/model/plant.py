"""The plant one sample at a time, for real time and lockstep."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dfm_stage.model.description import Model
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.record import peek, run
from dfm_stage.model.kernel.setup import prepare, reset
from dfm_stage.model.plan import Plan, place

_NONE = np.empty((0, 4))
_NOWHERE = np.full(len(slots.SIGNALS), -1)
_DRAWS = 1024
FINEST_COUNT_M = 1e-12


class Sample(NamedTuple):
    """The plant at t_k, before input k acts."""

    position_m: float
    """True position of the driven point."""
    velocity: float
    """m/s"""
    current: float
    """A; V with a voltage drive and no coil_resistance"""
    force_n: float
    """Force of the actuator on the moving mass."""
    counts: int
    """The encoder's reading, noise included, in units of `Plant.count_size_m`."""
    reading_m: float
    """The same in metres."""


class Plant:
    """One axis of a model in time.

    >>> plant = Plant(load_model("paper_stage"), seed=1)
    >>> measured = plant.sample()      # at t_k; the same until the next advance
    >>> plant.advance(0.1)             # hold 0.1 V over [t_k, t_k+1)

    `sample()` and `advance(input, external_force_n=0.0)` cost a few microseconds. The same seed
    gives the same noise, sample by sample, as `SimulationResult.measured(seed)`; the motion is
    bit for bit that of `Simulator.run`. `external_force_n` (N) acts on the moving mass over the
    sample, undelayed. `reset(position=, velocity=, states=, past_input=)` starts again at k = 0,
    with the noise from its beginning.
    """

    def __init__(self, model: Model, axis: str | None = None, seed: int = 0) -> None:
        self.model = model.axis(axis)
        self.seed = seed
        self._plan = Plan.of(self.model)
        self._work = self._plan.work()
        self._theta = self._plan.theta.copy()
        self._held, self._out = np.zeros(1), np.zeros((len(slots.SIGNALS), 1))
        self._force = np.zeros((1, 4))
        self._noise = float(self._theta[slots.NOISE])
        step = self.model.effect("encoder_quantization")
        self._step = step.parameters["step"] if step else 0.0
        resolution = float(self._theta[slots.RESOLUTION])
        self.count_size_m = resolution if resolution > 0.0 else FINEST_COUNT_M
        prepare(self._plan.on, self._plan.layout, self._theta, self._work)
        self.reset()

    @property
    def sample_period(self) -> float:
        """Time between samples, s."""
        return self.model.sample_period

    def reset(self, position: float = 0.0, velocity: float = 0.0,
              states: Mapping[str, float] | None = None, past_input: float = 0.0) -> None:
        """Go back to k = 0 with the given state and a constant input before it."""
        theta = self._theta
        theta[slots.FIRST_INITIAL:] = 0.0
        for name, value in {"position": position, "velocity": velocity, **(states or {})}.items():
            theta[place(self.model, self._plan.states, f"initial.{name}")] = value
        reset(self._plan.on, self._plan.layout, theta, past_input, self._work)
        self._generator = np.random.default_rng(self.seed)
        self._draws: list[float] = []
        self._sample: Sample | None = None

    def sample(self) -> Sample:
        """The plant at the present sample."""
        if self._sample is None:
            self._sample = self._look()
        return self._sample

    def _look(self) -> Sample:
        peek(self._plan.on, self._plan.layout, self._theta, self._work, _NONE, self._out)
        position, velocity, current, force, reading, _ = self._out[:, 0].tolist()
        if self._noise > 0.0:
            if not self._draws:
                self._draws = self._generator.standard_normal(_DRAWS)[::-1].tolist()
            reading += self._noise * self._draws.pop()
        if self._step > 0.0:
            reading = round(reading / self._step) * self._step
        counts = round(reading / self.count_size_m)
        return Sample(position, velocity, current, force, counts, counts * self.count_size_m)

    def advance(self, input: float, external_force_n: float = 0.0) -> None:
        """Hold `input` (V, or A) for one sample period."""
        if self._sample is None:
            self.sample()
        self._held[0] = input
        force = _NONE
        if external_force_n != 0.0:
            self._force[0, 0] = external_force_n
            force = self._force
        run(self._plan.on, self._plan.layout, self._theta, self._work, self._held, force,
                _NONE, _NOWHERE, self._out)
        self._sample = None
