"""What a linear refit leaves of a record, and which part of it is a remainder's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter

from benchmarks.corpus.measured import plant
from benchmarks.corpus.measured.plant import STEPS
from benchmarks.corpus.measured.stage import Outcome, Run, Stage

FREE = ("damping", "stiffness", "force_constant", "amplifier_time_constant", "delay")
REFITS = 10
ENOUGH = 0.999
"""Of the gap before a step of the refit; above it another step is not worth its time."""


def linear_response(base: dict[str, float], period: float, run: Run) -> Any:
    """Position (N,) of the linear stage from rest, behind the filter of a band-limited record.

    Between steps of the plant the command is held or, if it is not a held one, linear.
    """
    fine = len(run.command) * STEPS
    late = run.shift + base.get("delay", 0.0) / period * STEPS
    whole = math.floor(late + 1e-9)
    place = np.arange(fine) - whole
    if run.hold == plant.HELD:
        u = np.where(place >= 0, run.command[np.clip(place // STEPS, 0, len(run.command) - 1)],
                     0.0)
    elif run.hold == plant.LINEAR:
        u = np.interp(place / STEPS, np.arange(len(run.command)), run.command, left=0.0)
    else:
        u = run.filtered[np.clip(place, 0, fine - 1)]  # it commutes with the stage
    denominator = [base["mass"], base["damping"], base.get("stiffness", 0.0)]
    if base.get("amplifier_time_constant", 0.0) > 0.0:
        denominator = list(np.polymul(denominator, [base["amplifier_time_constant"], 1.0]))
    rule = "zoh" if run.hold == plant.HELD else "foh"
    b, a, _ = cont2discrete(([base["force_constant"]], denominator), period / STEPS, rule)
    part = max(late - whole, 0.0)
    return lfilter(np.convolve(b[0], [1.0 - part, part]), a, u)[::STEPS]


def linear_refit(base: dict[str, float], stage: Stage, runs: Sequence[Run],
                 readings: Sequence[Any], offsets: bool = True) -> Any:
    """What is left (m), runs in a row, after Gauss-Newton steps of the base parameters that are
    there, with each run's first states and offset, until they change nothing.

    readings: clean, as the sensor's filter leaves them. offsets: False where the zero is known.
    """
    at, free = dict(base), [name for name in FREE if base.get(name, 0.0) > 0.0]
    best, size = np.zeros(0), math.inf
    for _ in range(REFITS):
        gap, columns = _slopes(at, free, stage, runs, readings)
        if not offsets:
            columns[:, len(free) + 2::3] = 0.0
        norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        basis, triangle = np.linalg.qr(columns / norms)
        along = basis.T @ gap
        found = gap - basis @ along
        now = float(np.linalg.norm(found))
        if now > ENOUGH * size:
            return found if now < size else best
        best, size = found, now
        step = np.linalg.lstsq(triangle, along, rcond=1e-9)[0] / norms
        for name, change in zip(free, step, strict=False):
            at[name] *= 1.0 + float(np.clip(change, -0.4, 0.4))
    return best


def _slopes(at: dict[str, float], free: Sequence[str], stage: Stage, runs: Sequence[Run],
            readings: Sequence[Any]) -> tuple[Any, Any]:
    """The gap, and columns of relative changes of the free parameters, then of each run's own."""
    rows = sum(len(r) for r in readings)
    columns = np.zeros((rows, len(free) + 3 * len(runs)))
    gap, first = np.empty(rows), 0
    for i, (run, reading) in enumerate(zip(runs, readings, strict=True)):
        part = slice(first, first + len(reading))
        centre = linear_response(at, stage.period, run)
        gap[part] = reading - centre
        for j, name in enumerate(free):
            moved = linear_response({**at, name: 1.0001 * at[name]}, stage.period, run)
            columns[part, j] = (moved - centre) / 1e-4
        columns[part, len(free) + 3 * i:len(free) + 3 * i + 3] = _own(at, stage.period,
                                                                     len(reading))
        first += len(reading)
    return gap, columns


def _own(base: dict[str, float], period: float, samples: int) -> Any:
    """Free motion from two first states, and an offset, (N, 3)."""
    t = np.arange(samples) * period
    roots = np.roots([base["mass"], base["damping"], base.get("stiffness", 0.0)]).astype(complex)
    decays = np.exp(np.outer(t, roots))
    return np.stack([decays[:, 0].real, decays[:, 1].imag if abs(roots[0].imag) > 0.0
                     else decays[:, 1].real, np.ones(samples)], axis=1)


def position_share(whole: Any, without: Any) -> float:
    """Power of a remainder over that of the gap: what the refits with and without it leave."""
    rest = whole - without
    return float(rest @ rest) / float(whole @ whole)


def force_parts(outcomes: Sequence[Outcome]) -> tuple[Any, Any]:
    """Missing force and its part from the remainder (N), runs in a row, without what is linear in
    position, speed, acceleration and command, or constant."""
    rows = np.hstack([o.rows for o in outcomes])
    columns = np.stack([*(rows[i] for i in (plant.POSITION, plant.SPEED, plant.ACCELERATION,
                                            plant.INPUT)), np.ones(rows.shape[1])], axis=1)
    columns /= np.linalg.norm(columns, axis=0)
    basis = np.linalg.qr(columns)[0]
    return tuple(row - basis @ (basis.T @ row)
                 for row in (rows[plant.MISSING], rows[plant.REST]))


def force_share(outcomes: Sequence[Outcome]) -> float:
    """Power of a remainder over that of the gap, as forces along the motion."""
    missing, rest = force_parts(outcomes)
    return float(rest @ rest) / max(float(missing @ missing), 1e-300)


def as_motion(force: Any, stage: Stage, run: Run) -> Any:
    """The motion (m) that a missing force gives a body held by its loop and its own spring."""
    m = stage.base["mass"]
    w = math.sqrt((run.gains[0] * stage.base["force_constant"]
                   + stage.base.get("stiffness", 0.0)) / m)
    w = min(max(w, 0.01 / stage.period), 1.0 / stage.period)
    b, a, _ = cont2discrete(([1.0], [m, 1.4 * m * w, m * w * w]), stage.period, "zoh")
    return lfilter(b[0], a, force)
