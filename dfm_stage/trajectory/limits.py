"""Does a movement stay within what the stage can do? Answered before it starts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model import Model
from dfm_stage.model.parameter import Parameter
from dfm_stage.trajectory.errors import LimitError, place
from dfm_stage.trajectory.signals import Excitation, Reference

LIMIT_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("travel_m", 7.7e-3, "m", "furthest from zero", 0.0, 1e3),
    Parameter("velocity_m_s", 0.0, "m/s", "largest velocity", 0.0, 1e6),
    Parameter("acceleration_m_s2", 0.0, "m/s^2", "largest acceleration", 0.0, 1e9),
    Parameter("jerk_m_s3", 0.0, "m/s^3", "largest jerk", 0.0, 1e12),
    Parameter("force_n", 0.0, "N", "largest force of the actuator; needs a model", 0.0, 1e6),
    Parameter("voltage_v", 10.0, "V", "largest command, that of the reference included where a "
              "model is given", 0.0, 1e6),
    Parameter("current_a", 0.0, "A", "largest current; needs a model with coil_resistance or a "
              "current drive", 0.0, 1e6),
)
_REMEDIES = {
    "position": "make the movement smaller or move its middle",
    "velocity": "make the movement slower or smaller",
    "acceleration": "make the movement, its turns or its ramps slower",
    "jerk": "give the movement smooth ramps or more time",
    "force": "make the movement smaller or slower",
    "voltage": "lower the excitation or make the movement smaller or slower",
    "current": "lower the excitation or make the movement smaller or slower",
}


@dataclass(frozen=True)
class Limits:
    """Largest absolute values allowed, SI; infinite where there is no limit."""

    travel_m: float = math.inf
    velocity_m_s: float = math.inf
    acceleration_m_s2: float = math.inf
    jerk_m_s3: float = math.inf
    force_n: float = math.inf
    voltage_v: float = math.inf
    current_a: float = math.inf

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any]) -> Limits:
        """Return the limits in a mapping of `LIMIT_PARAMETERS`; zero or absent means no limit."""
        return cls(**{each.name: float(values.get(each.name, 0.0)) or math.inf
                      for each in fields(cls)})

    @property
    def need_a_model(self) -> bool:
        """Whether force or current is limited."""
        return math.isfinite(self.force_n) or math.isfinite(self.current_a)


@dataclass(frozen=True)
class Violation:
    """The first sample of a movement that leaves a limit."""

    quantity: str
    time_s: float
    value: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return (f"{self.quantity} of {self.value:.4g} {self.unit} at t = {self.time_s:.6g} s "
                f"exceeds the limit of {self.limit:.4g} {self.unit}")


Candidate = tuple[str, Array, float, str]


def check_limits(reference: Reference, limits: Limits,
                 base: Mapping[str, float] | None = None) -> Violation | None:
    """Return the earliest violation of `limits` by a reference, or None.

    Jumps count: the velocity compared is the larger of the stated one and the difference of
    positions over one sample, and likewise acceleration. Force is m a + c v + k x from `base`
    (mass, damping, stiffness as in a model.yaml; absent means zero), voltage is that force over
    force_constant, with back_emf v added; current is voltage less back_emf v, over
    coil_resistance.

    Raises
    ------
    LimitError
        If force, voltage or current is limited but `base` lacks what it takes to compute it.
    """
    candidates = _movement(reference, limits)
    if limits.need_a_model or math.isfinite(limits.voltage_v):
        force = _force(reference, base)
        candidates.append(("force", force, limits.force_n, "N"))
        if math.isfinite(limits.voltage_v) or math.isfinite(limits.current_a):
            candidates += _electric(force, reference.velocity, base or {}, limits, 0.0)
    return _earliest(candidates, reference.sample_period_s)


def check_run(reference: Reference, excitation: Excitation | None, limits: Limits,
              model: Model | None = None, *, open_loop: bool = False) -> Violation | None:
    """Return the earliest violation by all that is asked of one axis, or None.

    In a closed loop the excitation counts beside the input that the reference takes, as
    `check_limits` reckons it. In open loop the one-axis model says where the excitation drives the
    stage, how fast, and with what force and current. Without a model, the movement of the
    reference and the excitation's own voltage are checked.

    Raises
    ------
    LimitError
        If force or current is limited and there is no model, or it cannot say.
    """
    added = excitation.voltage if excitation is not None else np.zeros(reference.position.size)
    if model is None:
        if limits.need_a_model:
            what = "force_n" if math.isfinite(limits.force_n) else "current_a"
            raise LimitError(f"the limit {what} needs a model; name one or take the limit away")
        candidates = _movement(reference, limits)
        candidates.append(("voltage", added, limits.voltage_v, "V"))
    elif open_loop:
        candidates = _driven(added, limits, model)
    else:
        base = {**model.base, "drive": 1.0 if model.drive == "current" else 0.0}
        force = _force(reference, base) + base.get("force_constant", 0.0) * added
        candidates = [*_movement(reference, limits), ("force", force, limits.force_n, "N"),
                      *_electric(_force(reference, base), reference.velocity, base, limits,
                                 added)]
    return _earliest(candidates, reference.sample_period_s)


def require_run_within(reference: Reference, excitation: Excitation | None, limits: Limits,
                       model: Model | None = None, *, open_loop: bool = False,
                       where: str = "") -> None:
    """Raise LimitError naming the first violation of `check_run`, if there is one."""
    violation = check_run(reference, excitation, limits, model, open_loop=open_loop)
    if violation:
        raise LimitError(place(where, f"{violation}; {_REMEDIES[violation.quantity]}; it was not "
                                      "started"))


def _movement(reference: Reference, limits: Limits) -> list[Candidate]:
    dt = reference.sample_period_s
    x, v, a = reference.position, reference.velocity, reference.acceleration
    return [("position", x, limits.travel_m, "m"),
            ("velocity", _larger(v, np.diff(x, prepend=x[:1]) / dt), limits.velocity_m_s, "m/s"),
            ("acceleration", _larger(a, np.diff(v, prepend=v[:1]) / dt), limits.acceleration_m_s2,
             "m/s^2"),
            ("jerk", np.diff(a, prepend=a[:1]) / dt, limits.jerk_m_s3, "m/s^3")]


def _electric(force: Array, velocity: Array, base: Mapping[str, float], limits: Limits,
              added: Array | float) -> list[Candidate]:
    """Return voltage and current that a force takes, with an added voltage."""
    gain = base.get("force_constant", 0.0)
    if not gain > 0.0:
        raise LimitError("a voltage or current limit needs base.force_constant above zero; give "
                         "it or limit the force")
    emf = base.get("back_emf", 0.0) * velocity
    voltage = force / gain + emf + added
    out: list[Candidate] = [("voltage", voltage, limits.voltage_v, "V")]
    if math.isfinite(limits.current_a):
        _require_current(base, bool(base.get("drive")))
        current = voltage if base.get("drive") else (voltage - emf) / base["coil_resistance"]
        out.append(("current", current, limits.current_a, "A"))
    return out


def _require_current(base: Mapping[str, float], driven: bool) -> None:
    if not driven and not base.get("coil_resistance", 0.0) > 0.0:
        raise LimitError("a current limit needs base.coil_resistance or a current drive; give it "
                         "or limit the voltage")


def _driven(voltage: Array, limits: Limits, model: Model) -> list[Candidate]:
    """What the model says an excitation does to the stage in open loop, a neighbour at rest."""
    from dfm_stage.model import Simulator

    if math.isfinite(limits.current_a):
        _require_current(model.base, model.drive == "current")
    found = Simulator(uncoupled(model)).run(voltage)
    acceleration = np.diff(found.velocity, prepend=found.velocity[:1]) / model.sample_period
    return [("position", found.position, limits.travel_m, "m"),
            ("velocity", found.velocity, limits.velocity_m_s, "m/s"),
            ("acceleration", acceleration, limits.acceleration_m_s2, "m/s^2"),
            ("force", found.force, limits.force_n, "N"),
            ("voltage", voltage, limits.voltage_v, "V"),
            ("current", found.current, limits.current_a, "A")]


def uncoupled(model: Model) -> Model:
    """Return a one-axis model without what the motion of its neighbour does to it."""
    return replace(model, effects=tuple(use for use in model.effects
                                        if not use.effect.couples))


def _larger(stated: Array, difference: Array) -> Array:
    return np.where(np.abs(difference) > np.abs(stated), difference, stated)


def _force(reference: Reference, base: Mapping[str, float] | None) -> Array:
    if not base or "mass" not in base:
        raise LimitError("a limit of force, voltage or current needs the model's base with its "
                         "mass")
    return np.asarray(base["mass"] * reference.acceleration
                      + base.get("damping", 0.0) * reference.velocity
                      + base.get("stiffness", 0.0) * reference.position)


def _earliest(candidates: list[Candidate], dt: float) -> Violation | None:
    return min(filter(None, (_first(*each, dt) for each in candidates)),
               key=lambda each: each.time_s, default=None)


def _first(quantity: str, values: Array, limit: float, unit: str, dt: float) -> Violation | None:
    beyond = ~(np.abs(values) <= limit * (1.0 + 1e-9))
    if not beyond.any():
        return None
    k = int(np.argmax(beyond))
    return Violation(quantity, k * dt, float(values[k]), limit, unit)
