"""Every effect at its starting points, as columns of a regression in the force domain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.black_box import features
from dfm_stage.diagnosis.blocks import Blocks, Solution, block_edges
from dfm_stage.diagnosis.candidates import excluded, starts
from dfm_stage.diagnosis.decisions import BLOCKS, FEWEST_CYCLES
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_domain import Terms, not_judged
from dfm_stage.diagnosis.force_setting import FEWEST, SHORTEST_KEPT, Setting, least_squares
from dfm_stage.diagnosis.spectra import frequency_peaks
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import Parameters

REFINED = 3
"""Times that the starting points next to the best one are brought closer to it."""
UNSEEN = 1e-4
"""Share of a term that the base parameters must leave for it to be seen."""
GRID = 20
"""Starting points up to which they are refined; a longer grid is dense already."""
SAME = 1e-10
"""Singular value over the largest below which base columns are the same."""


@dataclass(frozen=True)
class Candidate:
    """An effect at one starting point: the parameters of each of its `columns`; of one whose size
    is not free the `target` that it leaves instead, and by what `factor` that has less power: an
    effect that takes from the input makes every remainder smaller."""

    name: str
    directions: tuple[Parameters, ...]
    columns: tuple[int, ...]
    target: int = 0
    factor: float = 1.0

    def wrong_sign(self, coefficients: Array) -> bool:
        """Whether its size (first of `coefficients`) is on the wrong side of zero."""
        effect = EFFECTS[self.name]
        return bool(effect.one_sided and effect.wave is None and coefficients.size > 0
                    and coefficients[0] <= 0.0)


class Candidates:
    """Base columns, missing force and the columns of all candidates, over blocks.

    `base` (n, k) are the columns of the base parameters and of the effects that the model has.
    `columns` are (n,) each and off the base; the first is the missing force, from force_constant
    times input. `shadows` (k,) is what the base columns had of each. `refused` says why an effect
    of the library is not judged. The last of the runs are held out beyond `fitted_runs`.
    """

    def __init__(self, found: Setting, model: Model, fitted_runs: int,
                 library: Sequence[str]) -> None:
        self.setting, self.model = found, model
        self.terms = Terms(found.runs, model, found.linear, found.timing)
        own = [self._term(use.name, use.parameters) for use in model.effects
               if use.effect.late is None]
        self.base = np.column_stack((found.columns, *(-c for c in own if c.size)))
        norms = np.maximum(np.linalg.norm(self.base, axis=0), 1e-300)
        left, values, _ = np.linalg.svd(self.base / norms, full_matrices=False)
        self.space = left[:, values > SAME * values[0]]
        self.inverse = np.linalg.pinv(self.base / norms, rcond=SAME) / norms[:, None]
        self.plain = self.inverse @ found.target
        self.edges, self.owner = block_edges([run.kept.size for run in found.runs], BLOCKS,
                                             SHORTEST_KEPT)
        self.fitted = self.owner < fitted_runs
        if self.fitted.sum() < FEWEST:
            raise DiagnosisError("the records are too short for a look at forces")
        self.missing = self.off_base(found.target)
        self.columns: list[Array] = [self.missing]
        self.shadows: list[Array] = [np.zeros(self.base.shape[1])]
        self.at = self._conditions()
        self.refused: dict[str, str] = {}
        self.points = {n: p for n in library if (p := self._points(n))}

    def off_base(self, columns: Array) -> Array:
        """`columns` (n,) or (n, c) without what the base parameters can do."""
        return np.asarray(columns - self.space @ (self.space.T @ columns))

    def _term(self, name: str, parameters: Mapping[str, float]) -> Array:
        """The force (n,) of an effect; empty where it has none."""
        parts = self.terms.parts(name, parameters)
        return self.setting.stacked(parts) if parts is not None else np.empty(0)

    def _conditions(self) -> Conditions:
        """Sizes in the runs, and the lines of the missing force."""
        runs = self.setting.runs
        at = Conditions.of(self.model.base, self.model.drive, [run.run for run in runs],
                           math.sqrt(max(run.noise for run in runs)),
                           self.model.position_unit)
        ends = np.cumsum([run.kept.size for run in runs])[:-1]
        stride = int(np.median(np.diff(runs[0].kept)))
        lines = frequency_peaks([np.asarray(p) for p in np.split(self.missing, ends)],
                                stride * at.sample_period, lowest_hz=FEWEST_CYCLES / at.duration)
        return replace(at, frequencies=tuple(lines))

    def _points(self, name: str) -> list[Candidate]:
        """The effect at its starting points, and between the best of them."""
        effect = EFFECTS[name]
        why = excluded(name, self.model, self.at)
        if (effect.adds_to == "constant_force" and not self.setting.offset
                and self.model.effect(name) is None):
            why = None          # an encoder's zero is no force without a spring
        why = why or not_judged(effect, self.terms.linear.stiffness > 0.0,
                                any(run.run.driven for run in self.setting.runs))
        found = [] if why else [c for p in starts(name, self.at)
                                if (c := self._candidate(name, p)) is not None]
        if not found:
            self.refused[name] = why or "it gives no force on these records"
        return self._refined(found) if 1 < len(found) <= GRID else found

    def _candidate(self, name: str, parameters: Parameters) -> Candidate | None:
        directions = EFFECTS[name].directions(parameters, self.at)
        found = [self._term(name, p) for p in directions]
        if any(c.size == 0 or not np.all(np.isfinite(c)) for c in found):
            return None
        off = [-self.off_base(c) for c in found]
        if max(float(np.linalg.norm(c)) for c in off) <= UNSEEN * max(
                float(np.linalg.norm(c)) for c in found):
            return None
        first = len(self.columns)
        self.shadows += [self.inverse @ c for c in found]
        if EFFECTS[name].searched:
            self.columns.append(self.missing - off[0])
            less = np.linalg.norm(self.setting.target) / max(
                float(np.linalg.norm(self.setting.target + found[0])), 1e-300)
            return Candidate(name, (dict(parameters),), (), first, float(less**2))
        self.columns += off
        return Candidate(name, tuple(directions), tuple(range(first, first + len(off))))

    def _refined(self, own: list[Candidate]) -> list[Candidate]:
        """Bring the starting points next to the best one closer to it."""
        if own[0].target:
            return own
        left = [self._left(c) for c in own]
        for _ in range(REFINED):
            best = int(np.argmin(left))
            for k in (best + 1, best):
                if not 0 < k < len(own):
                    continue
                new = self._candidate(own[k].name, _between(own[k - 1].directions[0],
                                                            own[k].directions[0]))
                if new is not None:
                    own.insert(k, new)
                    left.insert(k, self._left(new))
        return own

    def _left(self, candidate: Candidate) -> float:
        """Power that a candidate leaves in sample."""
        columns = np.column_stack([self.columns[c] for c in candidate.columns])
        values = least_squares(columns, self.missing)
        if candidate.wrong_sign(values):
            values = 0.0 * values
        return float(np.mean((self.missing - columns @ values) ** 2))


def _between(a: Parameters, b: Parameters) -> Parameters:
    """Parameters half-way, as the geometric mean where both have one sign."""
    return {n: math.copysign(math.sqrt(a[n] * b[n]), a[n]) if a[n] * b[n] > 0.0
            else 0.5 * (a[n] + b[n]) for n in a}


@dataclass(frozen=True)
class Fitted:
    """A set of candidates with its fit by blocks."""

    members: tuple[Candidate, ...]
    solution: Solution

    @property
    def names(self) -> tuple[str, ...]:
        """The effects."""
        return tuple(m.name for m in self.members)

    @property
    def level(self) -> float:
        """Mean logarithm of the blocks' held-out errors, by which sets are ranked."""
        return float(np.mean(np.log(self.solution.errors + 1e-300)))


