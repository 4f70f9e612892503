"""From unknowns to residuals: a model on several runs, with what belongs to one run only.

Unknowns are, in this order, the free parameters of the model in well-conditioned coordinates, and
for each run its initial position and velocity, its offset, parameters of effects that differ from
run to run (the phase of a vibration, the rate of a drift), and gain and offset of the current.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.coordinates import group
from dfm_stage.model import EFFECTS, Model, SimulationError, Simulator

Array = NDArray[np.float64]

PER_RUN = {"periodic_disturbance": ("periodic_disturbance.in_phase",
                                    "periodic_disturbance.quadrature"),
           "thermal_drift": ("thermal_drift.rate",)}
"""Coordinates of effects that do not carry over from one run to the next."""
COST = {"presliding_friction": 3.0, "hysteresis": 4.0}
"""What a simulation costs beside one with a smooth nonlinear force."""
SAMPLES = 24_000
"""Samples whose simulation with a smooth nonlinear force is one unit of work."""
DISTANCES = ("presliding_friction.distance", "hysteresis.yield_displacement")
UNSEEN = 0.1
"""A distance below this much of the noise is that of dry friction, and slow to simulate."""
MOST_DAMPED = 0.5
"""Damping ratio up to which a second mode is looked for: beyond it there is no resonance."""
SMALL_SHARE = 0.05
"""Nonlinear effects that move the output by less than this leave the base's sensitivities."""


@dataclass(frozen=True)
class Place:
    """One unknown: name, the run it belongs to (-1: all), typical size, limits and step."""

    name: str
    run: int
    scale: float
    low: float = -math.inf
    high: float = math.inf
    step: float = 1e-4


def is_costly(name: str) -> bool:
    """Whether an effect makes the simulation nonlinear."""
    effect = EFFECTS[name]
    return effect.force is not None or effect.advance is not None \
        or effect.adds_to == "dry_friction"


