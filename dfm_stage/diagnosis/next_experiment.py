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
from numpy.typing import NDArray

from dfm_stage.diagnosis.experiment import LEAD_IN, Experiment
from dfm_stage.diagnosis.fit import Fit, fit, system_of
from dfm_stage.identification.criterion import Criterion
from dfm_stage.identification.weights import Weight, Weights
from dfm_stage.model import EFFECTS, Model
from dfm_stage.trajectory import load_experiment

Array = NDArray[np.float64]

PERIOD_S, DURATION_S, LONGEST_S = 8.0, 48.0, 240.0
TRIED_S = 16.0
"""Length of the records that experiments are compared on."""
FINALISTS = 3
"""Experiments for which a rival's parameters are re-estimated."""
TRAVEL = 1.1
"""Travel that an experiment may take over the recorded one."""
SAFE = 4.0
"""Expected chi-square over the margin that the length of an experiment aims at."""


def next_experiment(verdict: str, members: Sequence[str], best: Model, rivals: Sequence[Fit],
                    runs: Sequence[Experiment], weight: Weight, free: Sequence[Sequence[str]],
                    margin: float, dither: float = 0.0) -> dict[str, Any] | None:
    """Return an experiment for what `verdict` leaves open; None if nothing.

    `members` are the names that are not told apart, `rivals` the fits that compete with `best`,
    each with its `free` parameters; `weight` is the noise, `margin` the chi-square that parts
    rivals. It stays inside the voltage of the recorded runs, or what moves the stage by 1 mm
    where they held none.
    """
    if verdict in ("none", "retune", "named") or best.drive == "current":
        return None
    volts = _volts(best, runs)
    specs = list(_experiments(best, volts))
    if "cross_axis_coupling" not in members and rivals:
        travel = max(float(np.ptp(r.output)) for r in runs)
        ranked = _ranked(specs, best, rivals, free, travel, weight, dither, runs[0].unit)
        if ranked:
            gain, spec = ranked[0]
            return _worded(spec, gain, members, margin)
    return {**specs[0], "description": " ".join(filter(None, (
        specs[0]["description"], _hint(members)))).strip()}


def _volts(model: Model, runs: Sequence[Experiment]) -> float:
    largest = max(float(np.max(np.abs(r.input - np.mean(r.input)))) for r in runs)
    if largest <= 0.0:
        stiffness = model.base.get("stiffness", 0.0) or model.base["mass"] * 100.0
        largest = 1e-3 * stiffness / abs(model.base.get("force_constant", 1.0) or 1.0)
    return _round(min(largest, 10.0))


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def _experiments(model: Model, volts: float) -> Iterator[dict[str, Any]]:
    """Experiments to choose from; the first is the one that shows most where nothing is known."""
    natural = max(_natural_hz(model), 0.5)
    nyquist = 0.5 / model.sample_period
    top = min(max(10.0 * natural, 50.0), 0.8 * nyquist)
    bands = (("around the resonance", 0.5, top), ("slow", 0.25, max(1.5 * natural, 2.0)),
             ("up to the highest frequency", natural, 0.8 * nyquist))
    for where, low, high in bands:
        for share in (1.0, 0.3, 0.1):
            size = {1.0: "as large as recorded", 0.3: "a third as large", 0.1: "a tenth as large"}
            yield _as_experiment(
                f"A multisine with odd lines and detection lines, {where}, {size[share]}.",
                {"kind": "multisine", "amplitude_v": _round(share * volts), "low_hz": _round(low),
                 "high_hz": _round(high), "period_s": PERIOD_S, "odd": True,
                 "detection_lines": True})
    for share in (1.0, 0.3):
        yield _as_experiment(
            "Steps up and down again, each held.",
            {"kind": "steps", "start_v": 0.0, "step_v": _round(0.5 * share * volts), "count": 2,
             "down_again": True, "dwell_s": 4.0})
        yield _as_experiment(
            "A sine below the resonance.",
            {"kind": "sine", "amplitude_v": _round(share * volts),
             "frequency_hz": _round(0.3 * natural)})


def _natural_hz(model: Model) -> float:
    return math.sqrt(max(model.base.get("stiffness", 0.0), 0.0) / model.base["mass"]) / math.tau


