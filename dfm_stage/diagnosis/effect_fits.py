"""All fits of one diagnosis: the model with any set of effects, under the present weights."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dfm_stage.diagnosis.alike import is_dry
from dfm_stage.diagnosis.candidates import late_splits, shown_by_none, starts
from dfm_stage.diagnosis.decisions import (
    FURTHER,
    GRADED_FALL,
    GRADED_ITERATIONS,
    HALVINGS,
    POLISHED_PART,
)
from dfm_stage.diagnosis.fit import Fit, fit
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.same_motion import most_alike
from dfm_stage.diagnosis.screen import Hit
from dfm_stage.diagnosis.search_decisions import (
    AROUND_STEPS,
    BENT,
    MOST_STEPS,
    NEAR_NOISE,
    NOISE_SHARES,
    PER_PARAMETER,
    POLISHED,
    PROMISED,
    ROUGH_NOISE,
    ROUNDED_GAIN,
    STEPS_A_FIT,
    STEPS_BEFORE_LINEAR,
    STEPS_BEFORE_SLOW,
)
from dfm_stage.identification.quantity import Quantity
from dfm_stage.identification.system import is_nonlinear, rounding_step, steps_taken
from dfm_stage.identification.weights import Weight, Weights, white_weights
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import Parameters

Names = tuple[str, ...]


@dataclass
class Fits:
    """`runs` are fitted; `free` are the base parameters (and those of effects the model has) that
    are re-estimated."""

    model: Model
    runs: Sequence[Observation]
    free: Names
    fits: dict[tuple[frozenset[str], int], Fit] = field(default_factory=dict)
    weights: Weights = ()
    weighing: int = 0
    weighings: dict[tuple[Any, ...], int] = field(default_factory=dict)
    """The number of each set of weights so far: fits by the same weights are not made again."""
    noise: float = 0.0
    """RMS of the output's noise, over which a quantised reading is averaged."""
    begun: float = field(default_factory=steps_taken)
    most_steps: float = MOST_STEPS
    unfinished: dict[frozenset[str], Names] = field(default_factory=dict)
    """By the effects of a fit that was not begun, or not finished, for want of work: those for
    which it was made."""

    @property
    def steps(self) -> float:
        """Integration steps taken since this search was made: its work."""
        return steps_taken() - self.begun

    def begin_work(self, most_steps: float) -> None:
        """Allow so many integration steps from now on, also for fits that were cut short."""
        self.begun, self.most_steps = steps_taken(), most_steps
        self.fits = {key: found for key, found in self.fits.items() if not found.cut}

    def conditions(self, model: Model) -> Conditions:
        """Sizes that occur in the fitted runs."""
        return Conditions.of(model.base, model.drive, self.runs, self.noise,
                             model.position_unit)

    def begin(self) -> Fit:
        """Fit the model as it is; sets the first weights."""
        motion = [max(float(np.std(r.output)), 1e-300) for r in self.runs]
        rough = tuple(tuple(
            Weight(np.ones(1), ROUGH_NOISE * size, "") for size in
            (m, *(float(np.std(s)) for s in list(r.compared.values())[1:])))
            for r, m in zip(self.runs, motion, strict=True))
        self.weights = rough
        self.noise = rough[0][0].rms
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

    def fit_like(self, first: Fit, runs: Sequence[Observation]) -> Fit:
        """The model of a `first` fit fitted to other forms of the same runs, from there on: to
        where the power left is known."""
        return fit(first.model, runs, first.system.free, self.weights, earlier=first.locals,
                   noise=self.noise, tolerance=1.0)

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
        self.reweigh(first_weights(found), quiet_weights(found)[0][0].rms)

    def reweigh(self, weights: Weights, noise: float | None = None) -> None:
        """Compare fits by other weights from now on."""
        self.weights = weights
        self.noise = weights[0][0].rms if noise is None else noise
        content = self.noise, *((w.polynomial.tobytes(), w.sigma) for ws in weights for w in ws)
        self.weighing = self.weighings.setdefault(content, len(self.weighings))

    def keep(self, names: Iterable[str], found: Fit) -> Fit:
        """Remember a fit under the present weights."""
        key = frozenset(names)
        self.fits[key, self.weighing] = found
        if found.ok and not found.cut:
            self.unfinished.pop(key, None)
        return found

    def _keep_better(self, names: Names, found: Fit) -> Fit:
        """The better of a fit and the one known of the same effects, remembered; one that failed
        is not, because others may begin elsewhere."""
        known = self.fits.get((frozenset(names), self.weighing), found)
        better = found if found.ok and found.chi2 <= known.chi2 else known
        return self.keep(names, better) if better.ok else better

    @property
    def not_compared(self) -> Names:
        """Effects whose fits were not begun, or not finished, in that order."""
        return tuple(dict.fromkeys(n for names in self.unfinished.values() for n in names))

    def fitted(self, names: Sequence[str], start: Fit, hits: Sequence[Hit] = (),
               worth: float = math.inf) -> Fit:
        """The fit with the effects `names` under the present weights; begins at `start`, to which
        the effects of `hits` are added. Parameters that come later are freed only where the
        others alone bring chi-square below `worth`."""
        key = frozenset(names), self.weighing
        if key in self.fits:
            return self.fits[key]
        found = self._weaker(hits, lambda weaker: self._from(start.model, names, start, weaker,
                                                             worth))
        expected = start.chi2 - PROMISED * sum(h.gain for h in hits[:1])
        given = {n: v for n, v in self.model.base.items() if n in self.free}
        anew = start.model.with_parameters(given)
        weaker = _gain(anew) / _gain(start.model)
        bent = abs(math.log(weaker)) > math.log(BENT)
        if bent or start.system.springless:
            expected = -math.inf  # its base bends far to stand in for what is missing
        small = [_rescaled(h, weaker) for h in hits] if bent else hits
        for model, others_first, new in ((start.model, True, hits), (anew, False, small)):
            if not hits or found.chi2 < expected or self.steps >= STEPS_BEFORE_SLOW:
                break
            again = self._from(model, names, start, new, worth, others_first, split=False)
            if again.chi2 < found.chi2:
                found = self._split(again, new)
        if len(hits) == 1 and found.ok and found.chi2 > NEAR_NOISE * found.white.size:
            alone = self._in_place_of_base(names, start, hits[0])
            if alone is not None and alone.chi2 < found.chi2:
                found = alone
        return self.keep(names, self._no_worse(found, names, hits, lambda fewer, weaker:
                                               self._from(fewer.model, names, fewer, weaker,
                                                          worth)))

    def around(self, names: Names, start: Fit, hits: Sequence[Hit]) -> Fit:
        """The fit that begins with further effects, all else fitted around them first; the best so
        far of several."""
        return self._keep_better(names, self._from(start.model, names, start, hits, math.inf,
                                                   others_first=True))

    def once(self, names: Sequence[str], start: Fit, hits: Sequence[Hit] = (),
             base: Parameters | None = None) -> Fit:
        """The fit with the effects `names` from one beginning, without what is freed last, as far
        as power left is told by: enough to rank sets of which none reaches the noise.

        `base` are other values of base parameters to begin with, taken where they leave less.
        """
        key = frozenset(names), self.weighing
        if key in self.fits:
            return self.fits[key]
        found = self._weaker(hits, lambda weaker: self._once(names, start, weaker, base or {}))
        return self.keep(names, self._no_worse(
            found, names, hits, lambda fewer, weaker: self._once(names, fewer, weaker, {})))

    def as_given(self, known: Fit) -> Fit:
        """The model as given, with the initial states that bring it nearest to the records."""
        near = self._fit(self.model, (), known)
        return fit(self.model, self.runs, self.free, self.weights, earlier=near.locals,
                   noise=self.noise, iterations=0)

    def once_of(self, hit: Hit, bare: Fit, given: Fit) -> Fit:
        """The better of the fits, as in `once`, of one effect that begin beside the base as it was
        re-estimated and as it is `given`."""
        names = (hit.name,)
        self.once(names, bare, [hit])
        return self._keep_better(names, self._weaker(
            [hit], lambda weaker: self._once(names, given, weaker, {})))

    def _once(self, names: Sequence[str], start: Fit, hits: Sequence[Hit],
              base: Parameters) -> Fit:
        model, later = self._with(start.model, names, hits)
        given = {n: model.parameter(n).inside(v) for n, v in base.items() if n in self.free}
        if given:
            other = model.with_parameters(given)
            if self._fit(other, (), start, iterations=0).chi2 < self._fit(
                    model, (), start, iterations=0).chi2:
                model = other
        free = tuple(n for n in self.parameters(model) if n not in later)
        return self._fit(model, free, start, iterations=GRADED_ITERATIONS,
                         tolerance=GRADED_FALL * start.white.size)

    def _weaker(self, hits: Sequence[Hit], begin: Callable[[Sequence[Hit]], Fit]) -> Fit:
        """The fit that begins with the effects of `hits`, at half their sizes where the motion
        escapes: states that suit the model without a softening spring lie beyond its summit."""
        found = begin(hits)
        for _ in range(HALVINGS):
            if found.ok or not hits or self.steps > self.most_steps:
                break
            hits = [_halved(h) for h in hits]
            found = begin(hits)
        return found

    def _no_worse(self, found: Fit, names: Sequence[str], hits: Sequence[Hit],
                  begin: Callable[[Fit, Sequence[Hit]], Fit]) -> Fit:
        """`found`, or where a fit with fewer effects is better, which a minimum cannot be worse
        than, one that begins there with the others at half their sizes or less: begun at the size
        that a linear screen promises, a fit may end in a far minimum."""
        fewer = min((f for (known, weighing), f in self.fits.items() if f.ok
                     and weighing == self.weighing and known < frozenset(names)),
                    key=lambda f: f.chi2, default=found)
        where = {h.name: h.parameters for h in hits}
        new = [Hit.at(use.name, where.get(use.name, use.parameters))
               for use in found.model.effects if fewer.model.effect(use.name) is None]
        for _ in range(HALVINGS):
            if (found.ok and found.chi2 < fewer.chi2 + PER_PARAMETER) or not new \
                    or self.steps > self.most_steps:
                break
            new = [_halved(hit) for hit in new]
            again = begin(fewer, new)
            found = min(found, again, key=lambda f: f.chi2 if f.ok else math.inf)
        return found

    def settled(self, names: Sequence[str], found: Fit) -> Fit:
        """A fit made `once` at its minimum, for the values that are told."""
        again = self._fit(found.model, found.system.free, found, tolerance=POLISHED_PART
                          * found.white.size)
        return self.keep(names, again) if again.chi2 < found.chi2 else found

    def in_place_of(self, name: str, twin: str, names: Names, current: Fit) -> Fit:
        """The fit of `names`, in which `twin` has taken the place of `name`, begun where the two
        are the same motion (`Effect.twins`), or as nearly as they can be, beside the base that
        leaves least: that of `current`, that without any effect, or that given."""
        use = current.model.effect(name)
        assert use is not None  # noqa: S101 (who calls has found it)
        at = self.conditions(current.model)
        if twin in EFFECTS[name].twins:
            typical = next(iter(starts(twin, at)), EFFECTS[twin].defaults)
            begin = Hit.at(twin, {**typical, **EFFECTS[name].twins[twin](use.parameters)})
        else:
            gone = [each.name for each in current.model.effects
                    if each.name not in names and self.model.effect(each.name) is None]
            begin = Hit.at(twin, most_alike(twin, gone, current, self.runs, self.noise))
        bases = (current.model, self.fitted((), current).model, self.model)
        first = min((current.model.with_parameters(
            {n: v for n, v in each.base.items() if n in self.free}) for each in bases),
            key=lambda m: self._fit(self._with(m, names, [begin])[0], (), current,
                                    iterations=0).chi2)
        found = self._from(first, names, current, [begin], math.inf, limit=STEPS_BEFORE_LINEAR)
        return self._keep_better(names, found)

    def _from(self, model: Model, names: Sequence[str], start: Fit, hits: Sequence[Hit],
              worth: float, others_first: bool = False, limit: float = STEPS_BEFORE_SLOW,
              split: bool = True) -> Fit:
        """`others_first`: fit all else around the new effects first, and only then them, too.
        Begun together, a large effect may be traded away for what it displaces. Once the work is
        beyond `limit`, nothing slow is begun. With `split` a lag shares with the base's."""
        model, later = self._with(model, names, hits)
        free = self.parameters(model)
        early = tuple(n for n in free if n not in later)
        slow = bool(later) or (self.steps > STEPS_BEFORE_LINEAR
                               and any(is_nonlinear(use.name) for use in model.effects))
        if hits and slow and self.steps > limit:
            self.unfinished[frozenset(names)] = tuple(h.name for h in hits)
            return replace(start, chi2=math.inf, cut=True)
        if others_first:
            new = {hit.name for hit in hits}
            around = tuple(n for n in free if n.partition(".")[0] not in new)
            start = self._fit(model, around, start, iterations=AROUND_STEPS, tolerance=1.0)
            model = start.model
        found = self._fit(model, early, start, iterations=12 if later else 25,
                          tolerance=1.0 if later else 0.03)
        if any(EFFECTS[h.name].rounds for h in hits) and "noise" not in self.model.base:
            found = self._with_noise(found, early)
        if later and found.ok and found.chi2 < worth and not is_dry(
                found, [hit.name for hit in hits]):
            freed = found.model.with_parameters({
                f"{hit.name}.{n}": v for hit in hits
                for n, v in EFFECTS[hit.name].freed_last.items() if v is not None})
            found = self._fit(freed, self.parameters(freed), found, tolerance=0.1)
        found = self.refined(found)
        return self._split(found, hits) if split else found

    def _split(self, found: Fit, hits: Sequence[Hit]) -> Fit:
        """The best share of a new lag among those that act alike."""
        late = found.ok and any(EFFECTS[h.name].late for h in hits)
        return self.resplit(found) if late else found

    def _with(self, model: Model, names: Sequence[str],
              hits: Sequence[Hit]) -> tuple[Model, list[str]]:
        """The model with the effects `names`, those of `hits` where these begin, and what of the
        latter is freed last."""
        for use in model.effects:
            if use.name not in names and self.model.effect(use.name) is None:
                model = model.without_effect(use.name)
        later: list[str] = []
        for hit in hits:
            model = model.with_effect(hit.name, inside(hit.name, hit.parameters))
            later += [f"{hit.name}.{n}" for n in EFFECTS[hit.name].freed_last]
        return model, later

    def _in_place_of_base(self, names: Sequence[str], start: Fit, hit: Hit) -> Fit | None:
        """The fit that begins with an effect in the place of the base parameter that it acts like,
        which is at its lower limit and freed last: begun beside it, a fit does not come along
        that limit. None of an effect that replaces none."""
        base, own = EFFECTS[hit.name].replaces or ("", None)
        if own is None or base not in self.free:
            return None
        model, _ = self._with(start.model, names, [hit])
        known = model.parameters()
        made = own(known[base], {n: known[f"{hit.name}.{n}"] for n in EFFECTS[hit.name].defaults})
        model = model.with_parameters({base: model.parameter(base).low, **{
            f"{hit.name}.{n}": v for n, v in made.items()}})
        free = self.parameters(model)
        # without the base parameter no spring tells the offset of the reading from a force
        runs = [run if run.trend is not None else replace(run, trend=0) for run in self.runs]
        alone = self._fit(model, tuple(n for n in free if n != base), start, tolerance=1.0,
                          runs=runs)
        return self.refined(self._fit(alone.model, free, alone))

    def _fit(self, model: Model, free: Names, start: Fit, *, iterations: int = 25,
             tolerance: float = 1e-2, exact: bool = False,
             runs: Sequence[Observation] | None = None) -> Fit:
        """A fit within what is left of the work that may be done; parameters that have no
        meaning where it ends are at their defaults again, and no longer free."""
        found = fit(model, runs or self.runs, free, self.weights, earlier=start.locals,
                    noise=self.noise, iterations=iterations, tolerance=tolerance, exact=exact,
                    allowance=min(max(self.most_steps - self.steps, 0.0), STEPS_A_FIT))
        if self.steps > self.most_steps:
            added = self._added(found.model)
            self.unfinished[added] = tuple(n for n in found.system.nonlinear if n in added)
            found = replace(found, cut=True)
        lost = {f"{use.name}.{n}": use.effect.defaults[n] for use in found.model.effects
                if found.ok and self.model.effect(use.name) is None
                for n in use.effect.without_meaning(use.parameters)}
        kept = tuple(n for n in free if n not in lost)
        return found if kept == free else self._fit(
            found.model.with_parameters(lost), kept, found, iterations=iterations,
            tolerance=tolerance, exact=exact, runs=runs)

    def _added(self, model: Model) -> frozenset[str]:
        """The effects that a model has beside those given."""
        return frozenset(use.name for use in model.effects if self.model.effect(use.name) is None)

    def _with_noise(self, found: Fit, free: Names) -> Fit:
        """The noise before rounding that explains a counted reading best."""
        step = rounding_step(found.model)
        if step is None or not found.ok:
            return found
        trials = [self._fit(found.model.with_parameters({"noise": share * step}),
                            free, found, iterations=4)
                  for share in NOISE_SHARES]
        return min([found, *trials], key=lambda f: f.chi2)

    def parameters(self, model: Model) -> Names:
        """What is free in a model with effects added: the base and all of theirs."""
        own = [f"{use.name}.{n}" for use in model.effects
               if self.model.effect(use.name) is None
               for n in use.effect.fittable(use.parameters)
               if n not in shown_by_none(use.name, self.runs)]
        return (*self.free, *own)

    def refined(self, found: Fit) -> Fit:
        """`found` with each refinement of the effects added free where that pays as a further
        effect must, and at its default where it does not."""
        added = [use.name for use in found.model.effects if self.model.effect(use.name) is None]
        for effect in added if found.ok else ():
            for name in EFFECTS[effect].refinements:
                address, default = f"{effect}.{name}", EFFECTS[effect].defaults[name]
                freed = address in found.system.free
                free = tuple(n for n in found.system.free if n != address) if freed else (
                    *found.system.free, address)
                held = found.model.with_parameters({address: default})
                other = self._fit(held, free, found)
                simple, refined = (other, found) if freed else (found, other)
                gain = simple.chi2 - refined.chi2
                found = refined if gain > self.further(added, simple) else simple
        return found

    def quantities_of(self, name: str, found: Fit) -> dict[str, Quantity]:
        """Every free parameter with its interval; without the refinements of an effect that have
        none. They trade with the rest of it: a range that is met at one end has no middle."""
        lost = {n for r in EFFECTS[name].refinements
                if (n := f"{name}.{r}") in found.quantities
                and not found.quantities[n].bounded}
        if not lost:
            return found.quantities
        free = tuple(n for n in found.system.free if n not in lost)
        return self._fit(found.model, free, found, iterations=0).quantities

    def further(self, names: Iterable[str], current: Fit) -> float:
        """Fall in chi-square that a further effect must bring."""
        if not any(EFFECTS[n].rounds for n in names):
            return FURTHER
        return max(FURTHER, ROUNDED_GAIN * current.white.size)

    def polished(self, names: Names, current: Fit) -> Fit:
        """The fit of `names` at its minimum, for the values that are told."""
        if not names:
            return current
        found = self._fit(current.model, self.parameters(current.model), current, iterations=30,
                          tolerance=POLISHED, exact=True)
        return self.keep(names, found) if found.chi2 < current.chi2 else current

    def best(self, trials: Sequence[tuple[Names, Fit]]) -> tuple[Names, Fit]:
        """The smallest chi-square, further parameters paid for."""
        return min(trials, key=lambda t: self.score(t[1]))

    def score(self, found: Fit) -> float:
        """Chi-square and the price of the parameters."""
        return found.chi2 + PER_PARAMETER * len(found.system.free) if found.ok else math.inf


