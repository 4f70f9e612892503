"""Free decay: logarithmic decrement, damping ratio and natural frequency from the extremes.

Extreme i (counted by half cycles) of a damped swing about an offset lies at
x_i = o + (-1)^i A exp(-d i / 2), d the logarithmic decrement, so a least-squares line through
their logarithms, or as here the curve through the extremes themselves, uses all n cycles where
d = ln(X_0 / X_n) / n (Eq. 1 of the paper) uses two of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from dfm_stage.arrays import Array
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.fitting import fit_line, noise_level, turning_point
from dfm_stage.identification.quantity import Quantity, interval, propagate

FEWEST_CROSSINGS = 3
"""Of the resting place: two half cycles, to know how long one is."""
FEWEST_EXTREMES = 7
"""Three whole cycles: of fewer, the three coefficients of the decay leave too little over."""
OVER_NOISE = 10.0
"""An extreme is used while it is this many times the noise: its height is then good to 10 %."""
CROSSES = 5.0
"""Times the noise that the position leaves the resting place by between two crossings of it."""
REACH = 0.2
"""Share of half a cycle, on either side, through which the quartic of an extreme is laid."""
EVEN_SPACING = (0.5, 2.0)
"""Half cycles shorter or longer than this, against their median, are no swing of the stage."""
PRECISION = 1e-15
"""Of the search for the decay: to the last digit, as the problem is small."""


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
    size = np.abs(np.diff(value)) / 2.0
    if size.size:
        small = np.flatnonzero(size < max(smallest * size[0], OVER_NOISE * noise_level(free)))
        last = int(small[0]) + 1 if small.size else value.size
        last = min(last, 2 * cycles + 1) if cycles is not None else last
        time, value = time[:last], value[:last]
    if value.size < FEWEST_EXTREMES:
        raise IdentificationError(f"only {value.size} extremes stand out after the release at "
                                  f"{release * sample_period:g} s: deflect more or record longer")
    values, covariance = _fit(value)
    dof = value.size - 3

    def of(function: Callable[[Array], float], unit: str = "") -> Quantity:
        return propagate(function, values, covariance, unit, dof)

    ratio = of(lambda v: damping_ratio(float(v[2])))
    half = value.size // 2
    whole = 2 * ((value.size - 1) // 2)
    apart = (value[0] - values[0]) / (value[whole] - values[0])
    return RingDown(
        of(lambda v: float(v[2])), ratio, of(lambda v: damping_ratio_as_printed(float(v[2]))),
        _natural_frequency(time, np.abs(value - values[0]), ratio), of(lambda v: float(v[0]), "m"),
        2.0 / whole * math.log(abs(apart)), _part(value[:half + 1], values[0]),
        _part(value[half:], values[0]), 0.5 * (value.size - 1), time, value,
        np.asarray(np.abs(_curve(values, value.size) - values[0])), release)


def _extremes(free: Array, sample_period: float) -> tuple[Array, Array]:
    """Return time and height of every extreme, each from a quartic through its surroundings."""
    tail = free[free.size // 2:]
    weight = np.hanning(tail.size)
    around = free - float(weight @ tail / weight.sum())
    # A crossing counts when the swing left the noise since the one before.
    sign = np.where(np.abs(around) > CROSSES * noise_level(free), np.sign(around), 0.0)
    known = np.flatnonzero(sign)
    turns = known[1:][np.diff(sign[known]) != 0.0]
    if turns.size < FEWEST_CROSSINGS:
        return np.empty(0), np.empty(0)
    half = float(np.median(np.diff(turns)))
    short, long = (share * half for share in EVEN_SPACING)
    reach = max(round(REACH * half), 3)
    time, value = [], []
    for start, stop in zip(turns[:-1].tolist(), turns[1:].tolist(), strict=True):
        at = start + int(np.argmax(np.abs(around[start:stop])))
        if reach <= at < free.size - reach and short < stop - start < long:
            place, height = turning_point(free, at, reach)
            time.append(place * sample_period)
            value.append(height)
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
                          start / scale, xtol=PRECISION, ftol=PRECISION, gtol=PRECISION)
    variance = 2.0 * float(found.cost) / max(extreme.size - 3, 1)
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac) * np.outer(scale, scale)
    return np.asarray(found.x * scale), np.asarray(covariance)


def _part(extreme: Array, offset: float) -> Quantity:
    """Return the decrement of some extremes about a known offset, by a line through the logs."""
    count = extreme.size
    height = np.log(np.maximum(np.abs(extreme - offset), 1e-300))
    line, rest, inverse = fit_line(np.arange(count, dtype=float), height)
    error = math.sqrt(float(rest @ rest) / max(count - 2, 1) * inverse[0, 0])
    value = -2.0 * float(line[0])
    return Quantity(value, "", interval(value, 2.0 * error, max(count - 2, 1)))


def _natural_frequency(time: Array, size: Array, ratio: Quantity) -> Quantity:
    """Return the undamped frequency from the times of the extremes, half a period apart.

    The smaller an extreme, the less sure its time: each counts with its `size`.
    """
    line, rest, inverse = fit_line(np.arange(time.size, dtype=float), time, size)
    dof = time.size - 2
    error = math.sqrt(float(rest @ rest) / dof * inverse[0, 0])
    half = float(line[0])
    root = math.sqrt(1.0 - ratio.value**2)
    value = math.pi / half / root
    from_ratio = value * ratio.value / root**2 * ratio.half_width / 2.0
    return Quantity(value, "rad/s", interval(value, math.hypot(value * error / half, from_ratio),
                                             dof))
