"""The one experiment that would best part what remains, as the trajectory generator takes it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dfm_stage.diagnosis.experiment import Experiment
from dfm_stage.model import EFFECTS, Model

LOWEST_HZ, PERIOD_S, DURATION_S = 0.5, 8.0, 48.0
SLOW = ("creep", "thermal_drift", "force_offset", "encoder_zero")
FRICTION = ("coulomb_friction", "presliding_friction", "hysteresis")
LAGS = ("amplifier_bandwidth", "transport_delay", "coil_inductance")


def next_experiment(verdict: str, members: Sequence[str], model: Model,
                    runs: Sequence[Experiment]) -> dict[str, Any] | None:
    """Return an experiment for what `verdict` leaves open about `members`; None if nothing.

    It stays inside the voltage of the recorded runs, or what moves the stage by 1 mm where they
    held none.
    """
    if verdict in ("none", "retune") or (verdict == "named" and not members):
        return None
    if model.drive == "current":
        return None
    largest = max(float(np.max(np.abs(r.input - np.mean(r.input)))) for r in runs)
    if largest <= 0.0:
        stiffness = model.base.get("stiffness", 0.0) or model.base["mass"] * 100.0
        largest = 1e-3 * stiffness / abs(model.base.get("force_constant", 1.0) or 1.0)
    volts = float(f"{min(largest, 10.0):.3g}")
    if set(members) & set(FRICTION):
        return _multisine("split_friction", 0.1 * volts, 0.3, 20.0,
                          "Small, slow motion: friction that sticks, that deflects first and a "
                          "loop of the spring differ most before anything slides. " +
                          _hint(members))
    if set(members) & set(LAGS):
        top = 0.4 / model.sample_period
        return _multisine("split_lag", volts, 5.0, top,
                          "Up to the highest frequency: a delay turns the phase on and on, a lag "
                          "stops at 90 degrees and takes amplitude. " + _hint(members))
    if set(members) & set(SLOW):
        return {"name": "split_slow", "mode": "open_loop", "duration_s": 60.0, "seed": 1,
                "description": "Steps held in both directions: creep follows the load, drift the "
                               "clock. " + _hint(members),
                "axes": {"x": {"excitation": {"kind": "steps", "step_v": 0.5 * volts,
                                              "dwell_s": 10.0, "count": 2}}}}
    natural = math.sqrt(max(model.base.get("stiffness", 0.0), 1e-9)
                        / model.base["mass"]) / (2.0 * math.pi)
    top = min(max(10.0 * natural, 50.0), 0.4 / model.sample_period)
    return _multisine("excite_more", volts, LOWEST_HZ, top,
                      "Odd lines with detection lines around and above the resonance: even and "
                      "odd distortion, noise and response in one record. " + _hint(members))


def _multisine(name: str, volts: float, low: float, high: float, why: str) -> dict[str, Any]:
    return {"name": name, "description": why.strip(), "mode": "open_loop",
            "duration_s": DURATION_S, "seed": 1,
            "axes": {"x": {"excitation": {
                "kind": "multisine", "amplitude_v": float(f"{volts:.3g}"), "low_hz": low,
                "high_hz": float(f"{high:.4g}"), "period_s": PERIOD_S, "odd": True,
                "detection_lines": True}}}}


def _hint(members: Sequence[str]) -> str:
    """What the library says would part the members."""
    for name in members:
        if name not in EFFECTS:
            continue
        for c in EFFECTS[name].classes:
            if any(m in c.members for m in members if m != name):
                return f"Parts {' and '.join(c.members)}: {c.split_by}."
    return ""
