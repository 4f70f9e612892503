"""What came of a run: whether the output was on and the stage followed its reference."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.model.parameter import nearest
from dfm_stage.quantity import format_quantity
from dfm_stage.trajectory.errors import TrajectoryError

FOLLOWED_SHARE = 0.5
"""By default the RMS error may be this share of the RMS movement that was asked for. A stage that
does not move at all has 1; the slowest controller anybody would call one stays below."""
FOLLOWED_FLOOR_M = 1e-6
"""Or this much, if that is more: noise and drift are no failure to follow a few nanometres."""


@dataclass(frozen=True)
class Bounds:
    """What a run has to keep to count as done; None is the default.

    `error_rms_m` and `error_peak_m` (m) bound measured minus reference position, `output_on` asks
    for an output that is on throughout. In open loop there is no reference to follow.
    """

    error_rms_m: float | None = None
    error_peak_m: float | None = None
    output_on: bool = True

    @classmethod
    def from_mapping(cls, given: Any) -> Bounds:
        """Return the bounds in the entry `bounds` of an experiment.

        Raises
        ------
        TrajectoryError
            If an entry is unknown or not of its kind.
        """
        if not isinstance(given, Mapping):
            raise TrajectoryError(f"bounds must be a mapping such as {{error_rms_m: 1.0e-6}}, not "
                                  f"{given!r}", "bounds")
        names = tuple(cls.__dataclass_fields__)
        for name, value in given.items():
            where = f"bounds.{name}"
            if name not in names:
                raise TrajectoryError(f"bounds has no entry {name!r}, {nearest(name, names)}",
                                      where)
            if name == "output_on":
                if not isinstance(value, bool):
                    raise TrajectoryError(f"{where} must be true or false, not {value!r}", where)
            elif isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 0.0:
                raise TrajectoryError(f"{where} must be a number of metres above 0, not {value!r}",
                                      where)
        return cls(**dict(given))


DEFAULT_BOUNDS = Bounds()


class Outcome:
    """Watches one run of one axis; `complaint` says why it does not count, or nothing.

    Parameters
    ----------
    reference : (N,) array
        Positions asked for, m.
    before_m : float
        The position held before the run: movement is measured from there.
    bounds : Bounds
        Of the experiment.
    open_loop : bool
        Whether there is no reference to follow.
    """

    def __init__(self, reference: Array, before_m: float, bounds: Bounds,
                 open_loop: bool) -> None:
        self._bounds = bounds
        self._rms_m, self._peak_m = math.inf, math.inf
        if not open_loop:
            moved = float(np.sqrt(np.mean((reference - before_m) ** 2)))
            self._rms_m = bounds.error_rms_m or (
                max(FOLLOWED_SHARE * moved, FOLLOWED_FLOOR_M) if moved > 0.0 else math.inf)
            self._peak_m = bounds.error_peak_m or math.inf
        self._output = ""
        self._squares = self._largest = 0.0
        self._count = 0

    def output(self, words: str) -> None:
        """Note why the output is off; empty words say that it is on. The first reason counts."""
        self._output = self._output or words

    def measured(self, position_m: float, reference_m: float) -> None:
        """Compare one sample."""
        error = position_m - reference_m
        self._squares += error * error
        self._count += 1
        if error < 0.0:
            error = -error
        if error > self._largest:
            self._largest = error

    def complaint(self) -> str:
        """Return why the run does not count as done, in one line; empty where it does."""
        reasons = [self._output] if self._bounds.output_on else []
        rms_m = math.sqrt(self._squares / self._count) if self._count else 0.0
        for what, error_m, bound_m in (("RMS", rms_m, self._rms_m),
                                       ("largest", self._largest, self._peak_m)):
            if error_m > bound_m:
                reasons.append(
                    f"the reference was not followed: {what} error {format_quantity(error_m, 'm')}"
                    f", allowed {format_quantity(bound_m, 'm')}")
        return "; ".join(filter(None, reasons))
