"""A second witness: which effects explain the missing force, without simulating anything.

The missing force is regressed on what each effect would give along the measured motion, held out
by blocks, all records and amplitudes pooled. Seconds for the whole library, singles and pairs; an
opinion that shares no assumption about initial states and free motion with the simulated fits,
and starting values for them. It cannot tell what is smaller than the noise leaves of a force.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from dfm_stage.arrays import Array, Lines
from dfm_stage.diagnosis.black_box import features
from dfm_stage.diagnosis.blocks import Blocks, Solution, block_edges, jackknife, margin
from dfm_stage.diagnosis.candidates import excluded, starts
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_domain import (
    EDGE,
    WIDTHS,
    Linear,
    RunForces,
    Terms,
    Timing,
    at_width,
    not_judged,
    shifted,
)
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.spectra import frequency_peaks
from dfm_stage.identification.model_fit import default_free
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import Parameters

BLOCKS = 30
"""Blocks over all records: enough for a standard error, each still with many periods."""
SHORTEST_BLOCK = 40
"""Kept samples of the shortest block."""
NOISE_SHARE = 0.01
"""Share of the missing force's power that noise may make up: the narrowest filter that keeps
below it is taken."""
BIASED = 0.3
"""Noise of the acceleration over its RMS behind a filter that is wide enough: noise in a term
biases its coefficient by the square."""
SWAMPED = 0.5
"""Share of noise in what is missing, behind the best filter, above which nothing can be told."""
EARLIEST, LATEST = -2.0, 4.0
"""Samples around the model's delay where the input's timing is looked for."""
REFINED = 3
"""Times that the starting values next to the best one are brought closer to it."""
PAIRED = 10
"""Effects that are combined to pairs: those that explain most by themselves."""
RIDGES = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Penalties of the black box that are tried."""
TERCILES = 3


@dataclass(frozen=True)
class Explained:
    """What a set of effects explains of the missing force on held-out blocks.

    `share` is of its power above the noise, with a jackknife standard error `share_se`;
    `of_predictable` is that over the share which the best of all, black boxes included, explains.
    `parameters` are the effects' and the base's by address, with the jackknife standard errors of
    those that are sizes in `errors`. `constancy` is the relative fall of what remains when the
    sizes may depend on record or amplitude, and its standard error.
    """

    names: tuple[str, ...]
    share: float
    share_se: float
    of_predictable: float
    parameters: Mapping[str, float]
    errors: Mapping[str, float]
    constancy: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Witness:
    """What the force domain says by itself.

    `base` has the base parameters alone. `singles` and `pairs` are best first, `best` is the
    smallest set that no larger one beats; `margins` are those of `best` over every rival in its
    place: the mean log ratio of the blocks' errors in its standard errors. `left` is the RMS share
    of the missing force that the best of effects, black box, and black box beside effects leaves;
    `black_box` and `beside` are what the latter two leave. `missing` is the RMS of the missing
    force over that of the actuator's, `noise` the share of its power that is noise. `late_samples`
    is the timing of the input with its standard error, `held` whether it is late enough for a held
    one. `width_samples` is the filter's. `x`, `v`, `force` (n,) are the motion and the force (N)
    that the base parameters leave, `remainder` (n,) what `best` leaves.
    """

    base: Explained
    singles: tuple[Explained, ...]
    pairs: tuple[Explained, ...]
    best: Explained
    margins: Mapping[str, float]
    left: float
    black_box: float
    beside: float
    missing: float
    noise: float
    late_samples: tuple[float, float]
    held: bool
    width_samples: float
    blocks: int
    not_judged: Mapping[str, str]
    seconds: float
    x: Array = field(repr=False, compare=False)
    v: Array = field(repr=False, compare=False)
    force: Array = field(repr=False, compare=False)
    remainder: Array = field(repr=False, compare=False)

    @property
    def cannot_tell(self) -> bool:
        """Whether noise swamps the missing force behind every filter."""
        return self.noise > SWAMPED


