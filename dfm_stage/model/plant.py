"""The plant one sample at a time, for real time and lockstep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.description import Model
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.record import DIVERGED, peek, run
from dfm_stage.model.kernel.setup import prepare, reset
from dfm_stage.model.parameter import SimulationError
from dfm_stage.model.plan import Plan
from dfm_stage.model.simulator import rounding_of

_NONE = np.empty((0, 4))
_NOWHERE = np.full(len(slots.SIGNALS), -1)
_DRAWS = 1024
_SEED_STEP = 1000
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
    bit for bit that of `Simulator.run`. Without encoder_resolution a count is 1 pm.

    The other axis acts on this one in a `CoupledPlant` only; here it is at rest.

    Raises
    ------
    ModelError
        If the model has several axes and `axis` names none of them.
    SimulationError
        From `sample` and `advance`, if the input is not finite or the motion escapes to infinity.
    """

    def __init__(self, model: Model, axis: str | None = None, seed: int = 0) -> None:
        self.model = model.axis(axis)
        self.seed = seed
        self._plan = Plan.of(self.model)
        self._work = self._plan.work()
        self._theta = self._plan.theta.copy()
        self._held, self._out = np.zeros(1), np.zeros((len(slots.SIGNALS), 1))
        self._force, self._other = np.zeros((1, 4)), _NONE
        self._noise = float(self._theta[slots.NOISE])
        self._rounding = rounding_of(self.model)
        resolution = float(self._theta[slots.RESOLUTION])
        self.count_size_m = resolution if resolution > 0.0 else FINEST_COUNT_M
        prepare(self._plan.layout, self._theta, self._work)
        self.reset()

    @property
    def sample_period(self) -> float:
        """Time between samples, s."""
        return self.model.sample_period

    def reset(self, position: float = 0.0, velocity: float = 0.0,
              states: Mapping[str, float] | None = None, past_input: float = 0.0) -> None:
        """Go back to k = 0, with the noise from its beginning.

        `states` are further initial states by name, as `Simulator.states` lists them;
        `past_input` is the constant input before, which a delay still brings in.
        """
        theta = self._theta
        theta[self._plan.layout[slots.AT_INITIAL]:] = 0.0
        for name, value in {"position": position, "velocity": velocity, **(states or {})}.items():
            theta[self._plan.place(f"initial.{name}")] = value
        reset(self._plan.layout, theta, float(past_input), self._work)
        self._generator = np.random.default_rng(self.seed)
        self._draws: list[float] = []
        self._sample: Sample | None = None

    def sample(self) -> Sample:
        """The plant at the present sample."""
        if self._sample is None:
            self._sample = self._look()
        return self._sample

    def advance(self, input: float, external_force_n: float = 0.0) -> None:  # noqa: A002
        """Hold `input` (V, or A) for one sample period.

        `external_force_n` acts on the driven point over the sample, undelayed.

        Raises
        ------
        SimulationError
            If the input or the force is not finite.
        """
        if not -1e300 < input + external_force_n < 1e300:
            raise SimulationError(f"the plant was given the input {input!r} and the force "
                                  f"{external_force_n!r}; both must be finite")
        if self._sample is None:
            self.sample()
        self._sample = None
        self._step(input, external_force_n)

    def _step(self, value: float, external_force_n: float) -> None:
        self._held[0] = value
        force = _NONE
        if external_force_n != 0.0:
            self._force[0, 0] = external_force_n
            force = self._force
        run(self._plan.layout, self._theta, self._work, self._held, force,
            self._other, _NOWHERE, self._out)

    def _peek(self) -> Array:
        """All signals at the present sample, without noise and rounding, (6,)."""
        peek(self._plan.layout, self._theta, self._work, self._other, self._out)
        return self._out[:, 0]

    def _look(self) -> Sample:
        position, velocity, current, force, reading, *_ = self._peek().tolist()
        if not abs(position) < DIVERGED:
            raise SimulationError("the motion of the plant has escaped to infinity: the loop is "
                                  "unstable, or the model's forces do not hold the stage or are "
                                  "too stiff to follow")
        if self._noise > 0.0:
            if not self._draws:
                self._draws = self._generator.standard_normal(_DRAWS)[::-1].tolist()
            reading += self._noise * self._draws.pop()
        for effect in self._rounding:
            reading = effect(reading)
        counts = round(reading / self.count_size_m)
        return Sample(position, velocity, current, force, counts, counts * self.count_size_m)


