"""Whole records: one model, or many parameter sets at once."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfm_stage.model.description import Model
from dfm_stage.model.errors import SimulationError
from dfm_stage.model.kernel import record, slots
from dfm_stage.model.plan import Plan, addresses, apply_slots, place

Array = NDArray[np.float64]
_NO_FORCE = np.empty((0, 4))
_NO_OTHER = np.empty(0)


@dataclass(frozen=True)
class SimulationResult:
    """Signals at t_k = k T, each of shape (N,), sampled before input k acts.

    `position` (m) and `velocity` (m/s) are those of the driven point, `current` in A (with a
    voltage drive and no coil_resistance: the drive in V), `force` (N) that of the actuator on
    the moving mass, `output` (m) the encoder's reading without noise and rounding.
    """

    time: Array
    position: Array
    velocity: Array
    current: Array
    force: Array
    output: Array
    resolution: float
    noise: float

    def measured(self, seed: int = 0) -> Array:
        """The reading with noise (normal, `default_rng(seed)`) and rounding, shape (N,)."""
        reading = self.output
        if self.noise > 0.0:
            draws = np.random.default_rng(seed).standard_normal(len(reading))
            reading = reading + self.noise * draws
        if self.resolution > 0.0:
            reading = np.rint(reading / self.resolution) * self.resolution
        return reading


class Simulator:
    """Simulates one axis of `model` on whole records.

    Inputs are held: input[k] acts from t_k (plus the delay) for one sample period, and signals
    are sampled at t_k before it acts. A simulator keeps no state between calls and may be shared
    by threads.

    Raises
    ------
    ModelError
        If the model has several axes and `axis` names none of them.
    """

    def __init__(self, model: Model, axis: str | None = None) -> None:
        self.model = model.axis(axis)
        self._plan = Plan.of(self.model)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states an initial value can be given for."""
        return self._plan.states

    def run(self, input: ArrayLike, *, initial: Mapping[str, float] | None = None,
            past_input: float = 0.0, steady_state: bool = False) -> SimulationResult:
        """Simulate the input (N,) in V, or A with a current drive.

        Parameters
        ----------
        initial
            State name -> value at t_0 (`states` lists the names); zero where not given.
        past_input
            The constant input before t_0, which a delay still brings in.
        steady_state
            Take `input` as one period of a periodic input and return the periodic motion.

        Raises
        ------
        SimulationError
            If the input is not finite, or there is no periodic motion.
        """
        inputs = _record(input, "input")
        plan, work = self._plan, self._plan.work()
        theta = plan.theta.copy()
        for name, value in (initial or {}).items():
            theta[place(self.model, plan.states, f"initial.{name}")] = value
        record.prepare(plan.on, plan.layout, theta, work)
        record.reset(plan.layout, theta, float(past_input), work)
        if steady_state:
            _check(record.settle(plan.on, plan.layout, theta, work, inputs, _NO_FORCE, _NO_OTHER))
        out = np.empty((len(slots.SIGNALS), len(inputs)))
        _check(record.run(plan.on, plan.layout, theta, work, inputs, _NO_FORCE, _NO_OTHER,
                          np.arange(len(slots.SIGNALS)), out))
        time = np.arange(len(inputs)) * self.model.sample_period
        return SimulationResult(time, *out, resolution=theta[slots.RESOLUTION],
                                noise=theta[slots.NOISE])

    def run_many(self, input: ArrayLike, parameter_names: Sequence[str],
                 parameter_matrix: ArrayLike, *, signal: str = "output",
                 past_input: float = 0.0, steady_state: bool = False,
                 threads: int | None = None) -> Array:
        """Simulate the input (N,) for each row of `parameter_matrix` (P, n); returns (P, N).

        `parameter_names` (n) are addresses such as `mass`, `cubic_stiffness.k3` or, for the state
        at t_0, `initial.position`; `encoder_zero` is the output offset. Rows are spread over
        `threads` threads, by default one per available core.

        Raises
        ------
        ModelError, SimulationError
            If a name is not known, a shape is wrong, or there is no periodic motion.
        """
        inputs = _record(input, "input")
        matrix = np.atleast_2d(np.asarray(parameter_matrix, dtype=float))
        if matrix.ndim != 2 or matrix.shape[1] != len(parameter_names):
            raise SimulationError(f"the parameter matrix has shape {matrix.shape}; "
                                  f"it needs {len(parameter_names)} columns, one per name")
        plan, table = self._table(parameter_names, matrix)
        out = np.empty((len(table), len(inputs)))
        status = np.zeros(len(table), dtype=np.int64)

        def part(rows: slice) -> None:
            record.many(plan.on, plan.layout, self.model.sample_period, table[rows],
                        float(past_input), inputs, _NO_FORCE, _NO_OTHER,
                        slots.SIGNALS.index(signal), steady_state, plan.work(), out[rows],
                        status[rows])

        workers = min(threads or _cores(), len(table))
        bounds = np.linspace(0, len(table), workers + 1).astype(int)
        parts = [slice(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        if workers <= 1:
            for rows in parts:
                part(rows)
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(part, parts))
        _check(int(status.max(initial=0)))
        return out

    def _table(self, names: Sequence[str], matrix: Array) -> tuple[Plan, Array]:
        known = addresses(self.model, self._plan.states)
        delay = 0.0
        for column, name in enumerate(names):
            if name == "delay" or name == "transport_delay.delay":
                delay += float(matrix[:, column].max(initial=0.0))
        plan = Plan.of(self.model, [n for n in names if n in known],
                       delay + self._plan.theta[slots.DELAY])
        base = plan.theta.copy()
        for use_slot in _slot_indices(self.model):
            base[use_slot] = 0.0
        for name, value in self.model.base.items():
            base[slots.SLOT_NAMES.index(name)] = value
        table = np.tile(base, (len(matrix), 1))
        for column, name in enumerate(names):
            table[:, place(self.model, plan.states, name)] = matrix[:, column]
        apply_slots(self.model, table)
        return plan, table


def _slot_indices(model: Model) -> list[int]:
    from dfm_stage.model.registry import EFFECTS
    return [slots.SLOT_NAMES.index(slot) for use in model.effects
            if (slot := EFFECTS[use.name].adds_to) is not None]


def _record(values: ArrayLike, name: str) -> Array:
    array = np.ascontiguousarray(values, dtype=float)
    if array.ndim != 1 or len(array) == 0:
        raise SimulationError(f"the {name} has shape {array.shape}; give one value per sample")
    if not np.all(np.isfinite(array)):
        raise SimulationError(f"the {name} is not finite at sample "
                              f"{int(np.argmin(np.isfinite(array)))}; remove or repair it")
    return array


def _check(status: int) -> None:
    if status == 1:
        raise SimulationError("there is no periodic motion: the stage has no spring and drifts; "
                              "remove the mean of the input or simulate from an initial state")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
