"""The one experiment that would best part what remains, as the trajectory generator takes it.

Where rivals are left, experiments are ranked by how far the best model's response lies from what a
rival can do on them with its parameters re-estimated, in chi-square (T-optimality; Atkinson and
Fedorov, Biometrika 62, 1975). Nothing asks for more voltage or travel than was recorded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    DURATION_S,
    DWELL_S,
    FINALISTS,
    LONGEST_S,
    MARGIN,
    PERIOD_S,
    PERIOD_SAMPLES,
    SAFE,
    TRAVEL,
    TRIED_S,
)
from dfm_stage.diagnosis.evidence import Proposal
from dfm_stage.diagnosis.fit import Fit, fit, system_of
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.weights import Weight, Weights
from dfm_stage.model import EFFECTS, Model


def propose(parts: Sequence[str], best: Model, rivals: Sequence[Fit],
            runs: Sequence[Observation], weight: Weight, free: Sequence[Sequence[str]],
            noise: float = 0.0) -> Proposal | None:
    """Return an experiment for what stays open; None where the drive is a current.

    `parts` are the names that are not told apart, `rivals` the fits that compete with `best`,
    each with its `free` parameters; `weight` is the noise. It stays inside the voltage of the
    recorded runs, or what moves the stage by 1 mm where they held none.
    """
    if best.drive == "current":
        return None
    specs = list(experiments(best, _volts(best, runs)))
    if rivals and not any(n in EFFECTS and EFFECTS[n].couples for n in parts):
        travel = max(float(np.ptp(r.output)) for r in runs)
        ranked = _ranked(specs, best, rivals, free, travel, weight, noise, runs[0])
        if ranked:
            gain, spec = ranked[0]
            duration = _duration(gain, best)
            return Proposal({**spec, "duration_s": duration}, tuple(parts),
                            gain * duration / spec["duration_s"])
    return Proposal(specs[0], tuple(parts))


def _duration(gain: float, model: Model) -> float:
    """Whole periods (s) in which a `gain` in chi-square in the usual time reaches the margin."""
    period, usual, longest = (t * _slower(model) for t in (PERIOD_S, DURATION_S, LONGEST_S))
    wanted = SAFE * MARGIN * usual / max(gain, 1e-9)
    return period * math.ceil(min(max(wanted, 0.5 * usual), longest) / period)


def _slower(model: Model) -> float:
    """By how much an experiment takes longer than usual, so that a period has samples enough."""
    return max(1.0, PERIOD_SAMPLES * model.sample_period / PERIOD_S)


def _volts(model: Model, runs: Sequence[Observation]) -> float:
    largest = max(float(np.max(np.abs(r.input - np.mean(r.input)))) for r in runs)
    if largest <= 0.0:
        stiffness = model.base.get("stiffness", 0.0) or model.base["mass"] * 100.0
        largest = 1e-3 * stiffness / abs(model.base.get("force_constant", 1.0) or 1.0)
    return _round(min(largest, 10.0))


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def experiments(model: Model, volts: float) -> Iterator[dict[str, Any]]:
    """Experiments to choose from; the first is the one that shows most where nothing is known."""
    slower = _slower(model)
    duration = slower * DURATION_S
    period, dwell = (round(slower * t / model.sample_period) * model.sample_period
                     for t in (PERIOD_S, DWELL_S))  # whole samples
    highest = 0.4 / model.sample_period
    lowest = min(0.5, 0.1 * highest)
    natural = min(max(_natural_hz(model), lowest), 0.5 * highest)   # as fast as a record shows
    top = min(max(10.0 * natural, 50.0), highest)
    bands = (("around the resonance", lowest, top),
             ("slow", 0.5 * lowest, max(1.5 * natural, 4.0 * lowest)),
             ("up to the highest frequency", natural, highest))
    for where, low, high in bands:
        for share in (1.0, 0.3, 0.1):
            size = {1.0: "as large as recorded", 0.3: "a third as large", 0.1: "a tenth as large"}
            yield _as_experiment(
                f"A multisine with odd lines and detection lines, {where}, {size[share]}.",
                {"kind": "multisine", "amplitude_v": _round(share * volts), "low_hz": _round(low),
                 "high_hz": _round(high), "period_s": period, "odd": True,
                 "detection_lines": True}, duration)
    for share in (1.0, 0.3):
        yield _as_experiment(
            "Steps up and down again, each held.",
            {"kind": "steps", "start_v": 0.0, "step_v": _round(0.5 * share * volts), "count": 2,
             "down_again": True, "dwell_s": dwell}, duration)
        yield _as_experiment(
            "A sine below the resonance.",
            {"kind": "sine", "amplitude_v": _round(share * volts),
             "frequency_hz": _round(0.3 * natural)}, duration)


def _natural_hz(model: Model) -> float:
    return math.sqrt(max(model.base.get("stiffness", 0.0), 0.0) / model.base["mass"]) / math.tau


def _as_experiment(why: str, excitation: dict[str, Any], duration: float) -> dict[str, Any]:
    return {"name": "next_experiment", "description": why, "mode": "open_loop",
            "duration_s": duration, "seed": 1, "axes": {"x": {"excitation": excitation}}}


def _ranked(specs: Sequence[dict[str, Any]], best: Model, rivals: Sequence[Fit],
            free: Sequence[Sequence[str]], travel: float, weight: Weight, noise: float,
            like: Observation) -> list[tuple[float, dict[str, Any]]]:
    """Experiments with the chi-square that they bring in their time between `best` and the rival
    that is hardest to tell from it, best first."""
    weights: Weights = ((weight,),)
    trials = []
    for spec in specs:
        run = _tried(spec, best, like)
        moved = _response(best, run, noise)
        if moved is None or np.ptp(moved) > TRAVEL * travel:
            continue
        apart = [_response(rival.model, run, noise) for rival in rivals]
        if any(a is None for a in apart):
            continue
        raw = min(float(np.sum(weight.apply(moved - a) ** 2)) for a in apart if a is not None)
        trials.append((raw, spec, run, moved))
    trials.sort(key=lambda t: -t[0])
    found = []
    for _, spec, run, moved in trials[:FINALISTS]:
        seen = Observation(run.name, run.input, np.concatenate((np.zeros(run.skip), moved)),
                           run.sample_period, unit=run.unit, measures=run.measures)
        gain = min(_apart(rival.model, names, seen, weights, noise)
                   for rival, names in zip(rivals, free, strict=True))
        found.append((gain * DURATION_S / TRIED_S, spec))
    return sorted(found, key=lambda f: -f[0])


def _tried(spec: dict[str, Any], model: Model, like: Observation) -> Observation:
    from dfm_stage.trajectory import load_experiment

    asked = load_experiment({**spec, "duration_s": TRIED_S * _slower(model)})
    voltage = asked.excitation("x", model.sample_period).voltage
    return Observation("next", voltage, np.zeros(voltage.size), model.sample_period,
                       unit=like.unit, measures=like.measures)


def _response(model: Model, run: Observation, noise: float) -> Array | None:
    """What the model answers (N - skip,), from rest; None where it cannot be simulated."""
    system = system_of(model, [run], (), noise)
    found = system.signals(0, system.start[None, :])[0][0]
    return found if np.all(np.isfinite(found)) else None


def _apart(rival: Model, free: Sequence[str], run: Observation, weights: Weights,
           noise: float) -> float:
    """Chi-square between `run` and the nearest that the rival comes to it: by one linear step,
    or where the effect is quick to simulate by a fit."""
    system = system_of(rival, [run], free, noise)
    if not system.slow:
        return fit(rival, [run], free, weights, noise=noise, iterations=8).chi2
    light = system.barely_nonlinear(system.start)
    criterion = Criterion(system, weights, slopes=lambda i, z, exact: system.sensitivities(
        i, z, exact, light))
    white, jacobian = criterion.residual(system.start), criterion.jacobian(system.start)
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian[:, norms > 0.0] / norms[norms > 0.0]
    step = np.linalg.lstsq(scaled, white, rcond=1e-7)[0]
    return float(np.sum((white - scaled @ step) ** 2))
