"""Hysteresis of a piezo actuator (Prandtl-Ishlinskii): a sum of plays between command and force.

    s = u + weight (mean of z_i - u),    z_i = min(max(z_i, u - r_i), u + r_i),    r_i = i range/6

u is the command, V or A; each of the six plays z_i follows it at a distance of up to r_i. It is
rate-independent, so a held command keeps it exact. The plays begin where the input before the
record left them, from rest.
Source: Krasnoselskii and Pokrovskii, Systems with Hysteresis (1989); Kuhnen, Eur. J. Control 9
(2003) 407.
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import (
    SMALL,
    Array,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)

PLAYS = 6
"""Plays in parallel."""


def command(u: float, z: Array, period: float, p: Values) -> float:
    """V or A; z are the plays."""
    total = 0.0
    for i in range(PLAYS):
        reach = p[1] * (i + 1) / PLAYS
        z[i] = min(max(z[i], u - reach), u + reach)
        total += z[i]
    return u + p[0] * (total / PLAYS - u)


class PrandtlIshlinskii(Effect):
    """Begins at plays up to a part of the largest command, and beyond it."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small weight, which the response is linear in."""
        largest = _largest(at)
        return [{"weight": 10.0 * SMALL, "range": share * largest}
                for share in (0.1, 0.2, 0.4, 0.8, 1.5) if largest > 0.0]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Plays wider than the command never move."""
        return -math.inf, WIDEST * _largest(at) if parameter == "range" else math.inf


def _largest(at: Conditions) -> float:
    return max(float(abs(r.input).max()) for r in at.runs)


WIDEST = 3.0
"""Range over the largest command beyond which only some plays move."""


EFFECT = PrandtlIshlinskii(
    name="prandtl_ishlinskii",
    meaning="the actuator's force depends on the path of its command, as that of a piezo",
    equation="s = u + weight (mean of z_i - u);  z_i = min(max(z_i, u - r_i), u + r_i);  "
    "r_i = i range/6",
    source="Krasnoselskii and Pokrovskii, Systems with Hysteresis (1989); Kuhnen, Eur. J. "
    "Control 9 (2003) 407",
    parameters=(
        Parameter("weight", 0.0, "", "part of the force that goes through the plays", 0.0, 1.0),
        Parameter("range", 1.0, "V or A", "largest play", 1e-9, 1e6),
    ),
    priors={"weight": Prior(1e-3, 0.5), "range": Prior(0.05, 20.0)},
    side="actuator",
    parity="odd",
    memory=True,
    shown_by="slow commands at several amplitudes, and commands above the resonance",
    classes=(
        Equivalence(("prandtl_ishlinskii", "hysteresis"), "motion well below the resonance only",
                    "commands around and above the resonance: the loop is one of the command, or "
                    "one of the motion"),
        Equivalence(("prandtl_ishlinskii", "dead_zone"), "commands that hardly exceed range / 6",
                    "larger commands"),
    ),
    command=command,
    registers=PLAYS,
)
