"""One axis of one record, as estimation takes it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.convention import HELD, Convention, Drive, drive_of
from dfm_stage.identification.motion import ORDER, differentiated
from dfm_stage.recording.units import Measured

Start = Literal["free", "rest", "periodic"]
AnyRun = TypeVar("AnyRun", bound="Run")
"""What `Self` is from Python 3.11 on."""


@dataclass(frozen=True)
class Run:
    """One axis of one record: `input` (N,) and `output` (N,), which is sampled before it acts.

    The output is what `measures` says. A `velocity` (N,) measured beside a position is compared
    too.

    The first `skip` samples are simulated but not compared. `start` says how the state at sample
    0 is found: "free" estimates position and velocity, "rest" takes zero, "periodic" takes the
    input as whole periods of `period` samples in steady state. `trend` is the degree of the
    polynomial fitted along (-1 none, 0 offset, 1 drift); None leaves it to the model: an offset
    where there is a spring and no trusted encoder zero. `current` (N,) A is compared as well, and
    `other` (N,) is the position of the neighbouring axis, where they were recorded.

    With `window` the state is estimated again every so many samples (multiple shooting: Bock and
    Plitt, IFAC 1984). A small missing force then has no time to move a body without a spring far.

    The input is held from sample k on, unless the record's `convention` says otherwise: then
    `drive` is what a simulator takes. `by` makes it, `sliced` keeps it right at the cuts.
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
    convention: Convention = HELD
    drive: Drive | None = None
    measures: Measured = "position"
    velocity: Array | None = None

    def by(self: AnyRun, convention: Convention) -> AnyRun:  # noqa: PYI019
        """Return the same run by another convention of its input."""
        return replace(self, convention=convention, drive=drive_of(
            self.input, convention, self.output, self.start == "periodic", self.order))

    def sliced(self: AnyRun, part: slice) -> AnyRun:  # noqa: PYI019
        """Return some of the samples; what is known of all of them is left as it is."""
        return replace(self, input=self.input[part], output=self.output[part],
                       current=None if self.current is None else self.current[part],
                       other=None if self.other is None else self.other[part],
                       velocity=None if self.velocity is None else self.velocity[part],
                       drive=None if self.drive is None else self.drive.sliced(part))

    @property
    def windows(self) -> list[slice]:
        """The parts that begin with a state of their own; the last one is not shorter. A state
        that is known, at rest or periodic, is that of the beginning: then there is one part."""
        if not self.window or self.start != "free":
            return [slice(0, self.input.size)]
        starts = range(0, max(self.input.size - self.window, 0) + 1, self.window)
        ends = [*starts[1:], self.input.size]
        return [slice(a, b) for a, b in zip(starts, ends, strict=True)]

    @property
    def driven(self) -> bool:
        """Whether the input changes at all."""
        return float(np.ptp(self.input)) > 0.0

    @property
    def order(self) -> int:
        """Of which order in the position's time derivatives the output is."""
        return ORDER[self.measures]

    @property
    def compared(self) -> dict[str, Array]:
        """The simulator's signals (N,) that were measured: first the output, then the current and
        the velocity beside it, if recorded."""
        first = "output" if self.measures == "position" else self.measures
        beside = {"current": self.current, "velocity": self.velocity}
        return {first: self.output, **{name: signal for name, signal in beside.items()
                                       if signal is not None and name != first}}

    @property
    def measured(self) -> tuple[Array, ...]:
        """The signals (N - skip,) of `compared`, without the first `skip` samples."""
        return tuple(s[self.skip:] for s in self.compared.values())

    def motion(self, order: int) -> Array:
        """The position's time derivative (N,) of some order: the output, or made from it."""
        return differentiated(self.output, order - self.order, self.sample_period)

    @cached_property
    def position(self) -> Array:
        """The position (N,): the output, or its integral without offset and drift."""
        return self.motion(0)

    @cached_property
    def travelled(self) -> float:
        """RMS of the position about its mean; initial positions are scaled by it."""
        return float(np.std(self.position))

    @cached_property
    def spread(self) -> float:
        """RMS of the output about its mean; every system on the run scales unknowns by it."""
        return float(np.std(self.output))

    @cached_property
    def speed(self) -> float:
        """RMS velocity about its mean; of a position that of its differences."""
        if self.order:
            return float(np.std(self.motion(1)))
        return float(np.std(np.diff(self.output))) / self.sample_period

    @cached_property
    def speeds(self) -> tuple[float, float]:
        """The velocities that a run may have begun with: those it had, and as wide a range on
        either side. A beginning that is not compared and is soon forgotten would let a fit begin
        anywhere, and a force that grows with speed be evaluated there."""
        velocity = self.motion(1) if self.order else np.diff(self.output) / self.sample_period
        low, high = float(np.min(velocity)), float(np.max(velocity))
        return min(low - (high - low), 0.0), max(high + (high - low), 0.0)
