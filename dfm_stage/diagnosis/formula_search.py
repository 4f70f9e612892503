"""A sparse regression for the missing force: which few terms explain it, in the force domain.

Forward selection from the dictionary of `formula_terms`, with a beam: the best forms are kept at
every length, and the shapes of all their terms are fitted together (variable projection; Golub and
Pereyra, SIAM J. Numer. Anal. 10 (1973) 413) before another is added. Without that a hinge that
lies between two points of the grid would need a second hinge to mend it. How many terms there are
is decided on blocks that are held out. Terms go through the same filter as the forces, which is a
weak form (Messenger and Bortz, J. Comput. Phys. 443 (2021) 110525): no noisy derivative stands
alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import RIDGE, Blocks, Solution, log_ratio
from dfm_stage.diagnosis.decisions import BLOCK_MARGIN, PARAMETER_PART, SWAMPED
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.force_candidates import Candidates
from dfm_stage.diagnosis.force_domain import WIDTHS, RunForces
from dfm_stage.diagnosis.force_setting import least_squares, settled
from dfm_stage.diagnosis.formula_terms import DRY, TERMS, Over, Part, Term
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.model import Model

MOST_TERMS = 3
"""Terms of a formula at most: it is to be read."""
BEAM, BRANCHES = 3, 3
"""Sets that are carried to the next length, and terms that are tried beside each."""
EVALUATIONS = 10
"""Steps of a fit of shapes: the grid is near, and the formula is fitted again in simulation."""
RESAMPLES, SEED = 20, 1
"""Draws of blocks with replacement over which a choice of terms is repeated, and their seed."""
SEEN = 1e-3
"""Share of a term that base parameters and the terms before it must leave for it to be tried."""


@dataclass(frozen=True)
class Column:
    """A term at one shape, along all records (n,)."""

    term: Term
    shapes: tuple[float, ...]
    values: Array


@dataclass(frozen=True)
class Found:
    """Terms that explain the missing force together; `errors` (B,) are the mean squares of blocks
    held out, `base` the base parameters beside them, `came_back` how many of the RESAMPLES draws
    choose each term again, `all_back` how many choose all of them."""

    parts: tuple[Part, ...]
    errors: Array
    base: Mapping[str, float]
    came_back: tuple[int, ...] = ()
    all_back: int = 0

    @property
    def forms(self) -> frozenset[str]:
        """The texts of its terms."""
        return frozenset(p.term.text for p in self.parts)


class Regression:
    """The missing force of some records and the dictionary along their motion."""

    def __init__(self, runs: Sequence[Observation], model: Model, offsets: Mapping[int, float],
                 free_mass: bool = False) -> None:
        """`offsets` (m) are those of the readings, by run. Without `free_mass` all forces are told
        in the scale of the given mass: input and output alone do not show it.

        Raises
        ------
        DiagnosisError
            If the records tell nothing in the force domain.
        """
        found, noise, _ = settled([RunForces(r, WIDTHS[0]) for r in runs], model, len(runs))
        self.candidates = Candidates(found, model, len(runs), ())
        if noise >= SWAMPED:
            raise DiagnosisError("noise swamps the missing force")
        self.runs, self.setting, self.free_mass = found.runs, found, free_mass
        constant = np.zeros((self.candidates.missing.size, 0))
        if model.base.get("stiffness", 0.0) <= 0.0:   # a body without a spring is pushed
            constant = np.ones((self.candidates.missing.size, 1))
        self.base = np.column_stack((self.candidates.base, constant))
        norms = np.maximum(np.linalg.norm(self.base, axis=0), 1e-300)
        left, values, _ = np.linalg.svd(self.base / norms, full_matrices=False)
        self.space = left[:, values > RIDGE * values[0]]
        self.missing = self.off(self.setting.target)
        self.signals = {id(run): self._signals(run, offsets.get(k, 0.0))
                        for k, run in enumerate(self.runs)}
        spread = {name: float(np.std(np.concatenate([
            self.signals[id(run)][name][run.kept] for run in self.runs]))) for name in ("x", "v")}
        self.scales: dict[Over, float] = {"x": spread["x"], "v": spread["v"], "1": 1.0}
        self._known: dict[tuple[str, tuple[float, ...]], Array] = {}

    def off(self, columns: Array) -> Array:
        """`columns` (n,) or (n, c) without what the base parameters can do."""
        return np.asarray(columns - self.space @ (self.space.T @ columns))

    def _signals(self, run: RunForces, offset: float) -> dict[str, Array]:
        t, motion = run.trajectory, self.candidates.terms.motion(run)
        noise = np.sqrt(2.0) * max(t.speed_noise, 1e-9 * float(np.std(t.v)), 1e-300)
        from scipy.special import erf  # slow to import, and not always needed

        return {"x": t.x - offset, "v": t.v, "direction": erf(t.v / noise),
                "i": motion.per_newton * motion.actuator}

    def column(self, term: Term, shapes: tuple[float, ...]) -> Array:
        """A force of minus one times a term (n,), behind the filter, off the base."""
        key = term.text, shapes
        if key not in self._known:
            self._known[key] = self.off(self._force(term, shapes))
        return self._known[key]

    def _force(self, term: Term, shapes: tuple[float, ...]) -> Array:
        return self.setting.stacked(
            lambda run: run.filtered(term.values(self.signals[id(run)], shapes)))

    def told(self, chosen: Sequence[Column]) -> tuple[dict[str, float], tuple[Part, ...]]:
        """Base parameters by name and terms with their sizes, fitted together."""
        found, model = self.setting, self.candidates.model
        values = least_squares(np.column_stack((self.base, *(
            self._force(c.term, c.shapes) for c in chosen))), found.target)
        base = dict(zip(found.names, values.tolist(), strict=False))
        base.pop("late", None)
        mass = 0.0 if self.free_mass else base.get("mass", 0.0)
        factor = model.base["mass"] / mass if mass > 0.0 else 1.0
        base["force_constant"] = model.base.get("force_constant", 1.0)
        return ({n: factor * v for n, v in base.items()},
                tuple(Part(c.term, factor * float(size), c.shapes) for c, size in zip(
                    chosen, values[self.base.shape[1]:], strict=True)))

    @cached_property
    def grid(self) -> list[Column]:
        """Every term at every shape that it begins with, where the records show it."""
        found = [Column(term, shapes, self.column(term, shapes))
                 for term in TERMS for shapes in term.begins(self.scales)]
        return [c for c in found if np.all(np.isfinite(c.values)) and np.any(c.values)]

    @cached_property
    def stacked(self) -> tuple[Array, Array]:
        """The columns of the grid (n, K), and their sums of squares (K,)."""
        values = np.column_stack([c.values for c in self.grid])
        return values, np.asarray(np.sum(values**2, axis=0))

    def on_blocks(self, columns: Sequence[Array]) -> Solution:
        """The fit of columns (n,) with the base, each block held out."""
        k = self.base.shape[1] + len(columns)
        blocks = Blocks(np.column_stack((self.base, *columns, self.missing)),
                        self.candidates.edges, self.candidates.fitted)
        return blocks.fit(range(k), k)

    def left(self, columns: Sequence[Array]) -> Array:
        """The missing force (n,) without what columns (n,) explain."""
        stacked = np.column_stack(columns)
        return np.asarray(self.missing - stacked @ least_squares(stacked, self.missing))

    def fitted(self, chosen: Sequence[Column]) -> list[Column]:
        """The same terms with the shapes that explain most together."""
        scales = [self.scales[s.over] for c in chosen for s in c.term.shapes]
        if not scales:
            return list(chosen)
        low, high = (np.array([getattr(s, end) for c in chosen for s in c.term.shapes])
                     for end in ("low", "high"))
        begin = np.array([v for c in chosen for v in c.shapes]) / scales
        ends = np.cumsum([0, *(len(c.term.shapes) for c in chosen)])

        def columns(shapes: Array) -> list[Column]:
            found = []
            for c, (a, b) in zip(chosen, pairwise(ends), strict=True):
                own = tuple((shapes[a:b] * scales[a:b]).tolist())
                found.append(Column(c.term, own, self.column(c.term, own)))
            return found

        from scipy.optimize import least_squares as minimised  # slow to import, as erf is

        best = minimised(lambda at: self.left([c.values for c in columns(at)]),
                         np.clip(begin, low, high), bounds=(low, high), x_scale=0.3,
                         diff_step=1e-3, max_nfev=EVALUATIONS)
        return columns(best.x)


def search(regression: Regression) -> list[Found]:
    """The formulas worth a fit in simulation, that with most terms first, then the runners-up of
    its length and shorter ones; none where nothing explains a thing on blocks held out."""
    sets: list[list[Column]] = [[]]
    by_length: list[list[list[Column]]] = []
    for _ in range(MOST_TERMS):
        tried: dict[frozenset[str], list[Column]] = {}
        for chosen in sets:
            for column in next_terms(regression, chosen):
                wider = regression.fitted([*chosen, column])
                if not _allowed(regression, wider):
                    continue
                forms = frozenset(c.term.text for c in wider)
                if forms not in tried or _power(regression, wider) < _power(
                        regression, tried[forms]):
                    tried[forms] = wider
        sets = sorted(tried.values(), key=lambda s: _power(regression, s))[:BEAM]
        if not sets:
            break
        by_length.append(sets)
    return _worth(regression, by_length)


def next_terms(regression: Regression, chosen: Sequence[Column] = ()) -> list[Column]:
    """The terms that take most beside those chosen, each form once."""
    left, own = regression.missing, np.zeros((regression.missing.size, 0))
    if chosen:
        left = regression.left([c.values for c in chosen])
        own = np.linalg.qr(np.column_stack([c.values for c in chosen]))[0]
    values, whole = regression.stacked
    bare = whole - np.sum((own.T @ values) ** 2, axis=0)
    gain = np.where(bare > SEEN**2 * whole, (left @ values) ** 2 / np.maximum(bare, 1e-300), 0.0)
    used = {c.term.text for c in chosen if not c.term.shapes}
    best: dict[str, tuple[float, Column]] = {}
    for g, column in zip(gain.tolist(), regression.grid, strict=True):
        text = column.term.text
        if text not in used and g > best.get(text, (0.0, column))[0]:
            best[text] = g, column
    ranked = sorted(best.values(), key=lambda each: -each[0])
    return [column for _, column in ranked[:BRANCHES if chosen else BRANCHES * BEAM]]


def _power(regression: Regression, chosen: Sequence[Column]) -> float:
    left = regression.left([c.values for c in chosen])
    return float(left @ left)


def _sizes(regression: Regression, chosen: Sequence[Column]) -> Array:
    """A force is minus a size times its term, and the actuator's force meets it."""
    return least_squares(np.column_stack([c.values for c in chosen]), regression.missing)


