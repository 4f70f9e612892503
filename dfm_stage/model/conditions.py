"""What records and model say before an effect is added: from it effects choose where to begin."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dfm_stage.arrays import Array

SMOOTHED = 5
"""Samples over which a reading is averaged before it is differentiated for its speed."""
SLOWEST = 1e-3
"""Least speed, in motions a second, and least share of the spring's force, taken as a size."""


class Recorded(Protocol):
    """What a run must offer."""

    @property
    def input(self) -> Array:
        """V or A, (N,)"""

    @property
    def output(self) -> Array:
        """m, or m/s or m/s^2 where `order` says so, (N,)"""

    @property
    def order(self) -> int:
        """Of which order in the position's time derivatives the output is"""

    @property
    def position(self) -> Array:
        """m, (N,): the output, or made from it"""

    def motion(self, order: int) -> Array:
        """The position's time derivative of some order, (N,)"""

    @property
    def other(self) -> Array | None:
        """The neighbour's position, m, (N,)"""

    @property
    def current(self) -> Array | None:
        """A, (N,)"""

    @property
    def sample_period(self) -> float:
        """s"""

    @property
    def window(self) -> int:
        """Samples after which the state starts anew, 0 for never"""


@dataclass(frozen=True)
class Conditions:
    """Sizes that occur in some runs, the runs themselves, and the base of the model.

    RMS motion about its mean (m), RMS speed (m/s; a motor that never turns back has a mean),
    largest motion (m), RMS input (V or A) and force (N) about their means, the longest run (s),
    a stiffness (N/m), noise (m RMS) and sample period (s). `drive_kind` is the model's: voltage
    or current, `angular` says that positions are angles in rad. `frequencies` (Hz), `periods` (m)
    and `steps` (m) are what stands out in a residual: lines over time, patterns over position,
    steps of the reading.
    """

    motion: float
    speed: float
    travel: float
    drive: float
    force: float
    duration: float
    stiffness: float
    noise: float
    sample_period: float
    base: Mapping[str, float]
    drive_kind: str
    runs: tuple[Recorded, ...] = ()
    angular: bool = False
    frequencies: tuple[float, ...] = ()
    periods: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()

    @property
    def windowed(self) -> bool:
        """Whether the state of a body without a spring starts anew every so often."""
        return not self.base.get("stiffness", 0.0) and any(run.window for run in self.runs)

    @classmethod
    def of(cls, base: Mapping[str, float], drive_kind: str, runs: Sequence[Recorded],
           noise: float, position_unit: str = "m") -> Conditions:
        """Measure them on the run that moves most; `noise` is the RMS of its output's."""
        run = max(runs, key=lambda r: float(np.std(r.output)))
        noise *= float(np.std(run.position)) / max(float(np.std(run.output)), 1e-300) \
            if run.order else 1.0
        motion = max(float(np.std(run.position)), noise)
        smooth = np.convolve(run.output, np.ones(SMOOTHED) / SMOOTHED, "valid")
        velocity = run.motion(1) if run.order else np.diff(smooth) / run.sample_period
        speed = max(math.sqrt(float(np.mean(velocity**2))), SLOWEST * motion)
        drive = float(np.std(run.input))
        gain = abs(base.get("force_constant", 1.0))
        natural = math.sqrt(base["mass"] * base.get("stiffness", 0.0))
        stiffness = max(base.get("stiffness", 0.0), base["mass"] * (speed / motion) ** 2)
        force = max(gain * drive, SLOWEST * stiffness * motion, SLOWEST * natural * speed)
        return cls(motion, speed, float(np.ptp(run.position)), drive, force,
                   max(r.input.size * r.sample_period for r in runs), stiffness, noise,
                   run.sample_period, base, drive_kind, tuple(runs), position_unit == "rad")
