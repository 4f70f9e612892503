"""The linear stage at its samples, by matrix exponentials; no part of it is in `plant`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numba import njit
from scipy.linalg import expm


def system(base: Mapping[str, float]) -> tuple[Any, Any]:
    """A (n, n) and B (n,) of position, velocity and, where they are, amplifier and coil."""
    lag = base.get("amplifier_time_constant", 0.0)
    resistance = base.get("coil_resistance", 0.0)
    settling = base.get("coil_inductance", 0.0) / resistance if resistance > 0.0 else 0.0
    emf, force = base.get("back_emf", 0.0), base["force_constant"] / base["mass"]
    n = 2 + int(lag > 0.0) + int(settling > 0.0)
    a, b = np.zeros((n, n)), np.zeros(n)
    a[0, 1] = 1.0
    a[1, 0] = -base.get("stiffness", 0.0) / base["mass"]
    a[1, 1] = -base.get("damping", 0.0) / base["mass"]
    drive, feed = np.zeros(n), 1.0
    if lag > 0.0:
        a[2, 2], b[2] = -1.0 / lag, 1.0 / lag
        drive[2], feed = 1.0, 0.0
    drive[1] = -emf
    if settling > 0.0:
        a[-1] = drive / settling
        a[-1, -1] -= 1.0 / settling
        b[-1] = feed / settling
        drive, feed = np.zeros(n), 0.0
        drive[-1] = 1.0
    a[1] += force * drive
    b[1] = force * feed
    return a, b


def discrete(base: Mapping[str, float], period: float) -> tuple[Any, Any, Any, int]:
    """Phi (n, n), what commands k - D - 1 and k - D add (n,) each, and D."""
    a, b = system(base)
    delay = base.get("delay", 0.0)
    whole = math.floor(delay / period + 1e-12)
    late = max(delay - whole * period, 0.0)

    def held(length: float) -> tuple[Any, Any]:
        block = np.zeros((len(b) + 1, len(b) + 1))
        block[:-1, :-1], block[:-1, -1] = a * length, b * length
        step = expm(block)
        return step[:-1, :-1], step[:-1, -1]

    early, pulse = held(late)
    rest, now = held(period - late)
    return rest @ early, rest @ pulse, now, whole


@njit(cache=True)
def _march(phi: Any, before: Any, now: Any, whole: int, command: Any, start: Any, past: float,
           out: Any) -> None:
    x, after = start.copy(), start.copy()
    n = x.size
    for k in range(command.size):
        out[k] = x[0]
        old = command[k - whole - 1] if k > whole else past
        new = command[k - whole] if k >= whole else past
        for i in range(n):
            total = before[i] * old + now[i] * new
            for j in range(n):
                total += phi[i, j] * x[j]
            after[i] = total
        x[:] = after


def response(base: Mapping[str, float], period: float, command: Any,
             start: Sequence[float] = (0.0, 0.0), past: float = 0.0) -> Any:
    """Position (N,) for the held command; `start` are the first states, the rest are zero."""
    phi, before, now, whole = discrete(base, period)
    first = np.zeros(len(now))
    first[:len(start)] = start
    out = np.empty(len(command))
    _march(phi, before, now, whole, np.ascontiguousarray(command), first, past, out)
    return out


def transfer(base: Mapping[str, float], period: float, hertz: Any) -> Any:
    """Complex gain (m/V) from command samples to position samples at frequencies in Hz."""
    phi, before, now, whole = discrete(base, period)
    z = np.exp(2j * math.pi * np.asarray(hertz, dtype=float) * period)
    eye = np.eye(len(now))
    return np.array([np.linalg.solve(q * eye - phi, before * q ** (-whole - 1.0)
                                     + now * q ** float(-whole))[0] for q in z])


def sensitivities(base: Mapping[str, float], free: Sequence[str], period: float,
                  command: Any) -> tuple[Any, Any]:
    """The response from rest (N,), and a column per free parameter, and per first state and
    offset, (N, P + 3)."""
    centre = response(base, period, command)
    columns = []
    for name in free:
        step = 1e-4 * base[name]
        up, down = dict(base), dict(base)
        up[name] += step
        down[name] -= step
        columns.append((response(up, period, command) - response(down, period, command))
                       / (2.0 * step))
    zero = np.zeros(len(command))
    columns += [response(base, period, zero, start) for start in ((1.0, 0.0), (0.0, 1.0))]
    columns.append(np.ones(len(command)))
    return centre, np.column_stack(columns)
