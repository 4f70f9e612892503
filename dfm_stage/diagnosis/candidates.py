"""Which effects may be named here, and where the search for each begins."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dfm_stage.diagnosis.decisions import FEWEST_CYCLES, RINGS
from dfm_stage.diagnosis.search_decisions import MOST_TO_ONE
from dfm_stage.diagnosis.spectra import frequency_peaks
from dfm_stage.identification.coordinates import late_parameters, lateness
from dfm_stage.identification.run import Run
from dfm_stage.model import EFFECTS, Model
from dfm_stage.model.conditions import Conditions
from dfm_stage.model.effect import Parameters

FREQUENCY = "frequency"
"""Parameter of what oscillates: a vibration, a mode."""
HARMONICS = (2, 3)
"""Multiples of its frequency at which a free motion shows an error of a force or of a reading that
is even or odd over position: none of these lines is a vibration from outside. The line of the
motion itself is that of the model, because the highest line may be a vibration."""


def excluded(name: str, model: Model, at: Conditions, again: bool = False) -> str | None:
    """Why an effect cannot be a candidate here, or None where it can. With `again` one may be
    named of which the base has a first one: two lags in series are no lag of another size."""
    effect = EFFECTS[name]
    if model.effect(name) is not None:
        return "the model has it already: its parameters are re-estimated"
    if effect.wrong_number_of and model.base.get(effect.wrong_number_of, 0.0) > 0.0 \
            and not (again and effect.retuned_by):
        return f"base has {effect.wrong_number_of}: a wrong value of it is retuned"
    if any(run.order for run in at.runs) and (effect.sense or effect.encode):
        return "it changes the reading of a position, and the output is none"
    if effect.per_run and any(run.window for run in at.runs):
        return "its phase is lost where the state starts anew in every window"
    if effect.registers and any(run.window for run in at.runs):
        return "what it remembers is lost where the state starts anew in every window"
    return effect.hidden_because(at)


def starts(name: str, at: Conditions) -> list[Parameters]:
    """Starting points of one effect; empty where the data give it no size."""
    limits = {p.name: p for p in EFFECTS[name].parameters}
    return [found for found in EFFECTS[name].starts(at)
            if all(math.isfinite(v) and limits[n].low <= v <= limits[n].high
                   for n, v in found.items())]


def shown_by_none(name: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Parameters of an effect that no run shows: where nothing drives the stage, those that only
    an input shows."""
    return () if any(run.driven for run in runs) else EFFECTS[name].by_input


def cycles(name: str, model: Model, runs: Sequence[Run]) -> float:
    """Cycles that a sine makes in the longest run, or over the widest motion of one, which is the
    reading without what the sine itself adds; infinite for other effects. Where nothing drives the
    stage, those that tell a second mode from the stage's own motion, or a vibration from that and
    its HARMONICS: the beats between them. A vibration also where the stage mostly rings by itself,
    as after a pulse."""
    wave = EFFECTS[name].wave
    free = FREQUENCY in EFFECTS[name].defaults and not any(
        r.driven if wave is None else _is_driven_on(r) for r in runs)
    if wave is None and not free:
        return math.inf
    known = model.parameters()
    value = known[f"{name}.{FREQUENCY if wave is None else wave.parameter}"]
    if wave is not None and wave.over == "position":
        amplitude = 0.0 if EFFECTS[name].sense is None else sum(
            known[f"{name}.{size}"] for size in EFFECTS[name].sizes)
        widest = max(float(np.ptp(r.output)) for r in runs) - 2.0 * amplitude
        return max(widest, 0.0) / max(value, 1e-300)
    alike = [0.0]
    if free:
        own = math.sqrt(model.base.get("stiffness", 0.0) / model.base["mass"]) / (2.0 * math.pi)
        alike = [own, *(_harmonics(runs) if wave is not None else [])]
    return min(abs(value - each) for each in alike) * max(
        r.input.size * r.sample_period for r in runs)


def _is_driven_on(run: Run) -> bool:
    """Whether an input goes on to drive: it is not constant for more than RINGS of the run."""
    changes = np.flatnonzero(np.diff(run.input))
    stretches = np.diff(np.concatenate(([-1], changes, [run.input.size - 1])))
    return int(stretches.max()) <= RINGS * run.input.size


def _harmonics(runs: Sequence[Run]) -> list[float]:
    """Frequencies (Hz) of the HARMONICS of each run's motion. A large swing is not as fast as the
    model's small ones."""
    return [n * peak for n in HARMONICS for r in runs for peak in frequency_peaks(
        [r.output], r.sample_period, 1, FEWEST_CYCLES / (r.input.size * r.sample_period))]


def late_splits(model: Model, free: tuple[str, ...]) -> list[Parameters]:
    """Other ways to share the whole lateness out: nearly all of it to one free parameter.

    Lag, delay and inductance act alike to first order, and a search may end in a local minimum
    where one stands in for another. Empty where fewer than two are free.
    """
    per_second = {"coil": model.base.get("coil_resistance", 0.0)}
    unit = {n: per_second.get(kind, 1.0) for n, kind in late_parameters(model, free).items()}
    if len(unit) < 2 or min(unit.values()) <= 0.0:
        return []
    whole = lateness(model, free)
    if whole <= 0.0:
        return []
    rest = (1.0 - MOST_TO_ONE) / (len(unit) - 1)
    limits = {n: model.parameter(n) for n in unit}
    return [{n: limits[n].inside((MOST_TO_ONE if n == most else rest) * whole * u)
             for n, u in unit.items()} for most in unit]
