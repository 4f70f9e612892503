"""Coordinates in which a search is well conditioned, and the way back to physical parameters.

Amplifier lag tau and delay D act almost alike: exp(-s D) / (1 + tau s) depends on their sum to
first order and on tau^2 to second. They are searched as total = tau + D and share = (tau/total)^2,
in which the response is smooth and nearly linear even where one of them is zero, and in which
both stay positive inside a box. Effects may bring coordinates of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from dfm_stage.arrays import Array
from dfm_stage.identification.identifiability import Identifiability
from dfm_stage.identification.inference import limit_message
from dfm_stage.identification.quantity import t95
from dfm_stage.identification.result import Estimate
from dfm_stage.model import Model

BASE_LATE = {"amplifier_time_constant": "lag", "delay": "delay", "coil_inductance": "coil"}
"""Base parameters that make the force late, and how; see `Effect.late`."""
DRAWS, GENERATOR = 4093, 737
"""Draws, a prime number, from which the interval of a parameter searched in other coordinates is
taken; the generator of their lattice has the least error of covariances in 2 to 4 dimensions."""
LONGEST_LATENESS_S = 11.0
"""Limit of lag and delay together: the sum of their own limits."""


def late_parameters(model: Model, names: Sequence[str]) -> dict[str, str]:
    """Those free `names` that make the force late -> lag, delay or coil."""
    kinds = dict(BASE_LATE)
    for use in model.effects:
        effect = use.effect
        if effect.late is not None:
            kinds[f"{use.name}.{effect.parameters[0].name}"] = effect.late
    return {n: kinds[n] for n in names if n in kinds}


def lateness(model: Model, names: Sequence[str]) -> float:
    """Seconds by which parameters `names` make the force late, to first order."""
    per_second = {"coil": model.base.get("coil_resistance", 0.0)}
    values = model.parameters()
    return sum(values.get(n, 0.0) / per for n, kind in late_parameters(model, names).items()
               if (per := per_second.get(kind, 1.0)) > 0.0)


@dataclass(frozen=True)
class Coordinates:
    """`forward` takes values of `names` (n,) to those of `fitted` (n,), `backward` back.

    `low` and `high` bound the fitted values; `scale` is their size where a value is zero.
    """

    names: tuple[str, ...]
    fitted: tuple[str, ...]
    units: tuple[str, ...]
    forward: Callable[[Array], Array]
    backward: Callable[[Array], Array]
    low: Array
    high: Array
    scale: Array
    sum_and_share: bool = False


def group(model: Model, names: Sequence[str]) -> list[Coordinates]:
    """Return the coordinates of those free `names` that are not searched as they are."""
    groups: list[Coordinates] = []
    late = late_parameters(model, names)
    lags = [n for n, kind in late.items() if kind == "lag"]
    delays = [n for n, kind in late.items() if kind == "delay"]
    if len(lags) == len(delays) == 1:
        groups.append(_lag_and_delay(lags[0], delays[0], model.sample_period))
    taken = {n for g in groups for n in g.names}
    for use in model.effects:
        change = use.effect.coordinates
        if change is None or any(n not in names or n in taken for n in change.names):
            continue
        count = len(change.names)
        groups.append(Coordinates(
            change.names, change.fitted, ("",) * count, change.forward, change.backward,
            np.full(count, -np.inf), np.full(count, np.inf), np.ones(count)))
        taken.update(change.names)
    return groups


def _lag_and_delay(lag: str, delay: str, period: float) -> Coordinates:
    def forward(values: Array) -> Array:
        total = float(values[0] + values[1])
        return np.array([total, (values[0] / total) ** 2 if total > 0.0 else 0.25])

    def backward(fitted: Array) -> Array:
        part = fitted[0] * math.sqrt(max(fitted[1], 0.0))
        return np.array([part, fitted[0] - part])

    return Coordinates((lag, delay), (f"{lag} + {delay}", f"({lag} share)^2"), ("s", ""), forward,
                       backward, np.zeros(2), np.array([LONGEST_LATENESS_S, 1.0]),
                       np.array([period, 1.0]), True)


def to_physical(found: Estimate, groups: Sequence[Coordinates], model: Model) -> Estimate:
    """Return `found`, whose unknowns are fitted coordinates, in physical parameters.

    Covariances are carried linearly. Intervals are the 2.5 and 97.5 % points of what draws from
    the fitted coordinates' distribution, kept inside their box, become.
    """
    names, units = list(found.names), list(found.units)
    values, low, high = found.values.copy(), found.low.copy(), found.high.copy()
    covariance, determined, blind = found.covariance, found.determined, found.blind
    intervals = dict(found.intervals)
    for coordinates in groups:
        at = np.array([names.index(n) for n in coordinates.fitted])
        slope = _slope(coordinates, values[at], covariance[np.ix_(at, at)])
        intervals.update(_drawn(coordinates, values[at], covariance[np.ix_(at, at)], found.dof))
        covariance = _carried(covariance, at, slope)
        if determined is not None and blind is not None:
            determined = _carried(determined, at, slope)
            blind = blind.copy()
            blind[:, at] = blind[:, at] @ slope.T
        values[at] = coordinates.backward(values[at])
        for k, name in zip(at, coordinates.names, strict=True):
            limits = model.parameter(name)
            names[k], units[k] = name, limits.unit
            low[k], high[k] = limits.low, limits.high
    at_bound = tuple(n for n in found.at_bound if n in names)
    for coordinates in groups:
        at = np.array([names.index(n) for n in coordinates.names])
        near = np.array([1e-6 * max(abs(values[j]) for j in at if units[j] == units[k])
                         for k in at])
        values[at] = np.where(values[at] - low[at] <= near, low[at], values[at])
        stopped = [n for n, k, least in zip(coordinates.names, at, near, strict=True)
                   if values[k] == low[k] or high[k] - values[k] <= least]
        if not stopped and any(n in found.at_bound for n in coordinates.fitted):
            stopped = list(coordinates.names)
        at_bound += tuple(stopped)
    verdict = _reworded(found.identifiability, groups)
    status, message = found.status, found.message
    if at_bound and status in ("at_bound", "converged"):
        status, message = "at_bound", limit_message(at_bound)
    elif found.status == "not_identifiable":
        message = "; ".join(d.text for d in verdict.directions if math.isinf(d.std))
    return replace(found, status=status, message=message, identifiability=verdict,
                   names=tuple(names), units=tuple(units), values=values, low=low,
                   high=high, covariance=covariance,
                   intervals=intervals, at_bound=at_bound, determined=determined, blind=blind)


def _reworded(verdict: Identifiability, groups: Sequence[Coordinates]) -> Identifiability:
    """Say of a share that the data do not show that only the sum is known."""
    split = {g.fitted[1]: g.names for g in groups if g.sum_and_share}
    directions = tuple(
        replace(d, members=split[d.members[0]], change=(1.0, -1.0),
                text=f"{' and '.join(split[d.members[0]])} only as their sum")
        if len(d.members) == 1 and d.members[0] in split else d for d in verdict.directions)
    if directions == verdict.directions:
        return verdict
    return Identifiability(directions, "; ".join(d.text for d in directions))


def _slope(coordinates: Coordinates, values: Array, covariance: Array) -> Array:
    """Return the derivative of `backward` (n, n), taken over half a standard error each way."""
    std = np.sqrt(np.diag(covariance))
    slope = np.zeros((values.size, values.size))
    for j in range(values.size):
        step = 0.5 * std[j] if np.isfinite(std[j]) and std[j] > 0.0 else 1e-6 * max(
            abs(values[j]), 1e-9)
        up, down = values.copy(), values.copy()
        up[j] = min(values[j] + step, coordinates.high[j])
        down[j] = max(values[j] - step, coordinates.low[j])
        slope[:, j] = (coordinates.backward(up) - coordinates.backward(down)) / (up[j] - down[j])
    return slope


def _drawn(coordinates: Coordinates, values: Array, covariance: Array,
           dof: float) -> dict[str, tuple[float, float]]:
    """Return the interval of each physical parameter; unlimited where nothing is known."""
    box = coordinates.high - coordinates.low
    variance = np.diag(covariance).copy()
    unknown = ~np.isfinite(variance)
    if np.any(unknown & ~np.isfinite(box)):
        return dict.fromkeys(coordinates.names, (-math.inf, math.inf))
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    known[unknown, unknown] = box[unknown] ** 2
    widened = t95(dof) / t95(math.inf)
    strength, directions = np.linalg.eigh(known)
    root = directions * np.sqrt(np.maximum(strength, 0.0))
    draws = values + widened * _normal_draws(values.size) @ root.T
    draws = np.clip(draws, coordinates.low, coordinates.high)
    physical = np.array([coordinates.backward(row) for row in draws])
    physical = physical[np.all(np.isfinite(physical), axis=1)]
    limits = np.quantile(physical, (0.025, 0.975), axis=0)
    return {n: (float(limits[0, k]), float(limits[1, k]))
            for k, n in enumerate(coordinates.names)}


def _normal_draws(dimensions: int) -> Array:
    """Return DRAWS quasi-random points (DRAWS, d) of independent standard normal variables.

    A lattice of Korobov (1959). scipy.stats has other points, and takes far longer to import.
    """
    steps = GENERATOR ** np.arange(dimensions)
    lattice = (np.outer(np.arange(DRAWS), steps) % DRAWS + 0.5) / DRAWS
    return np.asarray(np.frompyfunc(NormalDist().inv_cdf, 1, 1)(lattice), dtype=float)


def _carried(covariance: Array, at: NDArray[np.int64], slope: Array) -> Array:
    """Apply `slope` to the rows and columns `at`; what was unknown there stays so."""
    whole = np.eye(covariance.shape[0])
    whole[np.ix_(at, at)] = slope
    known = np.where(np.isfinite(covariance), covariance, 0.0)
    out = np.asarray(whole @ known @ whole.T)
    lost = ~np.isfinite(np.diag(covariance))
    blurred = np.any(np.abs(whole[:, lost]) > 0.0, axis=1)
    out[blurred, :] = out[:, blurred] = np.nan
    out[blurred, blurred] = np.inf
    return out
