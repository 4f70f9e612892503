"""The restoring-force surface: the mean missing force over position and velocity.

Source: Masri and Caughey, J. Appl. Mech. 46 (1979) 433.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import StringIO

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.diagnosis.blocks import jackknife

FILE = "missing_force.csv"
"""What diagnosis.json calls the table of the surface, which stands beside it."""
FINEST, COARSEST = 15, 5
"""Bins along each axis, odd so that one lies about the middle: finer ones hold few samples."""
SAMPLES_A_BIN = 20
"""Samples that a bin has on average where there are fewer than the finest."""
LEAST_SAMPLES, LEAST_BLOCKS = 5, 3
"""Samples and blocks without which a bin has no mean and no standard error."""
OUTER = 0.005
"""Share of the samples at each end of an axis that the grid leaves out: single excursions would
make all bins wide."""


@dataclass(frozen=True)
class Surface:
    """The mean missing force over position and velocity, and how much of it there is to explain.

    All arrays are (I, J) over bins of position and of velocity. `x` and `v` are the means of the
    samples in a bin, in `unit` and `unit`/s, `force` and `standard_error` in N (N m where `unit`
    is rad); NaN where too few samples are; `samples` counts them. The force is that on the stage.
    It has no part that is linear in position or speed: those are base parameters of the model.

    Of the missing force's held-out power above the noise, `position_velocity_share` is what
    position and velocity alone explain, `predictable_share` what a black box does that also knows
    acceleration, past motion and amplitude, `form_shares` what each effect of the model does in
    other forms. `rms` is of the missing force, `frequency_hz` where its spectrum is highest.
    `history` is the force (N) over time (s) along the first fitted record, both (n,).
    """

    unit: str
    x: Array
    v: Array
    force: Array
    standard_error: Array
    samples: Array
    position_velocity_share: float
    predictable_share: float
    rms: float
    frequency_hz: float | None = None
    form_shares: Mapping[str, float] = field(default_factory=dict)
    history: tuple[Array, Array] | None = None

    @property
    def force_unit(self) -> str:
        """N, or N m of a rotary stage."""
        return "N m" if self.unit == "rad" else "N"

    def to_csv(self) -> str:
        """One line a bin that has a mean, units in the names of the columns."""
        force, text = self.force_unit.replace(" ", ""), StringIO()
        text.write(f"position_{self.unit},velocity_{self.unit}_s,force_{force},"
                   f"standard_error_{force},samples\n")
        for i, j in np.argwhere(np.isfinite(self.force)):
            text.write(f"{self.x[i, j]:.8g},{self.v[i, j]:.8g},{self.force[i, j]:.6g},"
                       f"{self.standard_error[i, j]:.3g},{int(self.samples[i, j])}\n")
        return text.getvalue()


@dataclass(frozen=True)
class Bins:
    """Mean force over bins, as in `Surface`."""

    x: Array
    v: Array
    force: Array
    standard_error: Array
    samples: Array


def binned(x: Array, v: Array, force: Array, left_out: Array, edges: Lines) -> Bins | None:
    """Means of `force` (n,) over bins of position and velocity (n,), with jackknife errors.

    `left_out` (B, n) is the force as it is estimated without each block of samples that begins at
    `edges` (B + 1,): what is uncertain in the estimate counts as well as what varies in a bin.
    None where no bin has enough samples.
    """
    count = _odd(math.sqrt(x.size / SAMPLES_A_BIN))
    at_x, at_v = _placed(x, count), _placed(v, count)
    inside = (at_x >= 0) & (at_v >= 0)
    place = np.where(inside, at_x * count + at_v, count**2)
    block = np.repeat(np.arange(edges.size - 1), np.diff(edges))
    shape = (edges.size - 1, count**2 + 1)
    visits = np.zeros(shape)
    np.add.at(visits, (block, place), 1.0)
    samples = visits.sum(axis=0)
    enough = (samples >= LEAST_SAMPLES) & ((visits > 0.0).sum(axis=0) >= LEAST_BLOCKS)
    enough[-1] = False
    if not enough.any():
        return None
    means = [np.bincount(place, each, shape[1]) / np.maximum(samples, 1.0)
             for each in (x, v, force)]
    others = np.array([np.bincount(place[block != b], own[block != b], shape[1])
                       for b, own in enumerate(left_out)])
    error = jackknife(others / np.maximum(samples - visits, 1.0))
    told = [np.where(enough, each, np.nan)[:-1].reshape(count, count) for each in (*means, error)]
    return Bins(told[0], told[1], told[2], told[3], samples[:-1].reshape(count, count))


def _odd(wanted: float) -> int:
    return 2 * (int(min(max(wanted, COARSEST), FINEST)) // 2) + 1


def _placed(values: Array, count: int) -> Lines:
    """In which of `count` bins each value (n,) lies; -1 is outside."""
    low, high = np.quantile(values, (OUTER, 1.0 - OUTER))
    at = np.floor((values - low) / max((high - low) / count, 1e-300))
    return np.where((at >= 0.0) & (at < count), at, -1.0).astype(np.int64)
