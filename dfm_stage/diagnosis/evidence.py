"""All that a verdict needs, as plain values: every fit, prediction and comparison is done.

Nothing here can simulate; `gather` fills it from a search, a test writes it by hand. RMS values
are in the unit of the output, chi-squares under the weights of the final noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.margins import Constancy, Signal
from dfm_stage.diagnosis.remainder import Description, Finding
from dfm_stage.diagnosis.surface import Surface
from dfm_stage.identification.quantity import Quantity
from dfm_stage.model.formula import Formula
from dfm_stage.recording.units import Measured

Which = Literal["given", "retuned", "extended"]


# Why an effect that paid on the fitted records is not kept.
DropReason = Enum("DropReason", [
    "NOT_EXERCISED",  # found in a second look, and the held-out records do not exercise it
    "NOT_HELD_OUT",   # free in each run, and held-out records do not show it
    "SURROGATES",     # does no better on held-out records than its surrogates
    "REFITTED",       # the others alone, refitted, predict held-out records better
    "LINE_OF_INPUT",  # a vibration at a line of the input, beside a remainder
    "AT_BOUND",       # a parameter is at its bound, and without an interval
    "NO_SIZE",        # the interval of its size holds zero
    # where a remainder stays:
    "BLOCKS",         # held-out blocks are not worse without it
    "SMALL_PART",     # takes too little of what is left on held-out blocks
    "RIVALS",         # unlike effects do as well, or one of its class better
    "UNHEARD",        # the force domain, which can judge it, finds none of it
])


@dataclass(frozen=True)
class Errors:
    """What a model leaves of some records: RMS and chi-square of `count` weighted samples,
    and the mean square `power` of the signal that is judged. Infinite where it cannot be
    simulated."""

    rms: float
    chi2: float
    count: int = 0
    power: float = math.inf


@dataclass(frozen=True)
class ModelEvidence:
    """One model against all records: what it leaves, and its free parameters by address
    (`stiffness`, `creep.gain`). `findings` are of the fitted records by name, `description` of
    what is more than noise in them, where anything is."""

    fitted: Errors
    held_out: Errors
    parameters: Mapping[str, Quantity] = field(default_factory=dict)
    findings: Mapping[str, tuple[Finding, ...]] = field(default_factory=dict)
    description: Description | None = None

    @property
    def remainder(self) -> bool:
        """Whether it leaves more than noise."""
        return any(f.real for each in self.findings.values() for f in each)


@dataclass(frozen=True)
class RivalEvidence:
    """An effect in the place of another: what it costs in chi-square, alone and with its
    parameters paid for, and how it predicts.

    `distance_over_noise` is the length within which it yields, for an effect that has one.
    `margin` is by how much it loses on held-out blocks, in block standard errors; `related` says
    that the library has both in one class, `larger` that it has more parameters, `finished` that
    there was work enough for its fit, `ahead` that the force domain has it in its best set, and
    the effect clearly behind; `repeats` that it makes the same motion with more parameters, and
    so says no more; `rarer` that few machines have it, and many the effect, which looks like it.
    """

    name: str
    cost: float
    price: float
    held_out: Errors
    distance_over_noise: float = math.inf
    margin: float = math.inf
    related: bool = True
    larger: bool = False
    finished: bool = True
    ahead: bool = False
    repeats: bool = False
    rarer: bool = False


@dataclass(frozen=True)
class EffectEvidence:
    """One effect of the hypothesis: parameters, the model without it, its rivals, and whether
    held-out records exercise it. `margin` is by how much the held-out blocks are worse without it,
    in block standard errors, `constancy` whether all sizes are the same for every size of motion.
    `force_share` is what it explains by itself of the force that is predictable, None where the
    force domain cannot judge it, `force_margin` its lead there over every rival outside its class,
    in block standard errors; `in_best` says that this has it, or one of its class, in its best
    set; `confirmed` that it has the effect itself there."""

    name: str
    parameters: Mapping[str, Quantity]
    without: ModelEvidence
    rivals: tuple[RivalEvidence, ...] = ()
    exercised: bool = True
    margin: float = math.inf
    constancy: Constancy | None = None
    force_share: float | None = None
    force_margin: float = -math.inf
    in_best: bool = True
    confirmed: bool = False


@dataclass(frozen=True)
class Heard:
    """What the force domain names by itself: by name the share of the missing force's power that
    is lost without the effect, the share of all together and of what is predictable, and for each
    name those that it does not part from it, itself first. `sizes` by address are what is known
    of them there, `start` are all parameters by address, SI. `margins` are, by name, how far each
    rival stays behind in its place, in block standard errors, smallest first."""

    added: Mapping[str, float]
    share: float
    predictable: float
    members: Mapping[str, tuple[str, ...]]
    sizes: Mapping[str, Quantity] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    margins: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def explained(self) -> float:
        """Share of what is predictable that all explain together."""
        return min(self.share / self.predictable, 1.0)


@dataclass(frozen=True)
class Candidate:
    """An effect of the library: why it is no candidate here, the fall in chi-square that the
    screen promised, the share of the missing force that it explains by itself, and why it was
    dropped after it had been fitted. `above` is chi-square above the noise where the screen
    looked, under the weights of that time."""

    name: str
    excluded: str | None = None
    gain: float | None = None
    dropped: DropReason | None = None
    share: float | None = None
    above: float = math.inf


@dataclass(frozen=True)
class Motion:
    """How much the stage moved: the largest RMS of a record, in the output's unit."""

    rms: float
    constant_input: bool = False