def _allowed(regression: Regression, chosen: Sequence[Column]) -> bool:
    """Whether friction brakes."""
    sizes = _sizes(regression, chosen)
    return all(size > 0.0 for size, c in zip(sizes, chosen, strict=True) if c.term.text == DRY)


def _worth(regression: Regression,
           by_length: Sequence[Sequence[Sequence[Column]]]) -> list[Found]:
    """The sets of the greatest length whose last term blocks held out bear out, and shorter
    ones."""
    bare = regression.on_blocks(()).errors
    best, kept = bare, 0
    told = [[_found(regression, s) for s in sets] for sets in by_length]
    for length, sets in enumerate(told, 1):
        mean, error = log_ratio(sets[0].errors, best)
        fall = 1.0 - float(np.sum(sets[0].errors)) / max(float(np.sum(best)), 1e-300)
        if mean <= BLOCK_MARGIN * error or fall <= PARAMETER_PART:
            break
        best, kept = sets[0].errors, length
    if not kept:
        return []
    ordered = [(kept - 1, k) for k in range(len(told[kept - 1]))]
    ordered[1:1] = [(length, 0) for length in range(kept - 2, -1, -1)]
    draws = _Draws(regression, [by_length[a][b] for a, b in ordered])
    return [draws.counted(told[a][b]) for a, b in ordered]