@dataclass(frozen=True)
class _Setting:
    """Filtered runs with timing, the base columns (n, k) and their names, target (n,) and the
    linear part that they give."""

    runs: Sequence[RunForces]
    timing: Timing
    names: tuple[str, ...]
    columns: Array
    target: Array
    linear: Linear
    offset: bool


@dataclass(frozen=True)
class _Candidate:
    """An effect at one starting point: where its columns are, and the target where its size is
    not free."""

    name: str
    directions: tuple[Parameters, ...]
    columns: tuple[int, ...]
    target: int = 0


def witness(runs: Sequence[Observation], model: Model, library: Sequence[str], *,
            held: Sequence[Observation] = (), free: Sequence[str] | None = None) -> Witness:
    """Judge every effect of `library` and pairs of them in the force domain.

    Parameters
    ----------
    runs : to fit. `held` : to predict and never to fit.
    free : base parameters that a fit would free (default: `default_free`). With `mass` among them
        the force constant is taken as given, else the mass.

    Raises
    ------
    DiagnosisError
        If the records are too short behind the filter that their noise asks for.
    """
    begun = time.monotonic()
    every = [RunForces(run, WIDTHS[0]) for run in (*runs, *held)]
    setting, noise, late = _settled(every, model)
    inquiry = _Inquiry(setting, model, len(runs), noise,
                       default_free(model) if free is None else free)
    found = inquiry.testimony(library, late)
    return replace(found, seconds=time.monotonic() - begun)


# -- filter and timing ---------------------------------------------------------------------------

def _setting(runs: Sequence[RunForces], model: Model, timing: Timing) -> _Setting:
    """Base columns and target; the linear part by least squares."""
    gain = model.base.get("force_constant", 1.0)
    spring = model.base.get("stiffness", 0.0) > 0.0
    offset = spring and "encoder_zero" not in model.base
    names = ["mass", "damping", *(["stiffness"] if spring else []),
             *(["constant_force"] if offset else []), "late"]
    centre = float(np.mean(np.concatenate([run.run.output for run in runs])))
    parts = []
    for run in runs:
        given = [run.derivative(2), run.derivative(1)]
        given += [run.derivative(0) - (centre if offset else 0.0)] if spring else []
        given += [np.ones(run.grid.size)] if offset else []
        given.append(gain * run.drive(timing, 1))
        parts.append(np.array(given)[:, run.kept])
    columns = np.concatenate(parts, axis=1).T
    target = np.concatenate([gain * run.drive(timing)[run.kept] for run in runs])
    values = dict(zip(names, _least_squares(columns, target), strict=True))
    linear = Linear(values["mass"], values["damping"], values.get("stiffness", 0.0))
    return _Setting(runs, timing, tuple(names), columns, target, linear, offset)


def _least_squares(columns: Array, target: Array) -> Array:
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(np.linalg.lstsq(columns / norms, target, rcond=1e-12)[0] / norms)


def _settled(runs: Sequence[RunForces], model: Model) -> tuple[_Setting, float,
                                                               tuple[float, float]]:
    """The filter and the timing that suit the records; the share of noise, and the timing in
    samples with its standard error."""
    period = runs[0].run.sample_period
    lag = model.base.get("amplifier_time_constant", 0.0)
    timing = Timing(model.base.get("delay", 0.0) + 0.5 * period, lag, True)
    shortest = min(run.grid.size for run in runs)
    widths = [w for w in WIDTHS if shortest >= 4.0 * EDGE * w + 4 * SHORTEST_BLOCK]
    if not widths:
        raise DiagnosisError("the records are too short for a look at forces")
    biased = {w: max(run.noise_rms(run.grid.omega**2, w) / float(np.std(run.derivative(2, w)))
                     for run in runs) for w in widths}
    usable = [w for w in widths if biased[w] < BIASED] or [min(widths, key=lambda w: biased[w])]
    best: tuple[float, _Setting] | None = None
    for width in usable:
        setting, share = _noise_share(_setting(at_width(runs, width), model, timing))
        if best is None or share < best[0]:
            best = share, setting
        if share < NOISE_SHARE:
            break
    assert best is not None
    timing, error = _timed(best[1].runs, model, timing)
    setting, share = _noise_share(_setting(best[1].runs, model, timing))
    return setting, share, (timing.late / period, error / period)


