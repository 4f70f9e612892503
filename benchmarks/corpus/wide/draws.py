"""How each uncommon effect is drawn: its fixed parameters, and the one that severity scales."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.corpus.stage import Stage
from benchmarks.corpus.truth import Draw

STIFF_STOP = (4.0, 20.0)
"""Stiffness of a stop over the stage's; the documents call it a stop from 3 on."""
SOFT_CABLE = 2.0
"""Largest stiffness of a cable over the stage's."""
SWING = (1.2, 4.5)
"""Radians to either side of a pendulum: below a radian it is a spring, and two turns over the
travel are 2 pi."""
WAVES = (2.7, 12.0)
"""Periods of cogging over the travel; from two on it is cogging."""


def draw_uncommon(name: str, rng: np.random.Generator, stage: Stage, motion: Any,
                  command: Any) -> Draw:
    """Draw an uncommon effect for a stage; motion (m) and command (V) of the largest run."""
    base = stage.base
    x, v, u = (float(np.sqrt(np.mean(np.square(a)))) for a in (
        motion, np.gradient(motion, 1e-3), command))
    size, k = 10.0 * stage.noise, base["stiffness"]
    zeta = base["damping"] / (2.0 * math.sqrt(k * base["mass"]))
    force = size * k * max(2.0 * zeta, 0.02)  # what moves the resonant stage by `size`
    gain = force / (base["force_constant"] * u)  # and the part of the drive that does
    hertz = math.sqrt(k / base["mass"]) / (2.0 * math.pi)
    travel = float(np.ptp(motion))
    sign, phase = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-3.0, 3.0))
    w = [float(value) for value in rng.random(6)]

    def between(i: int, low: float, high: float) -> float:
        return low * (high / low) ** w[i]

    def linear(most: float = math.inf, **shape: tuple[float, float]) -> Draw:
        """Each parameter is value * scale ** power; one that grows ends at `most`."""
        return Draw(name, lambda s: {n: value if power == 0.0 else math.copysign(
            min(abs(value) * s**power, most), value) for n, (value, power) in shape.items()})

    stop = between(0, *STIFF_STOP) * k
    centre = 0.4 * (w[0] - 0.5) * x if w[1] < 0.5 else 0.0
    dissipation = 0.0 if w[2] < 0.5 else 10.0 ** (2.0 * w[1] - 1.0)
    lines: dict[str, Callable[[], Draw]] = {
        "dead_zone": lambda: linear(width=(gain * u, 1)),
        "slew_limit": lambda: _below(
            name, float(np.max(np.abs(np.diff(command)))) / 1e-3, "rate"),
        "supply_sag": lambda: linear(sag=(gain / u, 1), time_constant=(between(0, 0.01, 3.0), 0)),
        "coil_heating": lambda: linear(
            rise=(gain / u**2, 1), time_constant=(between(0, 0.5, 60.0), 0)),
        "end_stop": lambda: _below(name, float(np.max(sign * motion)), "position", sign,
                                   stiffness=stop, dissipation=dissipation),
        "backlash": lambda: linear(
            8.0 * k, stiffness=(force / x, 1), gap=(between(0, 0.6, 3.0) * x, 0),
            centre=(0.3 * (w[1] - 0.5) * x * (w[2] < 0.5), 0)),
        "stribeck_friction": lambda: linear(
            force=(force, 1), sliding_ratio=(0.3 + 0.5 * w[0], 0),
            stribeck_velocity=(between(1, 0.08, 1.0) * v, 0),
            exponent=(2.0 if w[2] < 0.5 else 0.8 + 1.6 * w[3], 0)),
        "directional_friction": lambda: linear(difference=(sign * force / v, 1)),
        "position_dependent_friction": lambda: linear(
            force=(force, 1), length=(between(0, 0.4, 1.5) * x, 0),
            centre=((2.0 * w[1] - 1.0) * x * (w[2] < 0.5), 0)),
        "load_dependent_friction": lambda: linear(
            force=(force, 1), load=(between(0, 0.1, 1.5) * base["force_constant"] * u, 0)),
        "cogging": lambda: linear(
            amplitude=(force, 1), period=(travel / between(0, *WAVES), 0), phase=(phase, 0)),
        "gravity": lambda: linear(
            weight=(force, 1), length=(0.5 * travel / between(0, *SWING), 0),
            tilt=(0.6 * (w[1] - 0.5) * (w[2] < 0.5), 0)),
        "one_sided_cable": lambda: linear(
            SOFT_CABLE * k, stiffness=(sign * force / x, 1),
            slack=((2.0 * w[0] - 1.0) * x, 0)),
        "structural_damping": lambda: linear(loss_stiffness=(force / x, 1)),
        "stiffness_drift": lambda: linear(rate=(sign * force / x / 8.0, 1)),
        "sensor_clipping": lambda: _below(
            name, float(np.max(np.abs(motion - centre))), "limit", centre=centre),
        "sensor_lag": lambda: linear(time_constant=(size / v, 1)),
        "sensor_mount": lambda: linear(
            frequency=(hertz * math.sqrt(x / size), -0.5),
            damping_ratio=(between(0, 0.003, 0.1), 0)),
        "hardening_hysteresis": lambda: linear(
            stiffness=(force / x, 1), distance=(between(0, 0.6, 3.0) * x, 0),
            shape=(between(1, 0.5, 5.0), 0)),
        "prandtl_ishlinskii": lambda: linear(
            1.0, weight=(gain, 1), range=(between(0, 0.4, 3.0) * u, 0)),
    }
    return lines[name]()


def _below(name: str, largest: float, parameter: str, sign: float = 1.0,
           **fixed: float) -> Draw:
    """A limit, with a sign, that comes down from the largest value as the scale grows."""
    return Draw(name, lambda s: {parameter: sign * largest / (1.0 + 0.05 * s), **fixed})


__all__ = ["draw_uncommon"]
