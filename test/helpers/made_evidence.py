"""Evidence made by hand: what a user could meet, in the terms of a verdict.

The readings have a noise of 100 nm RMS and 10,000 samples, the stage moves by 1 mm RMS, and a
model that leaves nothing but noise has a chi-square of 10,000.
"""

from __future__ import annotations

import math
from dataclasses import replace

from dfm_stage.diagnosis.evidence import (
    EffectEvidence,
    Errors,
    Evidence,
    Judged,
    ModelEvidence,
    Motion,
    Noise,
    Offset,
    RivalEvidence,
)
from dfm_stage.diagnosis.margins import Constancy
from dfm_stage.diagnosis.remainder import Finding

COUNT, NOISE = 10_000, 1e-7
LEFT = {"run": (Finding("line", 100.0, 32.0, "a line stands out"),)}
QUIET = {"run": (Finding("line", 9.0, 32.0, "no line stands out"),)}

COLOURED = {"run": (Finding("excess", 5.0, 2.0, "slow", coloured=True),
                    Finding("drift", 90.0, 25.0, "it wanders", coloured=True))}


def left(gap: float = 0.0, *, held: float | None = None, above: float | None = None,
         held_above: float | None = None, remainder: bool = False) -> ModelEvidence:
    """A model that leaves a `gap` (m) beside the noise, `held` on held-out records; `above` is
    the chi-square above the noise, by default what the gap makes."""
    other = gap if held is None else held

    def errors(size: float, more: float | None) -> Errors:
        extra = COUNT * (size / NOISE) ** 2 if more is None else more
        rms = math.hypot(NOISE, size)
        return Errors(rms, COUNT + extra, COUNT, rms**2)

    return ModelEvidence(errors(gap, above), errors(other, held_above),
                         findings=LEFT if remainder else QUIET)


NO_GAP = left()
CLEAR = left(1e-6, remainder=True)
"""Ten times the noise: a million in chi-square."""


def case(given: ModelEvidence = NO_GAP, retuned: ModelEvidence = NO_GAP,
         extended: ModelEvidence | None = None, effects: tuple[EffectEvidence, ...] = (),
         **more: object) -> Evidence:
    return replace(Evidence(("run",), "m", Noise(NOISE, "residuals"), Motion(1e-3),
                            given, retuned, extended or retuned, effects), **more)


def effect(name: str, *rivals: RivalEvidence, without: ModelEvidence = CLEAR,
           exercised: bool = True) -> EffectEvidence:
    return EffectEvidence(name, {}, without, rivals, exercised)


def rival(name: str, price: float, held: float = 0.0, distance: float = math.inf
          ) -> RivalEvidence:
    """A rival that costs `price`, and `held` on held-out records."""
    return RivalEvidence(name, price, price, Errors(NOISE, COUNT + held, COUNT), distance)


def at(margin: float, **more: object) -> RivalEvidence:
    """A rival that is so many block standard errors behind."""
    return replace(rival("eddy_current_damping", 1e6), margin=margin, related=False, **more)


def leaving(share: float, gap: float = 100.0 * NOISE) -> ModelEvidence:
    """A model that takes a share of the power of a gap (m), fitted and held out."""
    power = NOISE**2 + (1.0 - share) * gap**2
    e = Errors(math.sqrt(power), COUNT * power / NOISE**2, COUNT, power=power)
    return ModelEvidence(e, e, findings=LEFT)


def parts(share: float, **alone: float) -> Evidence:
    """A gap of which effects take a `share` together, and without each of them so much less."""
    steady = Constancy(0.0, 0.02)
    return case(leaving(0.0), leaving(0.0), leaving(share), tuple(
        EffectEvidence(name, {}, leaving(share - less), margin=20.0, constancy=steady)
        for name, less in alone.items()), graded=True,
        judged=Judged("position", None, NOISE**2, NOISE))


def part(share: float, *rivals: RivalEvidence, predictable: float = 1.0, margin: float = 20.0,
         gain: float = 0.0, gap: float = 100.0 * NOISE, **more: object) -> Evidence:
    """A gap (m), of which friction takes a `share` of the power held out, where a black box would
    take `predictable`."""
    bare, found, black_box = (leaving(each, gap) for each in (0.0, share, predictable))
    friction = EffectEvidence("coulomb_friction", {}, bare, rivals, margin=margin,
                              constancy=Constancy(gain, 0.02))
    return case(bare, bare, found, (friction,), graded=True,
                judged=Judged("position", None, NOISE**2, black_box.held_out.rms), **more)


def found(*effects: EffectEvidence, after: ModelEvidence = NO_GAP, **more: object) -> Evidence:
    """A clear gap that the effects close."""
    return case(CLEAR, CLEAR, after, effects, **more)


FRICTION = effect("coulomb_friction")
NEAR_FLOOR = left(1e-8, held=1.2e-7, above=0.0, held_above=100.0)
"""Predicts held-out records at 1.56 times the floor."""
GROSS = left(1e-4, remainder=True)
MOST = left(1e-5, remainder=True)
"""A tenth of the gross gap: 99 % of its power is taken."""
PUSH = Offset("force_offset", 1e-6, 1e-8, 650.0)
MOVING_AT_NOISE = Motion(8.0 * NOISE)
