"""Where the search for each effect begins: shapes to try, and sizes that stand for one unit.

An effect's size enters the motion nearly linearly while it is small; its other parameters (a
frequency, a distance, a time constant) shape the response and are tried on a grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.observation import Observation
from dfm_stage.model import EFFECTS, Model

Array = NDArray[np.float64]
Parameters = dict[str, float]

SERIES: dict[str, tuple[str, ...]] = {
    "amplifier_bandwidth": ("amplifier_time_constant",),
    "transport_delay": ("delay",),
    "coil_inductance": ("coil_inductance",),
    "back_emf": ("back_emf",),
}
"""Base parameters in whose presence an effect is a wrong number, not missing physics."""
ONE_SIDED = ("coulomb_friction", "presliding_friction", "hysteresis", "quadratic_damping",
             "amplifier_bandwidth", "transport_delay", "back_emf", "coil_inductance", "creep",
             "eddy_current_damping", "saturation", "encoder_quantization")
"""Effects whose size cannot be negative."""
FIXED_SIZE = ("saturation", "encoder_quantization")
"""Effects whose one parameter is searched on the grid itself."""
SIZES: dict[str, tuple[str, ...]] = {
    "presliding_friction": ("force", "stiffness", "damping"), "hysteresis": ("stiffness",),
    "second_mode": ("share",), "creep": ("stiffness",), "eddy_current_damping": ("damping",),
    "thermal_drift": ("rate",), "periodic_disturbance": ("amplitude",),
    "encoder_periodic_error": ("amplitude",),
}
"""Parameters that scale with the size of an effect that has several."""
TWO_PHASED = ("periodic_disturbance", "encoder_periodic_error")
"""Effects whose size has a phase: two directions, in phase and in quadrature."""


@dataclass(frozen=True)
class Scales:
    """Sizes that occur in the runs: RMS motion, speed, input and force, largest motion, time."""

    motion: float
    speed: float
    travel: float
    drive: float
    force: float
    duration: float
    stiffness: float
    noise: float

    @classmethod
    def of(cls, model: Model, runs: Sequence[Observation], noise: float) -> Scales:
        """Measure them on the run that moves most."""
        run = max(runs, key=lambda r: float(np.std(r.output)))
        motion = max(float(np.std(run.output)), noise)
        smooth = np.convolve(run.output, np.ones(5) / 5.0, "valid")
        speed = max(float(np.std(np.diff(smooth))) / run.sample_period, 1e-3 * motion)
        drive = float(np.std(run.input))
        base = model.base
        gain = abs(base.get("force_constant", 1.0))
        natural = math.sqrt(base["mass"] * base.get("stiffness", 0.0))
        stiffness = max(base.get("stiffness", 0.0), base["mass"] * (speed / motion) ** 2)
        force = max(gain * drive, 1e-3 * stiffness * motion, 1e-3 * natural * speed)
        return cls(motion, speed, float(np.ptp(run.output)), drive, force,
                   max(r.input.size * r.sample_period for r in runs), stiffness, noise)


@dataclass(frozen=True)
class Shape:
    """One starting point: parameters at a size small enough to be linear in."""

    name: str
    parameters: Parameters

    def scaled(self, factor: float) -> Parameters:
        """The parameters at `factor` times the size."""
        if self.name in FIXED_SIZE:
            return dict(self.parameters)
        return {**self.parameters, **self.sizes(factor)}

    def sizes(self, factor: float) -> Parameters:
        """The parameters that make its size, at `factor` times it."""
        names = SIZES.get(self.name, tuple(self.parameters)[:1])
        return {n: v * factor for n, v in self.parameters.items() if n in names}


def excluded(name: str, model: Model, runs: Sequence[Observation]) -> str | None:
    """Why an effect cannot be a candidate here, or None where it can."""
    if model.effect(name) is not None:
        return "the model has it already: its parameters are re-estimated"
    for parameter in SERIES.get(name, ()):
        if model.base.get(parameter, 0.0) > 0.0:
            return f"base has {parameter}: a wrong value of it is retuned"
    if name in ("back_emf", "coil_inductance") and model.drive == "current":
        return "has no meaning with drive: current"
    if name == "coil_inductance" and model.base.get("coil_resistance", 0.0) <= 0.0:
        return "needs coil_resistance in base"
    if name == "back_emf" and not any(r.current is not None for r in runs):
        return "without a current record it is viscous damping: retuned"
    if name == "cross_axis_coupling" and not all(r.other is not None for r in runs):
        return "the neighbouring axis was not recorded"
    if name == "force_offset" and "encoder_zero" not in model.base:
        return "without a trusted encoder_zero it is an offset of the encoder"
    if name == "saturation" and all(np.ptp(r.input) == 0.0 for r in runs):
        return "the input is constant"
    return None


def shapes(name: str, model: Model, runs: Sequence[Observation], scales: Scales) -> list[Shape]:
    """Starting points of one effect; empty where the data give it no size."""
    maker = _MAKERS.get(name)
    found = _generic(name) if maker is None else maker(model, runs, scales)
    limits = {p.name: p for p in EFFECTS[name].parameters}
    return [Shape(name, parameters) for parameters in found
            if all(math.isfinite(v) and limits[n].low <= v <= limits[n].high
                   for n, v in parameters.items())]


def _generic(name: str) -> list[Parameters]:
    """An effect that this module does not know: its typical values."""
    effect = EFFECTS[name]
    values = {}
    for p in effect.parameters:
        prior = effect.priors.get(p.name)
        values[p.name] = p.default if prior is None else (
            math.sqrt(prior.low * prior.high) if prior.log else prior.high)
    return [values]


LATE = ("amplifier_time_constant", "delay", "coil_inductance",
        "amplifier_bandwidth.time_constant", "transport_delay.delay",
        "coil_inductance.inductance")
"""Parameters that make the force late, each in its own way."""


def late_splits(model: Model, free: Sequence[str]) -> list[Parameters]:
    """Other ways to share the whole lateness out: nearly all of it to one free parameter.

    Lag, delay and inductance act alike to first order, and a search may end in a valley where one
    stands in for another. Empty where fewer than two are free.
    """
    values = model.parameters()
    unit = {n: model.base.get("coil_resistance", 0.0) if "inductance" in n else 1.0
            for n in LATE if n in free}
    if len(unit) < 2 or min(unit.values()) <= 0.0:
        return []
    whole = sum(values.get(n, 0.0) / u for n, u in unit.items())
    if whole <= 0.0:
        return []
    rest = 0.1 / (len(unit) - 1)
    limits = {n: model.parameter(n) for n in unit}
    return [{n: min(max((0.9 if n == most else rest) * whole * u, limits[n].low), limits[n].high)
             for n, u in unit.items()} for most in unit]


SMALL = 1e-3
"""Size of a nonlinear force in units of the actuator's, for sensitivities."""


