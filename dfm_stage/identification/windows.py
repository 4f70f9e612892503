"""Windows of a run, each with an initial state of its own, as rows of one simulation.

Multiple shooting: Bock and Plitt, IFAC World Congress 1984.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.identification.run import Run

WINDOW = "@"
"""Stands between the name of an unknown and the sample at which its window begins."""
SLOPE_SAMPLES = 20
"""Samples around the beginning of a window over which its velocity is first read off."""

PARABOLA = 2
"""Degree of the polynomial through them."""


@dataclass(frozen=True)
class Windows:
    """Rows (R, m) of parameters by `names` (m), each for one of `parts`; `shown` says of each
    window which rows of the whole table they stand for, and which are as its last."""

    names: Sequence[str]
    rows: Array
    parts: Sequence[slice]
    shown: Sequence[tuple[slice, Lines, Lines]]

    @classmethod
    def of(cls, run: Run, names: Sequence[str], table: Array, states: Sequence[str]) -> Windows:
        """What is to be simulated of each window for a `table` (P, n) of parameters by `names`
        (n), initial `states` of windows among them: rows that leave a window alone stand once."""
        place = {n: k for k, n in enumerate(names)}
        shared = [k for n, k in place.items() if WINDOW not in n]
        states = [s for s in states if any(
            n.startswith(f"initial.{s}{WINDOW}") for n in names)]
        differ = table != np.median(table, axis=0)
        moved = np.any(differ[:, shared], axis=1)
        rows, parts, shown = [], [], []
        for part in run.windows:
            own = [place[at_window(f"initial.{s}", run, part)] for s in states]
            alone = moved | np.any(differ[:, own], axis=1)
            still = np.flatnonzero(~alone)
            chosen = np.concatenate((np.flatnonzero(alone), still[:1]))
            rows.append(table[chosen][:, [*shared, *own]])
            parts += [part] * chosen.size
            shown.append((part, chosen, still))
        return cls([*(names[k] for k in shared), *(f"initial.{s}" for s in states)],
                   np.concatenate(rows), parts, shown)

    def put_together(self, found: Array, count: int) -> Array:
        """A signal (count, N) from those of the windows, `found` (R, longest)."""
        out = np.empty((count, self.parts[-1].stop))
        at = 0
        for part, chosen, still in self.shown:
            size = part.stop - part.start
            out[chosen, part] = found[at:at + chosen.size, :size]
            at += chosen.size
            out[still[1:], part] = found[at - 1, :size]
        return out


def at_window(name: str, run: Run, part: slice) -> str:
    """The name of an unknown that belongs to one window of a run."""
    return f"{name}{WINDOW}{part.start}" if run.window else name


def slope_at(output: Array, at: int) -> float:
    """Change a sample of `output` (N,) at sample `at`, of a parabola by least squares through the
    samples around it: a straight line is as wrong as the motion is bent."""
    begin = max(at - SLOPE_SAMPLES // 2, 0)
    near = output[begin:begin + SLOPE_SAMPLES + 1]
    degree = min(PARABOLA, near.size - 1)
    times = np.arange(near.size) - float(at - begin)
    return float(np.polynomial.polynomial.polyfit(times, near, degree)[1]) if degree else 0.0