def _as_experiment(why: str, excitation: dict[str, Any]) -> dict[str, Any]:
    return {"name": "next_experiment", "description": why, "mode": "open_loop",
            "duration_s": DURATION_S, "seed": 1, "axes": {"x": {"excitation": excitation}}}


def _ranked(specs: Sequence[dict[str, Any]], best: Model, rivals: Sequence[Fit],
            free: Sequence[Sequence[str]], travel: float, weight: Weight, dither: float,
            unit: str) -> list[tuple[float, dict[str, Any]]]:
    """Experiments with the chi-square that they bring in `DURATION_S` between `best` and the
    rival that is hardest to tell from it, best first."""
    weights: Weights = ((weight,),)
    trials = []
    for spec in specs:
        run = _tried(spec, best, unit)
        moved = _response(best, run, dither)
        if moved is None or np.ptp(moved) > TRAVEL * travel:
            continue
        apart = [_response(rival.model, run, dither) for rival in rivals]
        if any(a is None for a in apart):
            continue
        raw = min(float(np.sum(weight.apply(moved - a) ** 2)) for a in apart if a is not None)
        trials.append((raw, spec, run, moved))
    trials.sort(key=lambda t: -t[0])
    found = []
    for _, spec, run, moved in trials[:FINALISTS]:
        seen = Experiment(run.name, run.input, np.concatenate((np.zeros(run.skip), moved)),
                          run.sample_period, unit)
        gain = min(_apart(rival.model, names, seen, weights, dither)
                   for rival, names in zip(rivals, free, strict=True))
        found.append((gain * DURATION_S / TRIED_S, spec))
    return sorted(found, key=lambda f: -f[0])


def _tried(spec: dict[str, Any], model: Model, unit: str) -> Experiment:
    asked = load_experiment({**spec, "duration_s": TRIED_S})
    voltage = asked.excitation("x", model.sample_period).voltage
    return Experiment("next", voltage, np.zeros(voltage.size), model.sample_period, unit,
                      skip=LEAD_IN)


def _response(model: Model, run: Experiment, dither: float) -> Array | None:
    """What the model answers (N - skip,), from rest; None where it cannot be simulated."""
    system = system_of(model, [run], (), dither)
    found = system.signals(0, system.start[None, :])[0][0]
    return found if np.all(np.isfinite(found)) else None


def _apart(rival: Model, free: Sequence[str], run: Experiment, weights: Weights,
           dither: float) -> float:
    """Chi-square between `run` and the nearest that the rival comes to it: by one linear step,
    or where the effect is quick to simulate by a fit."""
    system = system_of(rival, [run], free, dither)
    if not system.slow:
        return fit(rival, [run], free, weights, noise=dither, iterations=8).chi2
    x, light = system.start, system.barely_nonlinear(system.start)
    criterion = Criterion(system, weights, slopes=lambda i, z, exact: system.sensitivities(
        i, z, exact, light))
    white, jacobian = criterion.residual(x), criterion.jacobian(x)
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian[:, norms > 0.0] / norms[norms > 0.0]
    step = np.linalg.lstsq(scaled, white, rcond=1e-7)[0]
    return float(np.sum((white - scaled @ step) ** 2))


def _worded(spec: dict[str, Any], gain: float, members: Sequence[str],
            margin: float) -> dict[str, Any]:
    """The experiment as long as it has to be, with what is expected of it."""
    wanted = SAFE * margin * DURATION_S / max(gain, 1e-9)
    duration = PERIOD_S * math.ceil(min(max(wanted, 0.5 * DURATION_S), LONGEST_S) / PERIOD_S)
    expected = gain * duration / DURATION_S
    names = " and ".join(m.replace("_", " ") for m in members)
    said = (f"In {duration:g} s it is expected to part {names} by {expected:.0f} in chi-square "
            f"(needed: {margin:g}).")
    if expected < margin:
        said = (f"No experiment within the recorded voltage and travel is expected to part "
                f"{names}; this one comes nearest, with {expected:.1f} in chi-square "
                f"(needed: {margin:g}) in {duration:g} s.")
    words = " ".join(filter(None, (spec["description"], said, _hint(members))))
    return {**spec, "description": words, "duration_s": duration}


def _hint(members: Sequence[str]) -> str:
    """What the library says would part the members."""
    for name in members:
        if name not in EFFECTS:
            continue
        for c in EFFECTS[name].classes:
            if any(m in c.members for m in members if m != name):
                return f"In general: {c.split_by}."
    return ""
