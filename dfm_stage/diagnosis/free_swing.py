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
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.blocks import Blocks, Solution, block_edges, jackknife
from dfm_stage.diagnosis.decisions import (
    BLOCK_MARGIN,
    BLOCKS,
    BRAKES_MISSED,
    FEWEST_SWING_BLOCKS,
    SMALL_PART_MISSED,
    SWING_OVER_NOISE,
    SWINGS_A_BLOCK,
)
from dfm_stage.diagnosis.evidence import Braking
from dfm_stage.diagnosis.force_domain import WIDTHS, RunForces
from dfm_stage.diagnosis.margins import margin
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.identification.quantity import Quantity, interval
from dfm_stage.model import EFFECTS, Model

GRID = 2001
"""Points of the potential between the ends of the travel."""
FADES = (0.25, 0.5, 1.0, 2.0)
"""Speeds, over the RMS speed, from which a brake may fade: a brake that fades, and one that grows
with the square of position, are compared with what is told, and not told."""
Law = Callable[[Array, Array], Array]
"""A force against the motion over its size, of position and speed (without its sign)."""


@dataclass(frozen=True)
class Swings:
    """Full swings of a run: mean braking force (M,), and the mean along the path of each of some
    laws (M, K)."""

    force: Array
    laws: Array


def braking(runs: Sequence[Observation], held: Sequence[Observation], model: Model,
            library: Sequence[str]) -> Braking | None:
    """What of a library brakes the free swings of the fitted `runs`, and of those `held` out,
    beside viscous damping; None where nothing clearly does, where another law does it better,
    or where there are few swings.

    `model` has the spring, and effects that depend on position; the intervals do not cover an
    error of these.
    """
    brakes = {n: power for n in library if (power := EFFECTS[n].brakes) is not None}
    laws = [_power(1), *map(_power, brakes.values()), *_others(runs)]
    found = [(swings(run, model, laws), k < len(runs)) for k, run in enumerate((*runs, *held))]
    found = [(each, fitted) for each, fitted in found if each.force.size >= SWINGS_A_BLOCK]
    if not any(fitted for _, fitted in found):
        return None
    edges, owner = block_edges([each.force.size for each, _ in found], BLOCKS, SWINGS_A_BLOCK)
    blocks = Blocks(np.concatenate([np.column_stack((each.force, each.laws))
                                    for each, _ in found]), edges,
                    [found[k][1] for k in owner])
    if blocks.fitted.sum() < FEWEST_SWING_BLOCKS:
        return None
    return _judged(blocks, list(brakes), range(2 + len(brakes), 1 + len(laws)))


def _judged(blocks: Blocks, brakes: Sequence[str], others: Sequence[int]) -> Braking | None:
    """Which of `brakes`, the columns after the force and viscous damping, are told; none where one
    of the columns `others` in their place predicts better."""

    def fitted(names: Sequence[str]) -> Solution:
        return blocks.fit([1, *(2 + brakes.index(n) for n in names)], 0)

    names, viscous = tuple(brakes), fitted(())
    found, margins = fitted(names), dict[str, float]()
    while names:
        rest = {n: fitted([m for m in names if m != n]) for n in names}
        sizes = _sizes(names, found, int(blocks.fitted.sum()))
        margins = {n: margin(rest[n].errors, found.errors) if _is_above_zero(sizes[n]) else 0.0
                   for n in names}
        weakest = min(names, key=lambda n: margins[n])
        if margins[weakest] >= BLOCK_MARGIN:
            break
        names, found = tuple(n for n in names if n != weakest), rest[weakest]
    missed, left = _part(blocks, viscous), _part(blocks, found)
    worse = any(margin(blocks.fit([1, k], 0).errors, found.errors) < 0.0 for k in others)
    if not names or worse or missed < BRAKES_MISSED or left > SMALL_PART_MISSED * missed:
        return None
    return Braking(_sizes(names, found, int(blocks.fitted.sum())), missed, left, margins,
                   float(found.coefficients[0]))


def swings(run: Observation, model: Model, laws: Sequence[Law]) -> Swings:
    """The full swings of a run, without those that hardly stand out of the noise."""
    t, period = RunForces(run, WIDTHS[0]).trajectory, run.sample_period
    at = np.flatnonzero(np.diff(np.sign(t.v)) != 0.0)
    at = at[at >= run.skip]
    until = t.v[at] / (t.v[at] - t.v[at + 1])        # samples, to where the speed is zero
    turning = t.x[at] + 0.5 * t.v[at] * until * period
    middle = np.median(0.25 * (turning[:-2] + 2.0 * turning[1:-1] + turning[2:])) \
        if at.size > 2 else 0.0                      # the reading where the spring is at rest
    turning = turning - middle
    potential = _potential(model, float(np.max(np.abs(turning), initial=0.0)))
    speed, works = np.abs(t.v), np.array([law(t.x - middle, np.abs(t.v)) for law in laws])
    works = np.column_stack((np.zeros(len(laws)), np.cumsum(works * speed, axis=1) * period))
    force, means = [], []
    for k in range(at.size - 2):
        first, half, last = at[k:k + 3] + 1
        peak = min(np.max(speed[first:half]), np.max(speed[half:last]))
        path = float(np.sum(np.abs(np.diff(turning[k:k + 3]))))
        if peak > SWING_OVER_NOISE * t.speed_noise and path > 0.0:
            force.append((potential(turning[k]) - potential(turning[k + 2])) / path)
            means.append((works[:, last] - works[:, first]) / path)
    return Swings(np.array(force), np.array(means).reshape(-1, len(laws)))


def _power(power: int) -> Law:
    return lambda _, v: v**power


def _others(runs: Sequence[Observation]) -> list[Law]:
    """Laws that are not told."""
    speed = float(np.sqrt(np.mean([np.mean(np.gradient(run.output, run.sample_period) ** 2)
                                   for run in runs])))
    return [*(_fading(factor * speed) for factor in FADES), lambda x, v: x * x * v]


def _fading(from_speed: float) -> Law:
    return lambda _, v: v / (1.0 + (v / from_speed) ** 2)


def _potential(model: Model, reach: float) -> Callable[[float], float]:
    """The potential (J) of the model's spring, and of its effects in a stage that stands."""
    grid = np.linspace(-reach, reach, GRID)
    force = model.base.get("stiffness", 0.0) * grid
    for use in model.effects:
        if use.effect.force is not None:
            values = tuple(use.parameters.values())
            force -= [use.effect.force(float(at), 0.0, 0.0, values) for at in grid]
    steps = 0.5 * (force[1:] + force[:-1]) * np.diff(grid)
    energy = np.concatenate(([0.0], np.cumsum(steps)))
    return lambda at: float(np.interp(at, grid, energy))


def _part(blocks: Blocks, found: Solution) -> float:
    """What a fit misses of the braking force of held-out blocks, RMS over RMS."""
    missed = np.sqrt(found.errors @ blocks.sizes / blocks.sizes.sum())
    return float(missed / blocks.norms[0])


def _sizes(names: Sequence[str], found: Solution, blocks: int) -> dict[str, Quantity]:
    """With intervals over the fitted blocks."""
    errors = jackknife(found.left_out)[1:]
    return {n: Quantity(float(v), EFFECTS[n].parameters[0].unit, interval(
        float(v), float(e), blocks - 1))
        for n, v, e in zip(names, found.coefficients[1:], errors, strict=True)}


def _is_above_zero(size: Quantity) -> bool:
    return size.ci95 is not None and size.ci95[0] > 0.0
