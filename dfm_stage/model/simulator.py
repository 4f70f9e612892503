"""Whole records: one model, or many parameter sets at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.model.description import EffectUse, Model, unknown_name
from dfm_stage.model.kernel import slots
from dfm_stage.model.kernel.record import run
from dfm_stage.model.kernel.setup import prepare, reset
from dfm_stage.model.kernel.slots import Array, Layout
from dfm_stage.model.parameter import Parameter, SimulationError
from dfm_stage.model.plan import STEPS_ALLOWED, Plan, parameter_table
from dfm_stage.model.scales import typical_size
from dfm_stage.model.steady import DRIFTS, SETTLED, UNSETTLED, settle
from dfm_stage.processors import usable_cores

Rounding = Callable[[float], float]
RELATIVE_STEP = 1e-4
WHOLE_CYCLES = 1e-6
"""Cycles of a vibration that may be missing in a period: rounding of its frequency, no more."""


@dataclass(frozen=True)
class SimulationResult:
    """Signals at t_k = k T, each of shape (N,), sampled before input k acts.

    `position` (m) and `velocity` (m/s) are those of the driven point, `current` in A (with a
    voltage drive and no coil_resistance: the drive in V), `force` (N) that of the actuator on
    the moving mass. `reading` (m) is what the encoder sees, without noise and rounding: position
    behind what belongs to the sensor, zero, periodic error, drift, cross-axis. `output` is the
    same with the effects that round, if one is on, as their mean over the noise; it is what a
    measured record is compared with.
    """

    time: Array
    position: Array
    velocity: Array
    current: Array
    force: Array
    reading: Array
    output: Array
    rounding: tuple[Rounding, ...]
    resolution: float
    noise: float

    def measured(self, seed: int = 0) -> Array:
        """The reading with noise (normal, `default_rng(seed)`), then rounded as the effects with
        a hook `encode` do, and to encoder_resolution where it is given, shape (N,)."""
        reading = self.reading
        if self.noise > 0.0:
            draws = np.random.default_rng(seed).standard_normal(len(reading))
            reading = reading + self.noise * draws
        for effect in self.rounding:
            reading = np.array([effect(each) for each in reading.tolist()])
        if self.resolution > 0.0:
            reading = np.rint(reading / self.resolution) * self.resolution
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
        RMS of the noise (m) over which `output` averages the rounding; by default the
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

    def run(self, input: ArrayLike, *,  # noqa: A002
            initial: Mapping[str, float] | None = None, past_input: float = 0.0,
            external_force: ArrayLike | None = None, other: ArrayLike | None = None,
            dither: float | None = None, steady_state: bool = False) -> SimulationResult:
        """Simulate one record; see the class for the arguments.

        Raises
        ------
        ModelError, SimulationError
            If an argument is malformed, or there is no periodic motion.
        """
        inputs, force, neighbour = self._arguments(input, external_force, other, steady_state)
        plan, work = self._plan, self._plan.work()
        theta: Array = plan.theta.copy()
        for name, value in (initial or {}).items():
            theta[plan.place(f"initial.{name}")] = value
        if dither is not None:
            theta[slots.NOISE] = dither
        rows = np.arange(len(slots.SIGNALS))
        rows[slots.ACCELERATION] = -1
        effects = [use.effect for use in self.model.effects]
        encoded = any(effect.encode for effect in effects)
        if not encoded:
            rows[slots.OUTPUT] = -1
        if not (encoded or theta[slots.ZERO] or any(
                effect.sense or effect.stage == "sensor" for effect in effects)):
            rows[slots.READING] = -1
        out = np.empty((int(rows.max()) + 1, len(inputs)))
        prepare(plan.layout, theta, work)
        _check(_simulate(plan, theta, work, float(past_input), inputs, force, neighbour,
                         steady_state, rows, out))
        if not np.isfinite(out[slots.POSITION, -1]):
            when = int(np.argmin(np.isfinite(out[slots.POSITION]))) * self.model.sample_period
            raise SimulationError("the motion escapes to infinity, or a force is too stiff to "
                                  f"follow, before t = {when:g} s: the model's forces do not "
                                  "hold the stage; check their signs and sizes")
        reading = out[slots.READING] if rows[slots.READING] >= 0 else out[slots.POSITION]
        return SimulationResult(
            time=self.model.sample_period * np.arange(len(inputs), dtype=float),
            position=out[slots.POSITION], velocity=out[slots.VELOCITY],
            current=out[slots.CURRENT], force=out[slots.FORCE], reading=reading,
            output=out[slots.OUTPUT] if rows[slots.OUTPUT] >= 0 else reading,
            rounding=rounding_of(self.model),
            resolution=float(plan.theta[slots.RESOLUTION]), noise=float(plan.theta[slots.NOISE]))

    def output(self, input: ArrayLike, *,  # noqa: A002
               initial: Mapping[str, float] | None = None, past_input: float = 0.0,
               external_force: ArrayLike | None = None, other: ArrayLike | None = None,
               dither: float | None = None, steady_state: bool = False) -> Array:
        """The signal `output` alone, (N,), as `run` gives it but faster.

        Raises
        ------
        ModelError, SimulationError
            As `run`.
        """
        states = initial or {}
        return np.asarray(self.run_many(
            input, [f"initial.{name}" for name in states], [[*states.values()]],
            past_input=past_input, external_force=external_force, other=other, dither=dither,
            steady_state=steady_state, threads=1)[0])

    def run_many(self, input: ArrayLike, parameter_names: Sequence[str],  # noqa: A002
                 parameter_matrix: ArrayLike, *, signal: str = "output",
                 past_input: float = 0.0, external_force: ArrayLike | None = None,
                 other: ArrayLike | None = None, dither: float | None = None,
                 steady_state: bool = False, partial: bool = False,
                 threads: int | None = None, steps: Layout | None = None,
                 parts: Sequence[slice] | None = None,
                 steps_allowed: float = STEPS_ALLOWED) -> Array:
        """One signal for each row of `parameter_matrix` (P, n); returns (P, N).

        `signal` is one of those of a result, or the `acceleration` of the driven point, m/s^2.
        `parameter_names` (n) are addresses such as `mass`, `cubic_stiffness.k3` or, for the state
        at t_0, `initial.position`; `encoder_zero` is the output offset. Rows are spread over
        `threads` threads, by default one per available core. Values are not checked against the
        limits of the parameters. A motion that escapes to infinity, or meets a force too stiff to
        follow, ends in NaN. With `partial` a row without periodic motion is NaN, too.

        `steps` (P,) is filled with the integration steps of each row, the same in every run. A
        linear model takes one a sample. For others every step that was tried counts, also those
        that were then halved, and the events inside the shortest ones. A force is too stiff where
        it takes more than `steps_allowed` a sample over STIFF_SAMPLES samples, or as many at once.

        With `parts` (P of them) each row begins at the first of some samples and ends with them,
        in the first columns of its row; the step before is that of the input, of the very first
        one `past_input`.

        Raises
        ------
        ModelError, SimulationError
            If a name is not known, a shape is wrong, or there is no periodic motion.
        """
        if signal not in slots.SIGNALS:
            raise SimulationError(unknown_name("signal", signal, slots.SIGNALS))
        inputs, force, neighbour = self._arguments(input, external_force, other, steady_state)
        matrix = _matrix(parameter_matrix, len(parameter_names))
        if steps is not None and steps.shape != (len(matrix),):
            raise SimulationError(f"steps has shape {steps.shape}; give one number a row")
        plan, table = parameter_table(self._plan, parameter_names, matrix)
        if dither is not None:
            table[:, slots.NOISE] = dither
        spans = [part.indices(len(inputs))[:2] for part in parts] if parts is not None else \
            [(0, len(inputs))] * len(table)
        if len(spans) != len(table):
            raise SimulationError(f"{len(spans)} parts for {len(table)} rows; give one a row")
        out = np.empty((len(table), max((b - a for a, b in spans), default=0)))
        chosen = np.full(len(slots.SIGNALS), -1)
        chosen[slots.SIGNALS.index(signal)] = 0
        status = np.zeros(len(table), dtype=np.int64)

        order = _alike_together(table[:, :plan.layout[slots.AT_INITIAL]])

        def part(places: range) -> None:
            work, ready = plan.work(), b""
            work[plan.layout[slots.AT_HEAD] + slots.ALLOWED] = steps_allowed
            for row, what in order[places.start:places.stop]:
                a, b = spans[row]
                if what != ready:
                    prepare(plan.layout, table[row], work)
                    ready = what
                status[row] = _simulate(plan, table[row], work,
                                        float(inputs[a - 1]) if a else float(past_input),
                                        inputs[a:b], force[a:b], neighbour[a:b], steady_state,
                                        chosen, out[row:row + 1, :b - a])
                if steps is not None:
                    steps[row] = work[plan.layout[slots.AT_HEAD] + slots.STEPS]

        workers = max(1, min(threads or usable_cores(), len(table)))
        if workers == 1:
            part(range(len(table)))
        else:
            bounds = np.linspace(0, len(table), workers + 1).astype(int)
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(part, (range(a, b) for a, b in pairwise(bounds))))
        if partial:
            out[status != 0] = np.nan
        else:
            _check(int(status.max(initial=0)))
        return out

    def sensitivities(self, input: ArrayLike, free_names: Sequence[str], *,  # noqa: A002
                      initial: Mapping[str, float] | None = None, signal: str = "output",
                      past_input: float = 0.0, external_force: ArrayLike | None = None,
                      other: ArrayLike | None = None, dither: float | None = None,
                      steady_state: bool = False,
                      threads: int | None = None) -> tuple[Array, Array]:
        """A signal (N,) and its derivatives (P, N) by the P free parameters.

        At the values of the model and of `initial`; names as in `run_many`. Central differences
        with steps of 1e-4 of the value (of a typical value, where it is zero), one-sided of
        second order at a limit, all parameter sets simulated together. The derivatives are good
        to about 1e-5 of their size, those by delays of nonlinear models to 1e-4.

        Raises
        ------
        ModelError, SimulationError
            As `run_many`.
        """
        states = {f"initial.{name}": value for name, value in (initial or {}).items()}
        names = [*free_names, *(name for name in states if name not in free_names)]
        values = self.model.parameters()
        centre = np.array([states.get(name, values.get(name, 0.0)) for name in names])
        rows, weights = [centre], []
        for column in range(len(free_names)):
            offsets, share = self._differences(names[column], float(centre[column]))
            for offset in offsets:
                row = centre.copy()
                row[column] += offset
                rows.append(row)
            weights.append((len(rows) - len(offsets), share))
        found = self.run_many(input, names, np.array(rows), signal=signal, past_input=past_input,
                              external_force=external_force, other=other, dither=dither,
                              steady_state=steady_state, threads=threads)
        slopes = np.zeros((len(free_names), found.shape[1]))
        for column, (first, share) in enumerate(weights):
            slopes[column] = share[0] * found[0] + share[1] * found[first] \
                + share[2] * found[first + 1]
        return found[0], slopes

    def _differences(self, name: str, value: float) -> tuple[tuple[float, ...], Array]:
        """Offsets of a parameter, and the weights of [centre, *offsets] in its derivative."""
        limits = Parameter(name, 0.0, "", "") if name.startswith("initial.") \
            else self.model.parameter(name)
        step = RELATIVE_STEP * (abs(value) or typical_size(self.model, name))
        if limits.low <= value - step and value + step <= limits.high:
            return (-step, step), np.array([0.0, -0.5, 0.5]) / step
        if value + 2.0 * step > limits.high:
            step = -step
        return (step, 2.0 * step), np.array([-1.5, 2.0, -0.5]) / step

    def _arguments(self, input: ArrayLike, force: ArrayLike | None,  # noqa: A002
                   other: ArrayLike | None, steady_state: bool) -> tuple[Array, Array, Array]:
        inputs = _record(input, "input")
        pushes, others = np.empty((0, 4)), np.empty((0, 4))
        if force is not None:
            pushes = np.zeros((len(inputs), 4))
            pushes[:, 0] = _record(force, "external force", len(inputs))
        for use in self.model.effects:
            effect = use.effect
            if effect.couples and other is None:
                raise SimulationError(f"{use.name} is on: give the position of the other axis as "
                                      "other=")
            if other is not None and effect.couples and not len(others):
                others = hermite(_record(other, "position of the other axis", len(inputs)),
                                 steady_state)
            if steady_state and effect.on_the_clock:
                raise SimulationError(f"there is no periodic motion: {use.name} depends on time")
            if steady_state and effect.frequency is not None:
                self._check_cycles(use, len(inputs))
        return inputs, pushes, others

    def _check_cycles(self, use: EffectUse, samples: int) -> None:
        """Refuse a vibration that does not do whole cycles in a period of the input."""
        effect = use.effect
        cycles = use.parameters[str(effect.frequency)] * samples * self.model.sample_period
        state = np.ones(len(effect.states))
        if effect.start is not None:
            effect.start(state, 0, tuple(use.parameters.values()))
        if np.any(state) and abs(cycles - round(cycles)) > WHOLE_CYCLES:
            raise SimulationError(f"there is no periodic motion: {use.name} does {cycles:g} "
                                  "cycles in one period of the input")


def rounding_of(model: Model) -> tuple[Rounding, ...]:
    """What the effects of a one-axis model that round do to one reading."""
    return tuple(partial(hook, dither=0.0, p=tuple(use.parameters.values()))
                 for use in model.effects if (hook := use.effect.encode) is not None)


def _alike_together(parameters: Array) -> list[tuple[int, bytes]]:
    """Every row of `parameters` (P, n) and what it holds, those that hold the same in a row: for
    these the work array, which takes as long as some hundred samples, is prepared once."""
    first: dict[bytes, int] = {}
    rows = [(row, values.tobytes()) for row, values in enumerate(parameters)]
    return sorted(rows, key=lambda each: first.setdefault(each[1], each[0]))


def _simulate(plan: Plan, theta: Array, work: Array, past_input: float, inputs: Array,
              force: Array, other: Array, steady_state: bool, rows: Layout, out: Array) -> int:
    """Fill `out` as `kernel.record.run` does, from the initial or the periodic state; return
    whether there was one. `work` is prepared for the parameters in `theta`."""
    reset(plan.layout, theta, past_input, work)
    status = settle(plan, theta, work, inputs, force, other) if steady_state else SETTLED
    if status == SETTLED:
        run(plan.layout, theta, work, inputs, force, other, rows, out)
    return status


def hermite(values: Array, periodic: bool = False) -> Array:
    """Coefficients (N, 4) in r = (t - t_k) / T of the cubics through equidistant values (N,).

    Slopes are central differences of fourth order, one-sided at the ends unless `periodic`; the
    last interval of a record that is not periodic goes on with its slope.
    """
    count = len(values)
    if periodic:
        padded = values[np.arange(-2, count + 3) % count]
    elif count >= 4:
        padded = _extended(_extended(values))
        padded = np.append(padded, padded[-1])
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


def _extended(values: Array) -> Array:
    """One value more at either end, on the cubic through the four next to it."""
    ends = [4 * v[0] - 6 * v[1] + 4 * v[2] - v[3] for v in (values, values[::-1])]
    return np.concatenate((ends[:1], values, ends[1:]))


def _record(values: ArrayLike, name: str, length: int | None = None) -> Array:
    array = np.require(values, float, ["C", "W"])     # each other kind would compile anew
    if array.ndim != 1 or len(array) == 0:
        raise SimulationError(f"the {name} has shape {array.shape}; give one value per sample")
    if length is not None and len(array) != length:
        raise SimulationError(f"the {name} has {len(array)} samples, the input {length}; "
                              "they must agree")
    if not np.all(np.isfinite(array)):
        raise SimulationError(f"the {name} is not finite at sample "
                              f"{int(np.argmin(np.isfinite(array)))}; remove or repair it")
    return array


def _matrix(values: ArrayLike, columns: int) -> Array:
    matrix = np.atleast_2d(np.asarray(values, dtype=float))
    if matrix.ndim != 2 or matrix.shape[1] != columns:
        raise SimulationError(f"the parameter matrix has shape {matrix.shape}; "
                              f"it needs {columns} columns, one per name")
    if not np.all(np.isfinite(matrix)):
        raise SimulationError("the parameter matrix is not finite")
    return matrix


def _check(status: int) -> None:
    if status == DRIFTS:
        raise SimulationError("there is no periodic motion: the stage has no spring and drifts; "
                              "remove the mean of the input or simulate from an initial state")
    if status == UNSETTLED:
        raise SimulationError("the motion does not become periodic within 400 periods; "
                              "simulate several periods from an initial state instead")
