"""One axis of one record, as estimation takes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

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
    `other` (N,) is the position of the neighbouring axis, where they were recorded. With `window`
    the state is estimated anew every so many samples (multiple shooting: Bock and Plitt, IFAC
    1984): what little the model misses then has no time to carry a body without a spring away.
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
    window: int = 0

    @property
    def windows(self) -> list[slice]:
        """The parts that begin with a state of their own; the last one is not shorter."""
        if not self.window:
            return [slice(0, self.input.size)]
        starts = range(0, max(self.input.size - self.window, 0) + 1, self.window)
        ends = [*starts[1:], self.input.size]
        return [slice(a, b) for a, b in zip(starts, ends, strict=True)]

    @property
    def measured(self) -> tuple[Array, ...]:
        """The signals (N - skip,) that are compared: the output, and the current if recorded."""
        found = (self.output,) if self.current is None else (self.output, self.current)
        return tuple(s[self.skip:] for s in found)
