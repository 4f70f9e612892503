"""Judging models on records they were not fitted to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    NOT_EXERCISED,
    NOT_EXERCISED_SHARE,
    OUTSTANDING,
    PER_RUN_GAIN,
    SELF_SIMILAR,
    SURROGATES,
)
from dfm_stage.diagnosis.fit import Fit, fit, rms, system_of
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.weights import Weight, Weights
from dfm_stage.model import EFFECTS, Model


@dataclass(frozen=True)
class Prediction:
    """What a model leaves of held-out runs: RMS of the output, and chi-square."""

    rms: float
    chi2: float
    count: int
    residuals: list[list[Array]]


def predict(model: Model, runs: Sequence[Observation], weights: Weights,
            noise: float = 0.0) -> Prediction:
    """Simulate `model` on runs it has not seen; only initial states and offsets are free.

    Chi-square is the least under `weights`, the residuals are the least in themselves.
    """
    found = fit(model, runs, (), weights, noise=noise, iterations=15)
    if not found.ok:
        return Prediction(math.inf, math.inf, 0, [])
    nearest = nearest_to(model, runs, weights, noise, found)
    return Prediction(rms([parts[0] for parts in nearest.residuals]), found.chi2,
                      found.white.size, nearest.residuals)


def nearest_to(model: Model, runs: Sequence[Observation], weights: Weights, noise: float,
               found: Fit | None = None) -> Fit:
    """The fit of initial states and offsets that comes nearest to the records. `found` is one
    under `weights`.

    An autoregression of a gap hardly sees slow motion: under it the states of a body whose model
    lacks friction were such that it drifted away by many times the motion. Where they were not,
    a search that ends farther off ended in another minimum.
    """
    colourless = tuple(tuple(w.colourless() for w in ws) for ws in weights)
    springless = system_of(model, runs, (), noise).springless
    if found is not None and all(w.order <= springless for ws in weights for w in ws):
        return found
    if springless:
        colourless = tuple((ws[0].of_change(), *ws[1:]) for ws in colourless)
    nearest = fit(model, runs, (), colourless, noise=noise, iterations=15)
    if found is not None and not nearest.rms <= found.rms:
        nearest = min(nearest, fit(model, runs, (), colourless, noise=noise, iterations=15,
                                   earlier=found.locals), key=lambda f: f.chi2)
    return nearest if nearest.ok or found is None else found


def weights_like(runs: Sequence[Observation], known: Weights) -> Weights:
    """Weights of other runs with the same sensors: those of the first fitted run."""
    first = known[0]
    beside = 1 if runs and runs[0].velocity is not None else 0
    spare = next((ws[1] for ws in known if len(ws) > 1 + beside), None)
    velocity = first[-1:] if beside else ()
    return tuple((first[0], *velocity) if run.current is None else
                 (first[0], spare or Weight(np.ones(1), float(np.std(run.current)), "spread"),
                  *velocity) for run in runs)


LINES_APART = 2
"""Lines of a record by which a sine stands clear of its neighbour. Where the reading wanders,
lines farther away have less power by themselves."""
LINES_BESIDE = (-2, -1, 1, 2)
"""Lines of the input, counted from a vibration's own, at which its surrogates stand."""


@dataclass(frozen=True)
class SurrogateTest:
    """Chi-square on held-out runs: of the effect's contribution, with it (`original`), without it,
    and of the best of its surrogates, from which it must stand out by the factor `outstanding`.
    Where it has no surrogate, `best` is infinite and it must lower chi-square by itself."""

    contribution: float
    original: float
    without: float
    best: float
    outstanding: float = 1.0

    def passed(self, per_run: bool, fall: float = 0.0) -> bool | None:
        """Whether the effect does better than its surrogates; None where it does nothing here, or
        no better, no harm, and next to nothing beside what it explains of the fitted runs (`fall`
        in chi-square)."""
        if not per_run and self.contribution < NOT_EXERCISED:
            return None
        if per_run or math.isinf(self.best):
            gain = self.without - self.original
            better = gain > max(PER_RUN_GAIN, self.outstanding * (self.without - self.best))
        else:
            better = self.original < min(self.best, self.without)
        little = not per_run and self.contribution < NOT_EXERCISED_SHARE * fall \
            and self.original < self.without + NOT_EXERCISED
        return None if little and not better else better


def surrogate_test(model: Model, name: str, runs: Sequence[Observation], weights: Weights,
                   noise: float, seed: int) -> SurrogateTest:
    """Compare an effect with surrogates: its contribution to held-out runs, shifted in time.

    Each has the contribution's size and spectrum and, moved by a quarter to three quarters of the
    records, nothing to do with their motion (Theiler et al., Physica D 58, 1992). Of a vibration,
    whose phase is free in each record, the surrogates are vibrations of neighbouring frequencies.
    A constant has none: shifted, it is itself.
    """
    rng = np.random.default_rng(seed)
    found = fit(model, runs, (), weights, noise=noise, iterations=10)
    bare = fit(model.without_effect(name), runs, (), weights, noise=noise, iterations=10)
    if not (found.ok and bare.ok):
        return SurrogateTest(math.inf, found.chi2, bare.chi2, math.inf)
    if EFFECTS[name].frequency:
        address = f"{name}.{EFFECTS[name].frequency}"
        return SurrogateTest(math.inf, found.chi2, bare.chi2, min(
            fit(model.with_parameters({address: f}), runs, (), weights, noise=noise,
                iterations=10).chi2 for f in _neighbours(model.parameters()[address], runs)),
            outstanding=OUTSTANDING)
    contribution = bare.white - found.white
    quarter = contribution.size // 4
    power = float(contribution @ contribution)
    shifted = [np.roll(contribution, int(k))
               for k in rng.integers(quarter, 3 * quarter, SURROGATES)]
    others = [s for s in shifted if s @ contribution < SELF_SIMILAR * power]
    return SurrogateTest(power, found.chi2, bare.chi2, min(
        (float(np.sum((bare.white - s) ** 2)) for s in others), default=math.inf))


def _neighbours(own: float, runs: Sequence[Observation]) -> list[float]:
    """Frequencies (Hz) beside that of a vibration, one and two lines of the input away; where that
    does not repeat, LINES_APART and twice as many lines of the record."""
    run = runs[0]
    repeats = run.periodicity
    samples = run.input.size // LINES_APART if repeats is None else repeats.period
    apart = 1.0 / (samples * run.sample_period)
    return [own + k * apart for k in LINES_BESIDE if own + k * apart > 0.0] or [own + apart]


def joint(model: Model, free: Sequence[str], runs: Sequence[Observation],
          held: Sequence[Observation], weights: Weights, held_weights: Weights,
          earlier: Fit, noise: float) -> tuple[float, float]:
    """RMS over fitted and over held-out runs when one set of parameters must serve both."""
    found = fit(model, [*runs, *held], free, (*weights, *held_weights),
                earlier=earlier.locals, noise=noise, iterations=12)
    if not found.ok:
        return math.inf, math.inf
    parts = [p[0] for p in found.residuals]
    return rms(parts[:len(runs)]), rms(parts[len(runs):])
