"""One axis of one record, as estimation takes it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from dfm_stage.arrays import Array

Start = Literal["free", "rest", "periodic"]


@dataclass(frozen=True)
class Run:
    """One axis of one record: `input` (N,) held from sample k on, `output` (N,) before it acts.

    The first `skip` samples are simulated but not compared. `start` says how the state at sample
    0 is found: "free" estimates position and velocity, "rest" takes zero, "periodic" takes the
    input as whole periods of `period` samples in steady state. `trend` is the degree of the
    polynomial fitted along (-1 none, 0 offset, 1 drift); None leaves it to the model: an offset
    where there is a spring and no trusted encoder zero. `current` (N,) A is compared as well, and
    `other` (N,) is the position of the neighbouring axis, where they were recorded.
    """

    name: str
    input: Array
    output: Array
    sample_period: float
    skip: int = 0
    start: Start = "free"
    period: int | None = None
    trend: int | None = None
    current: Array | None = None
    other: Array | None = None

    @property
    def measured(self) -> tuple[Array, ...]:
        """The signals (N - skip,) that are compared: the output, and the current if recorded."""
        found = (self.output,) if self.current is None else (self.output, self.current)
        return tuple(s[self.skip:] for s in found)

    @cached_property
    def spread(self) -> float:
        """RMS of the output about its mean; every system on the run scales unknowns by it."""
        return float(np.std(self.output))

    @cached_property
    def speed(self) -> float:
        """RMS of the output's differences, per second, about their mean."""
        return float(np.std(np.diff(self.output))) / self.sample_period
