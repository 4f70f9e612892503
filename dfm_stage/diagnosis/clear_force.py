"""What the force domain names by itself, where no simulated motion bears a name out.

A body without a spring, or one in dry friction, is carried away by forces that hardly show in its
force balance; a fit of its motion then tells effects apart by where it drifts. The force balance
does not drift. It names effects where these explain most of the force that is predictable on
held-out blocks, and others in their place explain clearly less. Those of a common class, and those
of one other kind in the place of the main effect, may do as well: they are told in its class.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from dfm_stage.diagnosis.alike import gives_way, kinds, shares_class
from dfm_stage.diagnosis.candidates import cycles
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    FEWEST_CYCLES,
    FURTHER_PART,
    LEAST_HEARD,
    LEAST_PREDICTABLE,
    MARGIN_OVER_LARGER,
    PARTIAL_SHARE,
    RETUNE_RATIO,
    SMALL_SHARE,
)
from dfm_stage.diagnosis.effect_fits import inside
from dfm_stage.diagnosis.evidence import Evidence, Heard
from dfm_stage.diagnosis.fit import Fit, fit
from dfm_stage.diagnosis.gather import gather, with_witness
from dfm_stage.diagnosis.hypothesis import Hypothesis, Trial
from dfm_stage.diagnosis.verdict import most_unrelated
from dfm_stage.diagnosis.verification import weights_like
from dfm_stage.diagnosis.witness import Explained, Witness
from dfm_stage.identification.quantity import Quantity, interval
from dfm_stage.model import EFFECTS


def clear_force(seen: Witness) -> Heard | None:
    """What the force domain names; None where it does not see enough of the force, or does not
    part it from several other effects.

    A second effect counts where the first leaves a substantial part without it, or where it takes
    most of what that leaves, and clearly leads all others there; and where each explains something
    by itself: two that only do so together mend each other's errors. One that does not count stays
    beside the others where these are compared with their rivals.
    """
    predictable = max(seen.predictable_share, LEAST_PREDICTABLE)
    if seen.cannot_tell or seen.predictable_share < LEAST_HEARD or not seen.best.names:
        return None
    best, in_place_of = _common(seen)
    alone = {n: each.share if (each := seen.of(n)) is not None else 0.0 for n in best.names}
    added = {n: best.share - max((alone[m] for m in best.names if m != n), default=0.0)
             for n in best.names}
    names = tuple(n for n in best.names if alone[n] > 0.0 and (
        added[n] >= PARTIAL_SHARE * predictable
        or (_takes_the_rest(added[n], predictable - best.share + added[n], predictable)
        and min((behind for m, behind in seen.margins[in_place_of.get(n, n)].items()
                 if not shares_class(m, n)), default=math.inf) > BLOCK_MARGIN)))
    told = best if len(names) == len(best.names) else seen.of(*names) if names else None
    if told is None or told.share < FURTHER_PART * predictable:
        return None
    if len(names) == 1:
        added[names[0]] = told.share
    margins = {n: seen.margins[in_place_of.get(n, n)] for n in names}
    level = {n: [m for m, behind in each.items() if m not in best.names and _level(behind, n, m)
                 and not gives_way(m, n)] for n, each in margins.items()}
    main = max(names, key=lambda n: added[n])
    if any(kinds(m for m in each if not _related(m, names)) > most_unrelated(n == main)
           for n, each in level.items()):
        return None
    members = {n: (n, *(m for m in level[n] if shares_class(m, n) or not _related(m, names)))
               for n in names}
    return Heard({n: added[n] for n in names}, told.share, predictable, members,
                 _sizes(told, seen.blocks), told.parameters, {} if in_place_of else margins)


def _takes_the_rest(added: float, rest: float, predictable: float) -> bool:
    """Whether an effect adds most of the `rest` that another one leaves of what is predictable, no
    small part of the whole."""
    return added >= SMALL_SHARE * predictable and added >= FURTHER_PART * rest


def _common(seen: Witness) -> tuple[Explained, dict[str, str]]:
    """The best set; with an effect that many machines have in the place of one that gives way to
    it, by name, where held-out blocks do not part the two, and no other kind explains more."""
    for name in seen.best.names:
        rest = [n for n in seen.best.names if n != name]
        there = {m: each for m in seen.margins[name] if (each := seen.of(m, *rest)) is not None}
        common = max((m for m in there if gives_way(name, m) and _level(
            seen.margins[name][m], name, m)), key=lambda m: there[m].share, default=name)
        if common != name and not any(each.share > there[common].share
                                      for m, each in there.items() if not shares_class(m, common)):
            return there[common], {common: name}
    return seen.best, {}


def _sizes(told: Explained, blocks: int) -> dict[str, Quantity]:
    """The sizes that a jackknife over blocks gives an interval, by address, SI."""
    found = {}
    for name in told.names:
        for size in EFFECTS[name].sizes:
            address = f"{name}.{size}"
            if address in told.errors:
                value = told.parameters[address]
                found[address] = Quantity(value, "", interval(
                    value, told.errors[address], blocks - 1))
    return found


def by_force(trial: Trial, bare: Fit, seen: Witness, heard: Heard, warnings: Sequence[str],
             split: bool) -> tuple[Hypothesis, Evidence] | None:
    """The hypothesis that the force domain bears out, with its evidence: sizes as it has them, all
    else fitted to the motion, begun from what the forces say of it, or as given where that is
    outside its limits.

    None where that does not lower the held-out gap clearly, where a vibration is not told from the
    motion's own lines, or where the forces balance only with a mass outside its limits: then no
    size beside it is to be believed.
    """
    search, names = trial.search, tuple(heard.added)
    search.step(f"fitting {' and '.join(names)}, which the force domain names")
    trial.held_weights = weights_like(trial.held, search.weights)
    start = {n: heard.start[n] for n in search.free if n in heard.start and n in bare.model.base}
    outside = [n for n, v in start.items()
               if not bare.model.parameter(n).low <= v <= bare.model.parameter(n).high]
    if "mass" in outside:
        return None
    model = bare.model.with_parameters({**start, **{n: search.model.base[n] for n in outside}})
    for name in names:
        model = model.with_effect(name, inside(name, {
            p: heard.start.get(f"{name}.{p}", value)
            for p, value in EFFECTS[name].defaults.items()}))
    free = [n for n in search.parameters(model) if n not in heard.sizes]
    found = fit(model, search.runs, free, search.weights, earlier=bare.locals, noise=search.noise)
    if not found.ok or any(cycles(n, found.model, search.runs) < FEWEST_CYCLES for n in names):
        return None
    h = Hypothesis(names, found, bare)
    evidence = with_witness(gather(trial, h, warnings, split, graded=True), seen)
    if RETUNE_RATIO**2 * evidence.extended.held_out.power >= evidence.retuned.held_out.power:
        return None
    moved = fit(found.model, search.runs, search.parameters(model), search.weights,
                earlier=found.locals, noise=search.noise).model.parameters()
    effects = tuple(replace(x, parameters={
        p: _size(heard.sizes.get(a := f"{x.name}.{p}"), q, moved[a])
        for p, q in x.parameters.items()}) for x in evidence.effects)
    judged = replace(evidence.judged, signal="force", predictable=None)
    return h, replace(evidence, heard=heard, effects=effects, judged=judged)


def _level(behind: float, name: str, rival: str) -> bool:
    """Whether held-out blocks do not part a rival from the effect in whose place it is."""
    larger = len(EFFECTS[rival].parameters) > len(EFFECTS[name].parameters)
    return behind < (MARGIN_OVER_LARGER if larger else BLOCK_MARGIN)


def _related(rival: str, names: Sequence[str]) -> bool:
    return any(shares_class(rival, n) for n in names)


def _size(size: Quantity | None, known: Quantity, moved: float) -> Quantity:
    """A parameter as `known` from the motion; a size from the force domain instead, its interval
    widened by how far a fit of the motion moves it: filters shift it by more than blocks vary."""
    if size is None:
        return known
    half = size.half_width + abs(moved - size.value)
    return Quantity(size.value, known.unit, (size.value - half, size.value + half))
