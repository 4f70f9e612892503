"""A random flexure stage, and how it is run."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.corpus import signals
from benchmarks.corpus.linear import response, transfer

PERIOD = 1e-3
SAMPLES = 24_000
NO_LOOP = np.zeros(4)


@dataclass(frozen=True)
class CaseRun:
    """An experiment as it is asked for: open loop `feed` is the input, else it is added."""

    kind: str
    reference: Any
    feed: Any
    gains: Any = field(default_factory=lambda: NO_LOOP)

    @property
    def closed(self) -> bool:
        """Whether a controller ran."""
        return bool(np.any(self.gains))


@dataclass(frozen=True)
class Stage:
    """base: true parameters (SI); amplitude: peak motion (m); noise: RMS of the reading (m)."""

    base: dict[str, float]
    amplitude: float
    noise: float
    current_noise: float | None

    @property
    def natural_hz(self) -> float:
        """Undamped natural frequency; 8 Hz, a scan's pace, for a stage without a spring."""
        stiffness = self.base.get("stiffness", 0.0)
        return math.sqrt(stiffness / self.base["mass"]) / (2.0 * math.pi) or 8.0


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A draw that is even in decades."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def draw_stage(rng: np.random.Generator, effects: tuple[str, ...]) -> Stage:
    """A stage on which the effects can be: without a delay in base for a transport delay."""
    mass = log_uniform(rng, 0.3, 3.0)
    natural = 2.0 * math.pi * log_uniform(rng, 2.0, 40.0)
    zeta = log_uniform(rng, 0.01, 0.1)
    base = {"mass": mass, "damping": 2.0 * zeta * mass * natural,
            "stiffness": mass * natural**2, "force_constant": log_uniform(rng, 0.5, 5.0)}
    lag, delay = log_uniform(rng, 2e-4, 3e-3), log_uniform(rng, 2e-4, 3e-3)
    has_lag, has_delay = rng.random() < 0.5, rng.random() < 0.5
    resistance, damped = rng.uniform(2.0, 10.0), log_uniform(rng, 0.02, 0.2)
    has_coil, current_noise = rng.random() < 0.3, log_uniform(rng, 2e-4, 2e-3)
    if has_lag and "amplifier_bandwidth" not in effects:
        base["amplifier_time_constant"] = lag
    if has_delay and "transport_delay" not in effects:
        base["delay"] = delay
    if rng.random() < 0.3:
        base["encoder_resolution"] = float(rng.choice([1e-9, 5e-9, 1e-8]))
    if has_coil or {"coil_inductance", "back_emf"} & set(effects):
        base["coil_resistance"] = resistance
        if "back_emf" not in effects:
            base["back_emf"] = 2.0 * damped * mass * natural / base["force_constant"]
    recorded = "coil_resistance" in base and rng.random() < 0.6
    if rng.random() < 0.3 or ("force_offset" in effects and rng.random() < 0.5):
        base["encoder_zero"] = 0.0
    return Stage(base, log_uniform(rng, 1e-4, 3e-3), log_uniform(rng, 5e-8, 3e-7),
                 current_noise if recorded else None)


def open_loop(rng: np.random.Generator, stage: Stage, kind: str, amplitude: float,
              samples: int = SAMPLES) -> CaseRun:
    """A run by input alone whose linear motion has the peak `amplitude` (m)."""
    if kind == "multisine":
        repeat = float(rng.choice([4.0, 4.0, 8.0]))
        low = float(rng.choice([0.25, 0.5]))
        feed = signals.multisine(rng, PERIOD, samples, repeat, low,
                                 float(rng.choice([150.0, 250.0, 400.0])), rng.random() < 0.5)
    elif kind == "chirp":
        feed = signals.chirp(PERIOD, samples, 0.5, 200.0, float(rng.choice([6.0, 12.0])))
    elif kind == "steps":
        feed = signals.steps(rng, PERIOD, samples, rng.uniform(0.7, 2.0))
    else:
        feed = signals.scan(rng, PERIOD, samples, _line_hz(rng, stage))
    motion = response(stage.base, PERIOD, feed)
    feed = feed * amplitude / np.max(np.abs(motion))
    return CaseRun(kind, np.zeros(0), feed)


def closed_loop(rng: np.random.Generator, stage: Stage, amplitude: float,
                dither: float, samples: int = SAMPLES) -> CaseRun:
    """A scan under control with static feedforward; `dither` (m) is the peak motion that an added
    multisine would cause in open loop."""
    reference = amplitude * signals.scan(rng, PERIOD, samples, _line_hz(rng, stage))
    feed = np.zeros(samples)
    if "stiffness" in stage.base:
        feed = 0.9 * reference / float(np.real(transfer(stage.base, PERIOD, [1e-3])[0]))
    if dither > 0.0:
        feed = feed + open_loop(rng, stage, "multisine", dither, samples).feed
    return CaseRun("closed_scan", reference, feed, signals.gains(stage.base, PERIOD))


def _line_hz(rng: np.random.Generator, stage: Stage) -> float:
    return float(min(log_uniform(rng, 0.4, 4.0), 0.25 * stage.natural_hz))


def draw_runs(rng: np.random.Generator, stage: Stage,
              samples: int = SAMPLES) -> tuple[list[CaseRun], list[CaseRun]]:
    """Training runs and held-out runs, which differ in kind."""
    top = stage.amplitude
    choice = rng.random()
    if choice < 0.4:
        train = [open_loop(rng, stage, "multisine", top, samples)]
    elif choice < 0.75:
        train = [open_loop(rng, stage, "multisine", top, samples),
                 open_loop(rng, stage, "multisine", top / 3.0, samples)]
    elif choice < 0.9:
        train = [closed_loop(rng, stage, top, 0.3 * top, samples)]
        return train, [open_loop(rng, stage, "multisine", rng.uniform(0.5, 1.1) * top, samples)]
    else:
        train = [open_loop(rng, stage, "chirp", top, samples)]
        return train, [closed_loop(rng, stage, rng.uniform(0.5, 1.1) * top, 0.1 * top, samples)]
    size = rng.uniform(0.5, 1.2) * top
    held = [closed_loop(rng, stage, size, 0.0, samples) if rng.random() < 0.5
            else open_loop(rng, stage, "scan", size, samples)]
    if rng.random() < 0.4:
        kind = str(rng.choice(["chirp", "steps"]))
        held.append(open_loop(rng, stage, kind, rng.uniform(0.4, 1.1) * top, samples))
    return train, held