def _noise_share(setting: _Setting) -> tuple[_Setting, float]:
    left = setting.target - setting.columns @ _least_squares(setting.columns, setting.target)
    noise = sum(run.kept.size * run.noise_rms(setting.linear.operator(run.grid.omega), run.width)
                ** 2 for run in setting.runs) / max(left.size, 1)
    return setting, min(noise / max(float(np.mean(left**2)), 1e-300), 1.0)


def _timed(runs: Sequence[RunForces], model: Model, timing: Timing) -> tuple[Timing, float]:
    """When the input acts, beside forces that any stage may have, and its standard error, s."""
    period = runs[0].run.sample_period
    general = np.concatenate([np.array([
        run.filtered(f)[run.kept] for t in [run.trajectory] for f in (
            t.x**2, t.x**3, np.abs(t.v) * t.v, t.v / np.hypot(t.v, t.speed_noise + 1e-12))])
        for run in runs], axis=1).T

    def fitted(at: Timing) -> tuple[float, float, Array, Array]:
        setting = _setting(runs, model, at)
        columns = np.column_stack((setting.columns, general))
        values = _least_squares(columns, setting.target)
        left = setting.target - columns @ values
        return (float(np.mean(left**2)), float(values[setting.names.index("late")]), columns,
                setting.target)

    tried = [shifted(timing, by * period, period)
             for by in np.arange(EARLIEST, LATEST + 0.25, 0.5)]
    found = min(tried, key=lambda at: fitted(at)[0])
    for _ in range(TIMED):
        late = found.late + float(np.clip(fitted(found)[1], -period, period))
        found = shifted(timing, float(np.clip(late - timing.late, EARLIEST * period,
                                              LATEST * period)), period)
    _, _, columns, target = fitted(found)
    edges, _ = block_edges([target.size], BLOCKS, SHORTEST_BLOCK)
    blocks = Blocks(np.column_stack((columns, target)), edges, np.ones(edges.size - 1))
    left_out = blocks.fit(range(columns.shape[1]), columns.shape[1]).left_out
    place = columns.shape[1] - general.shape[1] - 1
    return found, float(jackknife(left_out)[place])


TIMED = 4
"""Steps of the search for the timing; it is nearly linear."""


# -- the inquiry ---------------------------------------------------------------------------------

