"""Samples that a logger dropped, in all columns at once and without a trace in the time stamps.

A one-step predictor (ARX: Ljung, System Identification, 2nd ed., sec. 4.2) is fitted to the record
itself. Where samples are missing, it errs for as long as it looks back, and not at all once they
are put in; a spike of the reading and a push on the stage are explained otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import (
    LOST_AT_MOST,
    LOST_CLEAR,
    LOST_CURVED,
    LOST_EXPLAINED,
    LOST_IN_A_ROW,
    LOST_OTHERWISE,
)

ORDER = 6
"""Samples that the predictor looks back: two modes, a lag and a delay."""
EARLIER = 3
"""Errors before a loss that are looked at, too: a spike of the reading shows in one of them."""
AROUND = 12
"""Samples on either side that a missing input is interpolated from."""
SHORTEST = 120
"""Samples, for the 13 coefficients of the predictor."""
SINGLE = 0.3
"""Share of what several errors must come to that one of them has at least: of six, 0.41."""
OUTLYING = 5.0
"""Standard deviations from which an error is left out of a fit."""
MOVING = 0.1
"""Way within ORDER samples over its RMS, from which the stage moves: a reading that rests at one
count is predicted without error, and would make a step of one count look like a loss."""
ROBUST = 0.6745
"""Median over standard deviation of the size of a normal variable."""


@dataclass(frozen=True)
class Loss:
    """Samples missing before sample `at`: their `input` and `output` (m,) as estimated."""

    at: int
    input: Array
    output: Array


def find_lost(input_: Array, output: Array) -> list[Loss]:
    """Find samples that are missing in both `input_` (N,) and `output` (N,), in order of time.

    Nothing is found where the stage hardly moves within a sample: there it does no harm.
    """
    if output.size < SHORTEST or not (np.ptp(output) > 0.0 and np.ptp(input_) > 0.0):
        return []
    predictor = _Predictor.of((input_ - input_.mean()) / np.std(input_),
                              (output - output.mean()) / np.std(output))
    if predictor is None:
        return []
    error = predictor.error
    windowed = np.convolve(error**2, np.ones(ORDER))[ORDER - 1:]
    clear = LOST_CLEAR**2
    places = np.flatnonzero((np.abs(error) > SINGLE * LOST_CLEAR) & (windowed > clear))
    found: list[Loss] = []
    last = -1
    for first in places:
        if first <= last or not AROUND <= first - 1 < error.size - 2 * ORDER - 2:
            continue
        loss = predictor.explained(int(first))
        if loss is not None:
            found.append(Loss(loss.at, input_.mean() + np.std(input_) * loss.input,
                              output.mean() + np.std(output) * loss.output))
            last = loss.at + ORDER
    lost = sum(loss.input.size for loss in found)
    return found if lost <= LOST_AT_MOST * output.size else []


def put_in(signal: Array, losses: Sequence[Loss], values: Sequence[Array] | None = None) -> Array:
    """`signal` (N,) with the lost samples in their places: `values`, or a straight line."""
    parts, begin = [], 0
    for k, loss in enumerate(losses):
        count = loss.input.size
        line = np.linspace(signal[loss.at - 1], signal[loss.at], count + 2)[1:-1]
        parts += [signal[begin:loss.at], line if values is None else values[k]]
        begin = loss.at
    return np.concatenate([*parts, signal[begin:]])


class _Predictor:
    """y[k] from the samples before, fitted to `u` and `y` (N,); `error` (N,) over its spread."""

    def __init__(self, u: Array, y: Array, coefficients: Array, spread: float) -> None:
        self.u, self.y, self.coefficients, self.spread = u, y, coefficients, spread
        self.error = np.concatenate((np.zeros(ORDER), self.errors(u, y)))

    @cached_property
    def between(self) -> list[tuple[Array, Array]]:
        """How the input is filled in, for each number of samples that may be lost in a row."""
        return [_interpolation(self.u, count) for count in range(1, LOST_IN_A_ROW + 1)]

    @classmethod
    def of(cls, u: Array, y: Array) -> _Predictor | None:
        """Fitted twice, the second time without what stands out."""
        rows, target = _rows(u, y), y[ORDER:]
        way = np.abs(target - y[:-ORDER])
        moving = way > MOVING * math.sqrt(float(np.mean(way**2)))
        kept = np.ones(target.size, bool)
        for _ in range(3):
            solved = np.asarray(np.linalg.lstsq(rows[kept], target[kept], rcond=1e-12)[0], float)
            left = target - rows @ solved
            spread = float(np.median(np.abs(left[moving]))) / ROBUST
            kept = np.abs(left) < OUTLYING * spread
            if not spread > 0.0 or np.count_nonzero(kept) < rows.shape[1]:
                return None
        return cls(u, y, solved, spread)

    def errors(self, u: Array, y: Array) -> Array:
        """(n - ORDER,) of n samples, over their spread."""
        return np.asarray((y[ORDER:] - _rows(u, y) @ self.coefficients) / self.spread)

    def explained(self, near: int) -> Loss | None:
        """The loss at, or just before, a sample at which the predictor errs; None if it is no
        loss."""
        best: tuple[float, Loss] | None = None
        for at in range(near - 1, near + 2):
            for count in range(1, LOST_IN_A_ROW + 1):
                cost, loss = self._with(at, count)
                if best is None or cost < best[0]:
                    best = cost, loss
        assert best is not None  # noqa: S101 (there are several places)
        cost, loss = best
        begin, end = loss.at - ORDER - EARLIER, loss.at + 2 * ORDER
        u, y = self.u[begin:end], self.y[begin:end]
        plain = self.errors(u, y)
        before = float(plain @ plain)
        others = [_left(plain, self._changes(y.size, place, which))
                  for place in range(ORDER + 1, ORDER + EARLIER + 3) for which in range(2)]
        is_loss = cost < LOST_EXPLAINED * before and cost < LOST_OTHERWISE * min(others)
        return loss if is_loss and self._continues(loss) else None

    def _continues(self, loss: Loss) -> bool:
        """Whether the readings put in continue the motion: a controller's law, which predicts a
        reading from the input without error, puts in what no stage can follow.

        Between samples that are `steps` apart a line errs by steps^2 / 8 of the second difference.
        """
        steps = loss.input.size + 1
        curve = np.abs(np.concatenate([np.diff(part, 2) for part in (
            self.y[loss.at - AROUND:loss.at], self.y[loss.at:loss.at + AROUND])]))
        line = np.linspace(self.y[loss.at - 1], self.y[loss.at], steps + 1)[1:-1]
        allowed = LOST_CURVED * steps**2 / 8 * curve.max()
        return bool(np.max(np.abs(loss.output - line)) <= allowed)

    def _changes(self, size: int, place: int, which: int) -> Array:
        """How errors change with one sample of the reading, or of the input (n, 1)."""
        zero, unit = np.zeros(size), np.zeros(size)
        unit[place] = 1.0
        ones = self.errors(zero, zero)
        moved = self.errors(zero, unit) if which else self.errors(unit, zero)
        return np.asarray((moved - ones)[:, None])

    def _with(self, at: int, count: int) -> tuple[float, Loss]:
        """The squares left with `count` samples put in before `at`, and these."""
        begin, end = at - ORDER - EARLIER, at + 2 * ORDER
        weights, doubt = self.between[count - 1]
        known = weights @ self.u[at - AROUND:at + AROUND]
        u = np.concatenate((self.u[begin:at], known, self.u[at:end]))
        y = np.concatenate((self.y[begin:at], np.zeros(count), self.y[at:end]))
        plain = self.errors(u, y)
        moves = np.hstack([self._changes(y.size, ORDER + EARLIER + k, which)
                           for which in (1, 0) for k in range(count)])
        prior = np.hstack((np.zeros((count, count)), np.diag(1.0 / doubt)))
        rows = np.vstack((moves, prior))
        target = np.concatenate((-plain, np.zeros(count)))
        solved = np.linalg.lstsq(rows, target, rcond=1e-12)[0]
        left = target - rows @ solved
        return float(left @ left), Loss(at, np.asarray(known + solved[count:]),
                                        np.asarray(solved[:count]))


def _rows(u: Array, y: Array) -> Array:
    """(N - ORDER, 2 ORDER + 1): past readings and inputs, and one.

    Not the present input: a controller computes it from the present reading, exactly.
    """
    size = y.size - ORDER
    past = [y[ORDER - i:ORDER - i + size] for i in range(1, ORDER + 1)]
    fed = [u[ORDER - i:ORDER - i + size] for i in range(1, ORDER + 1)]
    return np.asarray(np.array([*past, *fed, np.ones(size)]).T)


def _interpolation(u: Array, count: int) -> tuple[Array, Array]:
    """Weights (count, 2 AROUND) of the samples around so many missing ones, and the RMS errors
    (count,) that they make: nearly exact where the input is smooth."""
    windows = np.lib.stride_tricks.sliding_window_view(u, 2 * AROUND + count)
    around = np.delete(windows, np.s_[AROUND:AROUND + count], axis=1)
    missing = windows[:, AROUND:AROUND + count]
    kept = np.ones(len(windows), bool)
    for _ in range(2):
        weights = np.linalg.lstsq(around[kept], missing[kept], rcond=1e-9)[0].T
        errors = np.abs(missing - around @ weights.T)
        kept = errors[:, 0] <= OUTLYING * np.median(errors[:, 0]) / ROBUST
    doubt = np.sqrt(np.mean(errors[kept] ** 2, axis=0))
    return np.asarray(weights), np.maximum(doubt, 1e-9)


def _left(errors: Array, changes: Array) -> float:
    """Squares of `errors` (n,) that a multiple of `changes` (n, 1) leaves."""
    power = float(changes[:, 0] @ changes[:, 0])
    along = float(changes[:, 0] @ errors)
    return float(errors @ errors) - along**2 / max(power, 1e-300)
