"""Slew-rate limit of the amplifier: its output cannot change faster than a rate.

    s' = rate sgn(u - s) until s = u        u: the command, V or A

Within a sample the output is a ramp and then the command. The simulator holds its mean over the
sample, which gives the same impulse; a position differs by at most a twelfth of the squared sample
period times the acceleration that the change of the command gives. Fits hold it over a quarter of
a sample.
Source: Franco, Design with Operational Amplifiers and Analog Integrated Circuits (2014), sec. 6.3.
"""

from __future__ import annotations

import numpy as np

from dfm_stage.model.effect import (
    Array,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def command(u: float, z: Array, period: float, p: Values) -> float:
    """V or A; z[0] is the output at the end of the sample before."""
    rise, reach = u - z[0], p[0] * period
    if abs(rise) <= reach:
        z[0] = u
        return float(u - 0.5 * rise * abs(rise) / reach)
    ramp = reach if rise > 0.0 else -reach
    mean = z[0] + 0.5 * ramp
    z[0] += ramp
    return float(mean)


class SlewLimit(Effect):
    """Its rate is tried at quantiles of the command's changes."""

    def hidden_because(self, at: Conditions) -> str | None:
        """A command that never changes meets no limit."""
        return "the input is constant" if all(np.ptp(r.input) == 0.0 for r in at.runs) else None

    def starts(self, at: Conditions) -> list[Parameters]:
        """Rates that a growing share of the changes exceeds."""
        rates = np.sort(np.concatenate([np.abs(np.diff(r.input)) / r.sample_period
                                        for r in at.runs]))
        tried = np.quantile(rates, 1.0 - SHARES)
        return [{"rate": float(rate)} for rate in np.unique(tried) if rate > 0.0]


SHARES = np.geomspace(1e-3, 0.7, 24)
"""Shares of the changes of the command that are too fast."""


EFFECT = SlewLimit(
    name="slew_limit",
    meaning="the amplifier's output cannot change faster than a rate",
    equation="s' = rate sgn(u - s) until s = u",
    source="Franco, Design with Operational Amplifiers and Analog Integrated Circuits (2014), "
    "sec. 6.3",
    parameters=(Parameter("rate", 100.0, "(V or A)/s", "fastest change of the output", 1e-9,
                          1e12),),
    priors={"rate": Prior(1.0, 1e4)},
    side="actuator",
    parity="odd",
    memory=True,
    shown_by="large commands at high frequencies",
    classes=(Equivalence(("slew_limit", "amplifier_bandwidth"), "one amplitude of a single sine",
                         "the same sine at another amplitude: a slew limit spares a small one"),),
    command=command,
    registers=1,
    substeps=4,
    searched=True,
)
