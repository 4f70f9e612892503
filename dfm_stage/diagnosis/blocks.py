"""Least squares with contiguous blocks as resampling unit: held-out errors and jackknife errors.

The remainder of a measured record is model error, not white noise. What it leaves uncertain shows
only from block to block (Kunsch, Ann. Statist. 17 (1989) 1217; Efron and Tibshirani, An
Introduction to the Bootstrap (1993), ch. 11 and 17). All sums are taken once per block, so that
any choice of columns costs the solution of a few small equations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array, Lines
from dfm_stage.diagnosis.decisions import SIZE_GROUPS

RIDGE = 1e-11
"""Added to the diagonal of normalised equations: columns that are the same share a coefficient."""


@dataclass(frozen=True)
class Solution:
    """Columns fitted to a target.

    `errors` (B,) is the mean square of each block while it is held out, `coefficients` (k,) are of
    all fitted blocks, `left_out` (B', k) of those without one of them.
    """

    errors: Array
    coefficients: Array
    left_out: Array


def jackknife(values: Array) -> Array:
    """Standard error (k,) of an estimate that has the `values` (B, k) without each block."""
    count = len(values)
    return np.asarray(np.sqrt((count - 1.0) / count
                              * np.sum((values - values.mean(axis=0)) ** 2, axis=0)))


class Blocks:
    """Sums of products of `columns` (n, K) over blocks that begin at `edges` (B + 1,).

    `fitted` (B,) says which blocks take part in fits; the others are only predicted.
    """

    def __init__(self, columns: Array, edges: Lines, fitted: ArrayLike) -> None:
        self.edges, self.fitted = edges, np.asarray(fitted, dtype=bool)
        self.sizes = np.diff(edges)
        self.norms = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-150)
        self.sums = np.stack([columns[a:b].T @ columns[a:b] for a, b in pairwise(edges)])
        self.sums /= np.outer(self.norms, self.norms)

    @property
    def count(self) -> int:
        """How many blocks there are."""
        return self.sizes.size

    def fit(self, columns: Sequence[int], target: int) -> Solution:
        """Fit columns to a target, each block predicted without itself."""
        at = [*columns, target]
        return self._solved(self.sums[:, at][:, :, at], self.norms[at])

    def fit_by_group(self, shared: Sequence[int], own: Sequence[int], target: int,
                     groups: Lines) -> Solution:
        """The same with coefficients of the columns `own` that differ between groups of blocks;
        `groups` (B,) counts from zero."""
        at = [*shared, *own, target]
        sums = self.sums[:, at][:, :, at]
        first, width, several = len(shared), len(own), int(groups.max()) + 1
        size = first + several * width + 1
        wide, norms = np.zeros((self.count, size, size)), np.ones(size)
        for b, group in enumerate(groups):
            place = np.r_[0:first, first + group * width:first + (group + 1) * width, size - 1]
            wide[b][np.ix_(place, place)] = sums[b]
            norms[place] = self.norms[at]
        return self._solved(wide, norms)

    def _solved(self, sums: Array, norms: Array, penalty: Array | float = 0.0) -> Solution:
        k = sums.shape[1] - 1
        total = sums[self.fitted].sum(axis=0)
        without = total - np.where(self.fitted[:, None, None], sums, 0.0)
        if k == 0:
            return Solution(sums[:, 0, 0] / self.sizes * norms[-1] ** 2, np.empty(0),
                            np.empty((int(self.fitted.sum()), 0)))
        keep = RIDGE * np.eye(k) * max(float(np.trace(total[:k, :k])) / k, 1e-300) + penalty
        solved = np.linalg.solve(without[:, :k, :k] + keep, without[:, :k, k:])[:, :, 0]
        whole = np.linalg.solve(total[:k, :k] + keep, total[:k, k])
        errors = (sums[:, k, k] - 2.0 * np.einsum("bi,bi->b", solved, sums[:, :k, k])
                  + np.einsum("bi,bij,bj->b", solved, sums[:, :k, :k], solved))
        scale = norms[-1] / norms[:k]
        return Solution(np.maximum(errors, 0.0) / self.sizes * norms[-1] ** 2, whole * scale,
                        solved[self.fitted] * scale)

    def ridge_fit(self, columns: Sequence[int], penalised: Sequence[int], target: int,
                  ridges: Sequence[float]) -> Solution:
        """A fit with a penalty on some of the columns, that of `ridges` which predicts best."""
        at = [*columns, *penalised, target]
        sums, norms = self.sums[:, at][:, :, at], self.norms[at]
        weight = np.zeros(len(at) - 1)
        weight[len(columns):] = float(self.sizes[self.fitted].sum())
        tried = [self._solved(sums, norms, np.diag(ridge * weight)) for ridge in ridges]
        return min(tried, key=lambda s: float(s.errors @ self.sizes))


def log_ratio(better: Array, worse: Array) -> tuple[float, float]:
    """Mean log ratio of the errors (B,) of two fits, and its standard error.

    In logarithms every block counts the same; differences would be those of the largest ones.
    """
    ratio = np.log((worse + 1e-300) / (better + 1e-300))
    return float(np.mean(ratio)), float(np.std(ratio, ddof=1)) / math.sqrt(ratio.size)


def by_size(sizes: Array) -> Lines:
    """The group (B,) of each block, from zero: small, middle and large ones, as many of each."""
    rank = np.argsort(np.argsort(sizes))
    return np.asarray(rank * SIZE_GROUPS // sizes.size, dtype=np.int64)


def block_edges(sizes: Sequence[int], wanted: int, shortest: int) -> tuple[Lines, Lines]:
    """Edges (B + 1,) of about `wanted` blocks over runs of these sizes, none across two runs, and
    the run (B,) of each block; none is shorter than `shortest` where its run is not."""
    length = sum(sizes) / wanted
    edges, owner, at = [0], [], 0
    for number, size in enumerate(sizes):
        count = max(1, min(round(size / length), size // shortest))
        edges += [at + round((k + 1) * size / count) for k in range(count)]
        owner += [number] * count
        at += size
    return np.array(edges, dtype=np.int64), np.array(owner, dtype=np.int64)
