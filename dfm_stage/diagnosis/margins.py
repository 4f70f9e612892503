"""Comparisons by blocks: contiguous stretches of the records are the unit that is resampled.

Where a model leaves more than noise, its samples are no independent draws; blocks much longer
than what the stage remembers nearly are (Kuensch, Annals of Statistics 17, 1989). Powers are
compared in logarithms, so that the block with the largest motion does not decide alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.diagnosis.blocks import Blocks, block_edges, by_size, log_ratio
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    BLOCKS,
    LONG_BLOCKS,
    LONGEST_VELOCITY,
    NOISE_IN_VELOCITY,
    REMAINDER_TERMS,
    SAYS_NOTHING,
    SHORTEST_BLOCK,
    SIZE_GROUPS,
    SIZES_APART,
)
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.search_decisions import NEAR_NOISE
from dfm_stage.identification.weights import high_band_rms

Signal = Literal["position", "velocity", "acceleration"]
Score = tuple[Array, float]
"""The covariance (n, n) of the score of a fit's unknowns, and its degrees of freedom."""


def judged_signal(residual: Array, lag: int) -> Array:
    """The residual (N,) of one run as it is judged: itself, or its change over `lag` samples where
    the velocity of a position is."""
    return residual[lag:] - residual[:-lag] if lag else residual


def velocity_lag(residuals: Sequence[Sequence[Array]], noise_power: float) -> int:
    """Samples over which the velocity of positions is judged, given what a model leaves of them
    and the mean square of their noise: as few as leave noise a small part of that."""
    lag = 1
    while 2 * lag <= LONGEST_VELOCITY and (
            2.0 * noise_power > NOISE_IN_VELOCITY * power(residuals, lag)):
        lag *= 2
    return lag


def cuts(sizes: Sequence[int]) -> list[list[slice]]:
    """Blocks of equal length of runs of `sizes` samples, about BLOCKS in all, at least one a
    run."""
    edges, owner = block_edges(sizes, BLOCKS, SHORTEST_BLOCK)
    begins = np.cumsum([0, *sizes])
    return [[slice(int(edges[b] - begins[i]), int(edges[b + 1] - begins[i]))
             for b in np.flatnonzero(owner == i)] for i in range(len(sizes))]


def powers(residuals: Sequence[Sequence[Array]], lag: int = 0) -> Array:
    """Mean square (B,) of the output's residual in each block; infinite without residuals."""
    if not residuals:
        return np.full(1, math.inf)
    signals = [judged_signal(parts[0], lag) for parts in residuals]
    return np.array([float(np.mean(s[part] ** 2)) for s, parts in
                     zip(signals, cuts([s.size for s in signals]), strict=True) for part in parts])


def power(residuals: Sequence[Sequence[Array]], lag: int = 0) -> float:
    """Mean square of the output's residual over all runs; infinite without residuals."""
    if not residuals:
        return math.inf
    signals = [judged_signal(parts[0], lag) for parts in residuals]
    return float(sum(s @ s for s in signals)) / max(sum(s.size for s in signals), 1)


def margin(rival: Array, own: Array, apart: Array | None = None) -> float:
    """By how many standard errors of the mean log ratio the blocks' powers (B,) of a rival exceed
    one's own; infinite where the rival cannot be simulated, minus infinite where only it can.

    `apart` (B,) is the power of the difference between the two predictions. Blocks in which it is
    small beside what both leave say nothing: they would make the mean of the others, and its
    standard error, alike however much these say. Without them the margin is that of all blocks
    whose Student's t is as unlikely.
    """
    if not np.all(np.isfinite(rival)):
        return math.inf
    if not np.all(np.isfinite(own)):
        return -math.inf
    every = own.size
    if apart is not None:
        tell = apart > SAYS_NOTHING * np.minimum(rival, own)
        rival, own = rival[tell], own[tell]
    if own.size < 2:
        return 0.0
    mean, error = log_ratio(own, rival)
    found = mean / max(error, 1e-12)
    if own.size == every:
        return found
    from scipy.special import stdtr, stdtrit  # slow to import, and most margins need none

    alike = -float(stdtrit(every - 1, stdtr(own.size - 1, -abs(found))))
    return math.copysign(min(alike, abs(found)), found)


def margin_between(rival: Sequence[Sequence[Array]], own: Sequence[Sequence[Array]],
                   lag: int = 0) -> float:
    """The margin over a rival from what both leave of the same runs."""
    apart = [[a[0] - b[0]] for a, b in zip(rival, own, strict=True)] if rival and own else None
    return margin(powers(rival, lag), powers(own, lag),
                  None if apart is None else powers(apart, lag))


@dataclass(frozen=True)
class Constancy:
    """What letting parameters differ between small, middle and large motion gains on blocks left
    out: mean logarithm of the RMS without over with, and its standard error. About zero for the
    effect itself; a stand-in needs another value for every size of motion."""

    gain: float
    se: float

    @property
    def share(self) -> float:
        """Share of what is left that the split explains; none where it is not clear."""
        return 1.0 - math.exp(-2.0 * self.gain) if self.gain > BLOCK_MARGIN * self.se else 0.0


