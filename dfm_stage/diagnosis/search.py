"""Which effects, added to the model, bring the residual down: forward, in pairs, and backward."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from dfm_stage.diagnosis.alike import at_upper_end, same_rounding, shares_class
from dfm_stage.diagnosis.candidates import excluded
from dfm_stage.diagnosis.decisions import FIRST, FURTHER, NAMED_SHARE
from dfm_stage.diagnosis.effect_fits import Fits, Names, first_weights
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.screen import Hit, Screen, best_of_each, pair_gains
from dfm_stage.diagnosis.search_decisions import (
    AKAIKE,
    EXCHANGES,
    FIRST_SHARE,
    FULL_SHARE,
    FURTHER_SHARE,
    MOST_EFFECTS,
    MOST_STEPS,
    NOISE_MOVED,
    PAIR_GAIN,
    PAIR_MEMBER,
    PROMISED,
    RELATED_GAIN,
    RESTART_ABOVE,
    ROUNDING_GAIN,
    SCREENS_KEPT,
    SHORT_LIST,
    SHORT_LIST_GAIN,
    TWIN_ABOVE,
    UNRELATED_GAIN,
    WORTH,
)
from dfm_stage.diagnosis.spectra import is_resolution, lattice
from dfm_stage.identification.system import rounding_step
from dfm_stage.identification.weights import weights_of
from dfm_stage.model import EFFECTS, Model


@dataclass(frozen=True)
class Rival:
    """An effect in the place of another: its fit, and what it costs in chi-square."""

    name: str
    cost: float
    fit: Fit

    def price(self, named: Fit) -> float:
        """Its cost, parameters paid for (Akaike), in the place of what `named` fits."""
        return self.cost + AKAIKE * (len(self.fit.system.free) - len(named.system.free))


@dataclass
class Search(Fits):
    """`library` are the effects that may be named; `step` is told what is done."""

    library: Names = ()
    again: bool = False
    """Whether an effect may be named of which the base has a first one."""
    step: Callable[[str], None] = lambda _: None
    hits: dict[str, Hit] = field(default_factory=dict)
    screens: dict[frozenset[str], list[Hit]] = field(default_factory=dict)
    smallest: dict[str, dict[str, float]] = field(default_factory=dict)
    """Size of each effect that would have been seen beyond the model as it is."""
    above: float = math.inf
    """Chi-square of the model as it is above the noise, where `hits` were screened."""
    seen: dict[tuple[Any, ...], tuple[Screen, dict[str, list[Hit]]]] = field(
        default_factory=dict)
    """The last screens by what they depend on, with the hits of the effects looked at."""
    barred: set[str] = field(default_factory=set)
    """Effects that were found and not borne out: not looked for again."""

    def widened(self, names: Names) -> Search:
        """A search among these effects, too, that knows what was fitted and screened so far."""
        self.begin_work(MOST_STEPS)
        return Search(self.model, self.runs, self.free, fits=self.fits, weights=self.weights,
                      weighing=self.weighing, weighings=self.weighings, noise=self.noise,
                      library=(*self.library, *names), again=True, step=self.step, seen=self.seen)

    def screened(self, current: Fit, names: Sequence[str],
                 among: Sequence[str] | None = None) -> tuple[Screen, list[Hit]]:
        """Hits of every effect, or of those `among` some, that is allowed and not in `current`
        yet, best first."""
        key = frozenset(names), self.weighing, current.chi2, frozenset(self.barred)
        if key not in self.seen:
            while len(self.seen) >= SCREENS_KEPT:
                del self.seen[next(iter(self.seen))]
            alike = self.fitted((), current).model if names else None
            self.seen[key] = Screen(current, self.runs, self.weights, self.noise, alike), {}
        screen, looks = self.seen[key]
        if not names and not self.hits:
            self.above = current.chi2 - current.white.size
        step, at = self._step_of(current.model), self.conditions(self.model)
        allowed = [n for n in (self.library if among is None else among)
                   if n not in (*names, *self.barred)
                   and not excluded(n, self.model, at, self.again)]
        looks.update({n: screen.hits(n) for n in allowed if n not in looks})
        found = [h for n in allowed for h in looks[n]
                 if step is None or not EFFECTS[n].is_rounding(h.parameters, step)]
        return screen, sorted(found, key=lambda h: -h.gain)

    def _step_of(self, model: Model) -> float | None:
        """The step in which the reading is known to count: the model's, or read off the data where
        it is the encoder's resolution, or the effect of a coarser one may be named."""
        step = rounding_step(model)
        if step is not None or self.runs[0].order:
            return step
        step = lattice(self.runs[0].output)
        if step is None or is_resolution(step, model.base.get("encoder_resolution", 0.0)):
            return step
        named = any(EFFECTS[n].rounds and n not in self.barred for n in self.library)
        return step if named else None

    def alone(self, current: Fit) -> tuple[Names, Fit]:
        """The effect that brings the model as it is down most by itself, none where none helps,
        and the fit."""
        _, best_hits = self._looked((), current)
        return self._best_alone(self._short_list(best_hits, FIRST), current)

    def alone_of(self, names: Names, current: Fit, known: Fit) -> tuple[Names, Fit]:
        """The same among `names` only, which must promise as much as the others where the `known`
        fit of one of these explains most. Where the best explains more than that fit does and
        leaves more than noise, each is begun at another size, all else fitted around
        it first: those with few parameters first."""
        screen, best_hits = self._looked((), current)
        own = [h for h in best_hits if h.name in names]
        most = (best_hits if explains_most(current, known) else own)[:1]
        listed = [h for h in self._short_list(own, FIRST)
                  if h.gain > SHORT_LIST_GAIN * most[0].gain]
        best = self._best_alone(listed, current)
        if self.score(best[1]) > self.score(known):
            return best
        self.begin_work(FIRST_SHARE * MOST_STEPS)
        again = [other for h in listed if (other := _elsewhere(h, screen)) is not None]
        for hit in sorted(again, key=lambda h: len(EFFECTS[h.name].parameters)):
            if best[1].chi2 < _noise(current):
                break
            self.step(f"fitting {hit.name}")
            found = self.around((hit.name,), current, [hit])
            if not at_upper_end(found, [hit.name]):
                best = self.best([best, ((hit.name,), found)])
        return best

    def _best_alone(self, listed: Sequence[Hit], current: Fit) -> tuple[Names, Fit]:
        """The best single effect of a list, or its twin, or none; fitted until one leaves only
        noise."""
        trials = self._singles((), current, listed, current.chi2 - current.white.size,
                               current.chi2 - _noise(current))
        best = self.best([((), current), *trials])
        return self._twin_instead((), *best) if best[1].ok else best

    def extend(self, names: Names, current: Fit) -> tuple[Names, Fit] | None:
        """Add what helps most, one effect or two at once; None where nothing helps enough."""
        limit = self.further(names, current) if names else FIRST
        above = current.chi2 - current.white.size
        screen, best_hits = self._looked(names, current)
        listed = self._short_list(best_hits, limit)
        if not listed or (names and listed[0].gain < FURTHER_SHARE * above):
            return None
        trials = self._singles(names, current, listed, above, FULL_SHARE * above)
        taken = current.chi2 - self.best([(names, current), *trials])[1].chi2
        if len(names) + 2 <= MOST_EFFECTS and taken < FULL_SHARE * above:
            _, hits = self.screened(current, names)
            pairs = pair_gains([h for h in hits if h.gain > PAIR_MEMBER * listed[0].gain],
                               screen.residual, keep=3)
            trials += self._pairs(names, current, [
                pair for gain, pair in pairs
                if gain >= taken + FURTHER and gain >= PAIR_GAIN * taken], above)
        if not trials:
            return None
        best = self.best(trials)
        if best[1].chi2 > RESTART_ABOVE * best[1].white.size:
            best = best[0], self.keep(best[0], self.resplit(best[1]))
        added = len(best[0]) - len(names)
        if current.chi2 - best[1].chi2 < limit + FURTHER * (added - 1):
            return None
        return best

    def _looked(self, names: Names, current: Fit) -> tuple[Screen, list[Hit]]:
        """A screen, and the best hit of each effect, best first."""
        screen, hits = self.screened(current, names)
        best_hits = best_of_each(hits)
        self.screens[frozenset(names)] = best_hits
        if not names:
            self.smallest = screen.smallest(FIRST)
            for hit in best_hits:
                self.hits.setdefault(hit.name, hit)
        return screen, best_hits

    @staticmethod
    def _short_list(best_hits: Sequence[Hit], limit: float) -> list[Hit]:
        """The hits worth a fit."""
        if not best_hits or best_hits[0].gain < PROMISED * limit:
            return []
        return [h for h in best_hits
                if h.gain > SHORT_LIST_GAIN * best_hits[0].gain][:SHORT_LIST]

    def _singles(self, names: Names, current: Fit, listed: Sequence[Hit], above: float,
                 enough: float) -> list[tuple[Names, Fit]]:
        """Fits with each of some candidates added, until one takes `enough` of what is `above`
        the noise."""
        trials: list[tuple[Names, Fit]] = []
        worth = math.inf
        for hit in sorted(listed, key=lambda h: bool(EFFECTS[h.name].freed_last)):
            self.step(f"fitting {hit.name}")
            found = self.fitted((*names, hit.name), current, [hit], worth)
            if not found.ok or at_upper_end(found, [hit.name]):
                continue
            trials.append(((*names, hit.name), found))
            worth = min(worth, found.chi2 + WORTH * max(above, 0.0))
            if current.chi2 - found.chi2 > enough > FURTHER:
                break
        return trials

    def _pairs(self, names: Names, current: Fit, pairs: Sequence[Sequence[Hit]],
               above: float) -> list[tuple[Names, Fit]]:
        """The same for two candidates at once."""
        trials: list[tuple[Names, Fit]] = []
        for pair in pairs:
            both = (*names, pair[0].name, pair[1].name)
            self.step(f"fitting {pair[0].name} and {pair[1].name}")
            found = self.fitted(both, current, pair)
            if not found.ok or at_upper_end(found, both[len(names):]):
                continue
            trials.append((both, found))
            if current.chi2 - found.chi2 > FULL_SHARE * above:
                break
        return trials

    def run(self) -> tuple[Names, Fit]:
        """Add effects until nothing helps; return them in the order they came, and the fit."""
        return self.grown((), self.begin())

    def second(self, names: Names, current: Fit) -> tuple[Names, Fit] | None:
        """Go on from `names` without the barred effects; None where nothing helps."""
        found = self.extend(names, current)
        return None if found is None else self.grown(*self.pruned(*found))

    def grown(self, names: Names, current: Fit, rounds: int = MOST_EFFECTS) -> tuple[Names, Fit]:
        """Go on from `names` and their fit until nothing helps, `rounds` times at most."""
        for _ in range(rounds):
            if not current.ok or len(names) >= MOST_EFFECTS:
                break
            self.step("screening every effect")
            found = self.extend(names, current)
            if found is None:
                moved = self.restarted(names, current)
                if moved is None:
                    break
                current = moved
                continue
            names, current = self.pruned(*self._twin_instead(names, *found))
            if any(abs(a.sigma / b.sigma - 1.0) > NOISE_MOVED for new, old in
                   zip(first_weights(current), self.weights, strict=True)
                   for a, b in zip(new, old, strict=True)):
                self.weigh_at_first(current)
                current = self.fitted(names, current)
        return names, current

    def _twin_instead(self, before: Names, names: Names, current: Fit) -> tuple[Names, Fit]:
        """The twin of one just added that leaves more than noise, if it fits better: what is left
        of the wrong one would pass for further effects."""
        if current.chi2 < TWIN_ABOVE * current.white.size:
            return names, current
        for name in names[len(before):]:
            rest = tuple(n for n in names if n != name)
            for twin in self._twin_rivals(name, rest, current):
                if self.score(twin.fit) < self.score(current):
                    return (*rest, twin.name), twin.fit
        return names, current

    def restarted(self, names: Names, current: Fit) -> Fit | None:
        """A better fit of the same effects, each screened anew beside the others; None if there is
        none. A first screen, with others still in the residual, may have led to another local
        minimum."""
        if not names or current.system.springless \
                or current.chi2 < RESTART_ABOVE * current.white.size:
            return None
        if current.system.nonlinear:
            exact = self._fit(current.model, self.parameters(current.model), current,
                              iterations=12, exact=True)
            if exact.chi2 < current.chi2 - FURTHER:
                return self.keep(names, exact)
        for name in names:
            if EFFECTS[name].freed_last:
                continue
            rest = tuple(n for n in names if n != name)
            without = self.fitted(rest, current)
            if not without.ok:
                continue
            screen = Screen(without, self.runs, self.weights, self.noise,
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
            if loss >= self.further(names, current):
                break
            names = tuple(n for n in names if n != weakest)
            current = self.fitted(names, current)
        return names, current

    def compare(self, names: Names, current: Fit) -> tuple[Names, Fit, dict[str, list[Rival]]]:
        """Put each effect's rivals in its place, under weights that the best model set.

        Returns the best set, its fit, and for every effect in it the rivals with what they would
        cost in chi-square, smallest first.
        """
        for _ in range(EXCHANGES):
            rivals = self.all_rivals(names, current)
            better: tuple[Names, Fit] | None = None
            for name, found in rivals.items():
                for rival in found:
                    if self.score(rival.fit) < self.score(current) and (
                            better is None or self.score(rival.fit) < self.score(better[1])):
                        better = tuple(rival.name if n == name else n for n in names), rival.fit
            if better is None:
                return names, current, rivals
            names, current = better
            self.reweigh(weights_of(current.residuals))
            current = self.fitted(names, current)
        return names, current, self.all_rivals(names, current)

    def all_rivals(self, names: Names, current: Fit) -> dict[str, list[Rival]]:
        """For each effect the others fitted in its place, cheapest first."""
        return {name: self._rivals(name, tuple(n for n in names if n != name), current)
                for name in names}

    def _rivals(self, name: str, rest: Names, current: Fit) -> list[Rival]:
        without = self.fitted(rest, current)
        loss = without.chi2 - current.chi2
        if frozenset(rest) not in self.screens and without.ok:
            _, hits = self.screened(without, rest)
            self.screens[frozenset(rest)] = best_of_each(hits)
        best = self.screens.get(frozenset(rest), [])
        own = max((h.gain for h in best if h.name == name), default=loss)
        found: list[Rival] = []
        for hit in sorted((h for h in best if h.name not in self.barred),
                          key=lambda h: -h.gain):
            least = RELATED_GAIN if shares_class(hit.name, name) else UNRELATED_GAIN
            if same_rounding(current.model, hit):
                least = ROUNDING_GAIN
            wanted = hit.gain > least * own
            if hit.name == name or not wanted or len(found) >= SHORT_LIST \
                    or hit.name in EFFECTS[name].twins:
                continue
            self.step(f"fitting {hit.name} in place of {name}")
            rival = self.fitted((*rest, hit.name), without, [hit],
                                current.chi2 + WORTH * max(loss, 0.0))
            if rival.ok and not at_upper_end(rival, [hit.name]):
                found.append(Rival(hit.name, rival.chi2 - current.chi2, rival))
        found += self._twin_rivals(name, rest, current)
        return sorted(found, key=lambda r: r.cost)

    def _twin_rivals(self, name: str, rest: Names, current: Fit) -> list[Rival]:
        """Effects that can be the same motion as `name`, begun there: from the screen, which is
        linear, their fits seldom find it."""
        found = []
        for twin in EFFECTS[name].twins:
            if twin in self.library and twin not in (*rest, *self.barred):
                self.step(f"fitting {twin} in place of {name}, from the same motion")
                fit = self.in_place_of(name, twin, (*rest, twin), current)
                if fit.ok:
                    found.append(Rival(twin, fit.chi2 - current.chi2, fit))
        return found

    def settle(self, names: Names, current: Fit) -> tuple[Names, Fit, Fit]:
        """Weigh by the noise that the best model leaves, and see whether each effect still pays.

        Returns the effects, their fit and the fit without any, under the same weights.
        """
        while True:
            self.reweigh(weights_of(current.residuals))
            current = self.fitted(names, current)
            bare = self.fitted((), current)
            if len(names) == 1 and bare.chi2 - current.chi2 < FIRST:
                names, current = (), bare
                continue
            if len(names) > 1:
                kept, found = self.pruned(names, current)
                if kept != names:
                    names, current = kept, found
                    continue
            return names, current, bare


def explains_most(first: Fit, found: Fit) -> bool:
    """Whether an effect takes enough of what is above the noise to be named for it."""
    noise = first.white.size
    return first.chi2 - found.chi2 >= NAMED_SHARE * (first.chi2 - noise)


def _noise(current: Fit) -> float:
    """Chi-square up to which nothing but noise is left."""
    return RESTART_ABOVE * current.white.size


def _elsewhere(hit: Hit, screen: Screen) -> Hit | None:
    """The best hit of the same effect on another side of zero; without one, the second best."""
    def side(parameters: Mapping[str, float]) -> list[bool]:
        return [parameters[n] > 0.0 for n in EFFECTS[hit.name].sizes]

    others = screen.hits(hit.name, keep=None)[1:]
    return next((h for h in others if side(h.parameters) != side(hit.parameters)),
                others[0] if others else None)