class _Inquiry:
    """Collects columns, fits them by blocks and puts the figures together."""

    def __init__(self, setting: _Setting, model: Model, fitted_runs: int, noise: float,
                 free: Sequence[str]) -> None:
        self.setting, self.model, self.noise, self.free = setting, model, noise, free
        self.terms = Terms(setting.runs, model, setting.linear, setting.timing)
        own = [self.terms.column(use.name, use.parameters) for use in model.effects]
        self.base = np.column_stack((setting.columns, *(-c for c in own if c.size)))
        norms = np.maximum(np.linalg.norm(self.base, axis=0), 1e-300)
        left, values, _ = np.linalg.svd(self.base / norms, full_matrices=False)
        self.space = left[:, values > 1e-10 * values[0]]
        sizes = [run.kept.size for run in setting.runs]
        self.edges, self.owner = block_edges(sizes, BLOCKS, SHORTEST_BLOCK)
        self.fitted = self.owner < fitted_runs
        if self.fitted.sum() < FEWEST:
            raise DiagnosisError("the records are too short for a look at forces")
        self.amplitude = np.sqrt(np.add.reduceat(
            self._along(lambda run: run.trajectory.x - np.mean(run.trajectory.x)) ** 2,
            self.edges[:-1]) / np.diff(self.edges))
        self.missing = self._off(setting.target)
        self.columns: list[Array] = [self.missing]
        self.inverse = np.linalg.pinv(self.base / norms, rcond=1e-10) / norms[:, None]
        self.plain = self.inverse @ setting.target
        self.shadows: list[Array] = [np.zeros(self.base.shape[1])]
        self.candidates: list[_Candidate] = []

    def _along(self, of: object) -> Array:
        return np.concatenate([of(run)[run.kept]          # type: ignore[operator]
                               for run in self.setting.runs])

    def _off(self, columns: Array) -> Array:
        """`columns` (n,) or (n, c) without what the base parameters can do."""
        return np.asarray(columns - self.space @ (self.space.T @ columns))

    def testimony(self, library: Sequence[str], late: tuple[float, float]) -> Witness:
        """All there is to say."""
        refused = self._collect(library)
        return _told(self, refused, late)

    # -- candidates ------------------------------------------------------------------------------

    def conditions(self) -> Conditions:
        """Sizes in the runs, and the lines of the missing force."""
        runs = [run.run for run in self.setting.runs]
        at = Conditions.of(self.model.base, self.model.drive, runs,
                           math.sqrt(max(run.noise for run in self.setting.runs)))
        ends = np.cumsum([run.kept.size for run in self.setting.runs])[:-1]
        parts = [np.asarray(p) for p in np.split(self.missing, ends)]
        stride = int(np.median(np.diff(self.setting.runs[0].kept)))
        lines = frequency_peaks(parts, stride * at.sample_period, lowest_hz=2.0 / at.duration)
        return replace(at, frequencies=tuple(lines))

    def _collect(self, library: Sequence[str]) -> dict[str, str]:
        """Compute the columns of every candidate; return which are not judged, and why."""
        at, refused = self.conditions(), {}
        for name in library:
            effect = EFFECTS[name]
            why = not_judged(effect, self.terms.linear.stiffness > 0.0) or excluded(name, self.model, at)
            if effect.adds_to == "constant_force" and not self.setting.offset:
                why = None          # without a spring an encoder's zero is no force
            points = [] if why else starts(name, at)
            tried = [c for p in points if (c := self._candidate(name, p, at)) is not None]
            if not tried:
                refused[name] = why or "it gives no force on these records"
                continue
            self.candidates += tried
        self._refine(at)
        return refused

    def _candidate(self, name: str, parameters: Parameters, at: Conditions) -> _Candidate | None:
        effect = EFFECTS[name]
        directions = effect.directions(parameters, at)
        found = [self.terms.column(name, p) for p in directions]
        if any(c.size == 0 or not np.all(np.isfinite(c)) for c in found):
            return None
        off = [-self._off(c) for c in found]
        if max(float(np.linalg.norm(c)) for c in off) <= UNSEEN * max(
                float(np.linalg.norm(c)) for c in found):
            return None
        first = len(self.columns)
        if effect.searched:
            self.columns.append(self.missing - off[0])
            self.shadows.append(self.inverse @ found[0])
            return _Candidate(name, (dict(parameters),), (), first)
        self.columns += off
        self.shadows += [self.inverse @ c for c in found]
        return _Candidate(name, tuple(directions), tuple(range(first, first + len(off))))

    def _refine(self, at: Conditions) -> None:
        """Try parameters between the best starting point and its neighbours on the grid."""
        for name in dict.fromkeys(c.name for c in self.candidates):
            own = [c for c in self.candidates if c.name == name]
            if not 1 < len(own) <= GRID or own[0].target:
                continue
            errors = [self._quick(c) for c in own]
            for _ in range(REFINED):
                k = int(np.argmin(errors))
                for neighbour in (k + 1, k):
                    if not 0 < neighbour < len(own):
                        continue
                    a, b = own[neighbour - 1].directions[0], own[neighbour].directions[0]
                    new = self._candidate(name, _between(a, b), at)
                    if new is not None:
                        own.insert(neighbour, new)
                        errors.insert(neighbour, self._quick(new))
            self.candidates = [c for c in self.candidates if c.name != name] + own

    def _quick(self, candidate: _Candidate) -> float:
        """Power that a candidate leaves in sample; its columns are off the base already."""
        columns = np.column_stack([self.columns[c] for c in candidate.columns])
        values = _least_squares(columns, self.missing)
        if self._wrong_sign(candidate, values):
            return float(np.mean(self.missing**2))
        return float(np.mean((self.missing - columns @ values) ** 2))

    @staticmethod
    def _wrong_sign(candidate: _Candidate, values: Array) -> bool:
        effect = EFFECTS[candidate.name]
        return bool(effect.one_sided and effect.wave is None and values.size > 0
                    and values[0] <= 0.0)


