"""Periodic disturbance: a sinusoidal force, such as ground vibration, a fan or the mains.

    F = amplitude sin(2 pi frequency t + phase)

t counts from the first sample. Carried as two states of the linear part, so it is exact.
Source: Francis and Wonham, Automatica 12 (1976) 457 for the exosystem.
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import PHASOR, SMALL, Array, Effect, Parameter, Prior, Values, Wave


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 3 is the force input."""
    w = 2.0 * math.pi * p[1]
    a[first, first + 1] = w
    a[first + 1, first] = -w
    for i in range(a.shape[0]):
        a[i, first] += rows[3, i]


def start(state: Array, first: int, p: Values) -> None:
    """Force and its quadrature at t = 0, N."""
    state[first] = p[0] * math.sin(p[2])
    state[first + 1] = p[0] * math.cos(p[2])


EFFECT = Effect(
    name="periodic_disturbance",
    meaning="a vibration from outside shakes the stage",
    equation="F = amplitude sin(2 pi frequency t + phase)",
    source="Francis and Wonham, Automatica 12 (1976) 457",
    parameters=(
        Parameter("amplitude", 0.0, "N", "amplitude of the force", 0.0, 1e6),
        Parameter("frequency", 10.0, "Hz", "frequency", 1e-6, 1e6),
        Parameter("phase", 0.0, "rad", "phase at t = 0", -100.0, 100.0),
    ),
    priors={"amplitude": Prior(1e-5, 1.0), "frequency": Prior(0.5, 450.0),
            "phase": Prior(-math.pi, math.pi, log=False)},
    side="mechanical",
    parity="none",
    memory=False,
    shown_by="any record, at rest too, at a frequency that is not excited",
    optional=("phase",),
    fit=PHASOR,
    states=(".force", ".quadrature"),
    stamp=stamp,
    start=start,
    begins={"amplitude": ("force", (SMALL,)), "frequency": ("frequencies", (1.0,))},
    wave=Wave("frequency", "time"),
    per_run=(".in_phase", ".quadrature"),
)
