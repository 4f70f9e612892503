"""Does a movement stay within what the stage can do? Answered before it starts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from dfm_stage.trajectory.errors import LimitError
from dfm_stage.trajectory.kind import Array
from dfm_stage.trajectory.reference import Reference


@dataclass(frozen=True)
class Limits:
    """Largest absolute values allowed, SI; infinite where there is no limit."""

    travel_m: float = math.inf
    velocity_m_s: float = math.inf
    acceleration_m_s2: float = math.inf
    jerk_m_s3: float = math.inf
    force_n: float = math.inf
    voltage_v: float = math.inf


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


def check_limits(reference: Reference, limits: Limits,
                 base: Mapping[str, float] | None = None) -> Violation | None:
    """Return the earliest violation of `limits`, or None.

    Jumps count: the velocity compared is the larger of the stated one and the difference of
    positions over one sample, and likewise acceleration. Force is m a + c v + k x from `base`
    (mass, damping, stiffness as in a model.yaml; absent means zero), voltage is that force over
    force_constant.

    Raises
    ------
    LimitError
        If force or voltage is limited but `base` lacks what it takes to compute it.
    """
    dt = reference.sample_period_s
    x, v, a = reference.position, reference.velocity, reference.acceleration
    velocity = _larger(v, np.diff(x, prepend=x[:1]) / dt)
    acceleration = _larger(a, np.diff(v, prepend=v[:1]) / dt)
    candidates = [("position", x, limits.travel_m, "m"),
                  ("velocity", velocity, limits.velocity_m_s, "m/s"),
                  ("acceleration", acceleration, limits.acceleration_m_s2, "m/s^2"),
                  ("jerk", np.diff(a, prepend=a[:1]) / dt, limits.jerk_m_s3, "m/s^3")]
    if math.isfinite(limits.force_n) or math.isfinite(limits.voltage_v):
        force = _force(reference, base)
        candidates.append(("force", force, limits.force_n, "N"))
        if math.isfinite(limits.voltage_v):
            gain = (base or {}).get("force_constant", 0.0)
            if not gain > 0.0:
                raise LimitError("a voltage limit needs base.force_constant above zero; give it "
                                 "or limit the force")
            candidates.append(("voltage", force / gain, limits.voltage_v, "V"))
    found = [_first(*each, dt) for each in candidates]
    return min((each for each in found if each), key=lambda each: each.time_s, default=None)


def require_within(reference: Reference, limits: Limits,
                   base: Mapping[str, float] | None = None, where: str = "reference") -> None:
    """Raise LimitError naming the first violation, if there is one."""
    violation = check_limits(reference, limits, base)
    if violation:
        raise LimitError(f"{where}: {violation}; make the movement smaller or slower")


def _larger(stated: Array, difference: Array) -> Array:
    return np.where(np.abs(difference) > np.abs(stated), difference, stated)


def _force(reference: Reference, base: Mapping[str, float] | None) -> Array:
    if not base or "mass" not in base:
        raise LimitError("a force or voltage limit needs the model's base with its mass")
    return np.asarray(base["mass"] * reference.acceleration
                      + base.get("damping", 0.0) * reference.velocity
                      + base.get("stiffness", 0.0) * reference.position)


def _first(quantity: str, values: Array, limit: float, unit: str, dt: float) -> Violation | None:
    beyond = ~(np.abs(values) <= limit * (1.0 + 1e-9))
    if not beyond.any():
        return None
    k = int(np.argmax(beyond))
    return Violation(quantity, k * dt, float(values[k]), limit, unit)
