"""Magnetic cogging: a force that is periodic in position, as magnets pass teeth.

    F = amplitude sin(2 pi x / period + phase)

Source: Otten et al., IEEE/ASME Trans. Mechatronics 2 (1997) 179.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.model.effect import (
    PHASOR,
    SMALL,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
    Wave,
)


def force(x: float, v: float, actuator: float, p: Values) -> float:
    """N"""
    return p[0] * math.sin(2.0 * math.pi * x / p[1] + p[2])


class Cogging(Effect):
    """Looked for at long periods, which a spring may hide, and at those that stand out over
    position."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small force with a few periods over the travel, or with as many as stand out."""
        return [{"amplitude": FAINT * SMALL * at.force, "period": at.travel / count,
                 "phase": 0.0} for count in (*FEW, *_standing_out(at))]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """A wave must come back at least once; a short one is felt by nothing that moves, and
        slow to simulate."""
        if parameter != "period":
            return -math.inf, math.inf
        return SHORTEST * at.travel, LONGEST * at.travel


def _standing_out(at: Conditions) -> list[float]:
    """The numbers of periods over the travel at which the force that is missed, as the noise lets
    it be seen, has a wave over position."""
    counts = np.arange(1.0 / LONGEST, 1.0 / SHORTEST, PERIODS_STEP)
    power = np.zeros(counts.size)
    for run in at.runs:
        x, h = run.position, run.sample_period
        if x.size < FEWEST:
            continue
        missed = (at.base["mass"] / h**2 * np.diff(x, 2)
                  + at.base.get("damping", 0.0) / (2.0 * h) * (x[2:] - x[:-2])
                  + at.base.get("stiffness", 0.0) * x[1:-1]
                  - at.base.get("force_constant", 1.0) * 0.5 * (run.input[1:-1] + run.input[:-2]))
        place = (x[1:-1] - np.mean(x)) / at.travel
        smooth = np.vander(place, DEGREE + 1)
        missed -= smooth @ np.linalg.lstsq(smooth, missed, rcond=None)[0]
        wave = missed * np.exp(2j * math.pi * counts[0] * place)
        step = np.exp(2j * math.pi * PERIODS_STEP * place)
        for k in range(counts.size):
            power[k] += abs(np.sum(wave)) ** 2
            wave = wave * step
    inner = power[1:-1]
    peaks = 1 + np.flatnonzero((inner >= power[:-2]) & (inner > power[2:]))
    return [float(counts[k]) for k in peaks[np.argsort(-power[peaks])][:PEAKS]]


PERIODS_STEP = 0.25
"""Of the periods over the travel: half a period off, the wave is lost at one end."""
FEW = (2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0)
"""Periods over the travel that are always tried: the noise of an acceleration hides them, and what
is taken off for springs."""
DEGREE = 5
"""Of the polynomial over position that is not taken for a wave: springs, and offsets."""
FEWEST, PEAKS = 10, 4
"""Samples that tell a wave, and waves that are tried."""
FAINT = 0.01
"""Amplitude in units of a small force: a fainter one is quicker to simulate."""
SHORTEST = 0.01
"""Period over the travel that is crossed within a sample or so."""
LONGEST = 0.5
"""Period over the travel beyond which too little repeats: it is a swinging weight then, or a
spring with square and cube."""


EFFECT = Cogging(
    name="cogging",
    meaning="magnets pull the stage towards places at equal distances",
    equation="F = amplitude sin(2 pi x / period + phase)",
    source="Otten et al., IEEE/ASME Trans. Mechatronics 2 (1997) 179",
    parameters=(
        Parameter("amplitude", 0.0, "N", "amplitude of the force", 0.0, 1e6),
        Parameter("period", 1e-3, "m", "length of one period", 1e-12, 1e3),
        Parameter("phase", 0.0, "rad", "phase at x = 0", -100.0, 100.0),
    ),
    priors={"amplitude": Prior(1e-4, 1.0), "period": Prior(1e-5, 1e-1),
            "phase": Prior(-math.pi, math.pi, log=False)},
    side="mechanical",
    parity="both",
    memory=False,
    shown_by="motion across some periods, at several amplitudes",
    optional=("phase",),
    classes=(
        Equivalence(("cogging", "gravity"), "motion across fewer than two periods: both are "
                    "sines",
                    "motion across some periods"),
        Equivalence(("cogging", "encoder_periodic_error"), "motion well below the resonance only",
                    "motion above the resonance, where a force moves less"),
    ),
    fit=PHASOR,
    force=force,
    wave=Wave("period", "position"),
)
