"""Which effects, added to the model, bring the residual down: forward, in pairs, and backward."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dfm_stage.diagnosis.alike import counts_in, same_steps, shares_class
from dfm_stage.diagnosis.candidates import LATE, excluded, late_splits
from dfm_stage.diagnosis.experiment import Experiment
from dfm_stage.diagnosis.fit import Fit, fit
from dfm_stage.diagnosis.screen import Hit, Screen, pair_gains
from dfm_stage.diagnosis.system import is_costly
from dfm_stage.diagnosis.weighting import (
    Weight,
    Weights,
    velocity_weights,
    weights_of,
    white_weights,
)
from dfm_stage.model import EFFECTS, Model

Array = NDArray[np.float64]
Names = tuple[str, ...]

FIRST, FURTHER = 40.0, 60.0
"""Fall in chi-square that names a first and any further effect."""
PER_PARAMETER = 12.0
"""What a further parameter must bring at least for the larger of two models to be preferred."""
ENOUGH = 0.2
"""A further effect must take this share of what is left above the noise: bits are no physics."""
BUDGET = 1500.0
"""Work (`System.work`: simulations of 24 s with a smooth force) after which no further candidate
that is slow to simulate is tried; after twice that none with a force that is not linear, and at
three times that every fit ends where it is."""
EACH = 1000.0
"""Work of a single fit at most."""
MOST = 4
VALLEY = 1.03
"""Chi-square per sample above which effects are looked for anew beside the others."""
SHORT_LIST = 4
CLOSE = 0.8
"""Candidates whose screened gain is this share of the best one's are fitted in full."""
FULL = 0.985
"""A fit that takes this share of what is above the noise needs no pairs beside it."""
RELATED, STRANGER, COUNTED = 0.9, 0.97, 0.25
"""Rivals whose screened gain is this share of an effect's loss are fitted in its place; counting
in the steps of a periodic error, whose screened gain suffers from every error of the motion."""
ROUGH = 0.02
"""Fall in chi-square per sample that a further effect must bring beside a reading that counts in
steps: what rounding leaves is not noise."""
TOLD = 1e-3
"""Fall in chi-square a step at which a fit whose values are told ends: 0.03 standard errors."""
HELD = {"encoder_quantization": ("step",)}
"""Parameters found by search and held in fits: the criterion is not smooth in them."""
LATER = {"presliding_friction": ("breakaway_ratio", "stribeck_velocity", "damping"),
         "hysteresis": ("exponent",)}
"""Parameters freed once the others have been fitted."""
STARTS: dict[str, dict[str, float]] = {
    "presliding_friction": {"breakaway_ratio": 1.1}, "hysteresis": {"exponent": 1.2}}
"""Where those begin then: off the values at which an effect is simpler and faster to simulate."""


@dataclass(frozen=True)
class Rival:
    """An effect in the place of another: its fit, and what it costs in chi-square."""

    name: str
    cost: float
    fit: Fit


