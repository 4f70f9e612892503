"""A hypothesis is a set of missing effects with its fit; here it is found and put to the test.

Whatever fails is dropped with its reason, and the search goes on without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from dfm_stage.diagnosis.candidates import cycles
from dfm_stage.diagnosis.decisions import FEWEST_CYCLES, FITTED_ALONE, MARGIN, RETUNE_RATIO
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.errors import DiagnosisError
from dfm_stage.diagnosis.evidence import DropReason
from dfm_stage.diagnosis.fit import Fit, fit
from dfm_stage.diagnosis.margins import power
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.remainder import Finding, findings
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.verification import (
    Prediction,
    nearest_to,
    predict,
    surrogate_test,
    weights_like,
)
from dfm_stage.diagnosis.witness import Witness, witness
from dfm_stage.identification.periods import find_period
from dfm_stage.identification.system import rounding_step
from dfm_stage.identification.weights import Weights
from dfm_stage.model import EFFECTS, Model

Rivals = Mapping[str, Sequence[Rival]]


@dataclass(frozen=True)
class Hypothesis:
    """Effects that the model lacks, in the order found, their fit and the one without any, for
    each effect the rivals fitted in its place, and those that held-out records do not exercise."""

    names: Names
    fit: Fit
    bare: Fit
    rivals: Rivals = field(default_factory=dict)
    not_exercised: Names = ()

    def without(self, name: str, search: Search) -> Hypothesis:
        """The same without one effect, refitted."""
        rest = tuple(n for n in self.names if n != name)
        return replace(self, names=rest, fit=search.fitted(rest, self.fit))


@dataclass
class Trial:
    """Finds a hypothesis with `search` and tests it on the records `held`.

    `dropped` is what failed and why; `seed` fixes the surrogates. `uncommon` are effects that are
    looked for only where those of the search leave more than noise. `lag` are the samples over
    which the velocity of a position that drifts is judged.
    """

    search: Search
    held: Sequence[Observation]
    seed: int = 0
    held_weights: Weights = ()
    dropped: dict[str, DropReason] = field(default_factory=dict)
    uncommon: Names = ()
    lag: int = 0
    _predicted: dict[tuple[int, int, float], tuple[Model, Weights, Prediction]] = field(
        default_factory=dict)
    """What was predicted, by the objects it depends on, which are kept so that no other has their
    identity."""
    _found: dict[tuple[int, bool], tuple[object, dict[str, tuple[Finding, ...]]]] = field(
        default_factory=dict)
    """The same of what was found in the residuals of a fit."""
    _witnesses: dict[Names, Witness | None] = field(default_factory=dict)
    """What the force domain says of these records, by the effects that it judged."""

    @cached_property
    def witness(self) -> Witness | None:
        """What the force domain says; None where the records are too short for it."""
        library = self.search.library
        if library not in self._witnesses:
            self._witnesses[library] = self._judged_by_force()
        return self._witnesses[library]

    def _judged_by_force(self) -> Witness | None:
        self.search.step("judging in the force domain")
        try:
            return witness([replace(r, window=0) for r in self.search.runs], self.search.model,
                           self.search.library, held=[replace(r, window=0) for r in self.held],
                           free=self.search.free)
        except DiagnosisError:
            return None

    def on(self, runs: Sequence[Observation], held: Sequence[Observation], *,
           free: Names | None = None) -> Trial:
        """The same with nothing tried yet, on other forms of the records, or with other base
        parameters free."""
        old = self.search
        search = Search(old.model, runs, old.free if free is None else free, library=old.library,
                        again=old.again, step=old.step)
        return Trial(search, held, self.seed, uncommon=self.uncommon, lag=self.lag)

    def widened(self) -> Trial:
        """The same among the uncommon effects, too."""
        return Trial(self.search.widened(self.uncommon), self.held, self.seed, lag=self.lag,
                     _witnesses=self._witnesses)

    def run(self, names: Names, found: Fit) -> Hypothesis:
        """Test what a search found and what it finds after each drop; return what is left."""
        search = self.search
        while True:
            names, found, bare = search.settle(names, found)
            search.step("comparing rivals")
            names, found, rivals = search.compare(names, found)
            h = Hypothesis(names, found, bare, rivals)
            self.held_weights = weights_like(self.held, search.weights)
            search.step("predicting held-out records")
            h = self.exchange_rival(h)
            h = replace(h, fit=search.polished(h.names, h.fit))
            for test in (self.surrogate_tests, self.without_each, self.line_of_input,
                         self.at_bound):
                h = test(h)
            second = self.second_look(h)
            if second is None:
                return h if len(h.names) == len(names) else self.compared(h)
            names, found = second

    def compared(self, h: Hypothesis) -> Hypothesis:
        """The same with rivals fitted beside the effects that are left after others were
        dropped."""
        return replace(h, rivals=self.search.all_rivals(h.names, h.fit))

    def second_look(self, h: Hypothesis) -> tuple[Names, Fit] | None:
        """Search on without what was dropped in this round; None if nothing was, or nothing
        helps."""
        if self.search.barred == set(self.dropped):
            return None
        self.search.barred = set(self.dropped)
        self.search.step("screening what is left")
        return self.search.second(h.names, h.fit)

    def predicted(self, model: Model) -> Prediction:
        """What a model with effects leaves of the held-out records."""
        key = id(model), id(self.held_weights), self.search.noise
        if key not in self._predicted:
            self._predicted[key] = model, self.held_weights, predict(
                model, self.held, self.held_weights, self.search.noise)
        return self._predicted[key][-1]

    def findings(self, found: Fit, ask_colour: bool = True) -> dict[str, tuple[Finding, ...]]:
        """What stands out in what a fit leaves of each run, by the run's name; with the question,
        which takes long, whether it is no more than colour of the noise."""
        key = id(found.residuals), ask_colour   # a fit holds much more
        if key not in self._found:
            rounded = rounding_step(found.model) is not None
            noise = None if rounded else found.model.base.get("noise")
            self._found[key] = found.residuals, {
                run.name: tuple(findings(run, parts[0], noise, found.model, ask_colour))
                for run, parts in zip(self.search.runs, found.residuals, strict=True)}
        return self._found[key][1]

    def no_worse(self, h: Hypothesis) -> Hypothesis:
        """The same with the model as given in the place of its re-estimation, where that is
        further from the fitted or from the held-out records than noise explains."""
        search, noise = self.search, self.search.noise
        near = nearest_to(search.model, search.runs, search.weights, noise)
        if not (near.ok and h.bare.ok):
            return h
        given = fit(search.model, search.runs, (), search.weights, earlier=near.locals,
                    noise=noise, iterations=0)
        lag = self.lag if given.system.drifts else 0
        left = [(power(given.residuals, lag), power(h.bare.residuals, lag)),
                (power(self.predicted(search.model).residuals, lag),
                 power(self.predicted(h.bare.model).residuals, lag))]
        if all(after <= RETUNE_RATIO**2 * before for before, after in left):
            return h
        return replace(h, bare=given, fit=h.fit if h.names else given)

    def exchange_rival(self, h: Hypothesis) -> Hypothesis:
        """Put a rival in the place of an effect that fits as well, where the held-out records part
        them: fitted and held out together it must be better by the margin."""
        for name in h.names:
            close = [r for r in h.rivals[name] if r.price(h.fit) <= MARGIN]
            if not close:
                continue
            own = self.predicted(h.fit.model).chi2
            scores = [r.price(h.fit) + self.predicted(r.fit.model).chi2 for r in close]
            if min(scores) >= own - MARGIN:
                continue
            better = close[scores.index(min(scores))]
            kept: dict[str, Sequence[Rival]] = {
                n: [replace(r, cost=r.fit.chi2 - better.fit.chi2) for r in found]
                for n, found in h.rivals.items() if n != name}
            kept[better.name] = [Rival(name, -better.cost, h.fit)]
            names = tuple(better.name if n == name else n for n in h.names)
            return replace(h, names=names, fit=better.fit, rivals=kept)
        return h

    def surrogate_tests(self, h: Hypothesis) -> Hypothesis:
        """Drop effects that do no better on held-out runs than their surrogates.

        Those that held-out runs do not exercise stay, noted as such, but not where they were
        found in place of dropped ones, as fitted records alone were wrong before, nor beside
        others where the fitted ones show little.
        """
        not_exercised = []
        for name in h.names:
            without = h.bare if len(h.names) == 1 else h.without(name, self.search).fit
            fall = without.chi2 - h.fit.chi2 if without.ok else 0.0
            passed = surrogate_test(
                h.fit.model, name, self.held, self.held_weights, self.search.noise, self.seed
            ).passed(bool(EFFECTS[name].per_run), fall)
            shown = len(h.names) == 1 or fall >= FITTED_ALONE or not without.ok
            if passed is None and shown and not self.search.barred:
                not_exercised.append(name)
            elif not passed:
                self.dropped[name] = (
                    DropReason.NOT_EXERCISED if passed is None else DropReason.NOT_HELD_OUT
                    if EFFECTS[name].per_run else DropReason.SURROGATES)
                return self.surrogate_tests(h.without(name, self.search))
        return replace(h, not_exercised=tuple(not_exercised))

    def without_each(self, h: Hypothesis) -> Hypothesis:
        """Drop the effect beside others without which the refitted model predicts best, where
        that is better than with it: the others may do what it did."""
        own = self.predicted(h.fit.model)
        rest = [(self.predicted(h.without(n, self.search).fit.model).rms, n) for n in h.names
                if len(h.names) > 1 and n not in h.not_exercised]
        rms, name = min(rest, default=(math.inf, ""))
        if rms >= own.rms:
            return h
        self.dropped[name] = DropReason.REFITTED
        return self.without_each(h.without(name, self.search))

    def line_of_input(self, h: Hypothesis) -> Hypothesis:
        """Drop a vibration at a line of the input where the model leaves more than noise: it may
        be no more than the model's own error there."""
        run = self.search.runs[0]
        name = next((n for n in h.names if EFFECTS[n].frequency), "")
        if not name or len(h.names) == 1:
            return h
        repeated = run.periodicity or find_period(run.input)  # measured, it repeats but for noise
        if repeated is None:
            return h
        lines = h.fit.model.parameters()[f"{name}.{EFFECTS[name].frequency}"] * (
            repeated.period * run.sample_period)
        nearest = 0.5 * repeated.period / run.input.size
        left = findings(run, h.fit.residuals[0][0], None)
        if abs(lines - round(lines)) > nearest or not any(f.real for f in left):
            return h
        self.dropped[name] = DropReason.LINE_OF_INPUT
        return h.without(name, self.search)

    def at_bound(self, h: Hypothesis) -> Hypothesis:
        """Drop effects of which a parameter has no interval: the fit ran to the bound of what the
        effect can be, and stands for something else there; so does a sine of which the records
        show but a part. One whose size may be zero is not shown."""
        for name in reversed(h.names):
            values = self.search.quantities_of(name, h.fit)
            own = [q for address, q in values.items() if address.startswith(f"{name}.")]
            sizes = [q for size in EFFECTS[name].sizes
                     if (q := values.get(f"{name}.{size}")) is not None]
            unbound = cycles(name, h.fit.model, self.search.runs) < FEWEST_CYCLES or any(
                not q.bounded for q in own)
            if unbound or (len(sizes) == 1 and sizes[0].covers(0.0)):
                self.dropped[name] = DropReason.AT_BOUND if unbound else DropReason.NO_SIZE
                return self.at_bound(h.without(name, self.search))
        return h
