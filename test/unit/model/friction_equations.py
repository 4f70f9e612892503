"""Stick and slip, LuGre and Bouc-Wen for references: SciPy with events, and very fine steps."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp
from stage_equations import Equations, hold_segments


def coulomb(given: dict[str, float], friction: float, inputs: np.ndarray, period: float,
            start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """States with Coulomb friction at the point, see `dry_friction`."""
    return dry_friction(given, lambda x, v, d: friction, inputs, period, start)


def dry_friction(given: dict[str, float], most, inputs: np.ndarray, period: float,
                 start: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """States (N, 21) with dry friction at the point, events located by SciPy.

    most(x, v, d) is the friction (N) at position, speed and actuator force. At a reversal the
    stage sticks when friction can hold it, and leaves when the other forces exceed the friction.
    One mode only.
    """
    equations = Equations(given)
    y = equations.start()
    y[0], y[1] = start
    mode = int(np.sign(start[1]))
    delay = given.get("delay", 0.0) + given.get("transport_delay.delay", 0.0)
    states = []

    def net(t: float, y: np.ndarray, u: float) -> float:
        return (equations.force(y, u, t) - given.get("stiffness", 0.0) * y[0]
                - given.get("damping", 0.0) * y[1])

    def friction(y: np.ndarray, u: float) -> float:
        return most(y[0], abs(y[1]), given["force_constant"] * equations.drive(y, u))

    for pieces in hold_segments(inputs, period, delay):
        states.append(y)
        for begin, end, u in pieces:
            t = begin
            while t < end - 1e-15:
                if mode == 0:
                    push = net(t, y, u)
                    if abs(push) > friction(y, u) * (1 + 1e-12):
                        mode = 1 if push > 0 else -1
                        continue

                    def held(t: float, y: np.ndarray, u: float = u) -> np.ndarray:
                        rates = equations.rates(t, y, u)
                        rates[0] = rates[1] = 0.0
                        return rates

                    def breakaway(t: float, y: np.ndarray, u: float = u) -> float:
                        return abs(net(t, y, u)) - friction(y, u)

                    breakaway.terminal, breakaway.direction = True, 1
                    got = solve_ivp(held, (t, end), y, method="DOP853", rtol=1e-10, atol=1e-15,
                                    events=breakaway)
                    y, t = got.y[:, -1].copy(), got.t[-1]
                    if got.status == 1:
                        mode = 1 if net(t, y, u) > 0 else -1
                else:
                    def reversal(t: float, y: np.ndarray) -> float:
                        return y[1]

                    reversal.terminal, reversal.direction = True, -mode
                    got = solve_ivp(lambda t, y, u=u, m=mode: equations.rates(
                        t, y, u, -m * friction(y, u)), (t, end), y, method="DOP853", rtol=1e-10,
                        atol=1e-15, events=reversal)
                    y, t = got.y[:, -1].copy(), got.t[-1]
                    if got.status == 1:
                        y[1] = 0.0
                        push = net(t, y, u)
                        mode = 0 if abs(push) <= friction(y, u) else int(np.sign(push))
    return np.array(states)


def fine_steps(given: dict[str, float], inputs: np.ndarray, period: float, steps: int,
               rate, force, z0: float = 0.0) -> np.ndarray:
    """Positions (N,) by RK4 with `steps` steps a sample, no delay, one mode, static amplifier.

    rate(v, z) = dz/dt and force(v, z) in N are those of an internal state z.
    """
    m, c, k = given["mass"], given.get("damping", 0.0), given.get("stiffness", 0.0)
    x, v, z = 0.0, 0.0, z0
    h = period / steps
    out = []

    def rates(x: float, v: float, z: float, drive: float) -> tuple[float, float, float]:
        return v, (drive - c * v - k * x + force(v, z)) / m, rate(v, z)

    for u in inputs:
        out.append(x)
        drive = given["force_constant"] * u
        for _ in range(steps):
            a1, b1, c1 = rates(x, v, z, drive)
            a2, b2, c2 = rates(x + h / 2 * a1, v + h / 2 * b1, z + h / 2 * c1, drive)
            a3, b3, c3 = rates(x + h / 2 * a2, v + h / 2 * b2, z + h / 2 * c2, drive)
            a4, b4, c4 = rates(x + h * a3, v + h * b3, z + h * c3, drive)
            x += h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
            v += h / 6 * (b1 + 2 * b2 + 2 * b3 + b4)
            z += h / 6 * (c1 + 2 * c2 + 2 * c3 + c4)
    return np.array(out)


def lugre(p: dict[str, float]):
    """rate(v, z), force(v, z) of the LuGre model."""
    def g(v: float) -> float:
        extra = p.get("breakaway_ratio", 1.0) - 1.0
        return p["force"] * (1 + extra * math.exp(-(v / p.get("stribeck_velocity", 1e-3))**2))

    def rate(v: float, z: float) -> float:
        return v - p["stiffness"] * abs(v) * z / g(v)

    def force(v: float, z: float) -> float:
        return -p["stiffness"] * z - p.get("damping", 0.0) * rate(v, z)
    return rate, force


def hardening(p: dict[str, float]):
    """rate(v, z), force(v, z) of a Bouc-Wen loop z' = v - beta |v| z + gamma v |z| that hardens;
    z in metres."""
    beta, gamma = p["shape"] / p["distance"], (1.0 + p["shape"]) / p["distance"]

    def rate(v: float, z: float) -> float:
        return v - beta * abs(v) * z + gamma * v * abs(z)

    def force(v: float, z: float) -> float:
        return -p["stiffness"] * z
    return rate, force


def bouc_wen(p: dict[str, float]):
    """rate(v, z), force(v, z) with z in metres: z = yield_displacement w."""
    d, sigma, n = p["yield_displacement"], p.get("shape", 0.5), p.get("exponent", 1.0)

    def rate(v: float, z: float) -> float:
        w = z / d
        return v * (1 - abs(w)**n * (sigma * math.copysign(1.0, v * w) + 1 - sigma))

    def force(v: float, z: float) -> float:
        return -p["stiffness"] * z
    return rate, force
