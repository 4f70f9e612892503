"""Supply sag: the amplifier's gain falls with the recent load on its supply, and recovers.

    s = u max(1 - sag m, 0),        time_constant m' = |u| - m

u is the command, V or A, and m the load that the supply's capacitors have felt. The simulator
holds the mean of m over each sample.
Source: Erickson and Maksimovic, Fundamentals of Power Electronics (2001), ch. 2 and 8 (output of
a converter without regulation in proportion to its supply).
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
    """V or A; z[0] is m at the end of the sample before."""
    load, passed = abs(u), period / p[1]
    away, kept = z[0] - load, math.exp(-passed)
    mean = load + away * (-math.expm1(-passed) / passed)
    z[0] = load + away * kept
    return u * max(1.0 - p[0] * float(mean), 0.0)


class SupplySag(Effect):
    """Begins at memories from some samples to the whole record."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """A small loss of gain."""
        if at.drive == 0.0:
            return []
        return [{"sag": SMALL / at.drive, "time_constant": float(tau)} for tau in np.geomspace(
            2.0 * at.sample_period, at.duration, 8)]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Over less than a part of a sample there is no memory to tell, over many records none
        that builds up."""
        if parameter != "time_constant":
            return -math.inf, math.inf
        return SHORTEST * at.sample_period, LONGEST * at.duration


SHORTEST, LONGEST = 0.2, 10.0
"""Least and largest memory, in sample periods and in records."""


EFFECT = SupplySag(
    name="supply_sag",
    meaning="the amplifier's gain falls with the recent load",
    equation="s = u max(1 - sag m, 0);  time_constant m' = |u| - m",
    source="Erickson and Maksimovic, Fundamentals of Power Electronics (2001), ch. 2 and 8",
    parameters=(
        Parameter("sag", 0.0, "1/(V or A)", "loss of gain per load", 0.0, 1e6),
        Parameter("time_constant", 0.1, "s", "memory of the supply", 1e-6, 1e6),
    ),
    priors={"sag": Prior(1e-3, 0.3), "time_constant": Prior(1e-3, 10.0)},
    side="actuator",
    parity="odd",
    memory=True,
    shown_by="bursts of large commands with pauses, at several amplitudes",
    classes=(
        Equivalence(("supply_sag", "coil_heating"), "one amplitude, or a memory longer than the "
                    "load changes", "several amplitudes: the gain falls with the load, or with "
                    "its square"),
        Equivalence(("supply_sag", "force_constant"), "a load that never changes",
                    "several amplitudes"),
    ),
    command=command,
    registers=1,
)
