"""Which combinations of parameters the data cannot tell apart, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dfm_stage.identification.least_squares import RANK_TOLERANCE, column_norms

Array = NDArray[np.float64]

WEAK = 0.5
"""A direction is weak when one standard deviation along it is half of the parameter itself."""


@dataclass(frozen=True)
class BlindDirection:
    """A joint change of `members` that hardly moves the output.

    `change` (len(members),) is relative to the values; `std` is the standard deviation along it
    in the same relative measure, infinite where the data say nothing at all.
    """

    members: tuple[str, ...]
    change: tuple[float, ...]
    std: float
    text: str


@dataclass(frozen=True)
class Identifiability:
    """The verdict: `text` for people, `directions` for programs."""

    directions: tuple[BlindDirection, ...]
    text: str

    @property
    def complete(self) -> bool:
        """Whether every parameter can be told from every other."""
        return not self.directions


def judge(names: Sequence[str], values: Array, units: Sequence[str], scale: Array,
          jacobian: Array, nuisance: Array) -> Identifiability:
    """Find the joint changes of `values` (p,) that the data cannot see.

    `jacobian` (N, p) and `nuisance` (N, q) are sensitivities of residuals weighted to unit
    variance; `nuisance` (offsets, initial states, noise model) is projected out first. A value
    of zero is measured against its `scale`.
    """
    count = len(names)
    if count == 0:
        return Identifiability((), "nothing was estimated")
    both = np.hstack([nuisance / column_norms(nuisance, np.ones(nuisance.shape[1])), jacobian])
    triangle = np.asarray(np.linalg.qr(both, mode="r"))
    upper = triangle[nuisance.shape[1]:, nuisance.shape[1]:]
    reference = np.where(values != 0.0, np.abs(values), scale)
    relative = upper * reference
    norms = column_norms(relative, np.ones(count))
    _, singular, right = np.linalg.svd(relative / norms)
    lost = singular <= RANK_TOLERANCE * singular[0]
    directions: list[BlindDirection] = []
    if np.any(lost):
        basis = right[lost] / norms
        directions += [_describe(vector, math.inf, names, reference, units)
                       for vector in _sparse_basis(basis)]
    _, singular, right = np.linalg.svd(relative)
    alive = singular > RANK_TOLERANCE * singular[0]
    for strength, vector in zip(singular[alive], right[alive], strict=True):
        if strength < 1.0 / WEAK:
            directions.append(_describe(vector, 1.0 / strength, names, reference, units))
    if not directions:
        return Identifiability((), "the data tell all estimated parameters apart")
    return Identifiability(tuple(directions), "; ".join(d.text for d in directions))


def _sparse_basis(basis: Array) -> list[Array]:
    """Return unit vectors that span `basis` (k, p), each with as few members as elimination gives.
    """
    rows = basis.copy()
    used: list[int] = []
    for i in range(rows.shape[0]):
        candidates = np.abs(rows[i])
        candidates[used] = 0.0
        pivot = int(np.argmax(candidates))
        used.append(pivot)
        rows[i] /= rows[i, pivot]
        for other in range(rows.shape[0]):
            if other != i:
                rows[other] -= rows[other, pivot] * rows[i]
    return [row / np.linalg.norm(row) for row in rows]


def _describe(vector: Array, std: float, names: Sequence[str], reference: Array,
              units: Sequence[str]) -> BlindDirection:
    chosen = [int(i) for i in np.flatnonzero(np.abs(vector) >= 0.2 * np.max(np.abs(vector)))]
    members = tuple(names[i] for i in chosen)
    change = vector[chosen] * np.sign(vector[chosen[0]])
    raw = change * reference[chosen]
    listed = _join(members)
    same_unit = len({units[i] for i in chosen}) == 1
    how_well = "" if math.isinf(std) else f" (known only to {100.0 * std:.0f} %)"
    if len(members) == 1:
        text = (f"the data do not show {listed}: hold it or excite it more" if math.isinf(std)
                else f"{listed} is hardly visible{how_well}")
    elif _equal(change):
        text = f"{listed} only as {'a ratio' if len(members) == 2 else 'ratios'}{how_well}"
    elif len(members) == 2 and same_unit and _equal(raw * [1.0, -1.0]):
        text = f"{listed} only as their sum{how_well}"
    elif len(members) == 2 and same_unit and _equal(raw):
        text = f"{listed} only as their difference{how_well}"
    elif len(members) == 2 and _equal(change * [1.0, -1.0]):
        text = f"{listed} only as a product{how_well}"
    else:
        text = f"{listed} only in combination{how_well}"
    return BlindDirection(members, tuple(float(c) for c in change), std, text)


def _equal(values: Array) -> bool:
    return bool(np.ptp(values) <= 0.15 * np.max(np.abs(values)))


def _join(names: Sequence[str]) -> str:
    if len(names) == 1:
        return names[0]
    return ", ".join(names[:-1]) + " and " + names[-1]