class System:
    """A one-axis `model` with `free` parameter addresses on `runs`."""

    def __init__(self, model: Model, runs: Sequence[Observation], free: Sequence[str],
                 dither: float = 0.0) -> None:
        self.runs, self.free = tuple(runs), tuple(free)
        self.dither = _dither(model, dither)
        self.least = UNSEEN * dither
        self.springless = model.base.get("stiffness", 0.0) == 0.0 and "stiffness" not in free
        pushed = self.springless and model.effect("force_offset") is None
        self.model = model.with_effect("force_offset", {"force": 0.0}) if pushed else model
        self.pushed = pushed
        self.trusted = "encoder_zero" in model.base
        self.groups = group(self.model, self.free)
        renamed = {n: f for g in self.groups for n, f in zip(g.names, g.fitted, strict=True)}
        self.fitted = [renamed.get(n, n) for n in self.free]
        self.simulator = Simulator(self.model)
        costly = [u.name for u in self.model.effects if is_costly(u.name)]
        light = self.model
        for name in costly:
            light = light.without_effect(name)
        self.light = Simulator(light) if costly else self.simulator
        self.costly = costly
        self.cost = max((COST.get(n, 1.0) for n in costly), default=0.0)
        self.work = 0.0
        self.places = [*self._global_places(), *(p for i in range(len(self.runs))
                                                 for p in self._local_places(i))]
        self.count = len(self.free)

    # -- unknowns -------------------------------------------------------------------------------

    def _global_places(self) -> Iterable[Place]:
        special = {n: (g, k) for g in self.groups for k, n in enumerate(g.fitted)}
        start = self.global_start()
        for value, name, address in zip(start, self.fitted, self.free, strict=True):
            step = self._step(address, float(value))
            if name in special:
                coordinates, k = special[name]
                scale = abs(value) or float(coordinates.scale[k])
                low = float(coordinates.low[k])
                yield Place(name, -1, scale, self._low(name, low),
                            float(coordinates.high[k]), step)
            else:
                limits = self.model.parameter(address)
                high = limits.high
                if address == "second_mode.damping_ratio":
                    high = max(MOST_DAMPED, abs(value))
                if address == "thermal_drift.decay":
                    high = max(15.0 / self._longest(), abs(value))
                yield Place(name, -1, abs(value) or self._typical(address),
                            self._low(name, limits.low), high, step)

    def _low(self, name: str, limit: float) -> float:
        """The least value of a coordinate that a search may try."""
        return max(limit, self.least) if name in DISTANCES else limit

    def _step(self, address: str, value: float) -> float:
        """The relative step of a difference: small where a phase would turn within it."""
        head, _, own = address.partition(".")
        if not own:
            return 1e-5
        if head == "periodic_disturbance" and own == "frequency":
            return 1e-3 / (self._longest() * max(abs(value), 1e-9))
        if head == "encoder_periodic_error" and own == "period":
            travel = max(float(np.ptp(r.output)) for r in self.runs) or 1.0
            return 1e-3 * min(1.0, abs(value) / travel)
        return 1e-3 if is_costly(head) else 1e-4

    def _longest(self) -> float:
        return max(r.input.size * r.sample_period for r in self.runs)

    def _typical(self, address: str) -> float:
        base = self.model.base
        natural = {"amplifier_time_constant": self.model.sample_period,
                   "delay": self.model.sample_period, "stiffness": base["mass"],
                   "damping": 0.02 * math.sqrt(base["mass"] * max(base.get("stiffness", 0.0),
                                                                  1e-3)),
                   "force_constant": 1.0}
        if address in natural:
            return natural[address]
        head, _, own = address.partition(".")
        prior = EFFECTS[head].priors.get(own) if head in EFFECTS else None
        if prior is None:
            return 1.0
        return math.sqrt(prior.low * prior.high) if prior.log else prior.high

    def _local_places(self, index: int) -> Iterable[Place]:
        run = self.runs[index]
        spread = float(np.std(run.output)) or 1e-9
        speed = float(np.std(np.diff(run.output))) / run.sample_period or 1e-9
        yield Place("initial.position", index, spread)
        yield Place("initial.velocity", index, speed)
        if not self.trusted and not self.springless:
            yield Place("encoder_zero", index, spread)
        if self.pushed:
            yield Place("force_offset.force", index, 1e-3 * self._force(run))
        if index > 0 or not self.free:
            for use in self.model.effects:
                for name in PER_RUN.get(use.name, ()):
                    yield Place(name, index, self._per_run_scale(name))
        if run.current is not None:
            yield Place("current.gain", index, 1.0)
            yield Place("current.offset", index, float(np.std(run.current)) or 1.0)

    def _force(self, run: Observation) -> float:
        base = self.model.base
        return (abs(base.get("force_constant", 1.0)) * float(np.std(run.input))
                or base["mass"] * 1e-3)

    def _per_run_scale(self, name: str) -> float:
        values = self.model.parameters()
        head = name.partition(".")[0]
        size = {"periodic_disturbance": "amplitude", "thermal_drift": "rate"}[head]
        return abs(values[f"{head}.{size}"]) or 1e-9

    def global_start(self) -> Array:
        """The model's values as unknowns (count,)."""
        values = {**dict.fromkeys(self.free, 0.0), **self.model.parameters()}
        found = np.array([values[n] for n in self.free], dtype=float)
        for g in self.groups:
            at = [self.fitted.index(n) for n in g.fitted]
            found[at] = g.forward(found[at])
        return found

    def start(self, earlier: dict[tuple[str, int], float] | None = None) -> Array:
        """Where a search begins: the model's values, and `earlier` values of single runs."""
        earlier = earlier or {}
        local = []
        per_run = self._coordinates()
        for place in self.places[self.count:]:
            value = earlier.get((place.name, place.run))
            if value is None:
                value = per_run.get(place.name, 0.0)
                if place.name == "initial.position" and self.springless:
                    run = self.runs[place.run]
                    value = float(run.output[0])
                elif place.name == "current.gain":
                    value = 1.0
            local.append(value)
        return np.concatenate((self.global_start(), local))

    def _coordinates(self) -> dict[str, float]:
        """Values of the coordinates that may differ from run to run."""
        values = self.model.parameters()
        found: dict[str, float] = {}
        for use in self.model.effects:
            if use.name == "thermal_drift":
                found["thermal_drift.rate"] = values["thermal_drift.rate"]
            if use.name == "periodic_disturbance":
                a, p = (values[f"{use.name}.{n}"] for n in ("amplitude", "phase"))
                found[f"{use.name}.in_phase"] = a * math.cos(p)
                found[f"{use.name}.quadrature"] = a * math.sin(p)
        return found

    def physical(self, x: Array) -> dict[str, float]:
        """Parameter address -> value."""
        values = np.array(x[:self.count], dtype=float)
        for g in self.groups:
            at = [self.fitted.index(n) for n in g.fitted]
            values[at] = g.backward(values[at])
        return dict(zip(self.free, values.tolist(), strict=True))

    def locals_of(self, x: Array) -> dict[tuple[str, int], float]:
        """(name, run) -> value of what belongs to single runs."""
        return {(p.name, p.run): float(v)
                for p, v in zip(self.places[self.count:], x[self.count:], strict=True)}

    # -- simulation -----------------------------------------------------------------------------

    def simulate(self, index: int, rows: Array, light: bool = False) -> list[Array]:
        """Outputs [(P, N - skip), ...] per channel for rows (P, n) of all unknowns; NaN rows
        where a row cannot be simulated."""
        run = self.runs[index]
        table, names, allowed = self._table(index, rows)
        simulator = self.light if light else self.simulator
        if light:
            kept = [k for k, n in enumerate(names) if n.partition(".")[0] not in self.costly]
            names, table = [names[k] for k in kept], table[:, kept]
        else:
            self.work += self.cost * len(rows) * run.input.size / SAMPLES
        out = [np.full((len(rows), run.input.size), np.nan) for _ in run.channels]
        if not np.any(allowed):
            return [o[:, run.skip:] for o in out]
        for channel, signal in zip(out, ("output", "current"), strict=False):
            try:
                channel[allowed] = simulator.run_many(
                    run.input, names, table[allowed], signal=signal,
                    past_input=float(run.input[0]), other=run.other, dither=self.dither or None,
                    threads=1)
            except SimulationError:
                return [o[:, run.skip:] for o in out]
        cut = [o[:, run.skip:] for o in out]
        for k, place in enumerate(self.places[self.count:], self.count):
            if place.run != index:
                continue
            if place.name == "current.gain":
                cut[1] *= rows[:, k:k + 1]
        for k, place in enumerate(self.places[self.count:], self.count):
            if place.run == index and place.name == "current.offset":
                cut[1] += rows[:, k:k + 1]
        return cut

    def _table(self, index: int, rows: Array) -> tuple[Array, list[str], NDArray[np.bool_]]:
        """Simulator parameters (P, m) of one run, their names, and which rows are allowed."""
        fitted = rows[:, :self.count].copy()
        states: list[tuple[str, Array]] = []
        extra: list[tuple[str, Array]] = []
        turned: dict[str, Array] = {}
        for k, place in enumerate(self.places[self.count:], self.count):
            if place.run != index:
                continue
            if place.name.startswith("initial."):
                states.append((place.name, rows[:, k]))
            elif place.name in self.fitted:
                fitted[:, self.fitted.index(place.name)] = rows[:, k]
            elif place.name.startswith("periodic_disturbance."):
                turned[place.name] = rows[:, k]
            elif place.name in ("thermal_drift.rate", "force_offset.force", "encoder_zero"):
                extra.append((place.name, rows[:, k]))
        if len(turned) == 2:
            a, b = (turned[n] for n in PER_RUN["periodic_disturbance"])
            extra += [("periodic_disturbance.amplitude", np.hypot(a, b)),
                      ("periodic_disturbance.phase", np.arctan2(b, a))]
        table = fitted
        with np.errstate(all="ignore"):
            for g in self.groups:
                at = [self.fitted.index(n) for n in g.fitted]
                table[:, at] = [g.backward(row) for row in table[:, at]]
        low = np.array([self.model.parameter(n).low for n in self.free])
        high = np.array([self.model.parameter(n).high for n in self.free])
        allowed = np.all(np.isfinite(table) & (table >= low) & (table <= high), axis=1)
        names = [*self.free, *(n for n, _ in states), *(n for n, _ in extra)]
        columns = [v[:, None] for _, v in (*states, *extra)]
        return np.hstack([table, *columns]), names, np.asarray(allowed)

    def residuals(self, x: Array) -> list[list[Array]]:
        """Measured minus simulated, per run and channel, (N - skip,)."""
        found = []
        for i, run in enumerate(self.runs):
            simulated = self.simulate(i, x[None, :])
            measured = (run.output, run.current)
            found.append([m[run.skip:] - s[0] for m, s in zip(measured, simulated, strict=False)
                          if m is not None])
        return found

    def use_light(self, x: Array) -> bool:
        """Whether the base's sensitivities may be taken without the nonlinear effects."""
        if not self.costly:
            return True
        full = self.simulate(0, x[None, :])[0][0]
        light = self.simulate(0, x[None, :], light=True)[0][0]
        if not np.all(np.isfinite(light)):
            return False
        return float(np.std(full - light)) < SMALL_SHARE * float(np.std(full))

    def is_own(self, name: str) -> bool:
        """Whether a coordinate is that of an effect that is costly to simulate."""
        return name.partition(".")[0] in self.costly or self._mixed(name)

    def sensitivities(self, index: int, x: Array, light: bool, own: bool = True) -> list[Array]:
        """Derivatives of one run's channels [(n, N - skip), ...] by all unknowns; zero for costly
        effects unless `own`."""
        run = self.runs[index]
        size = run.input.size - run.skip
        out = [np.zeros((x.size, size)) for _ in run.channels]
        base, costly = [], []
        for k, place in enumerate(self.places):
            if place.run not in (-1, index):
                continue
            if place.run == index and place.name in self.fitted:
                costly.append(k)
            elif place.run == -1 and any(p.run == index and p.name == place.name
                                         for p in self.places[self.count:]):
                continue
            elif self.is_own(place.name):
                costly.append(k)
            else:
                base.append(k)
        self._differences(index, x, base, light, out)
        if own or not light:
            self._differences(index, x, costly, False, out)
        return out

    def _mixed(self, name: str) -> bool:
        """Whether a coordinate of the base is tied to a costly effect."""
        return any(name in g.fitted and any(n.partition(".")[0] in self.costly for n in g.names)
                   for g in self.groups)

    def _differences(self, index: int, x: Array, chosen: list[int], light: bool,
                     out: list[Array]) -> None:
        if not chosen:
            return
        central = light or not self.costly
        rows = [x] if not central else []
        widths = []
        for k in chosen:
            place = self.places[k]
            step = place.step * max(place.scale, 1e-300)
            up, down = x.copy(), x.copy()
            up[k] = x[k] + step if x[k] + step <= place.high else x[k] - step
            down[k] = max(x[k] - step, place.low) if central else x[k]
            rows += [up, down] if central else [up]
            widths.append(up[k] - down[k])
        found = self.simulate(index, np.array(rows), light)
        for channel, outputs in zip(out, found, strict=True):
            for j, (k, width) in enumerate(zip(chosen, widths, strict=True)):
                if width == 0.0:
                    continue
                if central:
                    channel[k] = (outputs[2 * j] - outputs[2 * j + 1]) / width
                else:
                    channel[k] = (outputs[j + 1] - outputs[0]) / width


SHARP = 0.06
"""Noise over the step of a reading that counts in steps, where nothing else is known of it."""


def _dither(model: Model, found: float) -> float:
    """RMS of the noise before rounding: given, or at most a small part of the step, because what
    rounding adds looks like noise as well."""
    use = model.effect("encoder_quantization")
    if use is None:
        return found
    return min(found or math.inf, model.base.get("noise", 0.0) or SHARP * use.parameters["step"])
