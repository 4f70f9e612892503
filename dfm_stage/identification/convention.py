"""What an input does between its samples: found in the record, and turned into steps to simulate.

A held input acts half a sample late on average, one sampled at the same instant as the output
behind anti-alias filters does not; a simulator that holds the input cannot follow the second. How
late the input acts is read off the equation of motion: u(t - tau) is regressed on filtered
acceleration, velocity, position and usual nonlinear functions of them, and the tau that leaves
least is looked for. What is late cannot be told from a lag or a delay of the stage, and is left
to these; what is early is a convention.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.identification.decisions import (
    EARLIEST,
    EARLY_SHIFT,
    FINER,
    FOLLOWED,
    HELD_LEAST,
    HELD_SIGMAS,
    LATE_RATIO,
    TIMING_FLOOR,
    TIMING_KNOWN,
    UNEXPLAINED,
)
from dfm_stage.identification.input_timing import (
    HELD_LATE,
    Motion,
    Waves,
    livest,
    reflected,
    timing,
)

Hold = Literal["zero", "first", "band_limited"]
Source = Literal["estimated", "others", "contradicted", "assumed", "given"]

LATENESS: Mapping[Hold, float] = {"zero": HELD_LATE, "first": 0.0, "band_limited": 0.0}
"""Samples by which an input of each kind acts late on average."""
SINCS: Mapping[Hold, int] = {"zero": 1, "first": 2, "band_limited": 0}
"""Power of sinc by which the kinds weaken what is in the samples."""
WIDTHS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Standard deviations (samples) of the Gaussian filters that are tried."""


@dataclass(frozen=True)
class Convention:
    """What the input of one record does between its samples, and how it is known.

    The value that acts at t_k is column(t_k - `shift` T): `shift` samples, never above zero where
    it is found, because what is late is a delay. `sigma` is its standard error. `late` is how much
    later than the hold says the input acts, with `late_sigma`: lag and delay of the stage, or of
    the column; None where the record does not show it. `source` is "others" where the other
    records of the set show it, and "contradicted" where these show that it is held and this one
    does not. `left` is the RMS that each kind of hold leaves of the input.
    """

    hold: Hold = "zero"
    shift: float = 0.0
    sigma: float | None = None
    source: Source = "assumed"
    late: float | None = None
    late_sigma: float | None = None
    left: Mapping[Hold, float] = field(default_factory=dict, compare=False)

    @property
    def held(self) -> bool:
        """Whether the input is what every simulator takes: held, and neither early nor late."""
        return self.hold == "zero" and self.shift == 0.0

    @property
    def before_it_is_set(self) -> bool:
        """Whether a held input would surely act before it is set."""
        return self.hold == "zero" and self.late is not None and self.late_sigma is not None \
            and self.late < -HELD_SIGMAS * self.late_sigma

    def acts_when_held(self, behind: float = 0.0) -> bool:
        """Whether the record shows an input that acts as a held one does, half a sample late,
        `behind` a stage that is late by so many samples."""
        return self.hold == "zero" and self.source == "estimated" and self.late is not None \
            and abs(self.late - behind) <= EARLY_SHIFT

    def behind(self, late: float) -> Convention:
        """Return the same for a stage that is known to be `late` (samples) by itself: an input
        that acts early in spite of it was set so much earlier. What the regression does not know
        makes a held one look early, too."""
        early = self.shift + (self.late or 0.0)
        surely = self.hold != "zero" and self.late_sigma is not None \
            and early < -HELD_SIGMAS * self.late_sigma
        if self.source != "estimated" or late <= 0.0 or not (self.shift < 0.0 or surely):
            return self
        return replace(self, shift=early - late, late=late)

    def to_dict(self, record: str) -> dict[str, Any]:
        """As diagnosis.json and identify.json keep it."""
        return {"record": record, "input_hold": self.hold,
                "input_shift_samples": {"value": self.shift,
                                        "ci95": _interval(self.shift, self.sigma)},
                "estimated": self.source == "estimated", "source": self.source,
                "late_samples": {"value": self.late,
                                 "ci95": _interval(self.late, self.late_sigma)},
                "words": self.words}

    @property
    def words(self) -> str:
        """The convention in one sentence."""
        if self.hold == "zero" and self.shift == 0.0:
            text = "the input is taken as held from each sample to the next"
        else:
            kind = {"zero": "held from each sample to the next", "band_limited": "band-limited",
                    "first": "going straight from each sample to the next"}[self.hold]
            side = "before" if self.shift < 0.0 else "after"
            when = (f"the input acts {abs(self.shift):.3g} samples {side} its column says"
                    if self.shift else "both columns were sampled at the same instant")
            text = f"{when}; the input is taken as {kind}"
        return text + self._how

    @property
    def _how(self) -> str:
        if self.source == "given":
            return " (given)"
        if self.source == "assumed":
            return " (assumed: the record does not show it)"
        if self.source == "others":
            return " (assumed: the other records show it, this one does not)"
        if self.source == "contradicted":
            return " (assumed: the other records show it, this one contradicts them)"
        if self.late is not None and self.late_sigma is not None \
                and self.late > HELD_SIGMAS * self.late_sigma:
            return f" (it acts {self.late:.2g} samples later; a lag or a delay does the same)"
        return ""