def constancy(found: Fit, addresses: Sequence[str]) -> Constancy | None:
    """The constancy of some parameters of a fit together, to first order about its minimum; None
    where the fit knows none of them, there are too few blocks, all move alike, or states that
    begin anew in every window would take up what a split gains."""
    if not found.ok or any(run.window for run in found.system.runs):
        return None
    blocks, sizes = _rows(found)
    norms = np.linalg.norm(found.jacobian, axis=0)
    used = [k for k, u in enumerate(found.system.unknowns) if u.run is None and norms[k] > 0.0]
    own = [place for place, k in enumerate(used) if k < found.system.count
           and found.system.free[k] in addresses]
    groups = by_size(sizes)
    if not own or len(blocks) < 2 * SIZE_GROUPS or _apart(sizes, groups) < SIZES_APART:
        return None
    rows = np.concatenate([np.arange(output.start, output.stop) for output, *_ in blocks])
    edges = np.cumsum([0, *(output.stop - output.start for output, *_ in blocks)])
    sums = Blocks(np.column_stack((found.jacobian[rows][:, used], found.white[rows])), edges,
                  np.ones(len(blocks)))
    rest = [place for place in range(len(used)) if place not in own]
    plain = sums.fit([*rest, *own], len(used))
    split = sums.fit_by_group(rest, own, len(used), groups)
    gain, error = log_ratio(split.errors, plain.errors)
    return Constancy(0.5 * gain, 0.5 * error)


def _rows(found: Fit) -> tuple[list[list[slice]], Array]:
    """The blocks of a fit as rows of its Jacobian, those of the output first and then of what else
    is compared, with the RMS (B,) of the motion, or of its change where the position drifts."""
    blocks: list[list[slice]] = []
    sizes, at, degree = [], 0, 1 if found.system.drifts else 0
    lengths = [parts[0].size - ws[0].order
               for parts, ws in zip(found.residuals, found.weights, strict=True)]
    for run, ws, parts, length in zip(found.system.runs, found.weights, cuts(lengths), lengths,
                                      strict=True):
        output = run.output[run.skip + ws[0].order:]
        own = [[slice(at + part.start, at + part.stop)] for part in parts]
        sizes += [float(np.std(np.diff(output[part], degree))) for part in parts]
        at += length
        for measured, weight in zip(run.measured[1:], ws[1:], strict=True):
            edges = at + np.linspace(0, measured.size - weight.order, len(own) + 1).astype(int)
            for each, (a, b) in zip(own, pairwise(edges), strict=True):
                each.append(slice(int(a), int(b)))
            at = int(edges[-1])
        blocks += own
    return blocks, np.array(sizes)


def _apart(sizes: Array, groups: Lines) -> float:
    """Motion of the group that moves most over that of the one that moves least."""
    return float(np.mean(sizes[groups == SIZE_GROUPS - 1])) / max(
        float(np.mean(sizes[groups == 0])), 1e-300)


def score_by_blocks(found: Fit) -> Score:
    """The middle (n, n) of the sandwich covariance with blocks as clusters, and its degrees of
    freedom: it covers parameters that drift.

    Each block's score is taken where the fit without that block has its minimum, to first order,
    because a block that moves most has bent the fit towards itself (the jackknife form CR3;
    Bell and McCaffrey, Survey Methodology 28, 2002, 169). Neighbours are put together, because
    what a model leaves may outlast a block.
    """
    blocks, _ = _rows(found)
    count = min(len(blocks), LONG_BLOCKS)
    begins = np.linspace(0, len(blocks), count, endpoint=False).astype(int)
    clusters = [[rows for block in blocks[a:b] for rows in block]
                for a, b in pairwise((*begins, len(blocks)))]
    norms = np.linalg.norm(found.jacobian, axis=0)
    norms[norms == 0.0] = 1.0
    grams, scores = [], []
    for cluster in clusters:
        columns = np.concatenate([found.jacobian[rows] for rows in cluster]) / norms
        grams.append(columns.T @ columns)
        scores.append(columns.T @ np.concatenate([found.white[rows] for rows in cluster]))
    gram = np.sum(grams, axis=0)
    moved = np.array([gram @ np.linalg.pinv(gram - own, rcond=RANK, hermitian=True) @ score
                      for own, score in zip(grams, scores, strict=True)]) * norms
    return moved.T @ moved * (count - 1.0) / count, float(max(count - 1, 1))


def score_with_remainder(found: Fit) -> Score:
    """The same where the fit leaves more than noise.

    Blocks show how the hidden part of what is missing varies. What is alike in all of them they
    cannot show: a force that follows from the motion has few independent terms, and the parameters
    have taken up some of these. As much is allowed for in each direction as one term of what is
    left has, beyond what may be noise.
    """
    middle, dof = score_by_blocks(found)
    noise = sum((high_band_rms(part) / w.sigma) ** 2 * float(w.polynomial @ w.polynomial)
                * (part.size - w.order) for parts, ws in zip(
                    found.residuals, found.weights, strict=True)
                for part, w in zip(parts, ws, strict=True))
    hidden = max(found.chi2 - NEAR_NOISE * noise, 0.0) / REMAINDER_TERMS
    return middle + hidden * (found.jacobian.T @ found.jacobian), dof


RANK = 1e-10
"""Eigenvalue over the largest below which a parameter is seen in one block alone."""