class Fits:
    """Fits of sets of candidates to the missing force, and of a black box."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        self.base = tuple(range(candidates.base.shape[1]))
        self.first = len(self.base)
        count = len(candidates.columns)
        extra = candidates.off_base(candidates.setting.stacked_features(features))
        self.extra = tuple(range(self.first + count, self.first + count + extra.shape[1]))
        self.blocks = Blocks(np.column_stack((candidates.base, *candidates.columns, extra)),
                             candidates.edges, candidates.fitted)
        self.bare = Fitted((), self.blocks.fit(self.base, self.first))

    def place(self, members: Sequence[Candidate]) -> tuple[list[int], int]:
        """Columns and target of a set of candidates."""
        return ([c + self.first for m in members for c in m.columns],
                self.first + next((m.target for m in members if m.target), 0))

    def fit(self, members: tuple[Candidate, ...]) -> Fitted | None:
        """None where a size or the mass comes out on the wrong side of zero, or two are not
        free."""
        if sum(m.target > 0 for m in members) > 1:
            return None
        columns, target = self.place(members)
        solution = self.blocks.fit([*self.base, *columns], target)
        at = self.first
        for m in members:
            if m.wrong_sign(solution.coefficients[at:at + len(m.columns)]):
                return None
            at += len(m.columns)
        if "mass" in self.candidates.setting.names and self.base_of(
                members, solution.coefficients)[0] <= 0.0:
            return None
        return Fitted(members, replace(solution, errors=solution.errors * _factor(members)))

    def base_of(self, members: Sequence[Candidate], coefficients: Array) -> Array:
        """Base parameters (k,) beside a set whose fit gave `coefficients`."""
        candidates, at = self.candidates, self.first
        _, target = self.place(members)
        found = candidates.plain + coefficients[:at] + candidates.shadows[target - at]
        for column in (c for m in members for c in m.columns):
            found = found + coefficients[at] * candidates.shadows[column]
            at += 1
        return np.asarray(found)

    def black_box(self, members: Sequence[Candidate] = ()) -> Array:
        """Held-out errors (B,) of a black box, alone or beside effects."""
        columns, target = self.place(members)
        found = self.blocks.ridge_fit([*self.base, *columns], self.extra, target, RIDGES)
        return found.errors * _factor(members)


def _factor(members: Sequence[Candidate]) -> float:
    """Makes errors comparable with those of the target that is not smaller."""
    return math.prod(m.factor for m in members)


RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties of the black box that are tried."""
