"""A second witness: which effects explain the missing force, without simulating anything.

The missing force is regressed on what each effect would give along the measured motion, held out
by blocks, all records and amplitudes pooled. Seconds for the whole library, singles and pairs; an
opinion that shares no assumption about initial states and free motion with the simulated fits,
and starting values for them. It cannot tell what is smaller than the noise leaves of a force.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import jackknife, log_ratio
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    FORCE_WORTH,
    FURTHER_PART,
    LEAST_PREDICTABLE,
    SWAMPED,
)
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_candidates import Candidates, Fits, Fitted
from dfm_stage.diagnosis.force_domain import WIDTHS, RunForces
from dfm_stage.diagnosis.force_setting import settled
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.model_fit import default_free
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.effect import Parameters

PAIRED, LEADING = 10, 3
"""Effects that explain most: so many are combined to pairs, so many of them with all others."""
POINTS = 3
"""Starting points of an effect that are tried in a pair."""
SHOWN = 20
"""Pairs that are told."""


@dataclass(frozen=True)
class Explained:
    """What a set of effects explains of the missing force on held-out blocks.

    `share` is of its power above the noise, `share_se` its standard error;
    `of_predictable` is that over the share of the best of all, black boxes included.
    `parameters` are the base's and the effects' by address, SI; `errors` the jackknife standard
    errors of those that are free here.
    """

    names: tuple[str, ...]
    share: float
    share_se: float
    of_predictable: float
    parameters: Mapping[str, float]
    errors: Mapping[str, float]

    def of_effect(self, name: str) -> Parameters:
        """Its parameters, with defaults of what the force domain cannot see."""
        return {p: self.parameters.get(f"{name}.{p}", value)
                for p, value in EFFECTS[name].defaults.items()}


@dataclass(frozen=True)
class Witness:
    """What the force domain says by itself.

    `base` has the base parameters alone. `singles` and `pairs` are best first, `best` is the
    best pair where it clearly beats the best single effect, else that. `margins` are, by member
    of `best`, how far each rival stays behind in its place: the mean log ratio of the blocks'
    errors, in its standard errors; smallest first.

    `left` is the RMS share of the missing force that the best of all leaves: of the effects, of a
    black box alone (`black_box`), of a black box on top of the effects (`on_top`). `missing` is
    the RMS of the missing force over the actuator's, `noise` the share of its power that is noise.

    `late_samples` is when the input acts and its standard error, beside the lags that the model
    has; 0.5 for a held one. It is a nuisance here, not a finding. `held` tells how the input was
    taken, `width_samples` is the filter's standard deviation, `blocks` their number, `not_judged`
    says of the other effects why.
    """

    base: Explained
    singles: tuple[Explained, ...]
    pairs: tuple[Explained, ...]
    best: Explained
    margins: Mapping[str, Mapping[str, float]]
    left: float
    black_box: float
    on_top: float
    missing: float
    noise: float
    late_samples: tuple[float, float]
    held: bool
    width_samples: float
    blocks: int
    not_judged: Mapping[str, str]

    @property
    def cannot_tell(self) -> bool:
        """Whether noise swamps the missing force behind every filter."""
        return self.noise > SWAMPED

    @property
    def predictable_share(self) -> float:
        """Share of the missing force's power that can be predicted."""
        return 1.0 - self.left**2

    @property
    def nearest(self) -> dict[str, float]:
        """How far each rival stays behind in the place of the member where it comes nearest."""
        found: dict[str, float] = {}
        for each in self.margins.values():
            for rival, behind in each.items():
                found[rival] = min(behind, found.get(rival, math.inf))
        return dict(sorted(found.items(), key=lambda item: item[1]))

    def explained_by(self, names: Sequence[str]) -> bool:
        """Whether effects of `names` alone explain most of what can be predicted, and no others
        clearly more."""
        predictable = max(self.predictable_share, LEAST_PREDICTABLE)
        return not self.cannot_tell and set(self.best.names) <= set(names) and (
            self.best.share > FURTHER_PART * predictable)

    def of(self, *names: str) -> Explained | None:
        """What a single effect or a pair explains, in any order; None where not told."""
        wanted = set(names)
        return next((e for e in (*self.singles, *self.pairs) if set(e.names) == wanted), None)