FEWEST = 6
"""Blocks without which there is no standard error."""
UNSEEN = 1e-4
"""Share of a term that the base parameters must leave for it to be seen."""
GRID = 20
"""Starting points up to which they are refined; a longer grid is dense already."""


def _between(a: Parameters, b: Parameters) -> Parameters:
    """Parameters half-way, as the geometric mean where both have one sign."""
    return {n: math.copysign(math.sqrt(a[n] * b[n]), a[n]) if a[n] * b[n] > 0.0
            else 0.5 * (a[n] + b[n]) for n in a}


# -- fits and figures ----------------------------------------------------------------------------

@dataclass(frozen=True)
class _Fitted:
    """A set of candidates with its fit by blocks."""

    members: tuple[_Candidate, ...]
    solution: Solution

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(m.name for m in self.members)

    @property
    def level(self) -> float:
        """Mean logarithm of the blocks' errors: what sets are ranked by."""
        return float(np.mean(np.log(self.solution.errors + 1e-300)))


class _Ranking:
    """All fits of one inquiry."""

    def __init__(self, inquiry: _Inquiry) -> None:
        self.inquiry = inquiry
        extra = features(inquiry.setting.runs)
        self.base = tuple(range(inquiry.base.shape[1]))
        first = len(self.base)
        self.target = first
        count = len(inquiry.columns)
        self.extra = tuple(range(first + count, first + count + extra.shape[1]))
        self.blocks = Blocks(np.column_stack((inquiry.base, *inquiry.columns,
                                              inquiry._off(extra))), inquiry.edges,
                             inquiry.fitted)
        self.bare = self.fit(())
        singles: dict[str, list[_Fitted]] = {}
        for candidate in inquiry.candidates:
            found = self.fit((candidate,))
            if found is not None:
                singles.setdefault(candidate.name, []).append(found)
        self.points = {n: sorted(f, key=lambda s: s.level) for n, f in singles.items()}
        self.singles = sorted((f[0] for f in self.points.values()), key=lambda s: s.level)
        self.pairs = self._pairs()

    def fit(self, members: tuple[_Candidate, ...]) -> _Fitted | None:
        """None where a size comes out on the wrong side of zero."""
        at = [c + self.target for m in members for c in m.columns]
        target = self.target + next((m.target for m in members if m.target), 0)
        solution = self.blocks.fit([*self.base, *at], target)
        first = len(self.base)
        for m in members:
            width = len(m.columns)
            if _Inquiry._wrong_sign(m, solution.coefficients[first:first + width]):
                return None
            first += width
        return _Fitted(members, solution)

    def _pairs(self) -> list[_Fitted]:
        names = [s.names[0] for s in self.singles]
        wanted = {*combinations(names[:PAIRED], 2)}
        wanted |= {(a, b) for a in names[:LEADING] for b in names if names.index(b) > names.index(a)}
        found: dict[tuple[str, str], _Fitted] = {}
        for a, b in wanted:
            tried = [self.fit((p.members[0], q.members[0]))
                     for p in self.points[a][:POINTS] for q in self.points[b][:POINTS]
                     if not (p.members[0].target and q.members[0].target)]
            good = [t for t in tried if t is not None]
            if good:
                found[a, b] = min(good, key=lambda t: t.level)
        return sorted(found.values(), key=lambda t: t.level)


