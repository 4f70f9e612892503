"""Which combinations of parameters the data cannot tell apart, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import EQUAL, MEMBER, MOVES_OUTPUT, RANK_TOLERANCE, WEAK
from dfm_stage.identification.least_squares import column_norms


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
    reference = np.where(values != 0.0, np.abs(values), scale)
    relative = triangle[nuisance.shape[1]:, nuisance.shape[1]:] * reference
    effect = np.linalg.norm(jacobian, axis=0) * reference
    norms = np.where(effect > 0.0, effect, 1.0)
    _, singular, right = np.linalg.svd(relative / norms)
    lost = singular <= RANK_TOLERANCE * singular[0]
    told = _Words(names, reference, units, effect)
    directions = [told.direction(vector, math.inf)
                  for vector in _sparse_basis(right[lost] / norms)]
    _, singular, right = np.linalg.svd(relative)
    directions += [told.direction(vector, 1.0 / strength)
                   for strength, vector in zip(singular, right, strict=True)
                   if RANK_TOLERANCE * singular[0] < strength < 1.0 / WEAK]
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


@dataclass(frozen=True)
class _Words:
    """What is needed to put a direction into words; `effect` (p,) is what each moves alone."""

    names: Sequence[str]
    reference: Array
    units: Sequence[str]
    effect: Array

    def direction(self, vector: Array, std: float) -> BlindDirection:
        change, moved = np.abs(vector), np.abs(vector) * self.effect
        chosen = [int(i) for i in np.flatnonzero(
            (change >= MEMBER * np.max(change)) | (moved > MOVES_OUTPUT * np.max(moved)))]
        members = tuple(self.names[i] for i in chosen)
        change = vector[chosen] * np.sign(vector[chosen[0]])
        same_unit = len({self.units[i] for i in chosen}) == 1
        how = _how(change, change * self.reference[chosen], same_unit)
        if len(members) == 1 and math.isinf(std):
            text = f"the data do not show {members[0]}: hold it or excite it more"
        elif len(members) == 1:
            text = f"{members[0]} is hardly visible"
        else:
            text = f"{_join(members)} only {how}"
        if math.isfinite(std):
            text += f" (known only to {100.0 * std:.0f} %)"
        return BlindDirection(members, tuple(float(c) for c in change), std, text)


def _how(change: Array, raw: Array, same_unit: bool) -> str:
    """Say what remains known when `change` (relative) or `raw` (absolute) leaves no trace."""
    if _equal(change):
        return "as a ratio" if change.size == 2 else "as ratios"
    if change.size == 2 and same_unit and _equal(raw * [1.0, -1.0]):
        return "as their sum"
    if change.size == 2 and same_unit and _equal(raw):
        return "as their difference"
    if change.size == 2 and _equal(change * [1.0, -1.0]):
        return "as a product"
    return "in combination"


def _equal(values: Array) -> bool:
    return bool(np.ptp(values) <= EQUAL * np.max(np.abs(values)))


def _join(names: Sequence[str]) -> str:
    if len(names) == 1:
        return names[0]
    return ", ".join(names[:-1]) + " and " + names[-1]
