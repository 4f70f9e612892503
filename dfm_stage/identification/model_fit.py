"""Fitting a model of the stage to records: between `Model` and output-error estimation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.coordinates import LAGS, group, to_physical
from dfm_stage.identification.criterion import ACCURATE
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.output_error import estimate
from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.problem import Problem, Segment, Unknown
from dfm_stage.identification.result import Estimate, SegmentFit
from dfm_stage.model import EFFECTS, Model, SimulationError, Simulator
from dfm_stage.model.linear import linear_part

Array = NDArray[np.float64]
Start = Literal["free", "rest", "periodic"]

DYNAMIC = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay")
"""Base parameters that are free unless something else is asked for, where the model has them."""

SMALL = 1_000_000
"""Fewer samples than this (rows times length) are simulated on one core: threads cost more."""


@dataclass(frozen=True)
class Run:
    """One axis of one record: `input` (N,) held from sample k on, `output` (N,) before it acts.

    The first `skip` samples are simulated but not compared. `start` says how the state at sample
    0 is found: "free" estimates position and velocity (of every mode), "rest" takes zero,
    "periodic" takes the input as whole periods of `period` samples in steady state. `trend` is
    the degree of the polynomial fitted along (-1 none, 0 offset, 1 drift); None leaves it to the
    model: an offset where there is a spring and no trusted encoder zero.
    """

    name: str
    input: Array
    output: Array
    sample_period: float
    skip: int = 0
    start: Start = "free"
    period: int | None = None
    trend: int | None = None


@dataclass(frozen=True)
class ModelFit:
    """`model` with the estimated values, and the `estimate` they come from."""

    model: Model
    estimate: Estimate

    @property
    def fits(self) -> tuple[SegmentFit, ...]:
        """How each run was explained."""
        return self.estimate.segments


def default_free(model: Model) -> tuple[str, ...]:
    """Return what is estimated unless told otherwise: base dynamics and all effects.

    Mass is held, because volts to metres show ratios only.
    """
    base = [n for n in DYNAMIC if n in model.base or n == "force_constant"]
    effects = [f"{use.name}.{name}" for use in model.effects for name in use.parameters]
    return (*base, *effects)


def expand_names(model: Model, names: Iterable[str]) -> tuple[str, ...]:
    """Replace effect names by the addresses of all their parameters, and check every address.

    Raises
    ------
    ModelError
        If the model has no such parameter.
    """
    found: list[str] = []
    for name in names:
        use = model.effect(name)
        group = [f"{name}.{p}" for p in use.parameters] if use is not None else [name]
        for address in group:
            model.parameter(address)
            head = address.partition(".")[0]
            if "." in address and model.effect(head) is None:
                raise IdentificationError(f"{address}: the model has no effect {head}; add it to "
                                          "the model first")
            if address not in found:
                found.append(address)
    return tuple(found)


def fit_model(model: Model, runs: Sequence[Run], free: Sequence[str] | None = None, *,
              noise: str = "auto", starts: Sequence[Mapping[str, float]] = (),
              max_iterations: int = 60, tolerance: float = ACCURATE) -> ModelFit:
    """Estimate the parameters `free` of a one-axis `model` from `runs`.

    `starts` are other values to begin from, by address; parameters left out of one keep the
    model's. Effects that bring coordinates of their own are searched in those. `noise` and
    `tolerance` as in `estimate`.

    Raises
    ------
    IdentificationError
        If a run does not suit the model or is too short.
    ModelError
        If an address is not known.
    """
    names = default_free(model) if free is None else expand_names(model, free)
    builder = _Builder(model, runs, names)
    problem = builder.problem()
    held = {n: v for n, v in model.parameters().items() if n not in names}
    others = [builder.vector({**builder.values, **dict(start)}) for start in starts]
    found = estimate(problem, noise=noise, starts=others, held=held,
                     max_iterations=max_iterations, tolerance=tolerance)
    found = to_physical(found, builder.groups, model)
    fitted = model
    if found.status != "failed":
        fitted = model.with_parameters({n: found.value(n) for n in names})
    return ModelFit(fitted, found)


def evaluate(model: Model, run: Run, *, noise: str = "auto") -> SegmentFit:
    """Simulate `model` on a run it was not fitted to; only the start and the offset are free.

    Raises
    ------
    IdentificationError
        If the model cannot be simulated on it.
    """
    found = fit_model(model, [run], (), noise=noise).estimate
    if found.status == "failed":
        raise IdentificationError(f"{run.name}: {found.message}")
    return found.segments[0]


def linear_plant(model: Model) -> LinearPlant:
    """Return the linear part of a one-axis model with the figures of its modes.

    A mode is a position whose derivative is the velocity that stands after it; its stiffness and
    damping are those that act at once, without what relaxes (creep).
    """
    part = linear_part(model)
    a = part.a
    modes = tuple(Mode(float(part.c[q] * part.gain * part.g[q + 1]), float(0.0 - a[q + 1, q + 1]),
                       float(0.0 - a[q + 1, q])) for q in range(part.motion - 1)
                  if a[q, q + 1] == 1.0 and np.count_nonzero(a[q]) == 1)
    return LinearPlant(modes, part.lag_s, part.delay_s, part)


class _Builder:
    """The unknowns of a problem and the way from them to the simulator's addresses."""

    def __init__(self, model: Model, runs: Sequence[Run], names: tuple[str, ...]) -> None:
        self.model, self.names = model, names
        self.runs = _named_apart(runs)
        self.simulator = Simulator(_ready(model, names))
        given = {**dict.fromkeys(names, 0.0), **model.parameters()}
        if "force_constant" not in model.base:
            given["force_constant"] = 1.0
        self.values = given
        self.groups = group(model, names)
        renamed = {n: f for g in self.groups for n, f in zip(g.names, g.fitted, strict=True)}
        self.fitted = [renamed.get(n, n) for n in names]
        self.local: list[tuple[int, str]] = []
        for i, run in enumerate(self.runs):
            self._check(run)
            if run.start == "free":
                self.local += [(i, s) for s in self.simulator.states if _is_mechanical(s)]

    def _check(self, run: Run) -> None:
        if run.input.shape != run.output.shape or run.input.ndim != 1:
            raise IdentificationError(f"{run.name}: input {run.input.shape} and output "
                                      f"{run.output.shape} must be two arrays of one length")
        ratio = run.sample_period / self.model.sample_period
        if abs(ratio - 1.0) > 1e-6:
            raise IdentificationError(f"{run.name}: sampled every {run.sample_period:g} s, but "
                                      f"the model steps by {self.model.sample_period:g} s: "
                                      "resample the record or change the model")
        if not np.all(np.isfinite(run.input)):
            raise IdentificationError(f"{run.name}: the input holds values that are not finite: "
                                      "cut or interpolate them first")
        if run.start == "periodic" and (run.period is None or run.input.size % run.period):
            raise IdentificationError(f"{run.name}: a periodic run is a whole number of periods: "
                                      "cut it and give the period in samples")

    def problem(self) -> Problem:
        unknowns = list(self._global_unknowns())
        unknowns += [self._local_unknown(i, s) for i, s in self.local]
        spring = self.model.base.get("stiffness", 0.0) > 0.0 or "stiffness" in self.names
        trusted = "encoder_zero" in self.model.base or "encoder_zero" in self.names
        usual = 0 if spring and not trusted else -1
        segments = tuple(Segment(run.output, run.sample_period, run.name, run.skip,
                                 usual if run.trend is None else run.trend)
                         for run in self.runs)
        return Problem(tuple(unknowns), segments, self.simulate, self.model.position_unit)

    def vector(self, values: Mapping[str, float]) -> Array:
        """Return the unknowns (p,) that stand for parameter `values`, initial states zero."""
        found = np.array([values[n] for n in self.names], dtype=float)
        for coordinates in self.groups:
            at = [self.fitted.index(n) for n in coordinates.fitted]
            found[at] = coordinates.forward(found[at])
        return np.concatenate([found, np.zeros(len(self.local))])

    def _global_unknowns(self) -> Iterable[Unknown]:
        start = self.vector(self.values)
        special = {name: (coordinates, k) for coordinates in self.groups
                   for k, name in enumerate(coordinates.fitted)}
        for value, fitted, name in zip(start, self.fitted, self.names, strict=False):
            first = float(value)
            if fitted in special:
                coordinates, k = special[fitted]
                scale = float(coordinates.scale[k])
                yield Unknown(fitted, first, scale if first == 0.0 or np.isfinite(
                    coordinates.high[k]) else abs(first), float(coordinates.low[k]),
                    float(coordinates.high[k]), coordinates.units[k])
            else:
                limits = self.model.parameter(name)
                yield Unknown(name, first, self._scale(name), limits.low, limits.high,
                              limits.unit)

    def _scale(self, name: str) -> float:
        value = abs(self.values[name])
        if value > 0.0:
            return value
        period = self.model.sample_period
        base = self.model.base
        natural = {"amplifier_time_constant": period, "delay": period,
                   "stiffness": base["mass"], "force_constant": 1.0,
                   "damping": 0.02 * math.sqrt(max(base.get("stiffness", 0.0), 1e-6)
                                               * base["mass"]),
                   "encoder_zero": float(np.std(self.runs[0].output)) or 1e-6}
        if name in natural:
            return natural[name]
        head, _, own = name.partition(".")
        prior = EFFECTS[head].priors.get(own) if head in EFFECTS else None
        if prior is not None:
            return (math.sqrt(prior.low * prior.high) if prior.log and prior.low > 0.0
                    else max(abs(prior.low), abs(prior.high)))
        return abs(self.model.parameter(name).default) or 1.0

    def _local_unknown(self, index: int, state: str) -> Unknown:
        run = self.runs[index]
        spread = float(np.std(run.output)) or 1e-9
        speed = float(np.std(np.diff(run.output))) / run.sample_period or 1e-9
        moving = state.endswith("velocity")
        first = 0.0
        if not moving and state == "position" and self.model.base.get("stiffness", 0.0) == 0.0 \
                and "stiffness" not in self.names:
            first = float(run.output[0])
        unit = self.model.position_unit
        return Unknown(f"initial.{state}[{run.name}]", first, speed if moving else spread,
                       unit=f"{unit}/s" if moving else unit, segment=index)

    def simulate(self, index: int, rows: Array) -> Array:
        """Return outputs (P, N) for rows (P, p) of unknowns, NaN where that is not possible."""
        run = self.runs[index]
        physical, valid = self._physical_rows(rows)
        states = [(k, s) for k, (i, s) in enumerate(self.local) if i == index]
        columns = [*self.names, *(f"initial.{s}" for _, s in states)]
        first = rows.shape[1] - len(self.local)
        if run.start == "periodic":
            lags = [k for k, n in enumerate(self.names) if n in LAGS]
            physical[:, lags] = np.maximum(physical[:, lags], 1e-6 * run.sample_period)
        table = np.hstack([physical, rows[:, [first + k for k, _ in states]]])
        out = np.full((rows.shape[0], run.output.size), np.nan)
        if not np.any(valid):
            return out
        periodic = run.start == "periodic" and run.period is not None
        driven = run.input[: run.period] if periodic else run.input
        past = 0.0 if run.start == "rest" else float(run.input[0])
        for k in np.flatnonzero(valid) if periodic else (valid,):
            out[k] = self._rows(driven, columns, table[k], past, periodic, run.input.size)
        return out

    def _rows(self, driven: Array, columns: Sequence[str], table: Array, past: float,
              periodic: bool, samples: int) -> Array:
        """Simulate rows (P, n) or one (n,); one that has no periodic motion becomes NaN."""
        small = driven.size * np.atleast_2d(table).shape[0] < SMALL
        try:
            found = self.simulator.run_many(driven, columns, table, past_input=past,
                                            steady_state=periodic, threads=1 if small else None)
        except SimulationError:
            return np.full(samples, np.nan)
        if periodic:
            return np.asarray(np.tile(found[0], samples // driven.size))
        return np.asarray(found)

    def _physical_rows(self, rows: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return parameter values (P, n) in the order of `names`, and which rows are allowed."""
        count = len(self.names)
        table = rows[:, :count].copy()
        if not count:
            return table, np.ones(rows.shape[0], bool)
        for coordinates in self.groups:
            at = [self.fitted.index(n) for n in coordinates.fitted]
            with np.errstate(all="ignore"):
                table[:, at] = [coordinates.backward(row) for row in rows[:, at]]
        low = np.array([self.model.parameter(n).low for n in self.names])
        high = np.array([self.model.parameter(n).high for n in self.names])
        allowed = np.all(np.isfinite(table) & (table >= low) & (table <= high), axis=1)
        return table, allowed


def _ready(model: Model, names: Iterable[str]) -> Model:
    """Return the model with absent base parameters that are to be estimated added as zero."""
    absent = {n: 0.0 for n in names if "." not in n and n not in model.base}
    if "force_constant" in absent:
        absent["force_constant"] = 1.0
    return model.with_parameters(absent) if absent else model


def _is_mechanical(state: str) -> bool:
    return state.rpartition(".")[2] in ("position", "velocity")


def _named_apart(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return the runs with names made different where two are alike."""
    seen: dict[str, int] = {}
    out = []
    for run in runs:
        seen[run.name] = seen.get(run.name, 0) + 1
        out.append(run if seen[run.name] == 1
                   else replace(run, name=f"{run.name}#{seen[run.name]}"))
    return tuple(out)
