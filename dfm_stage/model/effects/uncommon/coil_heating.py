"""Coil heating: the power that the coil turns to heat raises its resistance: the current falls.

    s = u / (1 + h),        time_constant h' = rise u^2 / (1 + h) - h

u is the command in V and h the relative rise of the resistance: `rise` is the temperature
coefficient times thermal resistance over the cold resistance. It has no meaning with drive:
current, where the amplifier makes up for it. The simulator holds the mean of h over each sample.
Source: Schmidt, Schitter and Rankers, The Design of High Performance Mechatronics (2014), ch. 5;
Incropera, Fundamentals of Heat and Mass Transfer, sec. 5.1 (lumped capacitance).
"""

from __future__ import annotations

import math

import numpy as np

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


def command(u: float, z: Array, period: float, p: Values) -> float:
    """V; z[0] is h at the end of the sample before. The power over the sample is that at the mean
    of h, which is found by repeating."""
    passed = period / p[1]
    kept, part = math.exp(-passed), -math.expm1(-passed) / passed
    mean = end = z[0]
    for _ in range(PASSES):
        rest = p[0] * u * u / (1.0 + mean)
        end, mean = rest + (z[0] - rest) * kept, rest + (z[0] - rest) * part
    z[0] = end
    return float(u / (1.0 + mean))


PASSES = 4
"""Each pass is nearer by the part of the rise that falls into one sample."""


class CoilHeating(Effect):
    """Begins at time constants from a hundredth of the record to ten of them."""

    def hidden_because(self, at: Conditions) -> str | None:
        """A current drive makes up for the resistance."""
        return "has no meaning with drive: current" if at.drive_kind == "current" else None

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small rise of the resistance."""
        if at.drive == 0.0:
            return []
        return [{"rise": SMALL / at.drive**2, "time_constant": float(tau)}
                for tau in np.geomspace(0.01, 3.0, 6) * at.duration]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Over many records a rise that never ends is told by its rate alone."""
        return -math.inf, LONGEST * at.duration if parameter == "time_constant" else math.inf


LONGEST = 10.0
"""Largest time constant, in records."""


EFFECT = CoilHeating(
    name="coil_heating",
    meaning="the coil's resistance rises with the power that it turns to heat",
    equation="s = u / (1 + h);  time_constant h' = rise u^2 / (1 + h) - h",
    source="Schmidt et al., The Design of High Performance Mechatronics (2014), ch. 5",
    parameters=(
        Parameter("rise", 0.0, "1/V^2", "relative rise of the resistance in the end, per squared "
                  "voltage", 0.0, 1e6),
        Parameter("time_constant", 30.0, "s", "thermal time constant", 1e-4, 1e9),
    ),
    priors={"rise": Prior(1e-4, 0.1), "time_constant": Prior(0.1, 1e3)},
    side="actuator",
    parity="odd",
    memory=True,
    shown_by="a record as long as the time constant, from cold, at several amplitudes",
    classes=(
        Equivalence(("coil_heating", "supply_sag"), "one amplitude, or a memory longer than the "
                    "load changes", "several amplitudes: the gain falls with the square of the "
                    "load, or with the load"),
        Equivalence(("coil_heating", "force_constant"), "a coil that has become warm at one "
                    "amplitude", "several amplitudes, or a record from cold"),
    ),
    command=command,
    registers=1,
)