LEADING = 3
"""Effects that are combined with all others, however little those explain alone."""
POINTS = 3
"""Starting points of an effect that are tried in a pair."""
BEATS = 3.0
"""Standard errors by which a pair must beat the best single effect."""
WORTH = 0.005
"""Share of the missing force that a second effect must add."""


def _told(inquiry: _Inquiry, refused: Mapping[str, str], late: tuple[float, float]) -> Witness:
    ranking = _Ranking(inquiry)
    blocks, sizes = ranking.blocks, ranking.blocks.sizes
    bare = ranking.bare
    whole = float(bare.solution.errors @ sizes)

    def power(errors: Array) -> float:
        return float(errors @ sizes) / whole

    best = ranking.singles[0] if ranking.singles else bare
    if ranking.pairs:
        mean, error = margin(ranking.pairs[0].solution.errors, best.solution.errors)
        if mean > BEATS * error and power(best.solution.errors) - power(
                ranking.pairs[0].solution.errors) > WORTH:
            best = ranking.pairs[0]
    alone = blocks.ridge_errors(ranking.base, ranking.extra, ranking.target, RIDGES)
    at = [*ranking.base, *(c + ranking.target for m in best.members for c in m.columns)]
    goal = ranking.target + next((m.target for m in best.members if m.target), 0)
    beside = blocks.ridge_errors(at, ranking.extra, goal, RIDGES)
    left = min(1.0, power(best.solution.errors), power(alone), power(beside))
    figures = _Figures(ranking, left)
    setting, ends = inquiry.setting, inquiry.edges
    base = figures.explained(bare, False)
    kept = [run.trajectory for run in setting.runs]
    return Witness(
        base, tuple(figures.explained(s, k < CLOSER) for k, s in enumerate(ranking.singles)),
        tuple(figures.explained(s, k < CLOSER) for k, s in enumerate(ranking.pairs[:SHOWN])),
        figures.explained(best, True), _margins(ranking, best), math.sqrt(left),
        math.sqrt(min(1.0, power(alone))), math.sqrt(min(1.0, power(beside))),
        float(np.linalg.norm(inquiry.missing) / max(np.linalg.norm(setting.target), 1e-300)),
        inquiry.noise, late, setting.timing.held, setting.runs[0].width, ends.size - 1,
        dict(refused), 0.0,
        np.concatenate([t.x[r.kept] for t, r in zip(kept, setting.runs, strict=True)]),
        np.concatenate([t.v[r.kept] for t, r in zip(kept, setting.runs, strict=True)]),
        -inquiry.missing, -figures.remainder(best))


CLOSER, SHOWN = 4, 20
"""Sets whose constancy is looked at, and pairs that are told."""


def _margins(ranking: _Ranking, best: _Fitted) -> dict[str, float]:
    """How far each rival stays behind in the place of a member of `best`, in standard errors."""
    sets = ranking.singles if len(best.members) < 2 else ranking.pairs
    found: dict[str, float] = {}
    for rival in sets:
        new = set(rival.names) - set(best.names)
        if len(new) != 1:
            continue
        mean, error = margin(best.solution.errors, rival.solution.errors)
        behind, name = mean / max(error, 1e-300), new.pop()
        found[name] = min(behind, found.get(name, math.inf))
    return dict(sorted(found.items(), key=lambda item: item[1]))