@dataclass
class Search:
    """All fits of one diagnosis. `runs` are fitted; `library` are the effects that may be named;
    `free` the base parameters (and those of effects the model has) that are re-estimated."""

    model: Model
    runs: Sequence[Experiment]
    free: Names
    library: Names
    step: Callable[[str], None] = lambda _: None
    fits: dict[tuple[frozenset[str], int], Fit] = field(default_factory=dict)
    hits: dict[str, Hit] = field(default_factory=dict)
    screens: dict[frozenset[str], list[Hit]] = field(default_factory=dict)
    smallest: dict[str, dict[str, float]] = field(default_factory=dict)
    """Size of each effect that would have been seen beyond the model as it is."""
    weights: Weights = ()
    stage: int = 0
    dither: float = 0.0
    """RMS of the output's noise, over which a quantised reading is averaged."""
    spent: float = 0.0
    cut_short: bool = False

    def begin(self) -> Fit:
        """Fit the model as it is; sets the first weights."""
        motion = [max(float(np.std(r.output)), 1e-300) for r in self.runs]
        rough = tuple(tuple(
            Weight(np.ones(1), 1e-3 * size, "") for size in
            (m, *(float(np.std(c)) for c in (r.current,) if c is not None)))
            for r, m in zip(self.runs, motion, strict=True))
        self.weights = rough
        self.dither = rough[0][0].rms
        first = fit(self.model, self.runs, self.free, rough, iterations=40)
        if not first.ok:
            return first
        self.weigh_at_first(first)
        found = fit(first.model, self.runs, self.free, self.weights, earlier=first.locals)
        self.weigh_at_first(found)
        again = fit(found.model, self.runs, self.free, self.weights, earlier=found.locals)
        split = self.resplit(again)
        if split is again:
            return self.keep((), again)
        self.weigh_at_first(split)
        return self.keep((), self._fit(split.model, self.free, split))

    def resplit(self, found: Fit) -> Fit:
        """The best of `found` and of fits that begin with lag, delay and inductance shared out
        otherwise."""
        for values in late_splits(found.model, found.system.free):
            trial = self._fit(found.model.with_parameters(values), found.system.free, found)
            if trial.chi2 < found.chi2 - PER_PARAMETER:
                found = trial
        return found

    def weigh_at_first(self, found: Fit) -> None:
        """Weigh by what is left at high frequencies: there may be more than noise below."""
        self.reweigh(_first_weights(found), white_weights(found.residuals)[0][0].rms)

    def reweigh(self, weights: Weights, dither: float | None = None) -> None:
        """Compare fits by other weights from now on."""
        self.weights = weights
        self.dither = weights[0][0].rms if dither is None else dither
        self.stage += 1

    def keep(self, names: Iterable[str], found: Fit) -> Fit:
        """Remember a fit under the present weights."""
        self.fits[frozenset(names), self.stage] = found
        return found

    def fitted(self, names: Sequence[str], start: Fit, hits: Sequence[Hit] = (),
               worth: float = math.inf) -> Fit:
        """The fit with the effects `names` under the present weights; begins at `start`, to which
        the effects of `hits` are added. Parameters that come later are freed only where the
        others alone bring chi-square below `worth`."""
        key = frozenset(names), self.stage
        if key in self.fits:
            return self.fits[key]
        found = self._from(start.model, names, start, hits, worth)
        expected = start.chi2 - 0.5 * sum(h.gain for h in hits[:1])
        if hits and not found.chi2 < expected and self.spent < BUDGET:
            base = {n: v for n, v in self.model.base.items() if n in self.free}
            again = self._from(start.model.with_parameters(base), names, start, hits, worth)
            found = min(found, again, key=lambda f: f.chi2)
        return self.keep(names, found)

    def _from(self, model: Model, names: Sequence[str], start: Fit, hits: Sequence[Hit],
              worth: float) -> Fit:
        for use in model.effects:
            if use.name not in names and self.model.effect(use.name) is None:
                model = model.without_effect(use.name)
        later: list[str] = []
        for hit in hits:
            model = model.with_effect(hit.name, _inside(hit.name, hit.parameters))
            later += [f"{hit.name}.{n}" for n in LATER.get(hit.name, ())]
        free = self.parameters(model)
        early = tuple(n for n in free if n not in later)
        slow = bool(later) or (self.spent > 2.0 * BUDGET
                               and any(is_costly(use.name) for use in model.effects))
        if hits and slow and self.spent > BUDGET:
            self.cut_short = True
            return replace(start, chi2=math.inf)
        found = self._fit(model, early, start, iterations=12 if later else 25,
                          tolerance=1.0 if later else 0.03)
        if any(h.name == "encoder_quantization" for h in hits) and "noise" not in self.model.base:
            found = self._with_noise(found, early)
        if later and found.ok and found.chi2 < worth:
            freed = found.model.with_parameters({f"{hit.name}.{n}": v for hit in hits for n, v in
                                                 STARTS.get(hit.name, {}).items()})
            found = self._fit(freed, free, found, tolerance=0.1)
        if found.ok and any(f"{h.name}.{n}" in LATE for h in hits for n in h.parameters):
            found = self.resplit(found)
        return found

    def _fit(self, model: Model, free: Names, start: Fit, *, iterations: int = 25,
             tolerance: float = 1e-2, exact: bool = False) -> Fit:
        """A fit within what is left of the work that may be done."""
        found = fit(model, self.runs, free, self.weights, earlier=start.locals,
                    dither=self.dither, iterations=iterations, tolerance=tolerance, exact=exact,
                    allowance=min(max(3.0 * BUDGET - self.spent, 0.0), EACH))
        self.spent += found.system.work
        self.cut_short |= self.spent > 3.0 * BUDGET
        return found

    def _with_noise(self, found: Fit, free: Names) -> Fit:
        """The noise before rounding that explains a counted reading best."""
        use = found.model.effect("encoder_quantization")
        if use is None or not found.ok:
            return found
        trials = [self._fit(found.model.with_parameters({"noise": share * use.parameters["step"]}),
                            free, found, iterations=4)
                  for share in (0.02, 0.035, 0.06, 0.085, 0.115, 0.15, 0.2)]
        return min([found, *trials], key=lambda f: f.chi2)

    def parameters(self, model: Model) -> Names:
        """What is free in a model with effects added: the base and all of theirs."""
        own = [f"{use.name}.{n}" for use in model.effects
               if self.model.effect(use.name) is None for n in use.parameters
               if n not in HELD.get(use.name, ())]
        return (*self.free, *own)

    def refitted(self, names: Sequence[str], start: Fit) -> Fit:
        """The same effects under the present weights."""
        return self.fitted(names, start)

    # -- forward --------------------------------------------------------------------------------

    def screened(self, current: Fit, names: Sequence[str]) -> tuple[Screen, list[Hit]]:
        """Hits of every effect that is allowed and not in `current` yet, best first."""
        alike = self.fitted((), current).model if names else None
        screen = Screen(current, self.runs, self.weights, self.dither, alike)
        found: list[Hit] = []
        for name in self.library:
            if name in names or excluded(name, self.model, self.runs) is not None:
                continue
            found += [h for h in screen.hits(name) if h.name != "encoder_periodic_error"
                      or not counts_in(current.model, h.parameters["period"])]
        found.sort(key=lambda h: -h.gain)
        return screen, found

    def extend(self, names: Names, current: Fit) -> tuple[Names, Fit] | None:
        """Add what helps most, one effect or two at once; None where nothing helps enough."""
        limit = self._further(names, current) if names else FIRST
        screen, hits = self.screened(current, names)
        if not names:
            self.smallest = screen.smallest(FIRST)
        for hit in hits:
            if not names and hit.name not in self.hits:
                self.hits[hit.name] = hit
        best_hits = list({h.name: h for h in reversed(hits)}.values())
        best_hits.sort(key=lambda h: -h.gain)
        if not best_hits or best_hits[0].gain < 0.5 * limit:
            return None
        top = best_hits[0].gain
        if names and top < ENOUGH * (current.chi2 - current.white.size):
            return None
        listed = [h for h in best_hits if h.gain > CLOSE * top][:SHORT_LIST]
        self.screens[frozenset(names)] = best_hits
        above = current.chi2 - current.white.size
        trials: list[tuple[Names, Fit]] = []
        worth = math.inf
        for hit in sorted(listed, key=lambda h: h.name in LATER):
            self.step(f"fitting {hit.name}")
            trials.append(((*names, hit.name),
                           self.fitted((*names, hit.name), current, [hit], worth)))
            worth = min(worth, trials[-1][1].chi2 + 0.2 * max(above, 0.0))
            if current.chi2 - trials[-1][1].chi2 > FULL * above > FURTHER:
                break
        best = self.best(trials)
        taken = current.chi2 - best[1].chi2
        if len(names) + 2 <= MOST and taken < FULL * above:
            for gain, pair in pair_gains([h for h in hits if h.gain > 0.02 * top],
                                         screen.residual, keep=3):
                if gain < taken + FURTHER or gain < 1.02 * taken:
                    continue
                both = (*names, pair[0].name, pair[1].name)
                self.step(f"fitting {pair[0].name} and {pair[1].name}")
                trials.append((both, self.fitted(both, current, pair)))
                if current.chi2 - trials[-1][1].chi2 > FULL * above:
                    break
            best = self.best(trials)
        if best[1].chi2 > VALLEY * best[1].white.size:
            best = best[0], self.keep(best[0], self.resplit(best[1]))
        added = len(best[0]) - len(names)
        if current.chi2 - best[1].chi2 < limit + FURTHER * (added - 1):
            return None
        return best

    def _further(self, names: Names, current: Fit) -> float:
        """Fall in chi-square that a further effect must bring."""
        if "encoder_quantization" not in names:
            return FURTHER
        return max(FURTHER, ROUGH * current.white.size)

    def best(self, trials: Sequence[tuple[Names, Fit]]) -> tuple[Names, Fit]:
        """The smallest chi-square, further parameters paid for."""
        return min(trials, key=lambda t: self.score(t[1]))

    def score(self, found: Fit) -> float:
        """Chi-square and the price of the parameters."""
        return found.chi2 + PER_PARAMETER * len(found.system.free) if found.ok else math.inf

    # -- the whole search -----------------------------------------------------------------------

    def run(self) -> tuple[Names, Fit]:
        """Add effects until nothing helps; return them in the order they came, and the fit."""
        names: Names = ()
        current = self.begin()
        while current.ok and len(names) < MOST:
            self.step("screening every effect")
            found = self.extend(names, current)
            if found is None:
                moved = self.reseated(names, current)
                if moved is None:
                    break
                current = moved
                continue
            names, current = found
            names, current = self.pruned(names, current)
            if any(abs(a.sigma / b.sigma - 1.0) > 0.03 for new, old in
                   zip(_first_weights(current), self.weights, strict=True)
                   for a, b in zip(new, old, strict=True)):
                self.weigh_at_first(current)
                current = self.refitted(names, current)
        return names, current

    def polished(self, names: Names, current: Fit) -> Fit:
        """The fit of `names` at the bottom of its valley, for the values that are told."""
        if not names:
            return current
        found = self._fit(current.model, self.parameters(current.model), current, iterations=30,
                          tolerance=TOLD, exact=True)
        return self.keep(names, found) if found.chi2 < current.chi2 else current

    def reseated(self, names: Names, current: Fit) -> Fit | None:
        """A better fit of the same effects, each looked for anew beside the others; None if there
        is none. A first look, with others still in the residual, may have started a search in
        the wrong valley."""
        if not names or current.system.springless \
                or current.chi2 < VALLEY * current.white.size:
            return None
        if current.system.costly:
            exact = self._fit(current.model, self.parameters(current.model), current,
                              iterations=12, exact=True)
            if exact.chi2 < current.chi2 - FURTHER:
                return self.keep(names, exact)
        for name in names:
            if name in LATER:
                continue
            rest = tuple(n for n in names if n != name)
            without = self.fitted(rest, current)
            screen = Screen(without, self.runs, self.weights, self.dither,
                            self.fitted((), current).model)
            for hit in screen.hits(name, keep=3):
                trial = self._from(without.model, names, without, [hit], math.inf)
                if trial.chi2 < current.chi2 - FURTHER:
                    return self.keep(names, trial)
        return None

    def pruned(self, names: Names, current: Fit) -> tuple[Names, Fit]:
        """Drop effects that have become unnecessary."""
        while len(names) > 1:
            losses = []
            for name in names:
                rest = tuple(n for n in names if n != name)
                losses.append((self.fitted(rest, current).chi2 - current.chi2, name))
            loss, weakest = min(losses)
            if loss >= self._further(names, current):
                break
            names = tuple(n for n in names if n != weakest)
            current = self.fitted(names, current)
        return names, current

    def compare(self, names: Names, current: Fit) -> tuple[Names, Fit, dict[str, list[Rival]]]:
        """Put each effect's rivals in its place, under weights that the best model set.

        Returns the best set, its fit, and for every effect in it the rivals with what they would
        cost in chi-square, smallest first.
        """
        for _ in range(3):
            rivals: dict[str, list[Rival]] = {}
            better: tuple[Names, Fit] | None = None
            for name in names:
                rest = tuple(n for n in names if n != name)
                rivals[name] = found = self._rivals(name, rest, current)
                for rival in found:
                    if self.score(rival.fit) < self.score(current) and (
                            better is None or self.score(rival.fit) < self.score(better[1])):
                        better = tuple(rival.name if n == name else n for n in names), rival.fit
            if better is None:
                return names, current, rivals
            names, current = better
            self.reweigh(weights_of(current.residuals))
            current = self.refitted(names, current)
        return names, current, rivals

    def _rivals(self, name: str, rest: Names, current: Fit) -> list[Rival]:
        without = self.fitted(rest, current)
        loss = without.chi2 - current.chi2
        if frozenset(rest) not in self.screens:
            _, hits = self.screened(without, rest)
            self.screens[frozenset(rest)] = list({h.name: h for h in reversed(hits)}.values())
        best = self.screens[frozenset(rest)]
        own = max((h.gain for h in best if h.name == name), default=loss)
        found: list[Rival] = []
        for hit in sorted(best, key=lambda h: -h.gain):
            least = RELATED if shares_class(hit.name, name) else STRANGER
            if hit.name == "encoder_quantization" and same_steps(current.model,
                                                                 hit.parameters):
                least = COUNTED
            wanted = hit.gain > least * own
            if hit.name == name or not wanted or len(found) >= SHORT_LIST:
                continue
            self.step(f"fitting {hit.name} in place of {name}")
            rival = self.fitted((*rest, hit.name), without, [hit],
                                current.chi2 + 0.2 * max(loss, 0.0))
            if rival.ok:
                found.append(Rival(hit.name, rival.chi2 - current.chi2, rival))
        return sorted(found, key=lambda r: r.cost)

    def settle(self, names: Names, current: Fit) -> tuple[Names, Fit, Fit]:
        """Weigh by the noise that the best model leaves, and see whether each effect still pays.

        Returns the effects, their fit and the fit without any, under the same weights.
        """
        while True:
            self.reweigh(weights_of(current.residuals))
            current = self.refitted(names, current)
            bare = self.fitted((), current)
            limit = FIRST if len(names) == 1 else FURTHER
            if len(names) == 1 and bare.chi2 - current.chi2 < limit:
                names, current = (), bare
                continue
            if len(names) > 1:
                kept, found = self.pruned(names, current)
                if kept != names:
                    names, current = kept, found
                    continue
            return names, current, bare


def _first_weights(found: Fit) -> Weights:
    weights = velocity_weights if found.system.springless else white_weights
    return weights(found.residuals)


def _inside(name: str, parameters: dict[str, float]) -> dict[str, float]:
    """Parameters moved inside their limits."""
    limits = {p.name: p for p in EFFECTS[name].parameters}
    return {n: min(max(v, limits[n].low), limits[n].high) for n, v in parameters.items()}