def _coulomb(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"force": SMALL * s.force}]


def _presliding(_: Model, __: object, s: Scales) -> list[Parameters]:
    force = SMALL * s.force
    return [{"force": force, "stiffness": force / (share * s.motion), "breakaway_ratio": 1.0,
             "stribeck_velocity": 0.2 * s.speed, "damping": 0.0}
            for share in (0.01, 0.03, 0.1, 0.3, 1.0)]


def _hysteresis(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"stiffness": SMALL * s.force / (share * s.motion),
             "yield_displacement": share * s.motion, "shape": 0.6, "exponent": 1.0}
            for share in (0.05, 0.15, 0.5, 1.5)]


def _eddy(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"damping": SMALL * s.force / s.speed, "critical_velocity": share * s.speed}
            for share in (0.2, 0.6, 1.5, 4.0)]


def _saturation(_: Model, runs: Sequence[Observation], __: Scales) -> list[Parameters]:
    commands = np.sort(np.concatenate([np.abs(r.input) for r in runs]))
    largest = commands[-1]
    found: list[Parameters] = []
    for share in np.geomspace(1e-4, 0.5, 24):
        limit = float(commands[int((1.0 - share) * (commands.size - 1))])
        if 0.0 < limit < largest and (not found or limit < 0.999 * found[-1]["limit"]):
            found.append({"limit": limit})
    top = [{"limit": float(largest * (1.0 - c))} for c in (1e-3, 3e-3, 1e-2, 2e-2)]
    return found + [p for p in top if p["limit"] > 0.0]


