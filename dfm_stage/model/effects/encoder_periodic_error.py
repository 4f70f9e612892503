"""Periodic (sub-divisional) error of the encoder: interpolation of imperfect sine signals.

    y = x + amplitude sin(2 pi x / period + phase)

`period` is the signal period of the scale for offset errors of its two sine signals, half of it
for errors of their gains and of their quadrature.
Source: Heydemann, Appl. Opt. 20 (1981) 3382; Ellin and Dolsak, Sensor Review 28 (2008) 150.
"""

# ruff: noqa: ARG001 (a hook has its signature whether or not it uses all of it)
from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dfm_stage.model.effect import Effect, Equivalence, Prior, Reparametrisation, Values
from dfm_stage.model.parameter import Parameter

Array = NDArray[np.float64]


def sense(x: float, t: float, other: float, p: Values) -> float:
    """m"""
    return p[0] * math.sin(2.0 * math.pi * x / p[1] + p[2])


def _forward(values: Array) -> Array:
    amplitude, phase = values
    return np.array([amplitude * np.cos(phase), amplitude * np.sin(phase)])


def _backward(fitted: Array) -> Array:
    in_phase, quadrature = fitted
    return np.array([np.hypot(in_phase, quadrature), np.arctan2(quadrature, in_phase)])


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
    fit=Reparametrisation(
        (".amplitude", ".phase"),
        (".in_phase", ".quadrature"),
        _forward, _backward),
    sense=sense,
)
