"""When uncommon effects are looked for, and when what they explain is taken."""

from __future__ import annotations

from collections.abc import Sequence

from dfm_stage.diagnosis.alike import at_upper_end, laws_of_speed, shares_class
from dfm_stage.diagnosis.candidates import excluded
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    FIRST,
    FURTHER,
    FURTHER_PART,
    MARGIN,
    NAMED_SHARE,
)
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.explaining import Judgement, explained, is_noise, to_noise
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.grading import beside_main
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.screen import Hit, best_of_each
from dfm_stage.diagnosis.search import Search, explains_most
from dfm_stage.diagnosis.search_decisions import (
    FIRST_SHARE,
    MOST_STEPS,
    NEAR_NOISE,
)
from dfm_stage.diagnosis.verdict import (
    explained_share,
    is_clearly_more,
    is_coloured_noise,
    main_effect,
    verdict,
)
from dfm_stage.diagnosis.witness import Witness
from dfm_stage.model import EFFECTS


def judged_among_all(trial: Trial, first: Fit, warnings: Sequence[str], split: bool) -> Judgement:
    """What the effects of the search explain; where they leave a remainder, what these and the
    uncommon ones do, if that is clearly more; where they do not, one uncommon effect that does in
    the place of several. Before that search a first look says whether it is worth while."""
    alone = _one_uncommon(trial, first, warnings, split)
    if alone is not None:
        return alone
    found = explained(trial, first, warnings, split)
    said = verdict(found[2])
    relatives = _relatives(trial, found[1]) if said.complete else set()
    others = relatives or (len(found[1].names) > 1 and _kin(trial, found[1]))
    coloured = is_coloured_noise(found[2])
    if not trial.uncommon or (said.complete and not others and not coloured):
        return found
    trial.search.step("looking for uncommon effects, too")
    wide = trial.widened()
    first = wide.search.begin()
    if coloured:
        return _in_the_colour(wide, first, found, warnings, split)
    if said.complete:
        return _one_for_all(wide, first, found, relatives, warnings, split)
    heard = explained_share(found[2]) < NAMED_SHARE and _may_explain(wide, found)
    if heard or _leaves_less(wide, first, found):
        among_all = explained(wide, first, warnings, split)
        if is_clearly_more(among_all[2], found[2]):
            return among_all
    return _beside_main(found, warnings, split)


def _one_uncommon(trial: Trial, first: Fit, warnings: Sequence[str],
                  split: bool) -> Judgement | None:
    """One uncommon effect that leaves only noise where no common one does by itself, or the set of
    the force domain that does, or the one effect that takes its place in a search among all; a
    search for several common ones would end in more than noise, and late."""
    search = trial.search
    if not trial.uncommon or search.runs[0].window or is_noise(first):
        return None
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    usual, common = search.alone(first)
    if is_noise(common):
        return None
    search.step("looking for uncommon effects, too")
    wide = trial.widened()
    begun = wide.search.alone_of(trial.uncommon, first, common)
    if not may_stand_alone(search, begun[1], common):
        forced = _begun_by_force(trial, wide, first, usual, common)
        if forced is None or not may_stand_alone(search, forced[1], common):
            return None
        begun = forced
    other = wide, *to_noise(wide, *begun, MOST_STEPS, warnings, split)
    names = other[1].names
    alone = len(names) == 1 or set(names) & set(trial.uncommon)
    stays = alone and len(names) <= len(begun[0])
    return other if stays and verdict(other[2]).complete else None


def _begun_by_force(trial: Trial, wide: Trial, first: Fit, usual: Names,
                    common: Fit) -> tuple[Names, Fit] | None:
    """The fit of the effects that explain nearly all in the force domain, begun as there: a large
    effect is far from what its response to a small one promises.

    Of lags, the force domain knows little: where the `common` fit is of one that explains most,
    the effects come beside it. Where another effect explains most, the force is not asked.
    """
    beside = usual if explains_most(first, common) else ()
    if any(EFFECTS[n].late is None for n in beside):
        return None
    seen, search = wide.witness, wide.search
    if seen is None or not _needs_uncommon(seen, trial):
        return None
    told = tuple(n for n in seen.best.names if not beside or EFFECTS[n].late is None)
    names = *beside, *told
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    search.step(f"fitting {' and '.join(names)}")
    found = search.around(names, common if beside else first, [
        Hit.at(n, seen.best.of_effect(n)) for n in told])
    return None if at_upper_end(found, told) else (names, found)