@dataclass(frozen=True)
class Offset:
    """A constant in the reading that the model does not have, with its standard error, the
    stiffness (N/m) that makes a force of it, and the effect that this force is."""

    effect: str
    value: float
    sigma: float
    stiffness: float


@dataclass(frozen=True)
class Noise:
    """RMS of the noise by what the best model leaves, by which it is judged and which holds a
    remainder, too; and by what does not hold one: what does not repeat with a periodic input, and,
    where a remainder stays, high frequencies."""

    rms: float
    source: str
    by_periods: float | None = None
    by_high_frequencies: float | None = None

    @property
    def floor(self) -> tuple[float, str]:
        """The noise floor that is told, and what it is known from."""
        known = ((self.by_periods, "periods"), (self.by_high_frequencies, "high frequencies"))
        return next(((rms, source) for rms, source in known if rms is not None),
                    (self.rms, self.source))


@dataclass(frozen=True)
class Judged:
    """Where held-out power is compared: in which signal, in windows of how many seconds, the power
    of its noise, and the RMS that a black box would leave, where one was tried. With `lag` the
    signal is the output's change over so many samples, which are `velocity_s`."""

    signal: Signal | Literal["force"] = "position"
    window_s: float | None = None
    noise_power: float = 0.0
    predictable: float | None = None
    lag: int = 0
    velocity_s: float | None = None


@dataclass(frozen=True)
class Comparison:
    """One record for the report: time (s) and output (N,), which `measures` names, and
    what each model leaves of it (N,), of those that can be simulated."""

    name: str
    held_out: bool
    sample_period: float
    time: Array
    measured: Array
    left: Mapping[Which, Array]
    measures: Measured = "position"


@dataclass(frozen=True)
class Proposal:
    """An experiment as `load_experiment` takes it, but for what is expected of it: `parts` are the
    effects that it is to tell apart, by `expected` in chi-square (None: not simulated)."""

    experiment: Mapping[str, Any]
    parts: tuple[str, ...] = ()
    expected: float | None = None