HELD = Convention()


def reinterpreted(known: Convention, kind: Hold) -> Convention:
    """Return what another kind of hold makes of when the input acts: what is early is a shift,
    what is late a delay."""
    acts = LATENESS[known.hold] + known.shift + (known.late or 0.0)
    late = acts - LATENESS[kind]
    early = late if late < -EARLY_SHIFT else 0.0
    return replace(known, hold=kind, shift=early, late=late - early,
                   sigma=known.late_sigma if known.sigma is None else known.sigma)


def agreed(found: Sequence[Convention]) -> list[Convention]:
    """What the records of one set say together of their inputs, in their order.

    Where none shows an input that is held for sure, and one an input that is not, all take the
    kind of hold that leaves least over these records, and those that show none act when the
    others do. Where the records contradict each other, the regression misses something in some of
    them: none is corrected. What was given by hand stays.
    """
    shown = [each for each in found if each.source == "estimated"]
    early = [each for each in shown if not each.held]
    if not early:
        return list(found)
    if any(each.held and not each.before_it_is_set for each in shown):
        return [Convention(source="contradicted") if each in early else each for each in found]
    kinds = set.intersection(*(set(each.left) for each in early))
    kind = min(kinds, key=lambda k: sum(math.log(max(each.left[k], 1e-300)) for each in early))
    told = [reinterpreted(each, kind) if each.source == "estimated" and (
        each.held or each.hold != kind) else each for each in found]
    surest = min((each for each in told if each.source == "estimated"),
                 key=lambda each: each.sigma or math.inf)
    return [replace(surest, source="others") if each.source == "assumed" else each
            for each in told]


def sentences(conventions: Iterable[Mapping[str, Any]]) -> list[str]:
    """What `to_dict` says in words: once where all records are alike, else for each record."""
    known = list(conventions)
    words = {each["words"] for each in known}
    return sorted(words) if len(words) < 2 else [f"{c['record']}: {c['words']}" for c in known]


