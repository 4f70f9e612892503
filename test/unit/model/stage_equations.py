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
        """[q1, q1', q2, q2', amplifier, second lag, coil, creep, supply's load, heat, lagged
        reading, reading on a mount and its rate, eight strains]"""
        return np.zeros(21)

    def reading(self, y: np.ndarray) -> float:
        if self.get("sensor_lag.time_constant"):
            return float(y[10])
        return float(y[11]) if self.get("sensor_mount.frequency") else self.point(y)[0]

    def contact(self, x: float, v: float) -> float:
        """Forces with kinks, N."""
        g = self.get
        k, slack = g("one_sided_cable.stiffness"), g("one_sided_cable.slack")
        total = -k * max(x - slack, 0) if k > 0 else abs(k) * max(slack - x, 0)
        k, c = g("end_stop.stiffness"), g("end_stop.dissipation")
        place = g("end_stop.position")
        if place > 0 and x > place:
            total -= k * (x - place) * max(1 + c * v, 0)
        if place < 0 and x < place:
            total += k * (place - x) * max(1 - c * v, 0)
        off, half = x - g("backlash.centre"), g("backlash.gap") / 2
        if abs(off) > half:
            total -= g("backlash.stiffness") * math.copysign(abs(off) - half, off)
        return total

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
        total -= g("gravity.weight") * math.sin(x / g("gravity.length", 1.0) + g("gravity.tilt"))
        total += g("cogging.amplitude") * math.sin(
            2 * math.pi * x / g("cogging.period", 1.0) + g("cogging.phase"))
        total -= g("directional_friction.difference") * math.hypot(v, 0.0)
        total -= g("stiffness_drift.rate") * t * x
        total += self.contact(x, v)
        loss = g("structural_damping.loss_stiffness") * 2 * math.log(5) / math.pi
        total -= loss * sum(x - z for z in y[13:])
        total += g("periodic_disturbance.amplitude") * math.sin(
            2 * math.pi * g("periodic_disturbance.frequency") * t
            + g("periodic_disturbance.phase"))
        return total - g("cross_axis_coupling.stiffness") * other

    def rates(self, t: float, y: np.ndarray, u: float, extra: float = 0.0) -> np.ndarray:
        g = self.get
        m = self.p["mass"]
        command = u
        u = u * (1 - g("supply_sag.sag") * y[8]) / (1 + y[9])
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
            lag(y[8], abs(command), g("supply_sag.time_constant")),
            lag(y[9], g("coil_heating.rise") * command * u, g("coil_heating.time_constant")),
            lag(y[10], x, g("sensor_lag.time_constant")),
            y[12], self.mounted(x, v, y),
            *(2 * math.pi * 0.02 * 5**i * (x - z) for i, z in enumerate(y[13:])),
        ])

    def mounted(self, x: float, v: float, y: np.ndarray) -> float:
        """Acceleration of what is read, on its mount."""
        w = 2 * math.pi * self.get("sensor_mount.frequency")
        zeta = self.get("sensor_mount.damping_ratio")
        return w * w * (x - y[11]) + 2 * zeta * w * (v - y[12])


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
    """States (N, 21) at t_k by DOP853, restarted wherever the input jumps."""
    equations = Equations(given)
    delay = given.get("delay", 0.0) + given.get("transport_delay.delay", 0.0)
    limit = given.get("saturation.limit", math.inf)
    y, states, level = equations.start(), [], 0.0
    for k, pieces in enumerate(hold_segments(inputs, period, delay, limit)):
        states.append(y)
        extra = 0.0 if outside is None else float(outside[k])
        for begin, end, u in pieces:
            for first, last, at, slope in slewed(begin, end, level, u,
                                                 given.get("slew_limit.rate", math.inf)):
                y = solve_ivp(lambda t, y, t0=first, at=at, slope=slope, extra=extra:
                              equations.rates(t, y, at + slope * (t - t0), extra),
                              (first, last), y, method="DOP853", rtol=1e-10, atol=1e-16).y[:, -1]
                level = at + slope * (last - first)
    return np.array(states), equations


def slewed(begin: float, end: float, level: float, u: float,
           rate: float) -> list[tuple[float, float, float, float]]:
    """Pieces (begin, end, input at the beginning, its slope) of an input that cannot jump."""
    arrived = begin + abs(u - level) / rate
    slope = math.copysign(rate, u - level)
    if arrived >= end:
        return [(begin, end, level, slope)]
    ramp = [(begin, arrived, level, slope)] if arrived > begin else []
    return [*ramp, (arrived, end, u, 0.0)]