def first_weights(found: Fit) -> Weights:
    """White noise in the output. The position of a stage without a spring integrates whatever
    small force there is: its drift counts no more than its velocity."""
    quiet = quiet_weights(found)
    return tuple((ws[0].of_change(), *ws[1:]) for ws in quiet) if found.system.drifts else quiet


def quiet_weights(found: Fit) -> Weights:
    """White noise as strong as high frequencies are in what a fit leaves. In windows, in what was
    measured where they are weaker there: states that begin anew make the model's motion jump."""
    quiet, runs = white_weights(found.residuals), found.system.runs
    if not any(run.window for run in runs):
        return quiet
    measured = white_weights([[signal[run.skip:] for signal in run.compared.values()]
                              for run in runs])
    return tuple(tuple(min(pair, key=lambda w: w.sigma) for pair in zip(*each, strict=True))
                 for each in zip(quiet, measured, strict=True))


def _halved(hit: Hit) -> Hit:
    """An effect to begin with at half its size."""
    return Hit.at(hit.name, {n: 0.5 * v if n in EFFECTS[hit.name].sizes else v
                             for n, v in hit.parameters.items()})


def _gain(model: Model) -> float:
    """Force a unit of input, without its sign."""
    return max(abs(model.base.get("force_constant", 1.0)), 1e-300)


def _rescaled(hit: Hit, by: float) -> Hit:
    """An effect beside a base whose forces are larger by a factor, the motion being the same."""
    return Hit.at(hit.name, {n: v * by if EFFECTS[hit.name].parameter(n).unit.startswith("N")
                             else v for n, v in hit.parameters.items()})


def inside(name: str, parameters: dict[str, float]) -> dict[str, float]:
    """Parameters moved inside their limits."""
    limits = {p.name: p for p in EFFECTS[name].parameters}
    return {n: limits[n].inside(v) for n, v in parameters.items()}
