"""An estimation problem: unknowns, records, and the simulation that ties them together."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Unknown:
    """One parameter to estimate: where it starts, how large it typically is, where it may go.

    An unknown that belongs to one record only (an initial state) names it in `segment`.
    """

    name: str
    start: float
    scale: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    segment: int | None = None


@dataclass(frozen=True)
class Segment:
    """One record to be explained: `output` (N,), of which the first `skip` samples do not count.

    `trend` is the degree of the polynomial in time that is fitted along with it: -1 none, 0 an
    offset, 1 an offset and a drift.
    """

    output: Array
    sample_period: float
    name: str = "record"
    skip: int = 0
    trend: int = 0


@dataclass(frozen=True)
class Problem:
    """Unknowns, records and the simulation that ties them together.

    `simulate(segment, values)` takes parameter rows (P, p) and returns outputs (P, N) of that
    segment, NaN in a row that cannot be simulated.
    """

    unknowns: tuple[Unknown, ...]
    segments: tuple[Segment, ...]
    simulate: Callable[[int, Array], Array]
    output_unit: str = "m"
