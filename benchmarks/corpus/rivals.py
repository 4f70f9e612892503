"""Whether the data can tell an effect from the others of its class, by the likelihood ratio.

A rival, with the base parameters, first states and offsets free, is fitted to the noise-free
truth of all runs, held-out ones too. What it leaves over, squared and divided by the noise's
variance, is the distance D. An ideal likelihood-ratio test mistakes the one for the other with
probability Phi(-sqrt(D)/2): below one in a thousand from D = 38 on.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus import plant
from benchmarks.corpus.case import NOTHING, Truth
from benchmarks.corpus.linear import response, sensitivities
from benchmarks.corpus.plan import class_of
from benchmarks.corpus.severity import FREE
from benchmarks.corpus.stage import NO_LOOP, PERIOD
from benchmarks.corpus.truth import Parameters, plant_values

COARSE = 1e-4
DISTANCE = 38.2
BEYOND_DOUBT = 2000.0
LIMITS_OF = {"coulomb_friction": ("presliding_friction", "hysteresis")}
"""Effects that are limits of richer ones: the richer ones fit as well and are no rivals."""


@dataclass(frozen=True)
class Separability:
    """The nearest rival, None without one, and its distance D."""

    rival: str | None
    distance: float

    @property
    def separable(self) -> bool:
        """Whether an ideal test errs in less than one of a thousand."""
        return self.distance >= DISTANCE

    def to_dict(self) -> dict[str, Any]:
        """What the label says of it."""
        finite = self.distance if math.isfinite(self.distance) else None
        return {"separable": self.separable, "rival": self.rival, "distance": finite}


def separability(truth: Truth) -> Separability:
    """The nearest rival of a case with a single effect."""
    nearest = Separability(None, math.inf)
    if truth.spec.kind != "effect":
        return nearest
    name = truth.spec.effects[0]
    base = truth.setup.stage.base
    for rival in sorted(class_of(name) - {name}):
        if rival in LIMITS_OF.get(name, ()) or (
                rival == "coil_inductance" and "coil_resistance" not in base) or (
                rival == "transport_delay" and "delay" in base):
            continue
        found = distance(truth, rival)
        if found < nearest.distance:
            nearest = Separability(rival, found)
    return nearest


def distance(truth: Truth, rival: str) -> float:
    """D of the best fit of a rival, from the best of a few starts.

    D of one run alone is a lower bound: where it is beyond all doubt, the others are not asked.
    """
    starts = _starts(truth, rival)
    alone = _Fit(truth, rival, truth.outputs[:1])
    found = min(alone.best(start, 3) for start in starts)
    if found > BEYOND_DOUBT or len(truth.outputs) == 1:
        return found
    fit = _Fit(truth, rival, truth.outputs)
    return min(fit.best(start, 12) for start in starts)


class _Fit:
    """Weighted residuals of a rival with the base free; states and offsets are projected out."""

    def __init__(self, truth: Truth, rival: str, outputs: list[Any]) -> None:
        setup = truth.setup
        self.stage, self.rival = setup.stage, rival
        self.commands = [np.ascontiguousarray(out[0]) for out in outputs]
        self.free = [name for name in FREE if self.stage.base.get(name, 0.0) > 0.0]
        self.electric = self.stage.current_noise is not None and (
            "coil_inductance" in (rival, *setup.effects))
        self.wanted = self._outputs(self.stage.base, setup.effects)
        self.nuisance = self._nuisance()
        self.base_slopes = None if self.electric else self._linear_slopes()

    def _outputs(self, base: dict[str, float], effects: dict[str, Parameters]) -> Any:
        """Reading over its noise, and where it can tell the current over its own."""
        p = plant.numbers(plant_values(base, effects))
        lags = [p[plant.SECOND_LAG], p[plant.INDUCTANCE] / max(p[plant.RESISTANCE], 1e-9)]
        finest = max(min([COARSE, *(lag for lag in lags if lag > 0.0)]), 2e-6)
        start = np.zeros(plant.STATES)
        readings, currents = [], []
        for command in self.commands:
            none = np.zeros(command.size)
            out = np.empty((6, command.size))
            plant.run(p, PERIOD, finest, none, command, NO_LOOP, none, none, NOTHING, start, 0.0,
                      out)
            readings.append(out[2] / self.stage.noise)
            if self.electric and self.stage.current_noise is not None:
                currents.append(out[3] / self.stage.current_noise)
        return np.nan_to_num(np.concatenate([*readings, *currents]), nan=1e6)

    def _nuisance(self) -> Any:
        """Orthonormal columns of each run's first states and offset."""
        total, columns, at = self.wanted.size, [], 0
        own = [(1.0, 0.0), (0.0, 1.0)]
        for command in self.commands:
            still = np.zeros(command.size)
            for values in [*(response(self.stage.base, PERIOD, still, s) for s in own),
                           *([still + 1.0] if "encoder_zero" not in self.stage.base else [])]:
                column = np.zeros(total)
                column[at:at + command.size] = values / np.linalg.norm(values)
                columns.append(column)
            at += command.size
        return np.linalg.qr(np.column_stack(columns))[0]

    def residual(self, z: Any, names: list[str], signs: list[float]) -> Any:
        """z: logarithms of base factors, then of the rival's parameters."""
        base = dict(self.stage.base)
        for name, value in zip(self.free, z, strict=False):
            base[name] *= math.exp(value)
        parameters = {n: s * math.exp(v) for n, s, v in
                      zip(names, signs, z[len(self.free):], strict=True)}
        left = self._outputs(base, {self.rival: FIXED.get(self.rival, {}) | parameters}
                             ) - self.wanted
        return left - self.nuisance @ (self.nuisance.T @ left)

    def _slopes(self, z: Any, names: list[str], signs: list[float], at: Any) -> Any:
        """Columns d residual / d z; the base's from the linear stage where that will do."""
        columns = [] if self.base_slopes is None else list(self.base_slopes.T)
        for i in range(len(columns), z.size):
            moved = z.copy()
            moved[i] += 1e-4
            columns.append((self.residual(moved, names, signs) - at) / 1e-4)
        return np.column_stack(columns)

    def _linear_slopes(self) -> Any:
        """The same of the base parameters' logarithms, as if the stage were linear."""
        parts = [sensitivities(self.stage.base, self.free, PERIOD, command)[1]
                 for command in self.commands]
        slopes = np.concatenate(parts)[:, :len(self.free)] / self.stage.noise
        slopes = slopes * [self.stage.base[name] for name in self.free]
        return slopes - self.nuisance @ (self.nuisance.T @ slopes)

    def best(self, start: Parameters, steps: int) -> float:
        """Squares left after at most so many damped Gauss-Newton steps from `start`."""
        names = list(start)
        signs = [math.copysign(1.0, start[n]) for n in names]
        z = np.concatenate([np.zeros(len(self.free)), [math.log(abs(start[n])) for n in names]])
        left = self.residual(z, names, signs)
        cost = float(left @ left)
        for _ in range(steps):
            slopes = self._slopes(z, names, signs, left)
            step = np.clip(-np.linalg.lstsq(slopes, left, rcond=1e-8)[0], -2.0, 2.0)
            for _ in range(4):
                tried = self.residual(z + step, names, signs)
                if float(tried @ tried) < cost:
                    break
                step = 0.3 * step
            else:
                break
            fell = 1.0 - float(tried @ tried) / cost
            z, left, cost = z + step, tried, float(tried @ tried)
            if fell < 1e-3 or cost < 0.1 * DISTANCE:
                break
        return cost


