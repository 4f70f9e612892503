"""Resonance of the sensor's mount: what is read is carried along by a spring.

    y'' + 2 damping_ratio w (y' - x') + w^2 (y - x) = 0,      w = 2 pi frequency

y is the place of the scale (or head) that is read, x that of the stage it is mounted on. What is
mounted is light beside the stage, so nothing acts back.
Source: Preumont, Vibration Control of Active Structures (2011), ch. 3; Gawronski, Advanced
Structural Dynamics and Active Control of Structures (2004), sec. 2.2.
"""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.model.effect import (
    Array,
    Conditions,
    Effect,
    Equivalence,
    Parameter,
    Parameters,
    Prior,
    Values,
)


def stamp(a: Array, rows: Array, first: int, p: Values) -> None:
    """Row 5 is the reading; its rate comes from the states."""
    n, w = a.shape[0], 2.0 * math.pi * p[0]
    a[first, first + 1] = 1.0
    for j in range(n):
        rate = 0.0
        for i in range(n):
            rate += rows[5, i] * a[i, j]
        a[first + 1, j] += w * w * rows[5, j] + 2.0 * p[1] * w * rate
    a[first + 1, first] -= w * w
    a[first + 1, first + 1] -= 2.0 * p[1] * w
    for j in range(n):
        rows[5, j] = 0.0
    rows[5, first] = 1.0


class SensorMount(Effect):
    """Looked for on a grid of frequencies."""

    def starts(self, at: Conditions) -> list[Parameters]:
        """From slow against the record to fast against the samples, sharp and damped."""
        grid = np.geomspace(max(0.5, 4.0 / at.duration), 1.0 / at.sample_period, 50)
        tried = [(f, zeta) for f in (*grid, *at.frequencies) for zeta in (0.01, 0.05)]
        return [{"frequency": float(f), "damping_ratio": zeta} for f, zeta in tried]

    def search_range(self, parameter: str, at: Conditions) -> tuple[float, float]:
        """Beyond MOST_DAMPED there is no resonance, but a lag; far above the samples nothing."""
        return -math.inf, {"damping_ratio": MOST_DAMPED,
                           "frequency": FASTEST / at.sample_period}.get(parameter, math.inf)


MOST_DAMPED = 0.5
"""Damping ratio up to which a mount has a resonance."""
FASTEST = 2.0
"""Frequency over that of the samples beyond which a mount is stiff."""


EFFECT = SensorMount(
    name="sensor_mount",
    meaning="the sensor's mount has a resonance of its own",
    equation="y'' + 2 damping_ratio w (y' - x') + w^2 (y - x) = 0;  w = 2 pi frequency",
    source="Preumont, Vibration Control of Active Structures (2011), ch. 3",
    parameters=(
        Parameter("frequency", 200.0, "Hz", "undamped frequency of the mount", 1e-3, 1e6),
        Parameter("damping_ratio", 0.01, "", "damping ratio of the mount", 0.0, 10.0),
    ),
    priors={"frequency": Prior(5.0, 400.0), "damping_ratio": Prior(1e-3, 0.2)},
    side="sensor",
    parity="linear",
    memory=False,
    shown_by="a multisine or chirp across the mount's frequency",
    searched=True,
    classes=(
        Equivalence(("sensor_mount", "second_mode"), "a linear stage and a share far below zero: "
                    "a sensor on a second mass", "a heavier mount, which acts back on the stage"),
        Equivalence(("sensor_mount", "transport_delay"), "a band far below the mount's frequency",
                    "excitation up to the mount's frequency"),
    ),
    states=(".reading", ".rate"),
    stage="sensor",
    stamp=stamp,
)
