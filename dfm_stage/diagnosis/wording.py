"""A verdict and its evidence in words: every sentence of a diagnosis stands here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from dfm_stage.diagnosis.decisions import FIRST, FITTED_SHARE, MARGIN, OTHER_FORM, PARTIAL_SHARE
from dfm_stage.diagnosis.evidence import Braking, DropReason, Evidence, Offer, Proposal
from dfm_stage.diagnosis.rejections import Rejected, Rejection
from dfm_stage.diagnosis.surface import Surface
from dfm_stage.diagnosis.verdict import (
    Found,
    Reason,
    Verdict,
    above,
    explained_share,
    other_form,
)
from dfm_stage.model import EFFECTS
from dfm_stage.quantity import format_number, format_quantity

SENTENCES = {
    "unknown": "The gap is real, and no effect of the library explains it on data it was not "
    "fitted to.",
    "retune": "No physics is missing: the gap closes when the model's own parameters are "
    "re-estimated.",
    "not_excited": "These data could not have shown a missing effect: the motion is small beside "
    "what the model leaves as noise.",
    "none": "Nothing is missing: what the model leaves over is noise."}
PARTED = ("on a linear spring a constant force and an encoder zero are the same; give "
          "encoder_zero in the model if it is known")
SPLIT = (f"no hold-out record was given: the last {100 - round(100 * FITTED_SHARE)} % of each "
         "record are held out; a record of another kind would be a harder test")
CUT_SHORT = ("not compared to the end for want of work: {names}; diagnose shorter records or "
             "fewer effects (--without)")
MOST_TOLD = 5
"""Times of lost samples that are told."""
COLOURED = ("{name}: what is left is stronger than its high frequencies, but neither input nor "
            "motion foretells it: noise with a colour, or a disturbance from outside, no gap")
DOUBTS = {
    Reason.NOT_EXERCISED: "the held-out records do not exercise {names}: what is said of it "
    "rests on the fitted records",
    Reason.NOT_HELD_OUT: "{names}: lowers the fitted gap, not the held-out one",
    Reason.NEAR: "{names}: comes near, but leaves more than noise",
    Reason.JOINT_FIT: "held-out data are predicted at {ratio:.1f} times the noise "
    "floor, as far as the parameters are known",
    Reason.ABOVE_FLOOR: "{names}: explains the fitted records, but not the held-out ones"}
REJECTED: Mapping[Rejected | DropReason, str] = {
    DropReason.NOT_EXERCISED: "found second, and the held-out records do not exercise it",
    DropReason.NOT_HELD_OUT: "is not in the held-out data",
    DropReason.SURROGATES: "lowers the held-out error no more than when shifted",
    DropReason.REFITTED: "refitted without it, the others predict held-out records better",
    DropReason.LINE_OF_INPUT: "stands at a line of the input, as the model's own error does",
    DropReason.AT_BOUND: "its parameters run to the edge of their range",
    DropReason.NO_SIZE: "the interval of its size holds zero",
    DropReason.BLOCKS: "held-out blocks are not clearly worse without it",
    DropReason.SMALL_PART: "takes little of what is left on held-out blocks",
    DropReason.UNHEARD: "the force domain, which can judge it, finds none of it",
    DropReason.RIVALS: "other effects do as well in its place, or better",
    Rejected.RIVAL: "in place of {about}: chi-square {value:+.0f}",
    Rejected.EXCLUDED: "{about}",
    Rejected.NOT_HELD_OUT: "explains the fitted records, but does not pass on held-out ones",
    Rejected.OTHER_LAW: "{about} explains {value:.0%} of the missing force, clearly more",
    Rejected.FORCE_SHARE: "explains {value:.0%} of the missing force by itself",
    Rejected.NO_RESPONSE: "no response that the data show",
    Rejected.COLOUR: "chi-square falls by {value:.0f} where noise is taken as white, which it is "
    "not",
    Rejected.SHARE: "could take {value:.0%} of the gap at best",
    Rejected.BELOW_LIMIT: f"chi-square falls by {{value:.0f}}, below the limit {FIRST:g}"}


def sentence(e: Evidence, v: Verdict) -> str:
    """The verdict in one sentence, after what accepted formulas do."""
    if e.accepted is None:
        return _verdict(e, v)
    shown = e.extended if v.shown == "extended" else e.retuned
    before, after = e.accepted.retuned.held_out.rms, shown.held_out.rms
    names = " and ".join(f.name for f in e.accepted.formulas)
    gap = (f"With {names} the held-out gap falls from {format_quantity(before, e.unit)} to "
           f"{format_quantity(after, e.unit)}, {after / max(e.noise.floor[0], 1e-300):.2f} times "
           "the noise floor")
    if after >= before:
        gap = (f"With {names} the held-out gap does not fall: {format_quantity(before, e.unit)} "
               f"without, {format_quantity(after, e.unit)} with")
    rest = "what is left is noise." if v.kind in ("none", "retune") else _verdict(e, v)
    return f"{gap}; {rest}" if v.kind in ("none", "retune") else f"{gap}. {rest}"


def formula(offer: Offer) -> str:
    """A formula that is offered, in a sentence."""
    beside = f", beside {_listed(offer.beside)}" if offer.beside else ""
    return (f"{offer.formula.name}: {offer.formula.text}  ({offer.share:.0%} of the held-out gap"
            f"{beside}; all of its terms chosen again in {round(offer.found_in * offer.draws)} of "
            f"{offer.draws} draws)")


ONE_LAW = ("{names} stand in for one law of speed, which no effect of the library has and which "
           "does better")
NO_FORMULA = ("no short formula of position, velocity and drive explains a real part of it on "
              "held-out records")


OTHER_LAW = ("The gap is real, and another law than that of {names} is behind it: {words} "
             "explains {share:.0%} of the missing force on held-out blocks, {names} {own:.0%}.")


def _verdict(e: Evidence, v: Verdict) -> str:
    if e.other_law is not None:
        return OTHER_LAW.format(words=e.other_law.words, share=e.other_law.share,
                                names=_listed([x.name for x in e.effects]),
                                own=e.other_law.share_of_effects)
    if v.kind == "partial" or (v.kind == "named" and e.graded):
        return _part(e, v)
    if v.kind == "named":
        ratio = e.extended.held_out.rms / max(e.noise.floor[0], 1e-300)
        return (f"The model lacks {_listed([f.name for f in v.effects])}: with it the held-out "
                f"gap falls to {ratio:.2f} times the noise floor.")
    if v.kind == "ambiguous":
        kinds = "; ".join(" or ".join(map(_spoken, f.members)) for f in v.effects)
        return f"Something is missing that these data do not tell apart: {kinds}."
    return SENTENCES[v.kind]


def _part(e: Evidence, v: Verdict) -> str:
    """Effects that leave a remainder, with how much they explain and where that was judged."""
    share, where = above(e, e.extended.held_out.power), f"in {e.judged.signal}" + (
        f", windows of {e.judged.window_s:.2g} s" if e.judged.window_s else "")
    what = _listed([" or ".join(map(_spoken, f.members)) for f in v.effects])
    of = f"the held-out gap's power ({where})"
    if e.heard is not None:
        share, of = e.heard.share, ("the missing force's power on held-out blocks (judged in "
                                    "force alone)")
    how = f"{min(share, 1.0):.0%} of {of}"
    possible = min(explained_share(e), 1.0)
    if possible - share > WORTH_TELLING:
        how += f", {possible:.0%} of what is predictable of it"
    if v.kind == "named":
        they = "it explains" if len(v.effects) == 1 else "they explain"
        return (f"The model lacks {what}: {they} {how}; a remainder of "
                f"{100.0 * max(1.0 - share, 0.0):.2g} % stays.")
    rest = ONE_LAW.format(names=_listed(e.one_law)) if e.one_law else \
        "the true force has another form" if other_form(e) else \
        "the records do not show whether the true force has another form" if e.form_hidden else \
        "the rest is in no effect of the library"
    return f"A part of what is missing behaves like {what}: {how}; {rest}."


def effect_evidence(e: Evidence, found: Found) -> Iterator[str]:
    """What speaks for one effect found."""
    seen = next((x for x in e.effects if x.name == found.name), None)
    if seen is None:
        value = e.offset.value if e.offset is not None else 0.0
        yield f"the readings lie {value:.3g} {e.unit} from where the model has them"
        yield PARTED
        return
    if e.heard is None:
        yield f"chi-square rises by {format_number(found.loss)} without it (limit {FIRST:g})"
    yield (f"held-out RMS {format_quantity(seen.without.held_out.rms, e.unit)} without it, "
           f"{format_quantity(e.extended.held_out.rms, e.unit)} with it")
    yield f"{EFFECTS[found.name].meaning}: {EFFECTS[found.name].equation}"
    if e.braking is not None and found.name in e.braking.sizes:
        yield from _of_swings(e.braking, found.name)
        return
    if e.heard is not None:
        yield f"{e.heard.added[found.name]:.0%} of the missing force is lost without it"
        yield from (f"{name} in its place is {m:.1f} block standard errors behind in force"
                    for name, m in list(e.heard.margins.get(found.name, {}).items())[:2])
    if e.graded:
        yield f"held-out blocks are worse without it by {seen.margin:.1f} standard errors"
        if seen.constancy is not None:
            it = "it" if len(e.effects) == 1 else "the effects together"
            yield (f"with another size for every size of motion {it} would explain "
                   f"{seen.constancy.share:.0%} of what is left (limit {OTHER_FORM:.0%})")
        if e.surface is not None and found.name in e.surface.form_shares:
            yield ("with a size that varies with position, or another shape, it would "
                   f"explain {e.surface.form_shares[found.name]:.0%} of the force that is left "
                   f"(limit {OTHER_FORM:.0%})")
    for rival in seen.rivals:
        if rival.ahead:
            yield f"the force domain puts {rival.name} before it: motion and force disagree"
    for rival in seen.rivals[:2]:
        lost = f"{rival.margin:.1f} block standard errors" if e.graded else \
            f"{rival.cost:.0f} in chi-square"
        yield f"{rival.name} in its place costs {lost}"


def _of_swings(braking: Braking, name: str) -> Iterator[str]:
    """What the energy of free swings says of an effect that brakes them."""
    yield (f"of the force that brakes the swings, viscous damping alone misses "
           f"{braking.missed:.0%}, and what is named here {braking.left:.0%}: by the energy lost "
           "from swing to swing")
    yield (f"held-out swings are braked otherwise without it by {braking.margins[name]:.1f} block "
           "standard errors")


def warnings(e: Evidence, v: Verdict) -> tuple[str, ...]:
    """What a reader must know beside the verdict."""
    short = [CUT_SHORT.format(names=", ".join(e.not_compared))] if e.not_compared else []
    shown = e.extended if v.shown == "extended" else e.retuned
    coloured = [COLOURED.format(name=name) for name, each in shown.findings.items()
                if not v.remainder and any(f.coloured for f in each)]
    return (*e.warnings, *([SPLIT] if e.split else []), *short, *coloured,
            *(DOUBTS[d.reason].format(names=" and ".join(d.names), ratio=d.ratio)
              for d in v.doubts), *_implausible(e, v), *_disagreement(e, v))


def _implausible(e: Evidence, v: Verdict) -> Iterator[str]:
    """Which effects told have values that no machine has; what turns in rad is not judged."""
    told = {f.name for f in v.effects}
    for x in e.effects:
        doubt = EFFECTS[x.name].doubt
        if x.name in told and doubt is not None \
                and not any("rad" in q.unit for q in x.parameters.values()):
            reason = doubt({n: q.value for n, q in x.parameters.items()})
            if reason is not None:
                yield f"{x.name}: {reason}"


def _disagreement(e: Evidence, v: Verdict) -> Iterator[str]:
    """Where the force domain names something else than the fits."""
    if e.witness is None or e.other_law is not None or v.kind not in (
            "named", "partial", "ambiguous", "unknown"):
        return
    own = {m for f in v.effects for m in f.members}
    said = [n for n in e.witness["effects"] if n not in own]
    share = e.witness["share"]
    if share > PARTIAL_SHARE and said and len(said) == len(e.witness["effects"]):
        told = f"the fits say {' and '.join(f.name for f in v.effects)}" if own else \
            "no fit bears that out on held-out records"
        yield f"the force domain by itself says {' and '.join(said)} ({share:.0%}); {told}"


def lost_samples(name: str, times: Sequence[float]) -> str:
    """Where a record lacks samples."""
    listed = ", ".join(f"{t:.6g}" for t in times[:MOST_TOLD])
    more = ", ..." if len(times) > MOST_TOLD else ""
    many = "1 sample seems" if len(times) == 1 else f"{len(times)} samples seem"
    return (f"{name}: {many} to be missing, at {listed}{more} s, though the time stamps do not "
            "show it; what they must have been was put in")


def few_samples(name: str, count: int) -> str:
    """What a short record can and cannot show."""
    return (f"{name}: {count} samples are few; a large effect shows, but a small one is not "
            "excluded; detection_limits says which size would show")


def missing_force(s: Surface) -> str:
    """The force that is still missing, in a sentence."""
    where = "" if s.frequency_hz is None else \
        f", strongest at {format_quantity(s.frequency_hz, 'Hz')}"
    said = (f"The missing force is {format_quantity(s.rms, s.force_unit)} RMS{where}. Position "
            f"and velocity alone explain {s.position_velocity_share:.0%} of its power on data "
            "held out")
    more = s.predictable_share - s.position_velocity_share
    if more > WORTH_TELLING:
        return (f"{said}; with acceleration, past motion and amplitude {s.predictable_share:.0%} "
                "are predictable: it depends on more than where the stage is and how fast it "
                "moves.")
    if s.predictable_share < MOSTLY:
        return f"{said}: most of it does not follow the motion."
    return f"{said}; nothing else of the motion adds to that."


WORTH_TELLING = 0.05
"""Difference of two shares that is told beside the first."""
MOSTLY = 0.5
"""Share below which most of the missing force does not follow the motion."""


def rejection(r: Rejection) -> str:
    """Why an effect is not named."""
    return REJECTED[r.reason].format(value=r.value, about=r.about)


def experiment(proposal: Proposal) -> dict[str, Any]:
    """The next experiment with what is expected of it."""
    said = ""
    if proposal.expected is not None:
        names, expected = _listed(proposal.parts), proposal.expected
        duration = proposal.experiment["duration_s"]
        said = (f"In {duration:g} s it is expected to part {names} by {expected:.0f} in "
                f"chi-square (needed: {MARGIN:g}).") if expected >= MARGIN else (
            f"No experiment within the recorded voltage and travel is expected to part {names}; "
            f"this one comes nearest, with {expected:.1f} in chi-square (needed: {MARGIN:g}) in "
            f"{duration:g} s.")
    words = (proposal.experiment["description"], said, _hint(proposal.parts))
    return {**proposal.experiment, "description": " ".join(filter(None, words))}


def _hint(names: Sequence[str]) -> str:
    """What the library says would part the effects."""
    for name in names:
        for c in EFFECTS[name].classes if name in EFFECTS else ():
            if any(m in c.members for m in names if m != name):
                return f"In general: {c.split_by}."
    return ""


def _spoken(name: str) -> str:
    return name.replace("_", " ")


def _listed(names: Sequence[str]) -> str:
    return " and ".join(map(_spoken, names))
