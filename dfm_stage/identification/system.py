"""A model of the stage on runs, as an estimation problem.

Unknowns are, in this order, the free parameters of the model in well-conditioned coordinates, and
for each run its initial state, parameters of effects that differ from run to run (the phase of a
vibration, the rate of a drift), the force that a body without a spring feels, gain and offset of
the current, and offset and drift of the output.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.identification.convention import Drive, interpolated
from dfm_stage.identification.coordinates import group, late_parameters
from dfm_stage.identification.decisions import FITTED_STEPS, LINEAR_SHARE, SHARP
from dfm_stage.identification.problem import Problem, Signals, Unknown, trend
from dfm_stage.identification.run import Run
from dfm_stage.identification.windows import Windows, at_window, slope_at
from dfm_stage.model import EFFECTS, Model, SimulationError, Simulator
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import reads
from dfm_stage.model.scales import NEGLIGIBLE, typical_size

BASE_STEP, EFFECT_STEP, CURVED_STEP = 1e-5, 1e-4, 1e-3
"""Steps of differences over the size: by a base parameter, by one of a linear effect, by one of a
nonlinear force."""
PARALLEL = 1_000_000
"""Samples (rows times length) up to which one thread simulates: more cost more than they save."""
SHORTEST_LAG = 1e-6
"""Least lag, in samples, for which a periodic motion is looked for."""

_TAKEN: ContextVar[float] = ContextVar("steps", default=0.0)


def steps_taken() -> float:
    """Integration steps that all systems of this thread have taken with nonlinear forces."""
    return _TAKEN.get()


def is_nonlinear(name: str) -> bool:
    """Whether an effect makes the simulation nonlinear."""
    return EFFECTS[name].curves


def rounding_step(model: Model) -> float | None:
    """The step to which an effect of the model rounds the reading, None where there is none."""
    return next((next(iter(use.parameters.values())) for use in model.effects
                 if use.effect.rounds), None)


class System(Problem):
    """A one-axis `model` with `free` parameter addresses on `runs`.

    `states` are the initial states that are estimated, those of every mode by default. With
    `pushed` a body without a spring feels an unknown constant force in each run. `noise` is the
    RMS of the output's noise: a rounded reading is averaged over it, and distances far below
    it are not searched.
    """

    def __init__(self, model: Model, runs: Sequence[Run], free: Sequence[str], *,
                 noise: float = 0.0, states: Sequence[str] | None = None,
                 pushed: bool = False) -> None:
        self.free, self.given, self.runs = tuple(free), model, tuple(runs)
        self.springless = model.base.get("stiffness", 0.0) == 0.0 and "stiffness" not in free
        self.drifts = self.springless and all(run.order == 0 for run in runs)
        """Whether the output integrates whatever small force is missed, without end."""
        self.trusted = "encoder_zero" in model.base or "encoder_zero" in free
        constant = next(e for e in EFFECTS.values() if e.adds_to == "constant_force")
        self.push = ""
        if pushed and self.springless and model.effect(constant.name) is None \
                and not any(run.window or run.order > 1 for run in runs):
            self.push = f"{constant.name}.{constant.parameters[0].name}"
            model = model.with_effect(constant.name, constant.defaults)
        self.model = _ready(model, self.free)
        self.dither = _dither(self.model, noise)
        self.rounded = rounding_step(self.model) is not None
        self.groups = group(self.model, self.free)
        renamed = {n: f for g in self.groups for n, f in zip(g.names, g.fitted, strict=True)}
        self.fitted = [renamed.get(n, n) for n in self.free]
        self.count = len(self.free)
        self.simulator = Simulator(self.model)
        self.nonlinear = [u.name for u in self.model.effects if is_nonlinear(u.name)]
        self.slow = any(EFFECTS[n].memory for n in self.nonlinear)
        """Whether a simulation follows states with memory, and is worth being spared."""
        self.remembers = any(u.effect.registers for u in self.model.effects)
        """Whether the commands before a run count, which are none then."""
        self._finer: dict[tuple[int, bool], Simulator] = {}
        self._latest: dict[tuple[int, bool], tuple[bytes, Signals, float]] = {}
        self.work = 0.0
        """Integration steps that simulations with nonlinear forces have taken."""
        self.noise = noise
        self.states = [s for s in self.simulator.states if _is_mechanical(s)] \
            if states is None else list(states)
        own = [u for i, run in enumerate(runs) for u in self._own_unknowns(run, i)]
        super().__init__([*self._shared_unknowns(), *own],
                         runs, self.simulated, model.position_unit)

    @cached_property
    def at(self) -> Conditions:
        """Sizes that occur in the runs."""
        return Conditions.of(self.model.base, self.model.drive, self.runs, self.noise,
                             self.model.position_unit)

    @cached_property
    def light(self) -> Simulator:
        """The simulator without the nonlinear effects."""
        light = self.model
        for name in self.nonlinear:
            light = light.without_effect(name)
        return Simulator(light) if self.nonlinear else self.simulator

    # -- unknowns -------------------------------------------------------------------------------

    def _shared_unknowns(self) -> Iterable[Unknown]:
        special = {n: (g, k) for g in self.groups for k, n in enumerate(g.fitted)}
        values = self._coordinates(self.model.parameters()).tolist()
        for value, name, address in zip(values, self.fitted, self.free, strict=True):
            head, _, own = address.partition(".")
            low, high, step = -math.inf, math.inf, BASE_STEP
            if own:
                effect = EFFECTS[head]
                low, high = effect.search_range(name.removeprefix(f"{head}."), self.at)
                step = effect.difference_step(own, value, self.at) or (
                    CURVED_STEP if is_nonlinear(head) else EFFECT_STEP)
            if name in special:
                coordinates, k = special[name]
                typical = float(coordinates.scale[k])
                size = abs(value) if abs(value) > NEGLIGIBLE * typical else typical
                yield Unknown(name, value, size,
                              max(float(coordinates.low[k]), low),
                              min(float(coordinates.high[k]), max(high, abs(value))),
                              coordinates.units[k], step=step)
            else:
                limits = self.model.parameter(address)
                yield Unknown(name, value, typical_size(self.model, address),
                              max(limits.low, low), min(limits.high, max(high, abs(value))),
                              limits.unit, step=step)

    def _own_unknowns(self, run: Run, index: int) -> Iterable[Unknown]:
        unit = self.model.position_unit
        for part in run.windows if run.start == "free" else ():
            known = self._known_start(run, part)
            for state in self.states:
                if state == "position" and not self._sees_position(run):
                    continue
                moving = state.endswith("velocity")
                first = known.get(state, 0.0) if not run.driven or (self.springless and (
                    run.window or state == run.measures)) else 0.0
                low, high = run.speeds if state == "velocity" else (-math.inf, math.inf)
                yield Unknown(at_window(f"initial.{state}", run, part), first,
                              (run.speed or 1e-9) if moving else run.travelled or 1e-9,
                              low, high, unit=f"{unit}/s" if moving else unit, run=index,
                              part=part if run.window else None)
        yield from self._offset(run, index)
        if self.push:
            yield Unknown(self.push, 0.0, 1e-3 * self._force(run), unit="N", run=index)
        if index > 0 or not self.free:
            yield from self._per_run_unknowns(index)
        if run.current is not None:
            yield Unknown("current.gain", 1.0, 1.0, run=index)
            yield Unknown("current.offset", 0.0, float(np.std(run.current)) or 1.0, unit="A",
                          run=index)
        if run.velocity is not None:
            yield Unknown("velocity.offset", 0.0, float(np.std(run.velocity)) or 1e-9,
                          unit=f"{unit}/s", run=index)

    @staticmethod
    def _known_start(run: Run, part: slice) -> dict[str, float]:
        """What the output says by itself of the state at the beginning of a window."""
        first = float(run.output[part.start])
        if run.order == 0:
            return {"position": first,
                    "velocity": slope_at(run.output, part.start) / run.sample_period}
        return {"velocity": first} if run.order == 1 else {}

    def _sees_position(self, run: Run) -> bool:
        """Whether the output depends on where the point is when it begins to move: a velocity of
        a body without a spring does not, unless a force does."""
        return run.order == 0 or not self.springless or any(
            reads(use.effect.force, 0) or reads(use.effect.friction, 0)
            or reads(use.effect.flow, 1) for use in self.model.effects)

    def _offset(self, run: Run, index: int) -> Iterable[Unknown]:
        """Offset and drift of the output, as far as the run's trend goes; usually of a position
        without trusted zero. A velocity has one where a spring brings its mean to zero: else it
        is what a constant force does. An acceleration has one always."""
        unit = self.model.position_unit + ("", "/s", "/s^2")[run.order]
        usual = -1 if run.order < 2 and (self.springless or (
            self.trusted and run.order == 0)) else 0
        if self.rounded and run.order == 0 and run.trend is None and usual == 0:
            yield Unknown("offset", 0.0, run.spread or 1e-9, unit=unit, run=index)
        else:
            yield from trend(run, index, usual, unit)

    def _per_run_unknowns(self, index: int) -> Iterable[Unknown]:
        """Coordinates of effects that do not carry over from one run to the next."""
        for use in self.model.effects:
            if not use.effect.per_run:
                continue
            names, values = self._per_run(use.name)
            size = float(np.linalg.norm(values)) or 1e-9
            for name, value in zip(names, values, strict=True):
                yield Unknown(name, float(value), size, run=index)

    def _per_run(self, effect: str) -> tuple[tuple[str, ...], Array]:
        """Names and values of an effect's coordinates that differ from run to run."""
        change, values = EFFECTS[effect].coordinates, self.model.parameters()
        own = tuple(map(EFFECTS[effect].address, EFFECTS[effect].per_run))
        if change is not None and own == change.fitted:
            parts = np.array([values[n] for n in change.names])
            return own, np.asarray(change.forward(parts))
        return own, np.array([values[n] for n in own])

    def _force(self, run: Run) -> float:
        base = self.model.base
        return (abs(base.get("force_constant", 1.0)) * float(np.std(run.input))
                or base["mass"] * 1e-3)

    def _coordinates(self, values: Mapping[str, float]) -> Array:
        """Parameter values as the coordinates (count,) that are fitted."""
        found = np.array([values.get(n, 0.0) for n in self.free], dtype=float)
        for g in self.groups:
            at = [self.fitted.index(n) for n in g.fitted]
            found[at] = g.forward(found[at])
        return found

    def vector(self, values: Mapping[str, float]) -> Array:
        """The unknowns (n,) that stand for parameter `values`; the model's where one is left out,
        and what belongs to single runs where it starts."""
        return np.concatenate((self._coordinates({**self.model.parameters(), **values}),
                               self.start[self.count:]))

    def started(self, earlier: dict[tuple[str, int], float]) -> Array:
        """Where a search begins (n,): the model's values, and `earlier` values of single runs."""
        return np.array([u.start if u.run is None else earlier.get((u.name, u.run), u.start)
                         for u in self.unknowns])

    def physical(self, x: Array) -> dict[str, float]:
        """Address -> value of the free parameters."""
        return dict(zip(self.free, self._backward(x[None, :])[0].tolist(), strict=True))

    def fitted_model(self, x: Array) -> Model:
        """The model with the values that the unknowns `x` (n,) stand for."""
        values = {n: v if math.isfinite(v) else 0.0 for n, v in self.physical(x).items()}
        return self.given.with_parameters(values) if values else self.given

    def locals_of(self, x: Array) -> dict[tuple[str, int], float]:
        """(name, run) -> value of what belongs to single runs."""
        return {(u.name, u.run): float(v) for u, v in zip(self.unknowns, x, strict=True)
                if u.run is not None}

    def _backward(self, rows: Array) -> Array:
        """Parameter values (P, count) for rows (P, n) of unknowns."""
        table = rows[:, :self.count].copy()
        with np.errstate(all="ignore"):
            for g in self.groups:
                at = [self.fitted.index(n) for n in g.fitted]
                table[:, at] = [g.backward(row) for row in table[:, at]]
        return np.asarray(table)

    # -- simulation -----------------------------------------------------------------------------

    def simulated(self, index: int, rows: Array, light: bool = False) -> Signals:
        """The signals compared of one run, (P, N) each, for rows (P, n) of all unknowns; NaN rows
        where a row cannot be simulated. `light` leaves nonlinear effects out.

        A search asks for its start and its end twice: the latest single row of each run is kept.
        """
        if len(rows) != 1:
            return self._simulated(index, rows, light)
        x, known = rows.tobytes(), self._latest.get((index, light))
        if known is not None and x == known[0]:
            self._count(known[2])   # what is decided by work does not depend on what is kept
            return known[1]
        before = self.work
        found = self._simulated(index, rows, light)
        for signal in found:
            signal.flags.writeable = False
        self._latest[index, light] = x, found, self.work - before
        return found

    def varied(self, index: int, x: Array, values: Mapping[str, Array]) -> Signals:
        """The signals of one run, (P, N - skip) each, at `x` (n,) where parameters of the model
        that are not free have `values` (P,) each."""
        count = len(next(iter(values.values())))
        return self.signals(index, np.tile(x, (count, 1)), lambda i, rows: self._simulated(
            i, rows, False, values))

    def motion(self, index: int, x: Array, times: int) -> tuple[Array, Array, Array]:
        """Position (m), speed (m/s) and actuator force (N) of the driven point in one run at `x`
        (n,), each at the middles of at least `times` parts of every sample."""
        names, table, _ = self._table(index, x[None, :])
        position, speed, actuator = (
            self._run(self.runs[index], names, table, signal, False, middles=times)[0]
            for signal in ("position", "velocity", "force"))
        return position, speed, actuator

    def pushed(self, index: int, x: Array, force: Array) -> Signals:
        """The signals compared of one run, (N,) each, at `x` (n,) where a `force` (N,) on the
        driven point, held from sample to sample, acts beside all else."""
        run = self.runs[index]
        names, table, _ = self._table(index, x[None, :])
        found = [self._run(run, names, table, signal, False, force) for signal in run.compared]
        return [signal[0] for signal in self._as_measured(index, x[None, :], found)]

    def _simulated(self, index: int, rows: Array, light: bool,
                   values: Mapping[str, Array] | None = None) -> Signals:
        run = self.runs[index]
        names, table, allowed = self._table(index, rows)
        if values:
            kept = [k for k, n in enumerate(names) if n not in values]
            names = [*(names[k] for k in kept), *values]
            table = np.column_stack((table[:, kept], *values.values()))
        out = [np.full((len(rows), run.input.size), np.nan) for _ in run.measured]
        if light:
            kept = [k for k, n in enumerate(names) if n.partition(".")[0] not in self.nonlinear]
            names, table = [names[k] for k in kept], table[:, kept]
        if np.any(allowed):
            for channel, signal in zip(out, run.compared, strict=True):
                channel[allowed] = self._run(run, names, table[allowed], signal, light)
        return self._as_measured(index, rows, out)

    def _as_measured(self, index: int, rows: Array, out: Signals) -> Signals:
        """Signals of one run, (P, N) each, with the gain and the offsets of their sensors."""
        for k, unknown in enumerate(self.unknowns):
            if unknown.run == index and unknown.name == "current.gain":
                out[1] = out[1] * rows[:, k, None] + rows[:, k + 1, None]
            elif unknown.run == index and unknown.name == "velocity.offset":
                out[-1] = out[-1] + rows[:, k, None]
        return out

    def _run(self, run: Run, names: Sequence[str], table: Array, signal: str, light: bool,
             force: Array | None = None, middles: int = 0) -> Array:
        """One signal (P, N) of one run for rows (P, m) of parameters; with `middles` not at the
        samples, but at the middles of at least so many parts of each. A `force` (N,) on the
        driven point is held from sample to sample."""
        drive = Drive(run.input) if run.drive is None else run.drive
        if not light:
            substeps = max((u.effect.substeps for u in self.model.effects), default=1)
            drive = drive.finer(-(-max(substeps, middles) // drive.factor))
        if middles:
            drive = drive.finer(2)
        simulator = self._stepping(drive.factor, light)
        period = run.period if run.start == "periodic" else None
        driven = drive.values if period is None else drive.values[:drive.factor * period]
        push = None if force is None else np.repeat(force, drive.factor)[:driven.size]
        seen = slice(1, None, 2) if middles else slice(None, None, drive.factor)
        other = run.other if run.other is None or drive.factor == 1 else interpolated(
            run.other, drive.factor, periodic=period is not None)[:driven.size]
        windows = Windows.of(run, names, table, self.states) \
            if run.window and run.start == "free" else None
        rows, own_names, parts = (table, names, None) if windows is None else (
            windows.rows, windows.names, [slice(drive.factor * w.start, drive.factor * w.stop)
                                          for w in windows.parts])
        own_names, rows = self._with_delay(own_names, rows, drive.delay)
        steps = np.zeros(len(rows), dtype=np.int64)
        try:
            found = simulator.run_many(
                driven, own_names, rows, signal=signal, external_force=push, other=other,
                steady_state=period is not None, partial=period is not None,
                past_input=0.0 if run.start == "rest" or self.remembers else float(driven[0]),
                dither=self.dither or None, steps=steps, parts=parts, steps_allowed=FITTED_STEPS,
                threads=1 if driven.size * len(table) < PARALLEL else None)[:, seen]
        except SimulationError:
            return np.full((len(table), run.input.size), np.nan)
        if self.nonlinear and not light:
            self._count(float(steps.sum()))
        if windows is not None:
            return windows.put_together(found, len(table))
        return found if period is None else np.tile(found, (1, run.input.size // period))

    def _count(self, steps: float) -> None:
        self.work += steps
        _TAKEN.set(_TAKEN.get() + steps)

    def _stepping(self, factor: int, light: bool) -> Simulator:
        """A simulator that takes `factor` inputs a sample."""
        usual = self.light if light else self.simulator
        if factor == 1:
            return usual
        if (factor, light) not in self._finer:
            model = usual.model
            self._finer[factor, light] = Simulator(replace(
                model, sample_period=model.sample_period / factor))
        return self._finer[factor, light]

    def _with_delay(self, names: Sequence[str], table: Array,
                    samples: float) -> tuple[Sequence[str], Array]:
        """Rows of parameters with a delay more, of so many sample periods."""
        if samples == 0.0:
            return names, table
        longer = samples * self.model.sample_period
        if "delay" not in names:
            own = np.full((len(table), 1), self.model.base.get("delay", 0.0) + longer)
            return [*names, "delay"], np.hstack([table, own])
        table = table.copy()
        table[:, list(names).index("delay")] += longer
        return names, table

    def _table(self, index: int, rows: Array) -> tuple[list[str], Array, NDArray[np.bool_]]:
        """Names and values (P, m) of the simulator's parameters for one run, and which rows are
        allowed."""
        fitted = rows.copy()
        extra: dict[str, Array] = {}
        for k, unknown in enumerate(self.unknowns):
            if unknown.run != index or unknown.column is not None:
                continue
            if unknown.name in self.fitted:
                fitted[:, self.fitted.index(unknown.name)] = rows[:, k]
            elif unknown.name == "offset":
                extra["encoder_zero"] = rows[:, k]
            elif not unknown.name.startswith(("current.", "velocity.")):
                extra[unknown.name] = rows[:, k]
        for use in self.model.effects:
            change = use.effect.coordinates
            if change is not None and all(n in extra for n in change.fitted):
                back = change.backward(np.array([extra.pop(n) for n in change.fitted]))
                extra.update(zip(change.names, back, strict=True))
        table = self._backward(fitted)
        if self.runs[index].start == "periodic":
            lags = [k for k, n in enumerate(self.free) if n in self._lags]
            table[:, lags] = np.maximum(table[:, lags],
                                        SHORTEST_LAG * self.model.sample_period)
        limits = [self.model.parameter(n) for n in self.free]
        allowed = np.all(np.isfinite(table) & (table >= [p.low for p in limits])
                         & (table <= [p.high for p in limits]), axis=1)
        return ([*self.free, *extra],
                np.hstack([table, *(v[:, None] for v in extra.values())]), np.asarray(allowed))

    @property
    def _lags(self) -> list[str]:
        return [n for n, kind in late_parameters(self.model, self.free).items() if kind == "lag"]

    # -- sensitivities --------------------------------------------------------------------------

    def barely_nonlinear(self, x: Array) -> bool:
        """Whether the base's sensitivities may be taken without the nonlinear effects."""
        if not self.nonlinear:
            return True
        full = self.signals(0, x[None, :])[0][0]
        light = self.signals(0, x[None, :], self._lightly)[0][0]
        if not np.all(np.isfinite(light)):
            return False
        return float(np.std(full - light)) < LINEAR_SHARE * float(np.std(full))

    def is_own(self, unknown: Unknown) -> bool:
        """Whether an unknown is that of a nonlinear effect, or tied to one by its coordinates."""
        return unknown.name.partition(".")[0] in self.nonlinear or any(
            unknown.name in g.fitted and any(n.partition(".")[0] in self.nonlinear
                                             for n in g.names) for g in self.groups)

    def sensitivities(self, index: int, x: Array, exact: bool = True, light: bool = False,
                      own: bool = True) -> Signals:
        """As `Problem.sensitivities`; `light` takes those by the base without the nonlinear
        effects, and those by the effects' own parameters only where `own`."""
        out = self.no_slopes(index)
        left = self.fixed(index, out)
        apart = [k for k in left if self.is_own(self.unknowns[k])
                 or (self.unknowns[k].name in self.fitted[:self.count]
                 and self.unknowns[k].run is not None)]
        rest = [k for k in left if k not in apart]
        central = exact or not self.nonlinear
        self.differences(index, x, rest, light or central, out,
                         self._lightly if light else None)
        if own or not light:
            self.differences(index, x, apart, central, out)
        return out

    def _lightly(self, index: int, rows: Array) -> Signals:
        """As `simulated`, without the nonlinear effects."""
        return self.simulated(index, rows, light=True)


def _ready(model: Model, names: Iterable[str]) -> Model:
    """The model with absent base parameters that are to be estimated added: as zero, or as one
    where that is what absent means."""
    absent = {n: 1.0 if n == "force_constant" else 0.0 for n in names
              if "." not in n and n not in model.base}
    return model.with_parameters(absent) if absent else model


def _is_mechanical(state: str) -> bool:
    return state.rpartition(".")[2] in ("position", "velocity")


def _dither(model: Model, noise: float) -> float:
    """RMS of the noise before rounding: given, or at most a small part of the step, because what
    rounding adds looks like noise as well."""
    step = rounding_step(model)
    if step is None:
        return noise
    return min(noise or math.inf, model.base.get("noise", 0.0) or SHARP * step)
