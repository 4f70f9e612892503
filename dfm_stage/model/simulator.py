"""Whole records: one model, or many parameter sets at once."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfm_stage.model.description import COUPLING_EFFECT, Model, unknown_name
from dfm_stage.model.errors import SimulationError
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.batch import DRIFTS, UNSETTLED, many, settle
from dfm_stage.model.kernel.record import run
from dfm_stage.model.kernel.setup import prepare, reset
from dfm_stage.model.plan import Plan, parameter_table, place

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SimulationResult:
    """Signals at t_k = k T, each of shape (N,), sampled before input k acts.

    `position` (m) and `velocity` (m/s) are those of the driven point, `current` in A (with a
    voltage drive and no coil_resistance: the drive in V), `force` (N) that of the actuator on
    the moving mass. `reading` (m) is what the encoder sees, without noise and rounding: position,
    zero, periodic error, drift, cross-axis. `output` is the same with encoder_quantization, if it
    is on, as its mean over the noise; it is what a measured record is compared with.
    """

    time: Array
    position: Array
    velocity: Array
    current: Array
    force: Array
    reading: Array
    output: Array
    step: float
    resolution: float
    noise: float

    def measured(self, seed: int = 0) -> Array:
        """The reading with noise (normal, `default_rng(seed)`), then rounded to the step of
        encoder_quantization and to encoder_resolution where they are given, shape (N,)."""
        reading = self.reading
        if self.noise > 0.0:
            draws = np.random.default_rng(seed).standard_normal(len(reading))
            reading = reading + self.noise * draws
        for count in (self.step, self.resolution):
            if count > 0.0:
                reading = np.rint(reading / count) * count
        return reading


class Simulator:
    """Simulates one axis of `model` on whole records.

    Inputs are held: input[k] acts from t_k (plus the delay) for one sample period, and signals
    are sampled at t_k before it acts. A simulator keeps no state between calls and may be shared
    by threads.

    Parameters common to the methods
    --------------------------------
    input
        (N,) in V, or A with a current drive.
    initial
        State name -> value at t_0 (`states` lists the names); zero where not given.
    past_input
        The constant input before t_0, which a delay still brings in.
    external_force
        (N,) in N, held over each sample, undelayed, on the driven point.
    other
        (N,) position of the neighbouring axis in m, for cross_axis_coupling; between samples a
        cubic (Hermite, slopes by central differences of fourth order).
    dither
        RMS of the noise (m) over which `output` averages encoder_quantization; by default the
        model's noise. With 0 it is a sharp staircase.
    steady_state
        Take `input` as one period of a periodic input and return the periodic motion.

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
            past_input: float = 0.0, external_force: ArrayLike | None = None,
            other: ArrayLike | None = None, dither: float | None = None,
            steady_state: bool = False) -> SimulationResult:
        """Simulate one record; see the class for the arguments.

        Raises
        ------
        ModelError, SimulationError
            If an argument is malformed, or there is no periodic motion.
        """
        inputs, force, neighbour = self._signals(input, external_force, other, steady_state)
        plan, work = self._plan, self._plan.work()
        theta = plan.theta.copy()
        for name, value in (initial or {}).items():
            theta[place(self.model, plan.states, f"initial.{name}")] = value
        resolution, noise = float(theta[slots.RESOLUTION]), float(theta[slots.NOISE])
        if dither is not None:
            theta[slots.NOISE] = dither
        prepare(plan.on, plan.layout, theta, work)
        reset(plan.on, plan.layout, theta, float(past_input), work)
        if steady_state:
            _check(settle(plan.on, plan.layout, theta, work, inputs, force, neighbour))
        out = np.empty((len(slots.SIGNALS), len(inputs)))
        run(plan.on, plan.layout, theta, work, inputs, force, neighbour,
            np.arange(len(slots.SIGNALS)), out)
        step = self.model.effect("encoder_quantization")
        return SimulationResult(np.arange(len(inputs)) * self.model.sample_period, *out,
                                step=step.parameters["step"] if step else 0.0,
                                resolution=resolution, noise=noise)

    def run_many(self, input: ArrayLike, parameter_names: Sequence[str],
                 parameter_matrix: ArrayLike, *, signal: str = "output",
                 past_input: float = 0.0, external_force: ArrayLike | None = None,
                 other: ArrayLike | None = None, dither: float | None = None,
                 steady_state: bool = False, threads: int | None = None) -> Array:
        """One signal for each row of `parameter_matrix` (P, n); returns (P, N).

        `parameter_names` (n) are addresses such as `mass`, `cubic_stiffness.k3` or, for the state
        at t_0, `initial.position`; `encoder_zero` is the output offset. Rows are spread over
        `threads` threads, by default one per available core. Values are not checked against the
        limits of the parameters.

        Raises
        ------
        ModelError, SimulationError
            If a name is not known, a shape is wrong, or there is no periodic motion.
        """
        if signal not in slots.SIGNALS:
            raise SimulationError(unknown_name("signal", signal, slots.SIGNALS))
        inputs, force, neighbour = self._signals(input, external_force, other, steady_state)
        matrix = np.atleast_2d(np.asarray(parameter_matrix, dtype=float))
        if matrix.ndim != 2 or matrix.shape[1] != len(parameter_names):
            raise SimulationError(f"the parameter matrix has shape {matrix.shape}; "
                                  f"it needs {len(parameter_names)} columns, one per name")
        if not np.all(np.isfinite(matrix)):
            raise SimulationError("the parameter matrix is not finite")
        plan, table = parameter_table(self._plan, parameter_names, matrix)
        if dither is not None:
            table[:, slots.NOISE] = dither
        out = np.empty((len(table), len(inputs)))
        status = np.zeros(len(table), dtype=np.int64)

        def part(rows: slice) -> None:
            many(plan.on, plan.layout, table[rows], float(past_input), inputs, force, neighbour,
                 slots.SIGNALS.index(signal), steady_state, plan.work(), out[rows], status[rows])

        workers = max(1, min(threads or _cores(), len(table)))
        bounds = np.linspace(0, len(table), workers + 1).astype(int)
        parts = [slice(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True)]
        if workers == 1:
            part(parts[0])
        else:
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(part, parts))
        _check(int(status.max(initial=0)))
        return out

    def _signals(self, input: ArrayLike, force: ArrayLike | None, other: ArrayLike | None,
                 steady_state: bool) -> tuple[Array, Array, Array]:
        inputs = _record(input, "input")
        pushes, others = np.empty((0, 4)), np.empty((0, 4))
        if force is not None:
            pushes = np.zeros((len(inputs), 4))
            pushes[:, 0] = _record(force, "external force", len(inputs))
        coupled = self.model.effect(COUPLING_EFFECT) is not None
        if coupled and other is None:
            raise SimulationError(f"{COUPLING_EFFECT} is on: give the position of the other axis "
                                  "as other=")
        if coupled and other is not None:
            others = hermite(_record(other, "position of the other axis", len(inputs)),
                             steady_state)
        disturbance = self.model.effect("periodic_disturbance")
        if steady_state and disturbance is not None:
            cycles = (disturbance.parameters["frequency"] * len(inputs)
                      * self.model.sample_period)
            if disturbance.parameters["amplitude"] and abs(cycles - round(cycles)) > 1e-6:
                raise SimulationError("there is no periodic motion: periodic_disturbance does "
                                      f"{cycles:g} cycles in one period of the input")
        return inputs, pushes, others


