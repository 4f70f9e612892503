"""Periodic (sub-divisional) error of the encoder: interpolation of imperfect sine signals.

    y = x + amplitude sin(2 pi x / period + phase)

`period` is the signal period of the scale for offset errors of its two sine signals, half of it
for errors of their gains and of their quadrature.
Source: Heydemann, Appl. Opt. 20 (1981) 3382; Ellin and Dolsak, Sensor Review 28 (2008) 150.
"""

from __future__ import annotations

import math

from dfm_stage.model.effect import PHASOR, Effect, Equivalence, Parameter, Prior, Values, Wave


def sense(x: float, t: float, other: float, p: Values) -> float:
    """m"""
    return p[0] * math.sin(2.0 * math.pi * x / p[1] + p[2])


EFFECT = Effect(
    name="encoder_periodic_error",
    meaning="the reading errs periodically along the scale",
    equation="y = x + amplitude sin(2 pi x / period + phase)",
    source="Heydemann, Appl. Opt. 20 (1981) 3382",
    parameters=(
        Parameter("amplitude", 0.0, "m", "amplitude of the error", 0.0, 1.0),
        Parameter("period", 2e-5, "m", "length of one period", 1e-12, 1e3),
        Parameter("phase", 0.0, "rad", "phase at x = 0", -100.0, 100.0),
    ),
    priors={"amplitude": Prior(1e-9, 1e-5), "period": Prior(1e-7, 1e-3),
            "phase": Prior(-math.pi, math.pi, log=False)},
    side="sensor",
    parity="none",
    memory=False,
    shown_by="motion across several periods of the scale, slow enough to sample each",
    optional=("phase",),
    classes=(Equivalence(("encoder_periodic_error", "force_constant"),
                         "motion much smaller than the period",
                         "motion across several periods"),),
    fit=PHASOR,
    sense=sense,
    begins={"amplitude": ("noise", (0.1,)), "period": ("periods", (1.0,))},
    wave=Wave("period", "position"),
)