def origin_of(conventions: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """What a model fitted to the records says of their inputs: nothing where all were held."""
    unusual = sorted({c["input_hold"] for c in conventions
                      if c["input_hold"] != HELD.hold or c["input_shift_samples"]["value"]})
    return {"input_hold": unusual} if unusual else {}


@dataclass(frozen=True)
class Drive:
    """An input as a simulator takes it: `values` (factor N,), each held for a part 1 / `factor`
    of the sample period, and all of it `delay` sample periods late."""

    values: Array
    factor: int = 1
    delay: float = 0.0

    def sliced(self, part: slice) -> Drive:
        """Return the input of some of the samples."""
        samples = range(*part.indices(self.values.size // self.factor))
        first = self.factor * samples.start
        return Drive(self.values[first:first + self.factor * len(samples)], self.factor,
                     self.delay)

    def finer(self, times: int) -> Drive:
        """Return the same, each value as so many equal ones that are held for a shorter time."""
        return self if times == 1 else Drive(np.repeat(self.values, times), times * self.factor,
                                             self.delay)


def drive_of(values: Array, convention: Convention, motion: Array, periodic: bool = False,
             derivative: int = 0) -> Drive | None:
    """Return the input `values` (N,) as a simulator takes it; None where it is held as it stands.

    A held input that is early is exact. Others become up to FINER steps a sample, so large that
    the motion is that of the input between its samples: `motion` (N,) says how many it takes, and
    is the position's time derivative of order `derivative`. An acceleration follows each step at
    once: for it they lie about the sample instants, not between them.
    """
    if convention.held or values.size < 2:
        return None
    if convention.hold == "zero":
        ahead = math.ceil(-convention.shift)
        at = np.arange(values.size) + ahead
        at = at % values.size if periodic else np.clip(at, 0, values.size - 1)
        return Drive(values[at], delay=ahead + convention.shift)
    factor = FINER if convention.hold == "first" else next(
        (k for k in range(2, FINER) if image_share(motion, k, derivative) < FOLLOWED), FINER)
    half = 0.5 / factor if derivative > 1 else 0.0
    shift = convention.shift - half
    found = _straight(values, shift, factor, periodic) if convention.hold == "first" else \
        interpolated(values, factor, 0.5 / factor - shift, periodic, steps=True)
    return Drive(found, factor, half)


def image_share(motion: Array, factor: int, derivative: int = 0) -> float:
    """RMS of what the images of `factor` steps a sample add to a motion (N,), over its own.

    The image of f (in sampling rates) is f / (factor - f) as strong, and moves a mass by
    (f / (factor - f))^2 of what f does; below the resonance, taken at the RMS frequency of the
    motion, by that of the resonance. In a derivative an image is stronger by its frequency.
    """
    power = np.abs(np.fft.rfft(reflected(motion)[1])) ** 2
    f = np.linspace(0.0, 0.5, power.size)
    total = max(float(power.sum()), 1e-300)
    resonance = math.sqrt(float(f**2 @ power) / total)
    image = f * np.maximum(f, resonance) ** 2 / (factor - f) ** 3
    if derivative:
        image[1:] *= ((factor - f[1:]) / f[1:]) ** derivative
    return math.sqrt(float(image**2 @ power) / total)


def interpolated(values: Array, factor: int, offset: float = 0.0, periodic: bool = False,
                 steps: bool = False) -> Array:
    """Return a band-limited signal at times (k / factor + offset) T, shape (factor N,).

    At its ends a signal that is not periodic is taken to go on as its own reflection in the end
    point. With `steps` each value is that of a step of T / factor about the time: a step weakens a
    frequency by a sinc, which is taken out, so that only images near `factor` times the sampling
    rate are left.
    """
    count = values.size
    line, wave = (np.zeros(2), values) if periodic else reflected(values)
    spectrum = np.fft.rfft(wave)
    if wave.size % 2 == 0:
        spectrum[-1] = 0.5 * spectrum[-1]
    omega = 2.0 * np.pi * np.arange(spectrum.size) / wave.size
    spectrum = spectrum * np.exp(1j * omega * offset)
    if steps:
        spectrum /= np.sinc(omega / (2.0 * np.pi * factor))
    fine = np.fft.irfft(spectrum, factor * wave.size)[:factor * count] * factor
    return np.asarray(fine + line[0] + line[1] * (np.arange(factor * count) / factor + offset))


def _straight(values: Array, shift: float, factor: int, periodic: bool) -> Array:
    """Steps for an input that goes straight from sample to sample, (factor N,).

    Means over the steps, less a twelfth of their second difference: a step in the place of a slope
    s moves x'' = u by s h^3 / 12 too much, which adds up to h^2 u / 12.
    """
    middle = (np.arange(-1, factor * values.size + 1) + 0.5) / factor - shift
    edges = np.concatenate((middle - 0.5 / factor, middle[-1:] + 0.5 / factor))
    knots = np.arange(-3, values.size + 4)
    at = knots % values.size if periodic else np.clip(knots, 0, values.size - 1)
    area = np.concatenate(([0.0], np.cumsum(0.5 * (values[at][1:] + values[at][:-1]))))
    place = np.clip(np.floor(edges).astype(int) + 3, 0, knots.size - 2)
    rest = edges - knots[place]
    here, there = values[at][place], values[at][place + 1]
    means = np.diff(area[place] + rest * (here + 0.5 * rest * (there - here))) * factor
    return np.asarray(means[1:-1] - np.diff(means, 2) / 12.0)


# -- the estimate -------------------------------------------------------------------------------


def find_convention(input_: Array, output: Array, derivative: int = 0, *,
                    hold: str | None = None, shift: float | None = None) -> Convention:
    """Return the convention of one record from input (N,) and output (N,).

    `derivative` says of which order in the position's time derivatives the output is. What is
    given by hand (`hold`, `shift`) is taken as it is.
    """
    if hold is not None or shift is not None:
        kind: Hold = "zero" if hold is None else hold  # type: ignore[assignment]
        return Convention(kind, 0.0 if shift is None else shift, source="given")
    u, y = livest(input_, output)
    if np.ptp(u) == 0.0 or np.ptp(y) == 0.0 or not (np.all(np.isfinite(u))
                                                    and np.all(np.isfinite(y))):
        return HELD
    waves, motion = Waves.of(u), Motion.of(y, derivative)
    seen = [(width, t) for width in WIDTHS
            if (t := timing(waves, motion, width)) is not None and t.left < UNEXPLAINED]
    if not seen:
        return HELD
    width, best = min(seen, key=lambda w: w[1].sigma)
    if best.sigma > TIMING_KNOWN:
        return HELD
    sigma = math.hypot(best.sigma, TIMING_FLOOR)
    if best.tau + HELD_SIGMAS * best.sigma >= HELD_LEAST:
        return Convention("zero", source="estimated", late=best.tau - LATENESS["zero"],
                          late_sigma=sigma)
    margin = max(EARLY_SHIFT, HELD_SIGMAS * sigma)
    if best.left_late < LATE_RATIO * best.left or best.tau < EARLIEST - margin:
        return HELD
    left = _left_by_kind(waves, motion, width)
    kind = min(left, key=lambda kind: left[kind])
    early = best.tau - LATENESS[kind]
    if early > -margin:
        return Convention(kind, 0.0, sigma, "estimated", early, sigma, left)
    return Convention(kind, early, sigma, "estimated", 0.0, sigma, left)


def _left_by_kind(u: Waves, motion: Motion, width: float) -> dict[Hold, float]:
    """What each kind of hold leaves of an input that is not simply held, behind the filter that
    tells its timing best. Kinds differ at high frequencies: a wider filter has none, a narrower
    one mostly noise."""
    return {kind: found.left for kind, power in SINCS.items()
            if (found := timing(u, motion, width, power)) is not None}


def _interval(value: float | None, sigma: float | None) -> list[float] | None:
    if value is None or sigma is None or not math.isfinite(sigma):
        return None
    return [value - 1.96 * sigma, value + 1.96 * sigma]