def _needs_uncommon(seen: Witness, trial: Trial) -> bool:
    """Whether the set that explains nearly all of the force has an uncommon effect, lags apart,
    and every common one in the place of it is clearly worse: of two friction laws, the best by a
    hair is chance."""
    own = [n for n in seen.best.names if n in trial.uncommon and EFFECTS[n].late is None]
    return bool(own) and not seen.cannot_tell and seen.best.share >= NAMED_SHARE and all(
        behind > BLOCK_MARGIN for n in own for rival, behind in seen.margins[n].items()
        if rival in trial.search.library)


def _in_the_colour(wide: Trial, first: Fit, found: Judgement, warnings: Sequence[str],
                   split: bool) -> Judgement:
    """The verdict on coloured noise, or an uncommon effect that leaves only noise: what acts
    rarely does not repeat with the input, and passes for noise with a colour."""
    if not _leaves_less(wide, first, found):
        return found
    other = explained(wide, first, warnings, split)
    said = verdict(other[2])
    return other if other[1].names and said.complete else found


def _beside_main(found: Judgement, warnings: Sequence[str], split: bool) -> Judgement:
    """What was found to explain a part, with the effects beside the main one, and a main one that
    few machines have, compared with the uncommon ones, too. In windows the force domain alone
    proposes rivals, and it has done so."""
    own, h, evidence = found
    alone = len(h.names) < 2 and not any(EFFECTS[n].gives_way_to for n in h.names)
    if alone or not evidence.graded or evidence.heard is not None or own.search.runs[0].window:
        return found
    own.search.step("comparing uncommon effects, too")
    wide = own.widened()
    wide.dropped, wide.witness = own.dropped, own.witness
    return wide, *beside_main(wide, h, main_effect(evidence).name, own.search.library, warnings,
                              split)


def _relatives(trial: Trial, h: Hypothesis) -> set[str]:
    """The uncommon effects that may stand behind what was found: those that can be the same motion
    as one of its effects, those of its class that have fewer parameters than all together, and
    those of its class that what is left looks like."""
    many = sum(len(EFFECTS[own].parameters) for own in h.names)
    kin = _kin(trial, h)
    return {n for n in trial.uncommon if any(n in EFFECTS[own].twins for own in h.names)} | {
        n for n in kin if len(EFFECTS[n].parameters) < many} | _seen_in_what_is_left(trial, h, kin)


def _kin(trial: Trial, h: Hypothesis) -> list[str]:
    """The uncommon effects that share a class with one that was found."""
    return [n for n in trial.uncommon if any(shares_class(n, own) for own in h.names)]


def _seen_in_what_is_left(trial: Trial, h: Hypothesis, names: Sequence[str]) -> set[str]:
    """Those of some effects that would lower the chi-square of what was found: one of it may only
    be the first term of theirs."""
    if not names or trial.search.runs[0].window:
        return set()
    search = trial.search.widened(tuple(names))
    _, hits = search.screened(_weighed(search, h), h.names, names)
    return {hit.name for hit in hits if hit.gain > FIRST}


def _weighed(search: Search, h: Hypothesis) -> Fit:
    """The fit of what was found under the weights of a search: tests of it may have set others."""
    return h.fit if h.fit.weights is search.weights else search.fitted(h.names, h.fit)


