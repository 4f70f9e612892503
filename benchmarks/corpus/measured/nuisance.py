"""What happens to logs although nothing physical is missing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.corpus.measured.stage import pink
from benchmarks.corpus.plan import class_of
from benchmarks.corpus.stage import log_uniform

Columns = dict[str, Any]


@dataclass(frozen=True)
class Nuisance:
    """verdicts: those that are right; allowed: names that are right all the same, and why."""

    apply: Callable[[np.random.Generator, Columns, float], Columns]
    verdicts: tuple[str, ...] = ("none",)
    allowed: frozenset[str] = frozenset()
    reason: str = ""


def _added(of: Callable[[np.random.Generator, int], Any],
           low: float, high: float) -> Callable[[np.random.Generator, Columns, float], Columns]:
    """Add a signal of so many times the noise to the position."""
    def apply(rng: np.random.Generator, columns: Columns, noise: float) -> Columns:
        wave = of(rng, len(columns["position_m"]))
        return {**columns, "position_m": columns["position_m"] + noise * log_uniform(
            rng, low, high) * wave}

    return apply


def _walk(rng: np.random.Generator, samples: int) -> Any:
    wave = np.cumsum(rng.standard_normal(samples))
    return (wave - wave.mean()) / np.std(wave)


def _student(rng: np.random.Generator, samples: int) -> Any:
    return rng.standard_t(rng.uniform(2.2, 4.0), samples)


def _spikes(rng: np.random.Generator, samples: int) -> Any:
    hit = rng.random(samples) < rng.uniform(5e-4, 5e-3)
    return hit * rng.standard_normal(samples) * 30.0


def _mains(rng: np.random.Generator, columns: Columns, noise: float) -> Columns:
    hertz = float(rng.choice([50.0, 60.0])) * (1.0 + rng.uniform(-1e-3, 1e-3))
    wave = np.sin(2.0 * math.pi * hertz * columns["time_s"] + rng.uniform(-3.0, 3.0))
    return {**columns, "position_m": columns["position_m"]
            + noise * log_uniform(rng, 1.0, 10.0) * wave}


def _stamps(rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    period = columns["time_s"][1] - columns["time_s"][0]
    late = period * rng.uniform(0.02, 0.15) * np.abs(rng.standard_normal(len(columns["time_s"])))
    return {**columns, "time_s": columns["time_s"] + np.minimum(late, 0.45 * period)}


def _rows(keep: Any, columns: Columns) -> Columns:
    return {name: values[keep] for name, values in columns.items()}


def _repeated(rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    n = len(columns["time_s"])
    times = 1 + (rng.random(n) < rng.uniform(1e-3, 5e-3))
    return _rows(np.repeat(np.arange(n), times), columns)


def _stale(rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    position = columns["position_m"].copy()
    hit = np.flatnonzero(rng.random(len(position)) < rng.uniform(1e-3, 5e-3))
    hit = hit[hit > 0]
    position[hit] = position[hit - 1]
    return {**columns, "position_m": position}


def _lost(rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    n = len(columns["time_s"])
    keep = rng.random(n) > rng.uniform(5e-4, 2e-3)
    keep[:2] = True
    return _rows(np.flatnonzero(keep), columns)


def _lost_silently(rng: np.random.Generator, columns: Columns, noise: float) -> Columns:
    found = _lost(rng, columns, noise)
    return {**found, "time_s": columns["time_s"][:len(found["time_s"])]}


def _scaled(rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    factor = float(rng.choice([1e-3, 0.1, 0.5, 2.0, 10.0, 25.4, 1e3]))
    name = "input_v" if rng.random() < 0.5 else "position_m"
    return {**columns, name: factor * columns[name]}


def _moved(name: str, by: int) -> Callable[[np.random.Generator, Columns, float], Columns]:
    def apply(_rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
        return _rows(slice(1, -1), {**columns, name: np.roll(columns[name], by)})

    return apply


def _as_is(_rng: np.random.Generator, columns: Columns, _noise: float) -> Columns:
    return columns


LATE = class_of("transport_delay")
WRONG = ("retune", "unknown")
NUISANCES: dict[str, Nuisance] = {
    "complete": Nuisance(_as_is),
    "retune": Nuisance(_as_is, ("retune",)),
    "flicker": Nuisance(_added(pink, 0.3, 30.0)),
    "wander": Nuisance(_added(_walk, 1.0, 30.0), ("none", "unknown"),
                       frozenset({"thermal_drift", "creep"}), "a drift of the sensor"),
    "heavy_tails": Nuisance(_added(_student, 1.0, 3.0)),
    "mains": Nuisance(_mains, ("none", "unknown"), frozenset({"periodic_disturbance"}),
                      "a periodic disturbance, if of the reading"),
    "outliers": Nuisance(_added(_spikes, 0.7, 10.0)),
    "jitter_stamps": Nuisance(_stamps),
    "jitter_samples": Nuisance(_as_is),
    "repeated_rows": Nuisance(_repeated),
    "stale_samples": Nuisance(_stale, ("none", "unknown")),
    "lost_rows": Nuisance(_lost),
    "lost_silently": Nuisance(_lost_silently, ("none", "unknown", "retune")),
    "inverted": Nuisance(lambda _r, c, _s: {**c, "position_m": -c["position_m"]}, WRONG),
    "wrong_scale": Nuisance(_scaled, WRONG),
    "in_motion": Nuisance(_as_is),
    "low_resolution": Nuisance(_as_is, ("none",), frozenset({"encoder_quantization"}),
                               "the step of the reading, where the model does not give it"),
    "output_late": Nuisance(_moved("position_m", 1), ("none", "retune", "named", "ambiguous"),
                            LATE, "late is not to be told from a delay"),
    "output_early": Nuisance(_moved("position_m", -1), ("none", "retune")),
}
"""What is decided before any run. A sign or a scale is a wrong number of the model (`retune`) or
not to be mended by one (`unknown`); rows lost without a trace cannot be mended by any model."""
