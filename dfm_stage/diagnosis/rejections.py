"""Why effects are not named: a pure function of the evidence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from dfm_stage.diagnosis.decisions import FIRST
from dfm_stage.diagnosis.evidence import Candidate, DropReason, Evidence

# Why an effect of the library is not named, where it was not dropped.
Rejected = Enum("Rejected", [
    "RIVAL",          # another one in its place fits better
    "EXCLUDED",       # it is no candidate here
    "NOT_HELD_OUT",   # it is in the hypothesis, which did not pass
    "OTHER_LAW",      # it is in the hypothesis, and another law explains clearly more
    "FORCE_SHARE",    # it explains but a share of the missing force
    "NO_RESPONSE",    # the data show none of it
    "SHARE",          # it could take but a share of the gap
    "BELOW_LIMIT",    # chi-square falls by less than the limit
    "COLOUR",         # what it would take is noise with a colour
])


@dataclass(frozen=True)
class Rejection:
    """An effect that is not named. `value` is the cost, the share or the fall in chi-square that
    its reason speaks of, `about` the effect that it would replace, or what excludes it."""

    name: str
    reason: Rejected | DropReason
    value: float = math.nan
    about: str = ""
    held_out_rms: float | None = None


def rejections(e: Evidence, named: set[str]) -> Iterator[Rejection]:
    """Every effect that is not named: rivals first, then the library in its order."""
    told = set(named)
    for effect in e.effects:
        for rival in effect.rivals:
            if rival.name not in named:
                told.add(rival.name)
                yield Rejection(rival.name, Rejected.RIVAL, rival.cost, effect.name,
                                rival.held_out.rms)
    gap = e.retuned.remainder or (
        e.retuned.fitted.chi2 - e.retuned.fitted.count > FIRST)
    fitted = {x.name for x in e.effects}
    for candidate in e.library:
        if candidate.name not in told:
            own = candidate.name in fitted
            yield Rejection(candidate.name, Rejected.OTHER_LAW, e.other_law.share,
                            e.other_law.words) if own and e.other_law is not None \
                else _not_named(candidate, own, gap)


def _not_named(c: Candidate, fitted: bool, gap: bool) -> Rejection:
    """Why a candidate is not named; `gap` says whether there is one to take a share of. By the
    weights of the end there may be none: they take coloured noise for what it is."""
    if c.excluded is not None:
        return Rejection(c.name, Rejected.EXCLUDED, about=c.excluded)
    if c.dropped is not None:
        return Rejection(c.name, c.dropped)
    if fitted:
        return Rejection(c.name, Rejected.NOT_HELD_OUT)
    if c.share is not None and (c.gain is None or c.gain <= 0.0):
        return Rejection(c.name, Rejected.FORCE_SHARE, max(c.share, 0.0))
    if c.gain is None or c.gain <= 0.0:
        return Rejection(c.name, Rejected.NO_RESPONSE)
    if c.gain <= FIRST:
        return Rejection(c.name, Rejected.BELOW_LIMIT, c.gain)
    if not gap:
        return Rejection(c.name, Rejected.COLOUR, c.gain)
    return Rejection(c.name, Rejected.SHARE, min(c.gain / max(c.above, c.gain), 1.0))