def _found(regression: Regression, chosen: Sequence[Column]) -> Found:
    base, parts = regression.told(chosen)
    return Found(parts, regression.on_blocks([c.values for c in chosen]).errors, base)


class _Draws:
    """The choice of terms repeated over blocks that are drawn with replacement."""

    def __init__(self, regression: Regression, sets: Sequence[Sequence[Column]]) -> None:
        columns = [*regression.grid, *(c for s in sets for c in s if c.term.shapes)]
        self.texts = [c.term.text for c in columns]
        self.first = regression.base.shape[1]
        blocks = Blocks(np.column_stack((regression.base, *(c.values for c in columns),
                                         regression.missing)), regression.candidates.edges,
                        regression.candidates.fitted)
        draw = np.random.default_rng(SEED)
        own = blocks.sums[blocks.fitted]
        self.grams = [_swept(own[draw.integers(0, len(own), len(own))].sum(axis=0),
                             range(self.first)) for _ in range(RESAMPLES)]
        self._chosen: dict[int, list[frozenset[str]]] = {}

    def counted(self, found: Found) -> Found:
        """`found` with how often its terms are chosen again."""
        length = len(found.parts)
        if length not in self._chosen:
            self._chosen[length] = [self._choice(gram, length) for gram in self.grams]
        chosen = self._chosen[length]
        return replace(found, came_back=tuple(sum(p.term.text in c for c in chosen)
                                              for p in found.parts),
                       all_back=sum(found.forms <= c for c in chosen))

    def _choice(self, gram: Array, length: int) -> frozenset[str]:
        """Terms chosen one by one, then each exchanged once where another does better."""
        chosen: list[int] = []
        for step in range(2 * length):
            if step >= length:
                del chosen[0]
            left = _swept(gram, chosen)
            power = np.maximum(np.diag(left)[self.first:-1], 1e-300)
            whole = np.maximum(np.diag(gram)[self.first:-1], 1e-300)
            gain = np.where(power > SEEN**2 * whole, left[self.first:-1, -1] ** 2 / power, 0.0)
            gain[[c - self.first for c in chosen]] = 0.0
            chosen.append(self.first + int(np.argmax(gain)))
        return frozenset(self.texts[c - self.first] for c in chosen)


def _swept(gram: Array, columns: Sequence[int]) -> Array:
    """Sums of products (K, K) without what some columns explain."""
    at = list(columns)
    if not at:
        return gram
    own = gram[np.ix_(at, at)]
    scale = max(float(np.trace(own)) / len(at), 1e-300)
    return np.asarray(gram - gram[:, at] @ np.linalg.solve(
        own + RIDGE * scale * np.eye(len(at)), gram[at]))