class CoupledPlant:
    """All axes of a model in time, acting on each other where the model says so.

    >>> stage = CoupledPlant(load_model("xy_stage"), seed=1)
    >>> x, y = stage.sample()          # in the order of `stage.axes`
    >>> stage.advance([0.1, 0.0])

    Axis number i has the noise of seed + 1000 i. Between samples an axis sees the motion of its
    neighbour as the cubic through its positions and velocities at both ends of the sample, found
    by advancing all axes twice.
    """

    def __init__(self, model: Model, seed: int = 0) -> None:
        self.model = model
        self.axes: tuple[str, ...] = model.axis_names
        names: list[str | None] = [*self.axes] if self.axes else [None]
        self.plants = tuple(Plant(model, name, seed + _SEED_STEP * index)
                            for index, name in enumerate(names))
        neighbours = [model.neighbour(name) for name in names]
        self._coupled = [(plant, names.index(name)) for plant, name in
                         zip(self.plants, neighbours, strict=True) if name is not None]
        for plant, _ in self._coupled:
            plant._other = np.zeros((1, 4))
        self._twice = any(
            hook(tuple(use.parameters.values())) != 0.0
            for plant, _ in self._coupled for use in plant.model.effects
            if (hook := use.effect.other_force) is not None)

    def reset(self) -> None:
        """Go back to k = 0 and rest; use the `reset` of single `plants` for another state."""
        for plant in self.plants:
            plant.reset()

    def sample(self) -> tuple[Sample, ...]:
        """All axes at the present sample."""
        if self._coupled and all(plant._sample is None for plant in self.plants):
            for plant, source in self._coupled:         # where the neighbour is now
                plant._other[0] = self.plants[source]._peek()[slots.POSITION], 0.0, 0.0, 0.0
        return tuple([plant.sample() for plant in self.plants])

    def advance(self, inputs: Sequence[float],
                external_forces_n: Sequence[float] | None = None) -> None:
        """Hold one input per axis (V, or A) for one sample period.

        Raises
        ------
        SimulationError
            If the number of inputs is wrong or one is not finite.
        """
        forces = external_forces_n if external_forces_n is not None else [0.0] * len(self.plants)
        if len(inputs) != len(self.plants) or len(forces) != len(self.plants):
            raise SimulationError(f"the plant has {len(self.plants)} axes, but was given "
                                  f"{len(inputs)} inputs and {len(forces)} forces")
        if self._twice:
            before = self.sample()
            period = self.model.sample_period
            saved = [plant._work[:plant._plan.layout[slots.AT_A]].copy() for plant in self.plants]
            for plant, source in self._coupled:
                plant._other[0, 1] = before[source].velocity * period
            for plant, value, force in zip(self.plants, inputs, forces, strict=True):
                plant._step(value, force)
            after = [plant._peek().copy() for plant in self.plants]
            for plant, kept in zip(self.plants, saved, strict=True):
                plant._work[:len(kept)] = kept
            for plant, source in self._coupled:
                first, last = before[source], after[source]
                rise = last[slots.POSITION] - first.position_m
                v0, v1 = first.velocity * period, last[slots.VELOCITY] * period
                plant._other[0] = (first.position_m, v0, 3.0 * rise - 2.0 * v0 - v1,
                                   v0 + v1 - 2.0 * rise)
        for plant, value, force in zip(self.plants, inputs, forces, strict=True):
            plant.advance(value, force)
