"""How each effect is drawn: its fixed parameters, and the one that its severity scales."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.stage import Stage, log_uniform

Parameters = dict[str, float]


@dataclass(frozen=True)
class Draw:
    """`of(scale)` gives the effect's parameters by their documented names; `scale` 1 is a first
    guess for a severity of about ten, and the severity grows with it."""

    name: str
    of: Callable[[float], Parameters]


def draw(name: str, rng: np.random.Generator, stage: Stage, motion: Any, command: Any) -> Draw:
    """Draw effect `name` for a stage; motion (m) and command (V) of the largest training run."""
    base, noise = stage.base, stage.noise
    rms = float(np.sqrt(np.mean(motion**2)))
    speed = float(np.sqrt(np.mean(np.gradient(motion, 1e-3) ** 2)))
    size = 10.0 * noise
    sign = float(rng.choice([-1.0, 1.0]))
    k, m = base["stiffness"], base["mass"]
    omega = math.sqrt(k / m)
    zeta = base["damping"] / (2.0 * m * omega)
    force = size * k * max(2.0 * zeta, 0.02)  # what moves the resonant stage by `size`
    phase = rng.uniform(-3.0, 3.0)
    u = [float(v) for v in rng.random(6)]

    def between(i: int, low: float, high: float) -> float:
        return low * (high / low) ** u[i]

    def linear(**shape: tuple[float, float]) -> Draw:
        """Each parameter is value * scale ** power."""
        return Draw(name, lambda s: {n: v * s**power for n, (v, power) in shape.items()})

    slip, bend = between(0, 0.01, 0.2) * rms, between(0, 0.05, 0.5) * rms
    settle = between(0, 0.3, 5.0)
    lines = {
        "cubic_stiffness": lambda: linear(k3=(sign * force / rms**3, 1)),
        "quadratic_stiffness": lambda: linear(k2=(sign * force / rms**2, 1)),
        "coulomb_friction": lambda: linear(force=(force, 1)),
        "presliding_friction": lambda: linear(
            force=(force, 1), stiffness=(force / slip, 1),
            breakaway_ratio=(1.0 + 0.5 * u[1], 0),
            stribeck_velocity=(between(2, 0.05, 0.5) * speed, 0),
            damping=(u[3] * 0.1 * force / speed, 1)),
        "hysteresis": lambda: linear(
            stiffness=(force / bend, 1), yield_displacement=(bend, 0),
            shape=(0.5 + 0.5 * u[1], 0), exponent=(1.0 + u[2], 0)),
        "quadratic_damping": lambda: linear(coefficient=(force / speed**2, 1)),
        "force_offset": lambda: linear(force=(sign * size * k, 1)),
        "amplifier_bandwidth": lambda: linear(time_constant=(size / speed, 1)),
        "transport_delay": lambda: linear(delay=(size / speed, 1)),
        "saturation": lambda: Draw(name, _limits(command)),
        "back_emf": lambda: linear(constant=(force / speed / base["force_constant"], 1)),
        "coil_inductance": lambda: linear(
            inductance=(size / speed * base["coil_resistance"], 1)),
        "force_constant_slope": lambda: linear(slope=(sign * force / (k * rms**2), 1)),
        "force_constant_droop": lambda: linear(droop=(sign * force / (k * rms**3), 1)),
        "second_mode": lambda: linear(
            share=(force / (k * rms), 1), damping_ratio=(between(1, 0.003, 0.05), 0),
            frequency=(between(0, 1.6 * omega / (2.0 * math.pi), 120.0), 0)),
        "cross_axis_coupling": lambda: linear(
            ratio=(sign * size / rms, 1), stiffness=(phase * k * size / rms * (u[0] < 0.5), 1)),
        "encoder_quantization": lambda: linear(step=(math.sqrt(12.0) * size, 1)),
        "encoder_periodic_error": lambda: linear(
            amplitude=(math.sqrt(2.0) * size, 1), phase=(phase, 0),
            period=(between(0, max(4e-6, 0.02 * rms), 0.7 * rms), 0)),
        "creep": lambda: linear(stiffness=(k * size / rms, 1), time_constant=(settle, 0)),
        "thermal_drift": lambda: linear(
            rate=(sign * size / 7.0, 1), decay=(0.0 if u[0] < 0.3 else between(1, 0.02, 0.3), 0)),
        "periodic_disturbance": lambda: linear(
            amplitude=(_moving(base, between(0, 3.0, 150.0), size), 1),
            frequency=(between(0, 3.0, 150.0), 0), phase=(phase, 0)),
        "eddy_current_damping": lambda: linear(
            damping=(force / speed, 1), critical_velocity=(between(0, 0.3, 2.0) * speed, 0)),
    }
    return lines[name]()


def _limits(command: Any) -> Callable[[float], Parameters]:
    """A limit that a share of the commands, 1 % at scale 1, exceeds."""
    ordered = np.sort(np.abs(command))

    def of(scale: float) -> Parameters:
        share = min(0.01 * scale, 0.9)
        return {"limit": float(np.interp(1.0 - share, np.linspace(0.0, 1.0, ordered.size),
                                         ordered))}

    return of


def _moving(base: dict[str, float], hertz: float, rms: float) -> float:
    """Amplitude (N) of a force that moves the linear stage by `rms` at a frequency."""
    w = 2.0 * math.pi * hertz
    return math.sqrt(2.0) * rms * abs(base["stiffness"] - base["mass"] * w * w
                                      + 1j * w * base["damping"])


PLANT_NAMES = {
    "cubic_stiffness": {"k3": "k3"}, "quadratic_stiffness": {"k2": "k2"},
    "coulomb_friction": {"force": "coulomb"},
    "presliding_friction": {"force": "lugre_force", "stiffness": "lugre_stiffness",
                            "breakaway_ratio": "lugre_ratio", "stribeck_velocity": "lugre_speed",
                            "damping": "lugre_damping"},
    "hysteresis": {"stiffness": "wen_stiffness", "yield_displacement": "wen_yield",
                   "shape": "wen_shape", "exponent": "wen_exponent"},
    "quadratic_damping": {"coefficient": "drag"}, "force_offset": {"force": "offset"},
    "amplifier_bandwidth": {"time_constant": "second_lag"}, "transport_delay": {"delay": "delay"},
    "saturation": {"limit": "limit"}, "back_emf": {"constant": "emf"},
    "coil_inductance": {"inductance": "inductance"}, "force_constant_slope": {"slope": "slope"},
    "force_constant_droop": {"droop": "droop"},
    "second_mode": {"share": "share", "frequency": "mode_hz", "damping_ratio": "mode_zeta"},
    "cross_axis_coupling": {"ratio": "other_ratio", "stiffness": "other_stiffness"},
    "encoder_quantization": {"step": "step"},
    "encoder_periodic_error": {"amplitude": "ripple", "period": "ripple_period",
                               "phase": "ripple_phase"},
    "creep": {"stiffness": "creep_stiffness", "time_constant": "creep_time"},
    "thermal_drift": {"rate": "drift_rate", "decay": "drift_decay"},
    "periodic_disturbance": {"amplitude": "shake", "frequency": "shake_hz",
                             "phase": "shake_phase"},
    "eddy_current_damping": {"damping": "eddy", "critical_velocity": "eddy_speed"}}

BASE_NAMES = {"mass": "mass", "damping": "damping", "stiffness": "stiffness",
              "force_constant": "force_constant", "amplifier_time_constant": "lag",
              "delay": "delay", "coil_resistance": "resistance", "coil_inductance": "inductance",
              "back_emf": "emf", "encoder_zero": "zero", "encoder_resolution": "resolution"}


def plant_values(base: dict[str, float], effects: dict[str, Parameters]) -> dict[str, float]:
    """The plant's fields of base parameters and effects; what stands twice is added."""
    values: dict[str, float] = {}
    pairs = [(BASE_NAMES[n], v) for n, v in base.items() if n in BASE_NAMES]
    for name, parameters in effects.items():
        theirs = PLANT_NAMES.get(name, {})  # the uncommon ones are called as in the documents
        pairs += [(theirs.get(n, f"{name}.{n}"), v) for n, v in parameters.items()]
    for field, value in pairs:
        values[field] = values.get(field, 0.0) + value
    return values


__all__ = ["Draw", "draw", "log_uniform", "plant_values"]
