"""Effects that explain a part: the search where no set of effects reaches the noise.

Sets are ranked by the power they leave, not by chi-square: where a model error remains, every bit
of structure lowers chi-square by thousands. An effect stays while held-out blocks are worse
without it, and no rival outside its class does as well.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Sequence

from dfm_stage.diagnosis.alike import at_upper_end, gives_way, shares_class
from dfm_stage.diagnosis.candidates import cycles
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    FEWEST_CYCLES,
    FURTHER_PART,
    GRADED_RIVALS,
    MOST_GRADED,
    NEAR_RIVAL,
    PARAMETER_PART,
    PRESLIDING_DISTANCE,
    PROPOSED,
    RIVAL_GAIN,
    SMALL_SHARE,
)
from dfm_stage.diagnosis.effect_fits import Names
from dfm_stage.diagnosis.evidence import DropReason, Evidence
from dfm_stage.diagnosis.fit import Fit
from dfm_stage.diagnosis.gather import gather, with_witness
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.screen import Hit, best_of_each
from dfm_stage.diagnosis.search import Rival, Search
from dfm_stage.diagnosis.search_decisions import (
    FULL_SHARE,
    GRADING_STEPS,
    LEAST_STEPS,
    SHORT_LIST,
    SHORT_LIST_GAIN,
)
from dfm_stage.diagnosis.verdict import fallen, is_level
from dfm_stage.diagnosis.verification import weights_like
from dfm_stage.diagnosis.witness import Witness
from dfm_stage.model import EFFECTS
from dfm_stage.model.effect import Parameters

Begin = tuple[Fit, dict[str, Parameters], Parameters]
"""A set of effects to begin with: a fit that has some of them, the others' parameters, and base
parameters that may suit better."""


def graded(trial: Trial, h: Hypothesis, warnings: Sequence[str],
           split: bool) -> tuple[Hypothesis, Evidence]:
    """The hypothesis that explains most of the gap, with its evidence.

    What the search found and what it dropped is tried, and what the force domain proposes. Where
    nothing stands, the hypothesis is empty.
    """
    search = trial.search
    search.begin_work(min(GRADING_STEPS, max(search.most_steps - search.steps, LEAST_STEPS)))
    seen = trial.witness
    bare = h.bare
    search.weigh_at_first(bare)
    bare = search.once((), bare)
    trial.held_weights = weights_like(trial.held, search.weights)
    names, found = _largest(search, bare, [
        *_found_before(trial, h, bare), *((bare, *each) for each in _proposed(search, seen))],
        _paid(seen))
    if not _proposes_alone(seen, search):
        if not _takes_all(bare, found):
            names, found = _as_given(search, bare, names, found)
        names, found = _further(search, names, found)
    return _standing(trial, names, found, bare, warnings, split)


def beside_main(wide: Trial, h: Hypothesis, main: str, known: Names, warnings: Sequence[str],
                split: bool) -> tuple[Hypothesis, Evidence]:
    """The effects of `h`, compared with what `wide` knows beyond the effects `known`, too: those
    beside the `main` one with those of no common class, which would make the name wrong, and those
    that can be the same motion; a main one that few machines have with the latter."""
    search = wide.search
    search.begin_work(LEAST_STEPS)
    search.weigh_at_first(h.bare)
    wide.held_weights = weights_like(wide.held, search.weights)

    def among(name: str) -> Names:
        is_main = name == main or name in EFFECTS[main].twins   # which may have taken its place
        twins = () if is_main and not EFFECTS[name].gives_way_to else EFFECTS[name].twins
        return tuple(n for n in search.library if n in known or n in twins
                     or not (is_main or shares_class(n, name)))

    return _standing(wide, h.names, h.fit, h.bare, warnings, split, among)


def _standing(trial: Trial, names: Names, found: Fit, bare: Fit, warnings: Sequence[str],
              split: bool, among: Callable[[str], Names] | None = None
              ) -> tuple[Hypothesis, Evidence]:
    """What of `names` stands on held-out records and against its rivals, which are `among` those
    of the search that this allows an effect. A set that stands is not lost to a rival that does
    not."""
    search, seen = trial.search, trial.witness
    allowed = among or (lambda _: search.library)
    dropped: dict[str, DropReason] = {}
    before: set[frozenset[str]] = set()
    stood: dict[str, tuple[Hypothesis, Evidence]] = {}
    while True:
        before.add(frozenset(names))
        search.begin_work(max(search.most_steps - search.steps, LEAST_STEPS))
        found = search.settled(names, found) if names else found
        h = trial.no_worse(Hypothesis(names, found, bare, {
            n: list(_rivals(search, seen, n, names, found, allowed(n)))
            for n in names}))
        judged = with_witness(gather(trial, h, warnings, split, graded=True), seen)
        weakest = fallen(judged)
        if weakest is None:
            name, better = next(_simpler_rivals(h, judged, before), ("", None))
            if better is None:
                break
            stood[better.name] = h, judged
        elif weakest[0] in stood:
            h, judged = stood[weakest[0]]
            break
        else:
            name, reason = weakest
            better = _better_rival(h, judged, name, dropped)
            dropped[name] = reason
        names = _with_rival(names, name, better)
        found = search.once(names, found) if better is None else better.fit
    trial.dropped.update({n: r for n, r in dropped.items() if n not in h.names})
    return h, judged


def _proposed(search: Search,
              seen: Witness | None) -> Iterator[tuple[dict[str, Parameters], Parameters]]:
    """The sets that explain most of the missing force, and the base parameters beside them."""
    if seen is None or seen.cannot_tell:
        return
    listed = [seen.best, *seen.singles[:PROPOSED], *seen.pairs[:PROPOSED]]
    told: set[frozenset[str]] = set()
    for each in listed:
        allowed = all(n in search.library and n not in search.barred for n in each.names)
        if each.names and allowed and frozenset(each.names) not in told \
                and each.share > max(RIVAL_GAIN * seen.best.share, SMALL_SHARE):
            told.add(frozenset(each.names))
            yield ({n: each.of_effect(n) for n in each.names},
                   {n: v for n, v in each.parameters.items() if "." not in n})


def _paid(seen: Witness | None) -> set[frozenset[str]]:
    """The sets of which the force domain has borne out every effect on held-out blocks: the best,
    and those that explain nearly as much by as many effects."""
    if seen is None or seen.cannot_tell:
        return set()
    return {frozenset(each.names) for each in (seen.best, *seen.pairs)
            if len(each.names) == len(seen.best.names)
            and each.share > RIVAL_GAIN * seen.best.share}


def _found_before(trial: Trial, h: Hypothesis, bare: Fit) -> Iterator[Begin]:
    """The sets that the search fitted: its answer, and the best single effects that can be told
    from what they become at an end of their range."""
    search, seen = trial.search, trial.witness
    if h.names:
        yield h.fit, {}, {}
    singles: dict[str, Fit] = {}
    for (names, _), found in search.fits.items():
        name = next(iter(names), "")
        if len(names) == 1 and name in search.library and _usable(found, (name,)) and (
                name not in singles or found.rms < singles[name].rms):
            singles[name] = found
    for found in sorted(singles.values(), key=lambda f: f.rms)[:2]:
        yield found, {}, {}
    if not search.hits and (seen is None or seen.cannot_tell):
        search.step("screening every effect")
        _, hits = search.screened(bare, ())
        search.hits.update({x.name: x for x in best_of_each(hits)})
    for hit in sorted(search.hits.values(), key=lambda x: -x.gain)[:SHORT_LIST]:
        if hit.name not in singles:
            yield bare, {hit.name: hit.parameters}, {}


def _largest(search: Search, bare: Fit, begins: Sequence[Begin],
             paid: set[frozenset[str]]) -> tuple[Names, Fit]:
    """The set that leaves the least power, a further effect paid for by what it must take; those
    of `paid` have been, on held-out blocks in the force domain.

    Sets with few parameters come first, and one that takes nearly all is the last: large ones
    become the small ones at an end of their range, and take the work of all that follow."""
    best: tuple[Names, Fit] = (), bare

    def score(names: Names, found: Fit) -> float:
        return _score(names[:1] if frozenset(names) in paid else names, found)

    for start, new, base in sorted(begins, key=_added_parameters):
        names = (*(use.name for use in start.model.effects
                   if search.model.effect(use.name) is None), *new)
        search.step(f"fitting {' and '.join(names)}")
        found = search.once(names, start, [Hit.at(n, p) for n, p in new.items()], base)
        if _usable(found, names) and score(names, found) < score(*best):
            best = names, found
        if _takes_all(bare, best[1]):
            break
    return best


def _takes_all(bare: Fit, found: Fit) -> bool:
    """Whether a fit takes nearly all that is above the noise."""
    return bare.chi2 - found.chi2 > FULL_SHARE * (bare.chi2 - bare.white.size)


def _as_given(search: Search, bare: Fit, names: Names, found: Fit) -> tuple[Names, Fit]:
    """What was found, or a single effect that does more, begun beside the base as it was given: a
    large effect bends a base that is re-estimated without it, and no longer shows beside that."""
    given = search.as_given(bare)
    if not given.ok:
        return names, found
    search.step("screening beside the model as given")
    _, hits = search.screened(given, ())
    best = best_of_each(hits)
    for hit in (h for h in best[:SHORT_LIST] if h.gain > SHORT_LIST_GAIN * best[0].gain):
        search.step(f"fitting {hit.name}, begun at the model as given")
        other = search.once_of(hit, bare, given)
        if _usable(other, (hit.name,)) and _score((hit.name,), other) < _score(names, found):
            names, found = (hit.name,), other
    return names, found


def _added_parameters(begin: Begin) -> int:
    """Parameters of the effects that a fit begins with."""
    return sum(len(EFFECTS[name].parameters) for name in begin[1])


def _usable(found: Fit, names: Names) -> bool:
    """Whether every effect can be told from what it becomes at an end of its range: a force that
    yields over less than what is left cannot be told from dry friction, a part of a sine not from
    a curve."""
    return found.ok and not at_upper_end(found, names) and not any(
        use.name in names and (
            use.effect.yields_within(use.parameters) < PRESLIDING_DISTANCE * found.rms
            or cycles(use.name, found.model, found.system.runs) < FEWEST_CYCLES)
        for use in found.model.effects)


def _score(names: Names, found: Fit) -> float:
    """Power left, with what each further effect and parameter must take of it at least."""
    return found.chi2 * (1.0 - FURTHER_PART) ** -max(len(names) - 1, 0) \
        * (1.0 - PARAMETER_PART) ** -len(found.system.free)


def _further(search: Search, names: Names, found: Fit) -> tuple[Names, Fit]:
    """Add effects one by one while each takes enough of what is left on the fitted records."""
    while 0 < len(names) < MOST_GRADED and found.ok:
        search.step("screening what is left")
        _, hits = search.screened(found, names)
        trials = []
        for hit in best_of_each(hits)[:SHORT_LIST // 2]:
            search.step(f"fitting {hit.name} beside {' and '.join(names)}")
            trial = search.once((*names, hit.name), found, [hit])
            if _usable(trial, (hit.name,)):
                trials.append(((*names, hit.name), trial))
        best = min(trials, key=lambda t: t[1].chi2, default=None)
        if best is None or _score(*best) >= _score(names, found):
            break
        names, found = best
    return names, found


def _proposes_alone(seen: Witness | None, search: Search) -> bool:
    """Whether the force domain alone proposes: without a spring, where it sees every effect and
    screens of many windows are slow."""
    return seen is not None and not seen.cannot_tell and bool(search.runs[0].window)


def _rivals(search: Search, seen: Witness | None, name: str, names: Names, found: Fit,
            among: Names) -> Iterator[Rival]:
    """The effects `among` some that come nearest in the place of one, fitted."""
    rest = tuple(n for n in names if n != name)
    without = search.once(rest, found)
    if not without.ok:
        return
    near = _near(seen, name, names) if seen is not None and _proposes_alone(seen, search) \
        else _screened(search, name, rest, without, among)
    for hit in near:
        search.step(f"fitting {hit.name} in place of {name}")
        rival = search.once((*rest, hit.name), without, [hit])
        if _usable(rival, (hit.name,)):
            yield Rival(hit.name, rival.chi2 - found.chi2, rival)


def _near(seen: Witness, name: str, names: Names) -> list[Hit]:
    """The rivals that the force domain puts within NEAR_RIVAL standard errors, or first."""
    alone = {e.names[0]: e for e in seen.singles}
    own = alone[name].share if name in alone else 0.0
    margins = seen.margins.get(name, seen.nearest)
    listed = [*seen.best.names, *(n for n, m in margins.items() if m < NEAR_RIVAL)]
    near = [n for n in listed if n in alone and n not in names
            and alone[n].share > RIVAL_GAIN * own]
    return [Hit.at(n, alone[n].of_effect(n)) for n in near[:GRADED_RIVALS]]


def _screened(search: Search, name: str, rest: Names, without: Fit, among: Names) -> list[Hit]:
    """The rivals that the screen ranks highest."""
    _, hits = search.screened(without, rest)
    best = {h.name: h for h in best_of_each(hits) if h.name in among}
    own = best[name].gain if name in best else max((h.gain for h in best.values()), default=0.0)
    listed = [h for h in best.values() if h.name != name and h.gain > RIVAL_GAIN * own]
    return listed[:GRADED_RIVALS]


def _with_rival(names: Names, name: str, rival: Rival | None) -> Names:
    """The same with a rival in the place of one, or without that one."""
    instead = () if rival is None else (rival.name,)
    return tuple(m for n in names for m in (instead if n == name else (n,)))


def _better_rival(h: Hypothesis, judged: Evidence, name: str,
                  dropped: Container[str]) -> Rival | None:
    """The rival that leaves least of what leaves less than the effect itself; else the one that
    held-out blocks clearly prefer; none that was dropped."""
    rivals = h.rivals.get(name, ())
    better = [r for r in rivals if r.cost < 0.0]
    margins = {r.name: r.margin for x in judged.effects if x.name == name for r in x.rivals}
    preferred = [r for r in rivals if margins[r.name] < -BLOCK_MARGIN]
    found = min(better, key=lambda r: r.cost, default=None) or min(
        preferred, key=lambda r: margins[r.name], default=None)
    return None if found is None or found.name in dropped else found


def _simpler_rivals(h: Hypothesis, judged: Evidence,
                    before: Container[frozenset[str]]) -> Iterator[tuple[str, Rival]]:
    """Effects, each with a rival that has fewer parameters and predicts held-out blocks better: an
    effect with more of them bends to what the fitted records alone have. A rare effect, too, with
    one that many machines have, where neither held-out blocks nor the force domain puts that
    clearly behind. The nearest comes first. No set that was judged `before` comes back."""
    for x in judged.effects:
        seen = {r.name: r for r in x.rivals}
        for r in sorted(h.rivals.get(x.name, ()), key=lambda r: seen[r.name].margin):
            simpler = len(r.fit.system.free) < len(h.fit.system.free) and seen[r.name].margin < 0.0
            commoner = gives_way(x.name, r.name) and is_level(seen[r.name]) \
                and not (x.confirmed and x.force_margin > BLOCK_MARGIN)
            if (simpler or commoner) \
                    and frozenset(_with_rival(h.names, x.name, r)) not in before:
                yield x.name, r
