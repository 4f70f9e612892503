"""Effects of the library written as formulas: how much longer a simulation takes, and the first.

Each stands with other names and its terms in another order. Both are simulated in turns in the
same run, and the ratio is that of their shortest times. `first use` is a formula that no cache has
seen: parsing, measuring, compiling and one simulation, with the simulator itself compiled before.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from benchmarks.figure import Figure
from dfm_stage.model import EffectUse, Model, Simulator
from dfm_stage.model.formula import formula_of

PERIOD_S = 1e-3
STAGE = {"mass": 1.0, "damping": 2.0, "stiffness": 600.0, "force_constant": 1.3, "delay": 4e-4,
         "amplifier_time_constant": 5e-4}
ALLOWED_RATIO, ALLOWED_FIRST_S = 1.3, 5.0
FIRST_USES = (
    "-k * max(x - {0}, 0)", "-k * x * exp(-(v / {0})**2) * cos(x / 1e-3)",
    "-k * z * (1 + {0} * x**2)")


def entry(name: str = "mine", *, state: dict[str, str] | None = None, kind: str = "force",
          text: str, **values: float) -> dict[str, Any]:
    """The entry of a formula, its parameters without units and ranges."""
    return {"name": name, kind: text, "parameters": {n: {"value": v} for n, v in values.items()},
            **({"state": state} if state else {})}


AS_FORMULAS: dict[str, tuple[dict[str, float], dict[str, Any], dict[str, str]]] = {
    "cubic_stiffness": ({"k3": 3e6}, entry(text="x * -q * x**2", q=3e6), {"q": "k3"}),
    "quadratic_stiffness": ({"k2": 2e4}, entry(text="-(x * x) * q", q=2e4), {"q": "k2"}),
    "quadratic_damping": ({"coefficient": 40.0}, entry(text="v * -abs(v) * q", q=40.0),
                          {"q": "coefficient"}),
    "coulomb_friction": ({"force": 0.2}, entry(text="-sign(v) * q", q=0.2), {"q": "force"}),
    "force_offset": ({"force": 0.3}, entry(text="q", q=0.3), {"q": "force"}),
    "eddy_current_damping": (
        {"damping": 4.0, "critical_velocity": 0.05},
        entry(text="-v * c / ((v / w)**2 + 1)", w=0.05, c=4.0),
        {"c": "damping", "w": "critical_velocity"}),
    "creep": ({"stiffness": 80.0, "time_constant": 0.12},
              entry(text="(y - x) * q", state={"y": "x / w - y / w"}, w=0.12, q=80.0),
              {"q": "stiffness", "w": "time_constant"}),
    "force_constant_slope": ({"slope": 60.0}, entry(text="i * x * q * 1.3", q=60.0),
                             {"q": "slope"}),
    "force_constant_droop": ({"droop": 6e3}, entry(text="x * i * x * -q * 1.3", q=6e3),
                             {"q": "droop"}),
    "presliding_friction": (
        {"force": 0.05, "stiffness": 2e4},
        entry(text="-y * q", state={"y": "-y * q * abs(v) / w + v"}, w=0.05, q=2e4),
        {"w": "force", "q": "stiffness"}),
    "encoder_periodic_error": (
        {"amplitude": 1e-5, "period": 3e-4, "phase": 0.4},
        entry(kind="reading", text="sin(b + 2 * pi * x / w) * q", w=3e-4, q=1e-5, b=0.4),
        {"q": "amplitude", "w": "period", "b": "phase"}),
    "thermal_drift": ({"rate": 1e-3, "decay": 3.0},
                      entry(kind="reading", text="(1 - exp(-t * w)) / w * q", q=1e-3, w=3.0),
                      {"q": "rate", "w": "decay"}),
    "periodic_disturbance": (
        {"amplitude": 0.2, "frequency": 37.3, "phase": 0.7},
        entry(text="sin(b + t * w * 2 * pi) * q", q=0.2, w=37.3, b=0.7),
        {"q": "amplitude", "w": "frequency", "b": "phase"}),
}
"""Effect of the library -> its values, the formula, and its parameters by those of the formula."""


AS_SPECIAL = {
    "periodic_disturbance": "built in it is a pair of linear states, which cost next to nothing",
    "presliding_friction": "built in its state has a closed form along the path"}
"""Shown, and held to no bar: what the library knows of the effect is more than its formula."""


def simulator(given: dict[str, Any]) -> Simulator:
    """The stage with a formula."""
    formula = formula_of(given)
    values = {p.name: p.value for p in formula.parameters}
    return Simulator(Model("formula", PERIOD_S, STAGE, effects=(
        EffectUse(formula.name, values, None, formula),)))


def _seconds(one: Simulator, other: Simulator, inputs: np.ndarray, turns: int) -> list[float]:
    best = [math.inf, math.inf]
    for _ in range(turns):
        for which, each in enumerate((one, other)):
            begun = time.perf_counter()
            each.output(inputs)
            best[which] = min(best[which], time.perf_counter() - begun)
    return best


def figures(quick: bool) -> list[Figure]:
    """Ratios for each effect, and the longest first use."""
    samples, turns = (4000, 7) if quick else (10_000, 25)
    sweep = np.linspace(1.0, 30.0, samples)
    inputs = 2.0 * np.sin(2.0 * np.pi * np.cumsum(sweep) * PERIOD_S)
    found = []
    for name, (values, given, _) in AS_FORMULAS.items():
        library = Simulator(Model("library", PERIOD_S, STAGE).with_effect(name, values))
        ours, theirs = _seconds(simulator(given), library, inputs, turns)
        judged = name not in AS_SPECIAL
        found.append(Figure(
            f"formulas.{name}_ratio", ours / theirs, "", ALLOWED_RATIO if judged else None,
            "built in, ns a sample", 1e9 * theirs / samples, ours / theirs,
            f"{samples} samples in turns, shortest of {turns}"
            + ("" if judged else f"; {AS_SPECIAL[name]}"),
            "at most" if judged else None))
    rng = np.random.default_rng()
    first = 0.0
    for text in FIRST_USES:
        begun = time.perf_counter()
        state = {"z": "v - abs(v) * z / 1e-4"} if "z" in text else None
        simulator(entry(text=text.format(f"{rng.uniform(1e-3, 2e-3):.12f}"), state=state,
                        k=100.0)).output(inputs[:1000])
        first = max(first, time.perf_counter() - begun)
    return [*found, Figure("formulas.first_use_s", first, "s", ALLOWED_FIRST_S,
                           how=f"longest of {len(FIRST_USES)} new formulas, simulator compiled",
                           bar_kind="at most")]
