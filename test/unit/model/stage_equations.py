"""The stage's equations written down a second time, for integrators that know nothing of ours."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp


class Equations:
    """dx/dt of one axis with any smooth effects; parameters by address, absent means off."""

    def __init__(self, given: dict[str, float]) -> None:
        self.p = given

    def get(self, name: str, default: float = 0.0) -> float:
        return self.p.get(name, default)

    def start(self) -> np.ndarray:
        """[q1, q1', q2, q2', amplifier, second lag, coil, creep]"""
        return np.zeros(8)

    def point(self, y: np.ndarray) -> tuple[float, float]:
        share = self.get("second_mode.share")
        return (1 - share) * y[0] + share * y[2], (1 - share) * y[1] + share * y[3]

    def drive(self, y: np.ndarray, u: float) -> float:
        g = self.get
        signal = y[4] if g("amplifier_time_constant") else u
        signal = y[5] if g("amplifier_bandwidth.time_constant") else signal
        inductance = g("coil_inductance") + g("coil_inductance.inductance")
        if inductance:
            return y[6]
        return signal - (g("back_emf") + g("back_emf.constant")) * self.point(y)[1]

    def force(self, y: np.ndarray, u: float, t: float, other: float = 0.0) -> float:
        """Sum of the forces at the point, N, the modes' own springs and dampers left out."""
        g = self.get
        x, v = self.point(y)
        actuator = self.p["force_constant"] * self.drive(y, u) * (
            1 + g("force_constant_slope.slope") * x - g("force_constant_droop.droop") * x**2)
        total = actuator + g("force_offset.force")
        total -= g("cubic_stiffness.k3") * x**3 + g("quadratic_stiffness.k2") * x**2
        total -= g("quadratic_damping.coefficient") * abs(v) * v
        total -= g("creep.stiffness") * (x - y[7])
        total -= (g("eddy_current_damping.damping") * v
                  / (1 + (v / g("eddy_current_damping.critical_velocity", 1.0))**2))
        total += g("periodic_disturbance.amplitude") * math.sin(
            2 * math.pi * g("periodic_disturbance.frequency") * t
            + g("periodic_disturbance.phase"))
        return total - g("cross_axis_coupling.stiffness") * other

    def rates(self, t: float, y: np.ndarray, u: float, extra: float = 0.0) -> np.ndarray:
        g = self.get
        m = self.p["mass"]
        f = self.force(y, u, t) + extra
        x, v = self.point(y)
        w = 2 * math.pi * g("second_mode.frequency")
        signal = y[4] if g("amplifier_time_constant") else u
        final = y[5] if g("amplifier_bandwidth.time_constant") else signal
        inductance = g("coil_inductance") + g("coil_inductance.inductance")
        emf = g("back_emf") + g("back_emf.constant")

        def lag(value: float, target: float, tau: float) -> float:
            return (target - value) / tau if tau else 0.0

        return np.array([
            y[1], (f - g("damping") * y[1] - g("stiffness") * y[0]) / m,
            y[3], f / m - 2 * g("second_mode.damping_ratio") * w * y[3] - w * w * y[2],
            lag(y[4], u, g("amplifier_time_constant")),
            lag(y[5], signal, g("amplifier_bandwidth.time_constant")),
            (final - emf * v - y[6]) * g("coil_resistance") / inductance if inductance else 0.0,
            lag(y[7], x, g("creep.time_constant")),
        ])


def hold_segments(inputs: np.ndarray, period: float, delay: float,
                  limit: float = math.inf) -> list[list[tuple[float, float, float]]]:
    """For each sample the pieces (begin, end, input) in absolute time."""
    whole = math.floor(delay / period + 1e-9)
    part = delay - whole * period
    pieces = []
    for k in range(len(inputs)):
        def command(i: int) -> float:
            return float(np.clip(inputs[i], -limit, limit)) if i >= 0 else 0.0
        t = k * period
        now = [(t, t + part, command(k - whole - 1))] if part > 1e-12 else []
        pieces.append([*now, (t + part, t + period, command(k - whole))])
    return pieces


def integrate(given: dict[str, float], inputs: np.ndarray, period: float,
              outside: np.ndarray | None = None) -> tuple[np.ndarray, Equations]:
    """States (N, 8) at t_k by DOP853, restarted wherever the input jumps."""
    equations = Equations(given)
    delay = given.get("delay", 0.0) + given.get("transport_delay.delay", 0.0)
    limit = given.get("saturation.limit", math.inf)
    y, states = equations.start(), []
    for k, pieces in enumerate(hold_segments(inputs, period, delay, limit)):
        states.append(y)
        extra = 0.0 if outside is None else float(outside[k])
        for begin, end, u in pieces:
            y = solve_ivp(equations.rates, (begin, end), y, method="DOP853", args=(u, extra),
                          rtol=1e-10, atol=1e-16).y[:, -1]
    return np.array(states), equations
