"""Fits of hypotheses: a model on runs, with the weights held."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.fit import Fit, rms, search
from dfm_stage.identification.system import System
from dfm_stage.identification.weights import Weights
from dfm_stage.model import Model

__all__ = ["Fit", "fit", "rms", "system_of", "weighted_output"]

STATES = ("position", "velocity")
"""Initial states that are estimated: what other modes held dies out in the lead-in."""


def system_of(model: Model, runs: Sequence[Observation], free: Sequence[str],
              noise: float = 0.0) -> System:
    """A model on runs as the diagnosis fits it: a body without a spring feels an unknown constant
    force in each run, and where nothing drives the stage, whatever moves was set going before."""
    driven = all(run.driven for run in runs)
    own = [state for use in model.effects for state in use.effect.state_names
           if use.effect.stage == "sensor"
           or (not driven and state.rpartition(".")[2] in STATES)]
    return System(model, runs, free, noise=noise, states=(*STATES, *own), pushed=True)


def fit(model: Model, runs: Sequence[Observation], free: Sequence[str], weights: Weights, *,
        earlier: Mapping[tuple[str, int], float] | None = None, noise: float = 0.0,
        iterations: int = 25, tolerance: float = 1e-2, exact: bool = False,
        allowance: float = math.inf) -> Fit:
    """Estimate the parameters `free` and what belongs to single runs; see
    `dfm_stage.identification.fit.search`.

    `earlier` are values of single runs to begin from, `noise` is the RMS of the output's (m).
    """
    system = system_of(model, runs, free, noise)
    return search(system, weights, system.started(dict(earlier or {})), iterations=iterations,
                  tolerance=tolerance, exact=exact, allowance=allowance)


def weighted_output(model: Model, found: Fit, runs: Sequence[Observation], weights: Weights,
                    noise: float) -> Array | None:
    """The weighted output (N,) of a model at the values that a fit found for single runs, all runs
    in a row; None where the motion escapes."""
    system = system_of(model, runs, (), noise)
    x = system.started(found.locals)
    rows = [w.apply(signal[0]) for i, ws in enumerate(weights)
            for signal, w in zip(system.signals(i, x[None, :]), ws, strict=True)]
    return np.concatenate(rows) if all(np.all(np.isfinite(row)) for row in rows) else None
