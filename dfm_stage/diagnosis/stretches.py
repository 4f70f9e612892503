"""Stretches of a long record that tell most of the stage, in the place of all of it.

A stage that follows the surrogate model

    m a + c v + d |v| v + k x + k2 x^2 + k3 x^3 + f sgn v = input

tells of its coefficients by the Gram matrix of these features. Stretches are chosen one by one,
each the one that raises the log-determinant of the summed matrix most (D-optimal design: Fedorov,
Theory of Optimal Experiments, 1972; of the greedy choice: Nemhauser, Wolsey and Fisher,
Mathematical Programming 14, 1978). Each size of motion and each part of the record has
coefficients of its own, so that all are among the chosen and what drifts stays visible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    LEAST_INFORMATION,
    LONG_RECORD,
    OFFSET_SIGMAS,
    RETUNE_GAIN,
    RETUNE_RATIO,
    SIZE_GROUPS,
    SMALLEST_MOTION,
    STRETCH,
    STRETCH_FILTER,
    STRETCH_PARTS,
    TIME_PARTS,
)
from dfm_stage.diagnosis.fit import fit, rms
from dfm_stage.diagnosis.observation import Observation, axis_name, observe
from dfm_stage.identification.convention import find_convention
from dfm_stage.identification.motion import ORDER, differentiated
from dfm_stage.identification.weights import Weights
from dfm_stage.model import Model
from dfm_stage.quantity import display_unit, format_number, format_quantity
from dfm_stage.recording import Record
from dfm_stage.recording.record import AxisRecord


@dataclass(frozen=True)
class Stretches:
    """What was chosen of one long record.

    `fitted` and `held` are the first samples of stretches of `length` samples, most telling first;
    `sizes` are the least and the largest RMS motion among them, in `unit`. `still` is the share of
    the record in stretches in which the stage stands still, at least for a part.
    """

    record: str
    samples: int
    sample_period: float
    length: int
    fitted: tuple[int, ...]
    held: tuple[int, ...]
    sizes: tuple[float, float]
    unit: str
    still: float

    @property
    def words(self) -> str:
        """What was chosen, why, and what it cannot show."""
        length = format_quantity(self.length * self.sample_period, "s")
        factor, unit = display_unit(self.sizes, self.unit)
        small, large = (format_number(factor * size, 2) for size in self.sizes)
        kinds = [f"{len(starts)} {how}" for starts, how in (
            (self.fitted, "fitted"), (self.held, "held out")) if starts]
        still = f"; in {self.still:.0%} of the record the stage stands still at times" \
            if self.still > 0.0 else ""
        return (f"{self.record}: {len(self.fitted) + len(self.held)} stretches of {length} "
                f"({', '.join(kinds)}), chosen of "
                f"{self.samples * self.sample_period:.5g} s: from its beginning, middle and end, "
                f"with small and large motion ({small} to {large} {unit} RMS), where it tells "
                f"most{still}. The answer speaks for these. What takes longer than {length}, as "
                "creep and drifts may, cannot be seen in them")

    def to_dict(self) -> dict[str, Any]:
        """As diagnosis.json keeps it: begin and end of each stretch, s since the record began."""
        return {"record": self.record, "of_s": self.samples * self.sample_period,
                "length_s": self.length * self.sample_period,
                "fitted_s": self._times(self.fitted), "held_out_s": self._times(self.held),
                "still_share": self.still, "words": self.words}

    def _times(self, starts: Sequence[int]) -> list[list[float]]:
        return [[round(at * self.sample_period, 9) for at in (start, start + self.length)]
                for start in sorted(starts)]


def is_long(record: Record) -> bool:
    """Whether stretches of a record are diagnosed in its place."""
    return len(record) > LONG_RECORD


def observe_stretches(record: Record, model: Model, axis: str | None, name: str | None,
                      fitted: int, held: int
                      ) -> tuple[list[Observation], list[Observation], Stretches]:
    """Return stretches of one axis of a long record, `fitted` to fit and `held` to predict, by the
    convention of the whole record.

    Raises
    ------
    DiagnosisError
        As `observe` does.
    """
    called, chosen = name or record.provenance.source, axis_name(record, axis)
    data = record.axis(chosen)
    found = choose(record, data, called, fitted, held)
    known = find_convention(data.input, data.position, ORDER[data.measures],
                            hold=data.input_hold, shift=data.input_shift)

    def part(start: int) -> Observation:
        stop = start + found.length
        begin, end = (k * record.sample_period for k in (start, stop))
        return replace(observe(record.slice(start, stop), model, chosen,
                               f"{called}, {begin:g} to {end:g} s", known),
                       start_s=begin, of=called, part_of_record=TIME_PARTS * start // len(record))

    return [part(k) for k in found.fitted], [part(k) for k in found.held], found


def changes(model: Model, runs: Sequence[Observation], free: Sequence[str], weights: Weights,
            noise: float) -> list[str]:
    """Say which of the parameters `free` differ between the first and the last part of each long
    record: fitted to each part they must leave clearly less than one set for both does."""
    said = []
    for record in dict.fromkeys(run.of for run in runs if run.of):
        parts = [[k for k, run in enumerate(runs) if run.of == record
                  and run.part_of_record == part] for part in (0, TIME_PARTS - 1)]
        if not all(parts):
            continue
        both, first, last = (
            fit(model, [runs[k] for k in which], free, tuple(weights[k] for k in which),
                noise=noise) for which in (parts[0] + parts[1], *parts))
        left = rms([r[0] for each in (first, last) for r in each.residuals])
        if not (both.ok and first.ok and last.ok) or both.rms < RETUNE_RATIO * left \
                or both.chi2 - first.chi2 - last.chi2 < RETUNE_GAIN:
            continue
        for name in free:
            before, after = first.quantities[name], last.quantities[name]
            apart = math.hypot(before.half_width, after.half_width) / 1.96
            if abs(after.value - before.value) > OFFSET_SIGMAS * apart > 0.0:
                said.append(f"{record}: {name.replace('_', ' ')} differs between the first and "
                            f"the last part of the record: {before}, then {after}")
    return said


def choose(record: Record, data: AxisRecord, name: str, fitted: int, held: int) -> Stretches:
    """Choose `fitted` stretches of one axis of a record to fit, and `held` others to predict."""
    starts = np.arange(0, len(record) - STRETCH + 1, STRETCH)
    grams, sizes = (np.array(each) for each in zip(*(
        _seen(data.position[a:a + STRETCH], data, record.sample_period) for a in starts),
        strict=True))
    moving = np.flatnonzero(sizes > SMALLEST_MOTION * np.max(sizes))
    if moving.size < fitted + held:
        moving = np.arange(starts.size)
    grams, sizes, at = grams[moving], sizes[moving], starts[moving]
    groups = _sizes_apart(sizes), np.floor(TIME_PARTS * at / len(record))
    grams = _in_proportion(grams, groups[0])
    first = _most_telling(grams, groups, range(at.size), fitted)
    other = _most_telling(grams, groups, [b for b in range(at.size) if b not in first], held)
    chosen = sizes[[*first, *other]]
    return Stretches(name, len(record), record.sample_period, STRETCH,
                     tuple(at[first].tolist()), tuple(at[other].tolist()),
                     (float(np.min(chosen)), float(np.max(chosen))), data.position_unit,
                     1.0 - at.size / starts.size)


def _seen(output: Array, data: AxisRecord, period: float) -> tuple[Array, float]:
    """The Gram matrix (7, 7), a sample, of what the surrogate's coefficients multiply in one
    stretch, without means: an offset is fitted to each. And the RMS motion of its quietest
    part. Zero where a sample is missing."""
    if not np.all(np.isfinite(output)):
        return np.zeros((7, 7)), 0.0
    from scipy.ndimage import gaussian_filter1d  # slow to import; few records are long

    x, v, a = (gaussian_filter1d(differentiated(output - np.mean(output), k - ORDER[data.measures],
                                                period), STRETCH_FILTER) for k in range(3))
    turns = v / np.maximum(np.abs(v), max(SMALLEST_MOTION * float(np.max(np.abs(v))), 1e-300))
    found = np.array([a, v, x, np.abs(v) * v, x**2, x**3, turns])
    found -= found.mean(axis=1, keepdims=True)
    size = min(float(np.std(part)) for part in np.array_split(x, STRETCH_PARTS))
    return np.asarray(found @ found.T / output.size), size


def _sizes_apart(sizes: Array) -> Array:
    """The group (B,) of each stretch by its size of motion."""
    edges = np.quantile(sizes, np.arange(1, SIZE_GROUPS) / SIZE_GROUPS)
    return np.asarray(np.searchsorted(edges, sizes))


def _in_proportion(grams: Array, groups: Array) -> Array:
    """The same (B, 7, 7) with every feature over its RMS in the group."""
    scaled = np.empty_like(grams)
    for group in np.unique(groups):
        inside = groups == group
        power = np.mean(np.einsum("bii->bi", grams[inside]), axis=0)
        scale = np.sqrt(np.maximum(power, 1e-300))
        scaled[inside] = grams[inside] / np.outer(scale, scale)
    return scaled


def _most_telling(grams: Array, groups: Sequence[Array], among: Sequence[int],
                  count: int) -> list[int]:
    """Up to `count` of the stretches `among`, each the one that adds most to the
    log-determinants of what its groups tell so far."""
    known = {(kind, int(group)): LEAST_INFORMATION * np.eye(grams.shape[1])
             for kind, each in enumerate(groups) for group in each}
    left, found = list(among), list[int]()
    while left and len(found) < count:
        gains = [sum(_log_det(known[kind, int(each[b])] + grams[b])
                     - _log_det(known[kind, int(each[b])]) for kind, each in enumerate(groups))
                 for b in left]
        best = left.pop(int(np.argmax(gains)))
        for kind, each in enumerate(groups):
            known[kind, int(each[best])] = known[kind, int(each[best])] + grams[best]
        found.append(best)
    return found


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1])