FIXED: dict[str, Parameters] = {
    "presliding_friction": {"breakaway_ratio": 1.0, "stribeck_velocity": 1.0, "damping": 0.0},
    "hysteresis": {"shape": 0.5, "exponent": 1.0},
    "thermal_drift": {}}


def _starts(truth: Truth, rival: str) -> list[Parameters]:
    """First guesses of a rival's parameters from the true effect's size."""
    base, out = truth.setup.stage.base, truth.outputs[0]
    position, speed = (float(np.sqrt(np.mean(out[row] ** 2))) for row in (4, 5))
    values = next(iter(truth.setup.effects.values()))
    kf = base["force_constant"]
    k = base["stiffness"]
    drive = float(np.sqrt(np.mean(out[0] ** 2))) * kf
    late = values.get("delay", 0.0) + values.get("time_constant", 0.0) + values.get(
        "inductance", 0.0) / base.get("coil_resistance", 1.0)
    force = values.get("force", values.get("stiffness", 1.0) * values.get(
        "yield_displacement", 1.0))
    slip = values.get("yield_displacement", force / values.get("stiffness", 1.0))
    size = sum(s * truth.setup.stage.noise for s in truth.severities.values())
    guesses: dict[str, Callable[[], list[Parameters]]] = {
        "transport_delay": lambda: [{"delay": late}],
        "amplifier_bandwidth": lambda: [{"time_constant": late}],
        "coil_inductance": lambda: [{"inductance": late * base["coil_resistance"]}],
        "coulomb_friction": lambda: [{"force": force}],
        "presliding_friction": lambda: [{"force": force, "stiffness": force / slip}],
        "hysteresis": lambda: [{"stiffness": force / slip, "yield_displacement": slip}],
        "cubic_stiffness": lambda: [
            {"k3": s * abs(values["droop"]) * drive / position} for s in (1.0, -1.0)],
        "force_constant_droop": lambda: [
            {"droop": s * abs(values["k3"]) * position / drive} for s in (1.0, -1.0)],
        "quadratic_stiffness": lambda: [
            {"k2": s * abs(values["slope"]) * drive / position} for s in (1.0, -1.0)],
        "force_constant_slope": lambda: [
            {"slope": s * abs(values["k2"]) * position / drive} for s in (1.0, -1.0)],
        "quadratic_damping": lambda: [{"coefficient": values["damping"] / speed}],
        "eddy_current_damping": lambda: [
            {"damping": values["coefficient"] * speed, "critical_velocity": speed}],
        "creep": lambda: [{"stiffness": k * size / position, "time_constant": 5.0}],
        "thermal_drift": lambda: [{"rate": s * size / 7.0, "decay": 0.05} for s in (1.0, -1.0)]}
    return guesses[rival]()
