"""Structural (hysteretic) damping: the loss per cycle does not depend on the frequency.

    F = -sum over i of weight loss_stiffness (x - z_i),    z_i' = 2 pi f_i (x - z_i)

A complex stiffness k + i loss_stiffness is not causal; a sum of relaxations, with corner
frequencies f_i from 0.02 to 1563 Hz by factors of five, has its loss and stays causal. The weight
2 ln(5)/pi makes the loss that of `loss_stiffness`, to 2 % from 0.4 to 100 Hz. The base stiffness
is the one that is left after a long time.
Source: Biot, 3rd US Nat. Congr. Appl. Mech. (1958) 1; Nashif, Jones and Henderson, Vibration
Damping (1985), ch. 2.
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import (
    Array,
    Effect,
    Equivalence,
    Parameter,
    Prior,
    Values,
)

RATIO = 5.0
"""Of neighbouring corner frequencies; the loss then ripples by 1 %."""
CORNERS = tuple(0.02 * RATIO**i for i in range(8))
"""Hz"""
WEIGHT = 2.0 * math.log(RATIO) / math.pi
"""The sum of w/(1 + w^2) over frequencies w by factors of RATIO is pi / (2 ln RATIO)."""


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 0 is the position, row 3 the force input."""
    n, k = a.shape[0], WEIGHT * p[0]
    for element in range(len(CORNERS)):
        z, rate = first + element, 2.0 * math.pi * CORNERS[element]
        for j in range(n):
            a[z, j] = rate * rows[0, j]
        a[z, z] -= rate
        for i in range(n):
            for j in range(n):
                a[i, j] -= rows[3, i] * k * rows[0, j]
            a[i, z] += rows[3, i] * k


EFFECT = Effect(
    name="structural_damping",
    meaning="the material loses the same in each cycle, slow or fast",
    equation="F = -sum of (2 ln(5)/pi) loss_stiffness (x - z_i);  z_i' = 2 pi f_i (x - z_i);  "
    "f_i = 0.02 Hz 5^i, i = 0 ... 7",
    source="Biot, 3rd US Nat. Congr. Appl. Mech. (1958) 1; Nashif et al., Vibration Damping "
    "(1985), ch. 2",
    parameters=(Parameter("loss_stiffness", 0.0, "N/m", "stiffness times loss factor", 0.0,
                          1e12),),
    priors={"loss_stiffness": Prior(0.1, 1e2)},
    side="mechanical",
    parity="linear",
    memory=True,
    shown_by="frequencies from far below the resonance to above it",
    classes=(
        Equivalence(("structural_damping", "damping"), "a narrow band, such as that of a "
                    "resonance", "frequencies over decades"),
        Equivalence(("structural_damping", "creep"), "a band of less than a decade",
                    "frequencies over decades"),
    ),
    states=tuple(f".strain_{i}" for i in range(len(CORNERS))),
    stamp=stamp,
)