@dataclass(frozen=True)
class Offer:
    """A formula for what has no name, with the values of its fit.

    `share` is of the held-out gap's power above the noise, `held_out_rms` what the model with it
    leaves. `came_back` says of each term in how many of `draws` resamples it was chosen again,
    `found_in` the share of these that chose all of them. It was fitted with the effects `beside`
    it, which were found; without any, it stands in the place of all that were.
    """

    formula: Formula
    parameters: Mapping[str, Quantity]
    share: float
    held_out_rms: float
    found_in: float
    came_back: tuple[tuple[str, int], ...]
    draws: int
    beside: tuple[str, ...] = ()

    @property
    def file(self) -> str:
        """What diagnosis.json calls its file, which stands beside it."""
        return f"{self.formula.name}.yaml"

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it."""
        return {"name": self.formula.name, "force": self.formula.text, "share": self.share,
                "found_in_percent": 100.0 * self.found_in, "held_out_rms": self.held_out_rms,
                "parameters": {n: q.to_dict() for n, q in self.parameters.items()},
                "came_back": {text: [n, self.draws] for text, n in self.came_back},
                "beside": list(self.beside), "file": self.file}


@dataclass(frozen=True)
class Braking:
    """What brakes free swings beside viscous damping, which is `damping` (N s/m): the size of each
    effect with its interval over blocks of swings, SI, and by how many block standard errors
    held-out swings are worse without it. `missed` is the part (RMS) of the braking force that
    viscous damping alone misses in held-out swings, `left` the one that is missed with all of
    them."""

    sizes: Mapping[str, Quantity]
    missed: float
    left: float
    margins: Mapping[str, float]
    damping: float


@dataclass(frozen=True)
class Accepted:
    """Formulas that the user has added to the model, and what the model leaves without them: as
    given, and with its own parameters re-estimated."""

    formulas: tuple[Formula, ...]
    given: ModelEvidence
    retuned: ModelEvidence


@dataclass(frozen=True)
class OtherLaw:
    """A law, in words, that explains clearly more of the missing force than the effects found, and
    than any of the library by itself: shares of its power on held-out blocks, of the law and of
    all effects found together."""

    words: str
    share: float
    share_of_effects: float


@dataclass(frozen=True)
class Evidence:
    """The evidence of one diagnosis.

    `given` is the model as it was given, `retuned` with its own parameters re-estimated,
    `extended` with the effects of the hypothesis added; without any, that is the retuned one.
    `base_shares` are damping, stiffness and force constant over their given values, those that
    were free; `linear` says that every effect of the hypothesis is. `joint` is the RMS over fitted
    and held-out records of one fit to both, where that was needed. `limits` are the sizes that
    effects would have needed to be named. `warnings` are of the records themselves; `split` says
    that no record was held out and a part of each was instead, `not_compared` are effects whose
    fits were not begun or finished for want of work.

    `conventions` are those of the input, one for each record, as diagnosis.json holds them,
    `witness` is what the force domain says by itself, `surface` the force that is still missing,
    where that is clear of the noise. `graded` says that the effects were found by
    how much of the gap they explain, because no set of them reaches the noise; `judged` is in what
    held-out powers are compared. `heard` says that the force domain alone bears the effects out,
    `braking` which of them the energy of free swings bears out.
    `one_law` are laws of speed in whose place one that has no name does better, `other_law` is one
    that does so in the place of all effects.
    `formulas` are offered for what no effect explains. `form_hidden` are forces among the
    effects of which the records do not show whether they stand in for another form.
    """

    records: tuple[str, ...]
    unit: str
    noise: Noise
    motion: Motion
    given: ModelEvidence
    retuned: ModelEvidence
    extended: ModelEvidence
    effects: tuple[EffectEvidence, ...] = ()
    base_shares: Mapping[str, float] = field(default_factory=dict)
    linear: bool = False
    joint: tuple[float, float] | None = None
    offset: Offset | None = None
    library: tuple[Candidate, ...] = ()
    limits: Mapping[str, Mapping[str, Quantity]] = field(default_factory=dict)
    comparisons: tuple[Comparison, ...] = ()
    next_experiment: Proposal | None = None
    warnings: tuple[str, ...] = ()
    split: bool = False
    not_compared: tuple[str, ...] = ()
    judged: Judged = field(default_factory=Judged)
    graded: bool = False
    witness: Mapping[str, Any] | None = None
    heard: Heard | None = None
    braking: Braking | None = None
    surface: Surface | None = None
    form_hidden: tuple[str, ...] = ()
    one_law: tuple[str, ...] = ()
    other_law: OtherLaw | None = None
    formulas: tuple[Offer, ...] = ()
    accepted: Accepted | None = None
    conventions: tuple[Mapping[str, Any], ...] = ()
