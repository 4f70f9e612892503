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

from benchmarks.corpus import plant, uncommon
from benchmarks.corpus.case import NOTHING, Truth
from benchmarks.corpus.linear import response, sensitivities
from benchmarks.corpus.plan import class_of
from benchmarks.corpus.severity import FREE
from benchmarks.corpus.stage import NO_LOOP, PERIOD
from benchmarks.corpus.truth import Parameters, draw, plant_values
from benchmarks.corpus.wide.draws import draw_uncommon
from benchmarks.corpus.wide.kin import relatives, rivals_of

COARSE = 1e-4
DISTANCE = 38.2
BEYOND_DOUBT = 2000.0
PART, DRAWS, SCALES, STARTS = 8000, 5, (0.5, 3.0, 20.0), 3
"""Of rivals of uncommon effects: samples of which D is a lower bound, too; guesses at several
sizes, of which the best ones are fitted."""
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
    """The nearest rival of a case with a single effect; of an uncommon one that is left out, the
    nearest of its relatives that the library keeps."""
    nearest = Separability(None, math.inf)
    if not truth.spec.effects:
        return nearest
    name, rare = truth.spec.effects[0], truth.spec.effects[0] in uncommon.PARAMETERS
    if truth.spec.kind not in (("effect", "left_out") if rare else ("effect",)):
        return nearest
    base, rivals = truth.setup.stage.base, class_of(name) - {name}
    if rare:
        rivals = rivals_of(name) if truth.spec.kind == "effect" else relatives(name)
    for rival in sorted(rivals):
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
    rare = truth.spec.effects[0] in uncommon.PARAMETERS
    alone = _Fit(truth, rival, [truth.outputs[0][:, :PART]] if rare else truth.outputs[:1])
    starts = sorted(_drawn_starts(truth, rival), key=alone.at_first)[:STARTS] if rare \
        else _starts(truth, rival)
    found = min(alone.best(start, 12 if rare else 3) for start in starts)
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
        self.others = [setup.other[i][1] if i in setup.other else NOTHING
                       for i in range(len(outputs))]
        self.free = [name for name in FREE if self.stage.base.get(name, 0.0) > 0.0]
        self.electric = self.stage.current_noise is not None and (
            rival != "" and bool({"coil_inductance", "sensor_lag"} & {rival, *setup.effects}))
        self.wanted = self.outputs(self.stage.base, setup.effects)
        self.nuisance = self._nuisance()
        self.base_slopes = None if self.electric else self._linear_slopes()

    def outputs(self, base: dict[str, float], effects: dict[str, Parameters]) -> Any:
        """Reading over its noise, and where it can tell the current over its own."""
        p = plant.numbers(plant_values(base, effects))
        lags = [p[plant.SECOND_LAG], p[plant.INDUCTANCE] / max(p[plant.RESISTANCE], 1e-9)]
        finest = max(min([COARSE, *(lag for lag in lags if lag > 0.0)]), 2e-6)
        start = np.zeros(plant.STATES)
        if p.size > plant.COMMON:
            start[plant.X1] = uncommon.at_rest(p[plant.COMMON:], base["stiffness"])
        readings, currents = [], []
        for command, other in zip(self.commands, self.others, strict=True):
            none = np.zeros(command.size)
            out = np.empty((6, command.size))
            plant.run(p, PERIOD, finest, none, command, NO_LOOP, none, none, other, start, 0.0,
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
        left = self.outputs(base, {self.rival: FIXED.get(self.rival, {}) | parameters}
                             ) - self.wanted
        return self.free_of_states(left)

    def free_of_states(self, signal: Any) -> Any:
        """The signal without what first states and offsets can explain."""
        return signal - self.nuisance @ (self.nuisance.T @ signal)

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
        return self.free_of_states(slopes)

    def at_first(self, start: Parameters) -> float:
        """Squares left at a start, after one step of the base where its slopes are known."""
        names = list(start)
        z = np.concatenate([np.zeros(len(self.free)), [math.log(abs(start[n])) for n in names]])
        left = self.residual(z, names, [math.copysign(1.0, start[n]) for n in names])
        if self.base_slopes is not None:
            left = left - self.base_slopes @ np.linalg.lstsq(
                self.base_slopes, left, rcond=1e-8)[0]
        return float(left @ left)

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


def margins(truth: Truth) -> dict[str, float]:
    """Of each of two effects, what it adds beyond a linear refit of the base and of the other
    effect's parameters: RMS over the noise, all runs. Small where the other one hides it."""
    fit = _Fit(truth, "", truth.outputs)
    effects, base = truth.setup.effects, truth.setup.stage.base
    found = {}
    for name in effects:
        if name == "encoder_quantization":  # white, and nothing else rounds
            found[name] = effects[name]["step"] / math.sqrt(12.0) / truth.setup.stage.noise
            continue
        kept = {n: v for n, v in effects.items() if n != name}
        without = fit.outputs(base, kept)
        columns = [fit.base_slopes]
        for other, values in kept.items():
            for parameter, value in values.items():
                step = 1e-4 * value
                if step == 0.0:
                    continue
                moved = {**kept, other: {**values, parameter: value + step}}
                column = fit.free_of_states(fit.outputs(base, moved) - without)
                columns.append((column / max(float(np.linalg.norm(column)), 1e-300))[:, None])
        slopes = np.hstack([c for c in columns if c is not None])
        gap = fit.free_of_states(fit.wanted - without)
        slopes = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        gap = gap - slopes @ np.linalg.lstsq(slopes, gap, rcond=1e-9)[0]
        found[name] = float(np.sqrt(np.mean(gap**2)))
    return found


def pair_separability(truth: Truth) -> dict[str, Any]:
    """What the label of a pair says: whether each effect can be seen beside the other."""
    seen = margins(truth)
    samples = sum(out.shape[1] for out in truth.outputs)
    return {"margins": seen, "separable": min(seen.values()) ** 2 * samples >= DISTANCE}


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


def _drawn_starts(truth: Truth, rival: str) -> list[Parameters]:
    """First guesses of the parameters of a rival of an uncommon effect: draws of its own."""
    stage, out, scale = truth.setup.stage, truth.outputs[0], truth.spec.severity / 10.0
    drawing = draw_uncommon if rival in uncommon.PARAMETERS else draw
    found = [drawing(rival, np.random.default_rng([17, i]), stage, out[4], out[0]).of(
        scale * size) for i in range(DRAWS) for size in SCALES]
    return [{n: v for n, v in each.items() if v != 0.0} for each in found]