def _second_mode(_: Model, runs: Sequence[Observation], s: Scales) -> list[Parameters]:
    top = 0.45 / runs[0].sample_period
    return [{"share": 1e-4, "frequency": float(hertz), "damping_ratio": zeta}
            for hertz in np.geomspace(max(0.5, 4.0 / s.duration), top, 60)
            for zeta in (0.01, 0.04)]


def _creep(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"stiffness": 1e-4 * s.stiffness, "time_constant": float(tau)}
            for tau in np.geomspace(0.02, 2.0 * s.duration, 12)]


def _lag(model: Model, _: object, __: Scales) -> list[Parameters]:
    return [{"time_constant": model.sample_period * f} for f in (0.1, 0.3, 1.0, 3.0, 10.0)]


def _delay(model: Model, _: object, __: Scales) -> list[Parameters]:
    return [{"delay": model.sample_period * f} for f in (0.02, 0.3, 1.0, 3.0)]


def _inductance(model: Model, _: object, __: Scales) -> list[Parameters]:
    resistance = model.base["coil_resistance"]
    return [{"inductance": resistance * model.sample_period * f} for f in (0.1, 0.3, 1.0, 3.0)]


def _back_emf(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"constant": 1e-3 * s.drive / s.speed}] if s.drive > 0.0 else []


def _drift(_: Model, __: object, s: Scales) -> list[Parameters]:
    return [{"rate": s.noise / s.duration, "decay": d / s.duration} for d in (0.0, 1.0, 3.0, 8.0)]


def _one(name: str, size: Callable[[Scales], float]) -> Callable[..., list[Parameters]]:
    def make(_: Model, __: object, s: Scales) -> list[Parameters]:
        return [{name: size(s)}]
    return make


def _cross(_: Model, runs: Sequence[Observation], s: Scales) -> list[Parameters]:
    other = max(float(np.std(r.other)) for r in runs if r.other is not None)
    return [{"ratio": 1e-3 * s.motion / max(other, 1e-12), "stiffness": 0.0}]


def _from_data(_: Model, __: object, ___: Scales) -> list[Parameters]:
    """Found from the residual itself: see `spectra`."""
    return []


_MAKERS: dict[str, Callable[..., Iterable[Parameters]]] = {
    "cubic_stiffness": _one("k3", lambda s: SMALL * s.force / s.motion**3),
    "quadratic_stiffness": _one("k2", lambda s: SMALL * s.force / s.motion**2),
    "quadratic_damping": _one("coefficient", lambda s: SMALL * s.force / s.speed**2),
    "force_constant_droop": _one("droop", lambda s: SMALL / s.motion**2),
    "force_constant_slope": _one("slope", lambda s: SMALL / s.motion),
    "force_offset": _one("force", lambda s: SMALL * s.force),
    "coulomb_friction": _coulomb, "presliding_friction": _presliding, "hysteresis": _hysteresis,
    "eddy_current_damping": _eddy, "saturation": _saturation, "second_mode": _second_mode,
    "creep": _creep, "amplifier_bandwidth": _lag, "transport_delay": _delay,
    "coil_inductance": _inductance, "back_emf": _back_emf, "thermal_drift": _drift,
    "cross_axis_coupling": _cross, "periodic_disturbance": _from_data,
    "encoder_periodic_error": _from_data, "encoder_quantization": _from_data,
}