def witness(runs: Sequence[Observation], model: Model, library: Sequence[str], *,
            held: Sequence[Observation] = (), free: Sequence[str] | None = None) -> Witness:
    """Judge every effect of `library`, and pairs of them, in the force domain.

    Parameters
    ----------
    runs : to fit. `held` : to predict and never to fit.
    free : base parameters that a fit would free (default: `default_free`). With `mass` among them
        forces are in the force constant's scale, else in that of the given mass.

    Raises
    ------
    DiagnosisError
        If the records are too short behind the filter that their noise asks for, the input does
        nothing, or an acceleration was measured.
    """
    if any(run.order > 1 for run in (*runs, *held)):
        raise DiagnosisError("a look at forces needs a measured position or velocity: an "
                             "acceleration integrated twice drifts by its noise")
    found, noise, late = settled([RunForces(run, WIDTHS[0]) for run in (*runs, *held)], model,
                                 len(runs))
    fits = Fits(Candidates(found, model, len(runs), library))
    sets = _Sets.of(fits)
    alone, on_top = fits.black_box(), fits.black_box(sets.best.members)
    whole = _power(fits, fits.bare.solution.errors)
    left = [min(1.0, _power(fits, e) / whole)
            for e in (sets.best.solution.errors, alone, on_top)]
    figures = _Figures(fits, noise, min(left), "mass" in (
        default_free(model) if free is None else free))
    wrong = {name: "its size, or the mass beside it, comes out on the wrong side of zero"
             for name in fits.candidates.points if name not in {s.names[0] for s in sets.singles}}
    return Witness(
        base=figures.explained(fits.bare),
        singles=tuple(figures.explained(s) for s in sets.singles),
        pairs=tuple(figures.explained(s) for s in sets.pairs[:SHOWN]),
        best=figures.explained(sets.best), margins=sets.margins(),
        left=math.sqrt(min(left)), black_box=math.sqrt(left[1]), on_top=math.sqrt(left[2]),
        missing=float(np.linalg.norm(fits.candidates.missing) / np.linalg.norm(found.target)),
        noise=noise, late_samples=late, held=found.timing.held,
        width_samples=found.runs[0].width, blocks=fits.blocks.count,
        not_judged={**fits.candidates.refused, **wrong})


def _power(fits: Fits, errors: Array) -> float:
    return float(errors @ fits.blocks.sizes)


@dataclass(frozen=True)
class _Sets:
    """Single effects and pairs at the best of their points, best first, and the best of all."""

    singles: Sequence[Fitted]
    pairs: Sequence[Fitted]
    best: Fitted

    @classmethod
    def of(cls, fits: Fits) -> _Sets:
        """Fit them."""
        points = {}
        for name, candidates in fits.candidates.points.items():
            found = [f for c in candidates if (f := fits.fit((c,))) is not None]
            if found:
                points[name] = sorted(found, key=lambda f: f.level)
        singles = sorted((f[0] for f in points.values()), key=lambda f: f.level)
        names = [s.names[0] for s in singles]
        pairs = []
        for a, b in combinations(names, 2):
            if names.index(a) >= LEADING and names.index(b) >= PAIRED:
                continue
            tried = [fits.fit((p.members[0], q.members[0]))
                     for p in points[a][:POINTS] for q in points[b][:POINTS]]
            good = [f for f in tried if f is not None]
            if good:
                pairs.append(min(good, key=lambda f: f.level))
        pairs.sort(key=lambda f: f.level)
        return cls(singles, pairs, cls._best(fits, singles, pairs))

    @staticmethod
    def _best(fits: Fits, singles: Sequence[Fitted], pairs: Sequence[Fitted]) -> Fitted:
        if not singles:
            return fits.bare
        single = singles[0]
        if not pairs:
            return single
        pair = pairs[0]
        mean, error = log_ratio(pair.solution.errors, single.solution.errors)
        added = _power(fits, single.solution.errors) - _power(fits, pair.solution.errors)
        worth = added > FORCE_WORTH * _power(fits, fits.bare.solution.errors)
        return pair if worth and mean > BLOCK_MARGIN * error else single

    def margins(self) -> dict[str, dict[str, float]]:
        """By member of the best set, of each rival that takes its place."""
        own = self.best
        found: dict[str, dict[str, float]] = {name: {} for name in own.names}
        for rival in self.singles if len(own.names) == 1 else self.pairs:
            new, old = set(rival.names) - set(own.names), set(own.names) - set(rival.names)
            if len(new) == 1:
                mean, error = log_ratio(own.solution.errors, rival.solution.errors)
                found[old.pop()][new.pop()] = mean / max(error, 1e-300)
        return {name: dict(sorted(each.items(), key=lambda item: item[1]))
                for name, each in found.items()}