def hermite(values: Array, periodic: bool = False) -> Array:
    """Coefficients (N, 4) in r = (t - t_k) / T of the cubics through equidistant values (N,).

    Slopes are central differences of fourth order, one-sided at the ends unless `periodic`; the
    last interval of a record that is not periodic goes on with its slope.
    """
    count = len(values)
    if periodic:
        padded = values[np.arange(-2, count + 3) % count]
    elif count >= 4:
        before = [4 * values[0] - 6 * values[1] + 4 * values[2] - values[3]]
        after = [4 * values[-1] - 6 * values[-2] + 4 * values[-3] - values[-4]]
        padded = np.concatenate((before, values, after))
        before = [4 * padded[0] - 6 * padded[1] + 4 * padded[2] - padded[3]]
        after = [4 * padded[-1] - 6 * padded[-2] + 4 * padded[-3] - padded[-4]]
        padded = np.concatenate((before, padded, after, after))
    else:
        padded = np.pad(values, (2, 3), mode="edge")
    slope = (8.0 * (padded[3:-1] - padded[1:-3]) - (padded[4:] - padded[:-4])) / 12.0
    here, there = padded[2:count + 2], padded[3:count + 3]
    first, last = slope[:count], slope[1:count + 1]
    if not periodic:
        last[-1] = first[-1]
    rise = there - here
    return np.ascontiguousarray(np.column_stack(
        (here, first, 3.0 * rise - 2.0 * first - last, first + last - 2.0 * rise)))


def _record(values: ArrayLike, name: str, length: int | None = None) -> Array:
    array = np.ascontiguousarray(values, dtype=float)
    if array.ndim != 1 or len(array) == 0:
        raise SimulationError(f"the {name} has shape {array.shape}; give one value per sample")
    if length is not None and len(array) != length:
        raise SimulationError(f"the {name} has {len(array)} samples, the input {length}; "
                              "they must agree")
    if not np.all(np.isfinite(array)):
        raise SimulationError(f"the {name} is not finite at sample "
                              f"{int(np.argmin(np.isfinite(array)))}; remove or repair it")
    return array


def _check(status: int) -> None:
    if status == DRIFTS:
        raise SimulationError("there is no periodic motion: the stage has no spring and drifts; "
                              "remove the mean of the input or simulate from an initial state")
    if status == UNSETTLED:
        raise SimulationError("the motion does not become periodic within 400 periods; "
                              "simulate several periods from an initial state instead")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
