"""Free decay: logarithmic decrement, damping ratio and natural frequency from the extremes.

Extreme i (counted by half cycles) of a damped swing about an offset lies at
x_i = o + (-1)^i A exp(-d i / 2), d the logarithmic decrement, so a least-squares line through
their logarithms, or as here the curve through the extremes themselves, uses all n cycles where
d = ln(X_0 / X_n) / n (Eq. 1 of the paper) uses two of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.quantity import Quantity, interval, propagate


def damping_ratio(decrement: float) -> float:
    """Return zeta = d / sqrt(4 pi^2 + d^2), the standard relation."""
    return decrement / math.sqrt(4.0 * math.pi**2 + decrement**2)


def damping_ratio_as_printed(decrement: float) -> float:
    """Return d / sqrt(4 pi^2 - d^2), Eq. 2 as the paper prints it (the sign is wrong)."""
    return decrement / math.sqrt(4.0 * math.pi**2 - decrement**2)


@dataclass(frozen=True)
class RingDown:
    """What a free decay shows.

    Attributes
    ----------
    decrement : logarithmic decrement per cycle
    damping : damping ratio by the standard relation; `damping_as_printed` by the paper's Eq. 2
    natural_frequency : undamped, rad/s
    offset : where it comes to rest, m
    two_point : ln(X_0 / X_n) / n between the first and the last extreme of one side
    early, late : decrement of the first and of the second half of the extremes; equal where the
        damping is viscous, rising where friction is
    cycles : n, between the first and the last extreme
    time_s, extreme_m : (E,) extremes; time counts from the release
    envelope_m : (E,) the fitted curve's distance from the offset there
    release : sample at which the stage was let go
    """

    decrement: Quantity
    damping: Quantity
    damping_as_printed: Quantity
    natural_frequency: Quantity
    offset: Quantity
    two_point: float
    early: Quantity
    late: Quantity
    cycles: float
    time_s: Array
    extreme_m: Array
    envelope_m: Array
    release: int

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        named = {name: getattr(self, name).to_dict() for name in (
            "decrement", "damping", "damping_as_printed", "natural_frequency", "offset", "early",
            "late")}
        return {**named, "two_point_decrement": self.two_point, "cycles": self.cycles}


def ring_down(position: Array, sample_period: float, *, input_: Array | None = None,
              release: int | None = None, cycles: int | None = None,
              smallest: float = 0.01) -> RingDown:
    """Analyse the decay of `position` (N,) after `release`, or after the last change of `input_`.

    Extremes are used down to `smallest` of the first one or ten times the noise, or for `cycles`
    whole cycles.

    Raises
    ------
    IdentificationError
        If nothing says where the release is, or fewer than three cycles swing out after it.
    """
    y = np.asarray(position, dtype=float)
    if release is None:
        changes = np.flatnonzero(np.diff(input_)) if input_ is not None else np.empty(0, int)
        if not changes.size:
            raise IdentificationError("the input never changes, so there is no release: hold a "
                                      "voltage and take it away")
        release = int(changes[-1]) + 1
    free = y[release:]
    time, value = _extremes(free, sample_period)
    noise = float(np.std(np.diff(free, 2))) / math.sqrt(6.0)
    size = np.abs(np.diff(value)) / 2.0
    if size.size:
        small = np.flatnonzero(size < max(smallest * size[0], 10.0 * noise))
        last = int(small[0]) + 1 if small.size else value.size
        last = min(last, 2 * cycles + 1) if cycles is not None else last
        time, value = time[:last], value[:last]
    if value.size < 7:
        raise IdentificationError(f"only {value.size} extremes stand out after the release at "
                                  f"{release * sample_period:g} s: deflect more or record longer")
    values, covariance = _fit(value)
    dof = value.size - 3
    decrement = propagate(lambda v: float(v[2]), values, covariance, "", dof)
    ratio = propagate(lambda v: damping_ratio(float(v[2])), values, covariance, "", dof)
    printed = propagate(lambda v: damping_ratio_as_printed(float(v[2])), values, covariance, "",
                        dof)
    half = value.size // 2
    cycles_used = 0.5 * (value.size - 1)
    whole = 2 * ((value.size - 1) // 2)
    apart = (value[0] - values[0]) / (value[whole] - values[0])
    return RingDown(
        decrement, ratio, printed, _natural_frequency(time, np.abs(value - values[0]), ratio),
        propagate(lambda v: float(v[0]), values, covariance, "m", dof),
        2.0 / whole * math.log(abs(apart)), _part(value[:half + 1], values[0]),
        _part(value[half:], values[0]), cycles_used, time, value,
        np.asarray(np.abs(_curve(values, value.size) - values[0])), release)


def _extremes(free: Array, sample_period: float) -> tuple[Array, Array]:
    """Return time and height of every extreme, each from a quartic through its surroundings."""
    tail = free[free.size // 2:]
    weight = np.hanning(tail.size)
    around = free - float(weight @ tail / weight.sum())
    noise = float(np.std(np.diff(free, 2))) / math.sqrt(6.0)
    # A crossing counts when the swing left the noise since the one before.
    sign = np.where(np.abs(around) > 5.0 * noise, np.sign(around), 0.0)
    known = np.flatnonzero(sign)
    turns = known[1:][np.diff(sign[known]) != 0.0]
    if turns.size < 3:
        return np.empty(0), np.empty(0)
    half = float(np.median(np.diff(turns)))
    reach = max(round(0.2 * half), 3)
    time, value = [], []
    for start, stop in zip(turns[:-1].tolist(), turns[1:].tolist(), strict=True):
        at = start + int(np.argmax(np.abs(around[start:stop])))
        if at < reach or at + reach >= free.size or not 0.5 * half < stop - start < 2.0 * half:
            continue
        u = np.arange(-reach, reach + 1) / reach
        fit = np.polynomial.Polynomial.fit(u, free[at - reach:at + reach + 1], 4,
                                           domain=[-1, 1], window=[-1, 1])
        roots = fit.deriv().roots()
        real = roots.real[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) <= 1.0)]
        top = float(real[np.argmin(np.abs(real))]) if real.size else 0.0
        time.append((at + top * reach) * sample_period)
        value.append(float(fit(top)))
    return np.array(time), np.array(value)


def _curve(values: Array, count: int) -> Array:
    i = np.arange(count)
    return np.asarray(values[0] + (-1.0)**i * values[1] * np.exp(-0.5 * values[2] * i))


def _fit(extreme: Array) -> tuple[Array, Array]:
    """Fit offset, first amplitude and decrement; covariance from what is left over."""
    size = np.abs(np.diff(extreme))
    slope = np.polyfit(np.arange(size.size), np.log(np.maximum(size, 1e-300)), 1)[0]
    offset = float(np.mean(0.5 * (extreme[1:] + extreme[:-1])[-4:]))
    first = float(extreme[0]) - offset
    start = np.array([offset, first, max(-2.0 * slope, 1e-6)])
    scale = np.array([abs(first), abs(first), 1.0])
    found = least_squares(lambda v: (_curve(v * scale, extreme.size) - extreme) / abs(first),
                          start / scale, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    variance = 2.0 * float(found.cost) / max(extreme.size - 3, 1)
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac) * np.outer(scale, scale)
    return np.asarray(found.x * scale), np.asarray(covariance)


def _part(extreme: Array, offset: float) -> Quantity:
    """Return the decrement of some extremes about a known offset, by a line through the logs."""
    count = extreme.size
    height = np.log(np.maximum(np.abs(extreme - offset), 1e-300))
    design = np.column_stack((np.arange(count), np.ones(count)))
    line, *_ = np.linalg.lstsq(design, height, rcond=None)
    rest = height - design @ line
    variance = float(rest @ rest) / max(count - 2, 1)
    error = math.sqrt(variance * np.linalg.inv(design.T @ design)[0, 0])
    value = -2.0 * float(line[0])
    return Quantity(value, "", interval(value, 2.0 * error, max(count - 2, 1)))


def _natural_frequency(time: Array, size: Array, ratio: Quantity) -> Quantity:
    """Return the undamped frequency from the times of the extremes, half a period apart.

    The smaller an extreme, the less sure its time: each counts with its `size`.
    """
    count = time.size
    design = np.column_stack((np.arange(count), np.ones(count))) * size[:, None]
    line, *_ = np.linalg.lstsq(design, time * size, rcond=None)
    rest = time * size - design @ line
    dof = count - 2
    error = math.sqrt(float(rest @ rest) / dof * np.linalg.inv(design.T @ design)[0, 0])
    half = float(line[0])
    root = math.sqrt(1.0 - ratio.value**2)
    value = math.pi / half / root
    from_ratio = value * ratio.value / root**2 * ratio.half_width / 2.0
    return Quantity(value, "rad/s", interval(value, math.hypot(value * error / half, from_ratio),
                                             dof))
