"""From evidence to one verdict: a pure function of values and of the table of decisions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal

from dfm_stage.diagnosis.alike import kinds
from dfm_stage.diagnosis.decisions import (
    AT_REST,
    AT_REST_INPUT,
    BASE_AT_ZERO,
    BLOCK_MARGIN,
    EXCESS,
    FITTED_ALONE,
    FURTHER_PART,
    HELD_OUT_FLOOR,
    JOINT_LOSS,
    LEAST_HEARD,
    LEAST_PREDICTABLE,
    MARGIN,
    MARGIN_OVER_LARGER,
    NAMED_SHARE,
    NOT_EXERCISED,
    OFFSET_NOISE,
    OFFSET_SIGMAS,
    OTHER_FORM,
    PARTIAL_SHARE,
    PRESLIDING_DISTANCE,
    RETUNE_GAIN,
    RETUNE_RATIO,
    SMALL_SHARE,
)
from dfm_stage.diagnosis.evidence import (
    DropReason,
    EffectEvidence,
    Evidence,
    Heard,
    ModelEvidence,
    RivalEvidence,
    Which,
)
from dfm_stage.diagnosis.rejections import Rejection, rejections
from dfm_stage.diagnosis.search_decisions import NEAR_NOISE

Kind = Literal["none", "retune", "named", "partial", "ambiguous", "unknown", "not_excited"]


# The rule that decided.
Reason = Enum("Reason", [
    # the effects stand:
    "AT_FLOOR",       # with them held-out records are predicted to the noise floor
    "JOINT_FIT",      # one set of values brings fitted and held-out records to the noise floor
    "GRADED",         # they explain enough of the gap on held-out blocks
    # the effects fall:
    "OTHER_LAW",      # a law that no effect has explains clearly more
    "BARELY_FITTED",  # held-out records do not exercise them, and the fitted ones show little
    "NOT_HELD_OUT",   # they lower the fitted gap, not the held-out one
    "NEAR",           # they come near, but leave more than noise
    "ABOVE_FLOOR",    # they explain the fitted records, but not the held-out ones
    # beside the effects:
    "NOT_EXERCISED",  # held-out records do not exercise them
    # there are none:
    "REMAINDER",      # more than noise is left, and no effect explains it
    "REST",           # the stage hardly moves above its noise
    "OFFSET",         # a constant that may be a force or an encoder zero
    "RETUNED",        # new values of the base parameters close the gap
    "NOISE",          # what is left is noise
])


@dataclass(frozen=True)
class Doubt:
    """What a reader must know of effects beside the verdict; `ratio` is the held-out RMS over the
    noise."""

    reason: Reason
    names: tuple[str, ...]
    ratio: float = math.nan


@dataclass(frozen=True)
class Found:
    """An effect found: its class, its share of the gap's held-out power and of what is predictable
    of it, and the rise in chi-square without it."""

    name: str
    members: tuple[str, ...]
    share: float
    loss: float
    predictable_share: float | None = None


@dataclass(frozen=True)
class Verdict:
    """What the evidence says.

    `effects` stand in the order in which they shrank the gap. `undecided` are the names that the
    data do not tell apart, `shown` the model whose gap is told, `model` the one to go on with.
    `complete` says that nothing but noise is left.
    """

    kind: Kind
    reason: Reason
    effects: tuple[Found, ...] = ()
    undecided: tuple[str, ...] = ()
    doubts: tuple[Doubt, ...] = ()
    rejected: tuple[Rejection, ...] = ()
    remainder: bool = False
    shown: Which = "retuned"
    model: Which = "given"

    @property
    def complete(self) -> bool:
        """Whether the model to go on with leaves nothing but noise."""
        return not self.remainder and self.kind != "unknown"


def verdict(e: Evidence) -> Verdict:
    """Judge the evidence."""
    names = {x.name for x in e.effects}
    if e.other_law is not None:
        return Verdict("unknown", Reason.OTHER_LAW, rejected=tuple(rejections(e, set())),
                       remainder=True)
    if e.heard is not None:
        return _by_force(e, e.heard)
    if e.graded and names:
        return _graded(e, names)
    outcome = judge_hypothesis(e)
    if outcome.stands:
        classes = {x.name: _class(e, x) for x in e.effects}
        found = sorted((_found(e, x, classes[x.name]) for x in e.effects), key=lambda f: -f.loss)
        undecided = tuple(m for members in classes.values() for m in members if len(members) > 1)
        kind: Kind = "partial" if e.one_law else "ambiguous" if undecided else "named"
        return Verdict(kind, outcome.reason, tuple(found),
                       undecided, outcome.doubts, tuple(rejections(e, names)),
                       e.extended.remainder or bool(e.one_law), "extended", "extended")
    offset = _offset(e)
    rules: tuple[tuple[bool, Kind, Reason], ...] = (
        (e.retuned.remainder, "unknown", Reason.REMAINDER),
        (_at_rest(e), "not_excited", Reason.REST),
        (offset is not None, "ambiguous", Reason.OFFSET),
        (_retuned(e), "retune", Reason.RETUNED),
        (True, "none", Reason.NOISE))
    kind, reason = next((kind, reason) for holds, kind, reason in rules if holds)
    told = (offset,) if offset is not None and kind == "ambiguous" else ()
    return Verdict(kind, reason, told, told[0].members if told else (), outcome.doubts,
                   tuple(rejections(e, {f.name for f in told})), e.retuned.remainder, "retuned",
                   "retuned" if kind == "retune" else "given")


@dataclass(frozen=True)
class Outcome:
    """Whether held-out data and what is left over bear out the effects of the hypothesis, by
    which rule, and what is doubtful."""

    stands: bool
    reason: Reason
    doubts: tuple[Doubt, ...] = ()


def judge_hypothesis(e: Evidence) -> Outcome:
    """Judge the effects of the hypothesis together; without any there is nothing to judge."""
    names = tuple(x.name for x in e.effects)
    if not names:
        return Outcome(False, Reason.NOISE)
    idle = tuple(x.name for x in e.effects if not x.exercised)
    doubts = (Doubt(Reason.NOT_EXERCISED, idle),) if idle else ()
    if idle and e.retuned.fitted.chi2 - e.extended.fitted.chi2 < FITTED_ALONE:
        return Outcome(False, Reason.BARELY_FITTED, doubts)
    allowed = NOT_EXERCISED if idle else 0.0
    if idle and e.retuned.held_out == e.given.held_out:  # other values were fitted
        allowed += (RETUNE_RATIO**2 - 1.0) * e.retuned.held_out.chi2
    new, old = e.extended.held_out, e.retuned.held_out
    worse = not new.chi2 < old.chi2 + allowed or new.power > RETUNE_RATIO**2 * old.power or (
        new.rms > RETUNE_RATIO * old.rms)  # of what drifts, the power is that of its changes
    limit = HELD_OUT_FLOOR * e.noise.rms
    by_one_fit = e.joint is not None and e.joint[1] <= limit and (
        e.joint[0] <= JOINT_LOSS * e.extended.fitted.rms)
    if (worse and not (idle and by_one_fit)) or (not idle and _explains_little(e)):
        return Outcome(False, Reason.NOT_HELD_OUT, (Doubt(Reason.NOT_HELD_OUT, names),))
    if e.extended.remainder:
        return Outcome(False, Reason.NEAR, (Doubt(Reason.NEAR, names),))
    if e.extended.held_out.rms <= limit and not worse:
        return Outcome(True, Reason.AT_FLOOR, doubts)
    ratio = e.extended.held_out.rms / e.noise.rms
    if by_one_fit:
        return Outcome(True, Reason.JOINT_FIT,
                       (*doubts, Doubt(Reason.JOINT_FIT, names, ratio)))
    return Outcome(False, Reason.ABOVE_FLOOR,
                   (*doubts, Doubt(Reason.ABOVE_FLOOR, names, ratio)))


def _explains_little(e: Evidence) -> bool:
    """Whether the effects take but a small part of a held-out gap that stays more than noise:
    whatever makes the rest may make all of it."""
    noise = e.noise.rms**2
    left, gap = (m.held_out.rms**2 - noise for m in (e.extended, e.retuned))
    return left > (NEAR_NOISE - 1.0) * noise and gap - left < PARTIAL_SHARE * gap


def _graded(e: Evidence, names: set[str]) -> Verdict:
    """The verdict on effects that leave a remainder, by how much they explain."""
    classes = {x.name: _graded_class(x) for x in e.effects}
    found = sorted((_found(e, x, classes[x.name]) for x in e.effects), key=lambda f: -f.loss)
    undecided = tuple(m for members in classes.values() for m in members if len(members) > 1)
    explained = explained_share(e)
    kind: Kind = "unknown"
    if explained >= PARTIAL_SHARE and not _base_at_zero(e):
        in_part = not _is_its_form(e) or bool(e.one_law) or (
            e.braking is None and _at_zero(e, "damping"))
        kind = "partial" if in_part else "ambiguous" if undecided else "named"
    if kind == "unknown":
        return Verdict(kind, Reason.GRADED, rejected=tuple(rejections(e, set())), remainder=True)
    return Verdict(kind, Reason.GRADED, tuple(found), undecided, (), tuple(rejections(e, names)),
                   True, "extended", "extended")


def _by_force(e: Evidence, heard: Heard) -> Verdict:
    """The verdict on effects that the force domain alone bears out."""
    found = tuple(Found(name, heard.members[name], min(share, 1.0), 0.0,
                        min(share / heard.predictable, 1.0))
                  for name, share in sorted(heard.added.items(), key=lambda each: -each[1]))
    found += tuple(_found(e, x, (x.name,)) for x in e.effects if x.name not in heard.added)
    undecided = tuple(m for f in found for m in f.members if len(f.members) > 1)
    in_part = not _is_its_form(e)
    kind: Kind = "partial" if in_part else "ambiguous" if undecided else "named"
    return Verdict(kind, Reason.GRADED, found, undecided, (),
                   tuple(rejections(e, {f.name for f in found})), True, "extended", "extended")


def _takes_the_gap(e: Evidence) -> bool:
    """Whether the effects explain nearly all of the held-out gap, or of the missing force, or
    bring the gap to the noise. What a black box predicts is no measure here: a true model may
    predict more."""
    left = e.extended.held_out.power
    share = above(e, left) if e.heard is None else e.heard.share
    return share >= NAMED_SHARE or left <= HELD_OUT_FLOOR**2 * e.judged.noise_power


def _is_its_form(e: Evidence) -> bool:
    """Whether the effects take the gap, and the records show that what they leave is no error of
    their form."""
    return _takes_the_gap(e) and not other_form(e) and not e.form_hidden


def other_form(e: Evidence) -> tuple[str, ...]:
    """Effects of the hypothesis that would explain much of what they leave in another form, or
    with another size for every size of motion: the true force is another. All of several of which
    each could be left out, because the others bend into its place, follow another law together."""
    if len(e.effects) > 1 and e.heard is None and all(_takes_little(e, x) for x in e.effects):
        return tuple(x.name for x in e.effects)
    shares = {} if e.surface is None else e.surface.form_shares
    sizes = {x.name: x.constancy.share for x in e.effects if x.constancy is not None}
    return tuple(x.name for x in e.effects
                 if max(shares.get(x.name, 0.0), sizes.get(x.name, 0.0)) > OTHER_FORM)


def explained_share(e: Evidence) -> float:
    """Share of what is predictable of the held-out gap, or of the missing force, that all effects
    explain together."""
    if e.heard is not None:
        return e.heard.explained
    return above(e, e.extended.held_out.power) / max(_predictable(e), 1e-300)


def above(e: Evidence, power: float) -> float:
    """Share of the held-out gap's power above the noise that a model leaving `power` explains;
    none where it cannot be simulated."""
    if not math.isfinite(power):
        return 0.0
    noise = e.judged.noise_power
    return 1.0 - (power - noise) / max(e.retuned.held_out.power - noise, 1e-300)


def _predictable(e: Evidence) -> float:
    """Share of the held-out gap that a black box predicts; never below what the effects do, and
    not below LEAST_PREDICTABLE: a black box knows no slow memory."""
    limit = e.judged.predictable
    if limit is None:
        return 1.0
    best = max(above(e, limit**2), above(e, e.extended.held_out.power))
    return min(max(best, LEAST_PREDICTABLE), 1.0)


def _graded_class(effect: EffectEvidence) -> tuple[str, ...]:
    """The effect and the rivals that do as well, or that the force domain puts before it: two
    witnesses that disagree. Of its kind, those too whose fit was cut short."""
    return (effect.name, *(r.name for r in effect.rivals if _does_as_well(r)
                           or r.ahead or (r.related and not r.finished)))


def is_level(rival: RivalEvidence) -> bool:
    """Whether a rival is no worse on held-out blocks than an effect that leaves a remainder, or
    not clearly so."""
    limit = MARGIN_OVER_LARGER if rival.larger else BLOCK_MARGIN
    return not rival.repeats and rival.margin < limit


def _does_as_well(rival: RivalEvidence) -> bool:
    """Whether a rival is level with an effect; one that few machines have must be clearly better
    than one that many have."""
    return is_level(rival) and (not rival.rarer or rival.margin < -BLOCK_MARGIN)


def fallen(e: Evidence) -> tuple[str, DropReason] | None:
    """The weakest effect that does not stand where a remainder stays, and why."""
    ranked = sorted(e.effects, key=lambda x: x.without.held_out.power)
    for x in ranked:
        reason = _falls(e, x)
        if reason is not None:
            return x.name, reason
    return None


def main_effect(e: Evidence) -> EffectEvidence:
    """The effect that takes most of the held-out gap."""
    return max(e.effects, key=lambda x: x.without.held_out.power)


def _falls(e: Evidence, x: EffectEvidence) -> DropReason | None:
    further = x is not main_effect(e)
    left = x.without.held_out.power - e.judged.noise_power
    taken = x.without.held_out.power - e.extended.held_out.power
    unrelated = kinds(r.name for r in x.rivals if _does_as_well(r) and not r.related)
    behind = any(r.related and r.margin < -BLOCK_MARGIN for r in x.rivals)
    rules = (
        (x.margin < BLOCK_MARGIN, DropReason.BLOCKS),
        (taken < _least_part(x, further) * left or (further and _is_small(e, x)),
         DropReason.SMALL_PART),
        (x.force_share is not None and not x.in_best
         and (not _takes_all(e, x) if further else x.force_share < LEAST_HEARD),
         DropReason.UNHEARD),
        (behind or unrelated > most_unrelated(not further), DropReason.RIVALS))
    return next((reason for holds, reason in rules if holds), None)


def most_unrelated(is_main: bool) -> int:
    """Of how many kinds rivals of no common class may be that do as well as an effect that leaves
    a remainder: those of one are told in the class of the main effect, more make a guess of it."""
    return 1 if is_main else 0


def _least_part(x: EffectEvidence, further: bool) -> float:
    """Share of what is left that an effect must take; less of the main one where the force domain
    has the effect itself in its best set, finds as much by it alone, and all others behind."""
    heard = x.force_share is not None and x.confirmed and x.force_share > PARTIAL_SHARE \
        and BLOCK_MARGIN < x.force_margin < math.inf
    return PARTIAL_SHARE if heard and not further else FURTHER_PART


def small_parts(e: Evidence) -> tuple[str, ...]:
    """Effects beside the main one that take so little that others would, too."""
    return tuple(x.name for x in e.effects if x is not main_effect(e) and _is_small(e, x))


def _is_small(e: Evidence, x: EffectEvidence) -> bool:
    """Whether the effect takes little of the gap, the force domain does not put it beside the
    others, nor does it take all that these leave. On held-out records; where these do not exercise
    it, on the fitted ones."""
    return _takes_little(e, x) and not x.confirmed and not _takes_all(e, x)


def _takes_little(e: Evidence, x: EffectEvidence) -> bool:
    """Whether the gap without the effect, all else fitted again, grows by little."""
    left, found, gap = (_shown(x, m) for m in (x.without, e.extended, e.retuned))
    return left - found < SMALL_SHARE * (gap - e.judged.noise_power)


def _shown(x: EffectEvidence, model: ModelEvidence) -> float:
    """The power that a model leaves of the records that show an effect: the held-out ones, or if
    these do not exercise it, the fitted ones."""
    return (model.held_out if x.exercised else model.fitted).power


def _takes_all(e: Evidence, x: EffectEvidence) -> bool:
    """Whether the effect takes nearly all that is left of the gap without it."""
    left, found = _shown(x, x.without), _shown(x, e.extended)
    return left - found >= NAMED_SHARE * (left - e.judged.noise_power)


def is_clearly_more(e: Evidence, known: Evidence) -> bool:
    """Whether the effects of `e` explain all, or something where those of `known` explain nothing,
    or much of what these leave of the held-out gap; any of it where those of `e` are named, and
    those of `known` are told as a part."""
    new, old = verdict(e), verdict(known)
    if new.kind == "unknown" or new.complete or old.kind == "unknown":
        return new.kind != "unknown"
    higher = new.kind == "named" and old.kind == "partial"
    return _left(e) < (1.0 if higher else 1.0 - FURTHER_PART) * _left(known)


def _left(e: Evidence) -> float:
    """Share of the held-out gap, or of the missing force, that the effects leave."""
    return 1.0 - (above(e, e.extended.held_out.power) if e.heard is None else e.heard.share)


def is_coloured_noise(e: Evidence) -> bool:
    """Whether nothing is missing, by a residual whose colour is taken for that of the noise."""
    return verdict(e).kind in ("none", "retune") and any(
        f.coloured and f.value > f.limit
        for each in e.retuned.findings.values() for f in each)


def needs_grading(e: Evidence) -> bool:
    """Whether a gap stays that no set of effects brings to the noise: a large one, or one of which
    they take nearly all on held-out records."""
    real = e.retuned.remainder if not e.effects else True
    large = e.retuned.held_out.power > EXCESS**2 * e.judged.noise_power
    taken = bool(e.effects) and above(e, e.extended.held_out.power) >= NAMED_SHARE
    return not judge_hypothesis(e).stands and real and (large or taken)


def stays_open(e: Evidence) -> bool:
    """Whether effects that explain a part are found, and what they leave is no noise."""
    return bool(e.effects) and verdict(e).kind != "unknown" and e.extended.remainder and (
        e.extended.held_out.power > EXCESS**2 * e.judged.noise_power)


def needs_joint_fit(e: Evidence) -> bool:
    """Whether the verdict hangs on one fit to all records that is not there: other values of the
    base may predict held-out records above the floor, or a little worse with what these lack."""
    reason, idle = judge_hypothesis(e).reason, any(not x.exercised for x in e.effects)
    return e.joint is None and (reason is Reason.ABOVE_FLOOR or (
        idle and reason is Reason.NOT_HELD_OUT))


def leaves_open(v: Verdict) -> bool:
    """Whether another experiment would tell more."""
    return v.kind not in ("none", "retune", "named")


def _base_at_zero(e: Evidence) -> bool:
    """Whether the fit pushed stiffness or the actuator to nothing, or the damping of a linear
    model: no such stage. A nonlinear effect may take more of the damping than it should."""
    return _at_zero(e, "stiffness") or _at_zero(e, "force_constant") or (
        e.linear and _at_zero(e, "damping"))


def _at_zero(e: Evidence, name: str) -> bool:
    return e.base_shares.get(name, 1.0) <= BASE_AT_ZERO


def _class(e: Evidence, effect: EffectEvidence) -> tuple[str, ...]:
    """The effect and the rivals that the data do not part from it."""
    return (effect.name, *(r.name for r in effect.rivals if _not_parted(e, r)))


def _not_parted(e: Evidence, rival: RivalEvidence) -> bool:
    if rival.repeats or rival.distance_over_noise < PRESLIDING_DISTANCE or rival.price > MARGIN:
        return False
    return rival.price + rival.held_out.chi2 - e.extended.held_out.chi2 <= MARGIN


def _found(e: Evidence, effect: EffectEvidence, members: tuple[str, ...]) -> Found:
    loss = effect.without.fitted.chi2 - e.extended.fitted.chi2
    taken = above(e, e.extended.held_out.power) - above(e, effect.without.held_out.power)
    share = min(max(taken, 0.0), 1.0)
    return Found(effect.name, members, share, loss, min(share / max(_predictable(e), 1e-9), 1.0))


def _offset(e: Evidence) -> Found | None:
    """A constant that is clear and that the model does not have; a reading that wanders has
    none."""
    o = e.offset
    wanders = any(f.name == "drift" and f.coloured for each in e.retuned.findings.values()
                  for f in each)
    if o is None or wanders or abs(o.value) < OFFSET_SIGMAS * o.sigma or (
            abs(o.value) < OFFSET_NOISE * e.noise.rms):
        return None
    return Found(o.effect, (o.effect, "encoder_zero"), 1.0, (o.value / o.sigma) ** 2)


def _at_rest(e: Evidence) -> bool:
    over_noise = AT_REST_INPUT if e.motion.constant_input else AT_REST
    return e.motion.rms < over_noise * e.noise.rms


def _retuned(e: Evidence) -> bool:
    given, retuned = e.given.fitted, e.retuned.fitted
    return given.chi2 - retuned.chi2 > RETUNE_GAIN and given.rms > RETUNE_RATIO * retuned.rms