class _Figures:
    """Shares, parameters and constancy of fitted sets."""

    def __init__(self, ranking: _Ranking, left: float) -> None:
        self.ranking, self.left = ranking, left
        self.inquiry = ranking.inquiry
        self.whole = ranking.bare.solution.errors

    def explained(self, found: _Fitted, closer: bool) -> Explained:
        share, error = self._share(found.solution.errors)
        values, errors = self._parameters(found)
        reached = self._share(self.left * self.whole)[0]
        return Explained(found.names, share, error, share / reached if reached > 0.0 else 0.0,
                         values, errors, self._constancy(found) if closer and found.members
                         else (0.0, 0.0))

    def _share(self, errors: Array) -> tuple[float, float]:
        """Of the power above the noise, and its jackknife standard error."""
        sizes = self.ranking.blocks.sizes

        def ratio(keep: Array) -> float:
            before = float(self.whole[keep] @ sizes[keep])
            noise = min(self.inquiry.noise, MOST_NOISE) * before
            return (before - float(errors[keep] @ sizes[keep])) / (before - noise)

        every = np.arange(sizes.size)
        without = np.array([[ratio(np.delete(every, b))] for b in every])
        return min(ratio(every), 1.0), float(jackknife(without)[0])

    def remainder(self, found: _Fitted) -> Array:
        """The force (n,) that a set leaves."""
        inquiry, first = self.inquiry, self.inquiry.base.shape[1]
        goal = next((m.target for m in found.members if m.target), 0)
        columns = np.column_stack((inquiry.base, *(
            inquiry.columns[c] for m in found.members for c in m.columns)))
        assert columns.shape[1] == found.solution.coefficients.size >= first
        return np.asarray(inquiry.columns[goal] - columns @ found.solution.coefficients)

    def _parameters(self, found: _Fitted) -> tuple[dict[str, float], dict[str, float]]:
        whole = self._values(found, found.solution.coefficients)
        parts = [self._values(found, c) for c in found.solution.left_out]
        errors = jackknife(np.array([[p[n] for n in whole] for p in parts]))
        return whole, {n: float(e) for n, e in zip(whole, errors, strict=True) if e > 0.0}

    def _values(self, found: _Fitted, coefficients: Array) -> dict[str, float]:
        inquiry = self.inquiry
        first = inquiry.base.shape[1]
        base = inquiry.plain + coefficients[:first]
        place, values = first, {}
        goal = next((m.target for m in found.members if m.target), 0)
        base = base + inquiry.shadows[goal]
        for m in found.members:
            multiples = coefficients[place:place + len(m.columns)]
            base = base + sum((c * inquiry.shadows[k] for c, k in zip(
                multiples, m.columns, strict=True)), np.zeros(first))
            place += len(m.columns)
            effect = EFFECTS[m.name]
            own = (effect.combined(m.directions, multiples) if m.columns
                   else dict(m.directions[0]))
            values.update({f"{m.name}.{n}": v for n, v in own.items()})
        given = dict(zip(inquiry.setting.names[:-1], base.tolist(), strict=False))
        gain = inquiry.model.base.get("force_constant", 1.0)
        if "mass" in inquiry.free or given["mass"] <= 0.0:
            return {**given, "force_constant": gain, **values}
        factor = inquiry.model.base["mass"] / given["mass"]
        for address in values:
            name, _, own_name = address.partition(".")
            effect = EFFECTS[name]
            if own_name in effect.sizes and "N" in effect.parameter(own_name).unit:
                values[address] *= factor
        return {**{n: v * factor for n, v in given.items()}, "force_constant": gain * factor,
                **values}

    def _constancy(self, found: _Fitted) -> tuple[float, float]:
        """The larger relative fall of the remainder when the sizes depend on amplitude or
        record, and its standard error."""
        inquiry, blocks = self.inquiry, self.ranking.blocks
        own = [c + self.ranking.target for m in found.members for c in m.columns]
        if not own:
            return 0.0, 0.0
        goal = self.ranking.target + next((m.target for m in found.members if m.target), 0)
        ranks = np.argsort(np.argsort(inquiry.amplitude))
        choices = [(ranks * TERCILES // ranks.size, np.ones(ranks.size, dtype=bool))]
        owners = inquiry.owner[inquiry.fitted]
        if len(set(owners)) > 1 and np.min(np.bincount(owners)) > 1:
            choices.append((np.where(inquiry.fitted, inquiry.owner, 0), inquiry.fitted))
        told = []
        for groups, counted in choices:
            split = blocks.fit_by_group(self.ranking.base, own, goal, groups).errors
            mean, error = margin(split[counted], found.solution.errors[counted])
            told.append((1.0 - math.exp(-mean), math.exp(-mean) * error))
        return max(told)


MOST_NOISE = 0.5
"""Share of noise beyond which a share above it has no meaning."""