def _one_for_all(wide: Trial, first: Fit, found: Judgement, relatives: set[str],
                 warnings: Sequence[str], split: bool) -> Judgement:
    """What was found to leave only noise, or what explains as much with fewer parameters, or
    clearly more: one of its `relatives` in the place of all, or one of its class in the place of
    one, of several, or of all laws of speed. An effect that is spared may cost what a further one
    must bring."""
    own, h, _ = found
    search = wide.search
    search.begin_work(FIRST_SHARE * MOST_STEPS)
    begun = _begun_alone(search, first, h, relatives)
    at, laws = search.conditions(search.model), laws_of_speed(h.names)
    kin = [n for n in (_kin(own, h) if len(h.names) > 1 else [])
           if not excluded(n, search.model, at, search.again)]
    for kindred in laws_of_speed(kin) if len(laws) > 1 else ():
        names = (*(n for n in h.names if n not in laws), kindred)
        gone = next((n for n in laws if kindred not in EFFECTS[n].twins), laws[0])
        begun[names] = search.in_place_of(gone, kindred, names, h.fit)
    for name in h.names:
        twins = {n for n in relatives & EFFECTS[name].twins.keys()
                 if not excluded(n, search.model, at, search.again)}
        for kindred in sorted(twins.union(n for n in kin if shares_class(n, name))):
            names = tuple(kindred if n == name else n for n in h.names)
            begun[names] = search.in_place_of(name, kindred, names, h.fit)
    search.reweigh(own.search.weights, own.search.noise)
    least = _weighed(search, h)
    tried = [(names, search.fitted(names, each)) for names, each in begun.items() if each.ok]
    most = least.chi2 + search.further(h.names, least) * (len(h.names) - 1)
    tried += [search.pruned(*each) for each in tried if each[1].ok and each[1].chi2 <= most]
    fits = {names: each for names, each in tried if set(names) & set(own.uncommon)
            and _is_preferred(search, names, each, h.names, least)}
    if not fits:
        return found
    names = min(fits, key=lambda each: search.score(fits[each]) + FURTHER * len(each))
    other = wide, *to_noise(wide, names, fits[names], MOST_STEPS, warnings, split)
    return other if len(other[1].names) <= len(names) and verdict(other[2]).complete else found


def _is_preferred(search: Search, names: Names, each: Fit, found: Names, least: Fit) -> bool:
    """Whether effects are preferred to those found, which leave the `least`: fewer effects by
    what a further one must bring, fewer parameters at the same score, others by a margin."""
    if len(names) < len(found):
        further = search.further(found, least)
        return each.chi2 <= least.chi2 + further * (len(found) - len(names))
    fewer = len(each.system.free) < len(least.system.free)
    return search.score(each) <= search.score(least) - (0.0 if fewer else MARGIN)


def _begun_alone(search: Search, first: Fit, h: Hypothesis,
                 relatives: set[str]) -> dict[Names, Fit]:
    """Fits of each relative of its class in the place of all that was found."""
    alone = {n for n in relatives if any(shares_class(n, own) for own in h.names)}
    if not alone:
        return {}
    _, hits = search.screened(first, (), sorted(alone))
    return {(hit.name,): search.fitted((hit.name,), first, [hit]) for hit in best_of_each(hits)}


def _may_explain(wide: Trial, found: Judgement) -> bool:
    """Whether the force domain, which takes seconds, has not said that the effects of a search
    without the uncommon ones explain most."""
    seen = wide.witness
    return seen is None or not seen.explained_by(found[0].search.library)


def _leaves_less(wide: Trial, first: Fit, found: Judgement) -> bool:
    """Whether the first effects of a search among all leave clearly less above the noise than what
    was found."""
    if found[0].search.runs[0].window:
        return False
    _, other = wide.search.grown((), first, rounds=1)
    noise = found[2].noise.rms**2
    return other.rms**2 - noise < (1.0 - FURTHER_PART) * (found[1].fit.rms**2 - noise)


def may_stand_alone(search: Search, found: Fit, common: Fit) -> bool:
    """Whether effects come near the noise and explain more than the best common one does, their
    parameters paid for."""
    return found.chi2 <= NEAR_NOISE * found.white.size \
        and search.score(found) <= search.score(common) - FURTHER