class _Figures:
    """Shares, parameters and constancy of fitted sets.

    `noise` and `left` are shares of the missing force's power: what is noise, and what the best
    of all leaves. With `keep_gain` the force constant is as given, else the mass.
    """

    def __init__(self, fits: Fits, noise: float, left: float, keep_gain: bool) -> None:
        self.fits, self.candidates, self.keep_gain = fits, fits.candidates, keep_gain
        self.noise = min(noise, SWAMPED)
        self.whole = fits.bare.solution.errors
        self.reached = self._share(left * self.whole)[0]

    def explained(self, found: Fitted) -> Explained:
        """All figures of a set."""
        share, error = self._share(found.solution.errors)
        values = self._values(found, found.solution.coefficients)
        parts = [self._values(found, c) for c in found.solution.left_out]
        errors = jackknife(np.array([[p[n] for n in values] for p in parts]))
        return Explained(
            found.names, share, error, share / self.reached if self.reached > 0.0 else 0.0,
            values, {n: float(e) for n, e in zip(values, errors, strict=True)
                     if e > FIXED * abs(values[n])})

    def _share(self, errors: Array) -> tuple[float, float]:
        """Of the power above the noise, and its standard error: from block to block, and what
        may be noise."""
        sizes = self.fits.blocks.sizes
        before, after = self.whole * sizes, errors * sizes

        def ratio(whole: float, left: float) -> float:
            return (whole - left) / max((1.0 - self.noise) * whole, 1e-300)

        without = [[ratio(float(before.sum() - a), float(after.sum() - b))]
                   for a, b in zip(before, after, strict=True)]
        return (min(ratio(float(before.sum()), float(after.sum())), 1.0),
                math.hypot(float(jackknife(np.array(without))[0]), self.noise))

    def _values(self, found: Fitted, coefficients: Array) -> dict[str, float]:
        """Parameters by address from the coefficients of a fit."""
        candidates = self.candidates
        base = self.fits.base_of(found.members, coefficients)
        place, values = self.fits.first, {}
        for m in found.members:
            multiples = coefficients[place:place + len(m.columns)]
            place += len(m.columns)
            own = (EFFECTS[m.name].combined(m.directions, multiples) if m.columns
                   else m.directions[0])
            values.update({f"{m.name}.{n}": float(v) for n, v in own.items()})
        names = [n for n in candidates.setting.names if n != "late"]
        given = dict(zip(names, base[:len(names)].tolist(), strict=True))
        return self._in_scale({**given, "force_constant": candidates.terms.gain, **values})

    def _in_scale(self, values: dict[str, float]) -> dict[str, float]:
        """The same with all forces in the scale of the given mass, unless it is free or is that
        scale already."""
        if self.keep_gain or values.get("mass", 0.0) <= 0.0:
            return values
        factor = self.candidates.model.base["mass"] / values["mass"]
        for address in values:
            name, _, own = address.rpartition(".")
            if not name or (own in EFFECTS[name].sizes
                            and "N" in EFFECTS[name].parameter(own).unit):
                values[address] *= factor
        return values


FIXED = 1e-12
"""Relative jackknife error below which a value is not free."""
