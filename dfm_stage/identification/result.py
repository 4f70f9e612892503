"""What output-error estimation returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import UNCHANGED
from dfm_stage.identification.errors import IdentificationError
from dfm_stage.identification.identifiability import Identifiability
from dfm_stage.identification.noise import NoiseModel
from dfm_stage.identification.quantity import Quantity, propagate


@dataclass(frozen=True)
class SegmentFit:
    """How one record was explained: arrays are (N - skip,) in the unit of the output."""

    name: str
    measured: Array
    simulated: Array
    innovations: Array
    noise: NoiseModel
    skip: int
    sample_period: float

    @property
    def residual(self) -> Array:
        """Measured minus simulated, offset included in the simulation."""
        return self.measured - self.simulated

    @property
    def rms(self) -> float:
        """RMS of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def fit_percent(self) -> float:
        """100 (1 - |residual| / |measured - mean|), the usual figure of fit."""
        spread = float(np.linalg.norm(self.measured - self.measured.mean()))
        return 100.0 * (1.0 - float(np.linalg.norm(self.residual)) / spread) if spread else 0.0


@dataclass(frozen=True)
class Estimate:
    """Estimated parameters with what is known of their errors.

    `names`, `units` (p,), `values` (p,), `covariance` and `correlation` (p, p) list the unknowns
    in the order of the problem, initial states and offsets included; `held` names parameters kept
    at a given value. Intervals use Student's t with `dof` degrees of freedom; `intervals`
    holds those of parameters that were searched in other coordinates. Where the data leave
    directions open, `blind` (k, p) holds them and `determined` (p, p) the covariance across them,
    so that figures which do not change along them keep their interval. `status` is one of
    `converged`, `at_bound`, `not_identifiable`, `not_converged` or `failed`; `message` says what
    to do about it.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    covariance: Array
    low: Array
    high: Array
    held: dict[str, float]
    dof: float
    identifiability: Identifiability
    segments: tuple[SegmentFit, ...]
    cost: float
    status: str
    message: str
    iterations: int
    at_bound: tuple[str, ...] = ()
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    determined: Array | None = None
    blind: Array | None = None

    @property
    def ok(self) -> bool:
        """Whether the search found a minimum."""
        return self.status not in ("failed", "not_converged")

    @property
    def std(self) -> Array:
        """Standard errors (p,), infinite where the data do not determine the parameter."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p); NaN where a standard error is infinite or zero."""
        std = self.std
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.covariance / np.outer(std, std))

    def index(self, name: str) -> int:
        """Return the position of an unknown.

        Raises
        ------
        IdentificationError
            If it was not estimated.
        """
        try:
            return self.names.index(name)
        except ValueError:
            raise IdentificationError(f"{name} was not estimated; estimated are "
                                      f"{', '.join(self.names)}") from None

    def value(self, name: str) -> float:
        """Return an estimated or held value by name."""
        return self.held[name] if name in self.held else float(self.values[self.index(name)])

    def quantity(self, name: str) -> Quantity:
        """Return one parameter with its interval, cut at what is physically allowed."""
        if name in self.held:
            return Quantity(self.held[name], "", None)
        j = self.index(name)
        if name in self.intervals:
            return Quantity(float(self.values[j]), self.units[j], self.intervals[name])
        return self.derived(lambda x: float(x[j]), self.units[j],
                            (float(self.low[j]), float(self.high[j])))

    def derived(self, function: Callable[[Array], float], unit: str,
                limits: tuple[float, float] = (-np.inf, np.inf)) -> Quantity:
        """Return a function of the unknowns (p,) with the interval the delta method gives."""
        covariance = self.covariance
        if self.determined is not None and self._unmoved(function):
            covariance = self.determined
        found = propagate(function, self.values, covariance, unit, self.dof)
        if found.ci95 is None or not np.all(np.isfinite(found.ci95)):
            return found
        low, high = found.ci95
        return Quantity(found.value, unit, (max(low, limits[0]), min(high, limits[1])))

    def _unmoved(self, function: Callable[[Array], float]) -> bool:
        """Whether a function stays what it is along all directions that the data leave open."""
        value = abs(function(self.values))
        for direction in np.empty((0, 0)) if self.blind is None else self.blind:
            sizes = np.abs(self.values)
            share = np.max(np.abs(direction[sizes > 0.0]) / sizes[sizes > 0.0], initial=0.0)
            step = direction * (1e-3 / share) if share > 0.0 else direction
            change = function(self.values + step) - function(self.values - step)
            if not abs(change) <= UNCHANGED * value:
                return False
        return True

    def quantities(self, local: bool = False) -> dict[str, Quantity]:
        """Return every estimated parameter; with `local`, initial states and offsets as well."""
        return {n: self.quantity(n) for n in self.names if local or "[" not in n}

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        shown = [i for i, n in enumerate(self.names) if "[" not in n]
        correlation = self.correlation[np.ix_(shown, shown)]
        return {
            "parameters": {n: q.to_dict() for n, q in self.quantities().items()},
            "held": dict(self.held),
            "correlation": {"names": [self.names[i] for i in shown],
                            "matrix": [[float(c) if np.isfinite(c) else None for c in row]
                                       for row in correlation]},
            "identifiability": {"complete": self.identifiability.complete,
                                "text": self.identifiability.text},
            "status": self.status, "message": self.message, "cost": float(self.cost),
            "iterations": self.iterations, "at_bound": list(self.at_bound),
            "dof": float(self.dof) if np.isfinite(self.dof) else None,
        }
