"""What brakes a free swing, from the energy that it loses from one turning point to the next.

A restoring force that is wrong by a percent is more than most friction, and hides it in the
balance of forces. In the balance of energy it does not: over a full swing, a force that depends on
position gives back what it took. What the swing loses is the work of what brakes it,

    U(x_k) - U(x_k+2) = integral of (c |v| + F + q v^2) |v| dt,

from turning point k to k + 2, with the potential U of the model's spring. Over the path, this is a
mean braking force. Dry friction is a constant in it, and drags grow with the speed or its square
(Feeny and Liang, J. Sound Vib. 195 (1996) 149, for the decrement of viscous and dry friction).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import Blocks, Solution, block_edges, jackknife, log_ratio
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    BLOCKS,
    BRAKES_MISSED,
    FEWEST_SWING_BLOCKS,
    SWING_OVER_NOISE,
    SWINGS_A_BLOCK,
)
from dfm_stage.diagnosis.evidence import Braking
from dfm_stage.diagnosis.force_domain import WIDTHS, RunForces
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.quantity import Quantity, interval
from dfm_stage.model import EFFECTS, Model

GRID = 2001
"""Points of the potential between the ends of the travel."""
Potential = Callable[[float], float]


def braking(runs: Sequence[Observation], model: Model,
            library: Sequence[str]) -> Braking | None:
    """What of a library brakes the free swings of some runs beside viscous damping; None where
    nothing clearly does, or where there are few. `model` has the spring, and effects that depend
    on position; the intervals do not cover an error of these."""
    brakes = {n: power for n in library if (power := EFFECTS[n].brakes) is not None}
    each = [rows for run in runs if len(
        rows := swings(run, model, (1, *brakes.values()))) >= SWINGS_A_BLOCK]
    if sum(map(len, each)) < SWINGS_A_BLOCK * FEWEST_SWING_BLOCKS:
        return None
    edges, _ = block_edges([len(rows) for rows in each], BLOCKS, SWINGS_A_BLOCK)
    blocks = Blocks(np.concatenate(each), edges, np.ones(edges.size - 1))
    place = {n: 2 + k for k, n in enumerate(brakes)}

    def fitted(names: Sequence[str]) -> Solution:
        return blocks.fit([1, *(place[n] for n in names)], 0)

    names, viscous = tuple(brakes), fitted(())
    found, margins = fitted(names), dict[str, float]()
    while names:
        rest = {n: fitted([m for m in names if m != n]) for n in names}
        margins = {n: _margin(found, rest[n]) if size > 0.0 else 0.0
                   for n, size in zip(names, found.coefficients[1:], strict=True)}
        weakest = min(names, key=lambda n: margins[n])
        if margins[weakest] >= BLOCK_MARGIN:
            break
        names, found = tuple(n for n in names if n != weakest), rest[weakest]
    force = float(np.sqrt(np.mean(np.concatenate(each)[:, 0] ** 2)))
    missed = float(np.sqrt(viscous.errors @ blocks.sizes / blocks.sizes.sum())) / force
    if not names or missed < BRAKES_MISSED:
        return None
    errors = jackknife(found.left_out)[1:]
    left = float(np.sqrt(found.errors @ blocks.sizes / blocks.sizes.sum())) / force
    return Braking({n: _size(n, float(v), float(e), blocks.count) for n, v, e in zip(
        names, found.coefficients[1:], errors, strict=True)}, missed, left, margins)


def swings(run: Observation, model: Model, powers: Sequence[int]) -> Array:
    """Of each full swing (M, 1 + len(powers)) of a run: mean braking force, and means along the
    path of these powers of the speed. Swings that hardly stand out of the noise are left out."""
    t, period = RunForces(run, WIDTHS[0]).trajectory, run.sample_period
    at = np.flatnonzero(np.diff(np.sign(t.v)) != 0.0)
    until = t.v[at] / (t.v[at] - t.v[at + 1])        # samples, to where the speed is zero
    turning = t.x[at] + 0.5 * t.v[at] * until * period
    potential, speed = _potential(model, t.x), np.abs(t.v)
    found = []
    for k in range(at.size - 2):
        first, middle, last = at[k:k + 3] + 1
        peak = min(np.max(speed[first:middle]), np.max(speed[middle:last]))
        if peak > SWING_OVER_NOISE * t.speed_noise:
            path = float(np.sum(np.abs(np.diff(turning[k:k + 3]))))
            lost = potential(turning[k]) - potential(turning[k + 2])
            works = [float(np.sum(speed[first:last] ** (1 + p))) * period for p in powers]
            found.append([lost / path, *(work / path for work in works)])
    return np.array(found).reshape(-1, 1 + len(powers))


def _potential(model: Model, x: Array) -> Potential:
    """The potential (J) of the model's spring, and of its effects in a stage that stands."""
    grid = np.linspace(float(np.min(x)), float(np.max(x)), GRID)
    force = model.base.get("stiffness", 0.0) * grid
    for use in model.effects:
        if use.effect.force is not None:
            values = tuple(use.parameters.values())
            force -= [use.effect.force(float(at), 0.0, 0.0, values) for at in grid]
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(grid)
    energy = np.concatenate(([0.0], np.cumsum(steps)))
    return lambda at: float(np.interp(at, grid, energy))


def _margin(better: Solution, worse: Solution) -> float:
    """By how many standard errors over blocks."""
    mean, error = log_ratio(better.errors, worse.errors)
    return mean / max(error, 1e-12)


def _size(name: str, value: float, error: float, blocks: int) -> Quantity:
    unit = EFFECTS[name].parameters[0].unit
    return Quantity(value, unit, interval(value, error, blocks - 1))
