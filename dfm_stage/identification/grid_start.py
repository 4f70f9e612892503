"""A first guess where no frequency response gives one: the best of many simulated stages."""

from __future__ import annotations

import math

import numpy as np

from dfm_stage.identification.plant import LinearPlant, Mode
from dfm_stage.identification.source import Source
from dfm_stage.model import Model, Simulator

DAMPING_RATIOS, FREQUENCIES = (0.03, 0.2, 1.0), 96
"""Of the grid: a flexure, a damped one, no resonance; frequencies some 9 % apart."""
HIGHEST = 0.2
"""Of the frequencies, over the sampling rate: above it, a few samples a swing tell no mode."""
SAMPLES, ROWS_AT_ONCE = 20_000, 64
"""Of the record that are simulated, and stages at once: bounds of time and of memory."""


def grid_start(source: Source) -> LinearPlant:
    """Return one mode behind a delay of one sample that suits the start of the record best.

    Natural frequencies from one period in the record to a fifth of the sampling rate, and a body
    without a spring, are simulated with unit gain; gain and offset follow by least squares.
    """
    period = source.sample_period
    omega = 2.0 * math.pi * np.geomspace(1.0 / (len(source.axis.input) * period),
                                         HIGHEST / period, FREQUENCIES)
    rows = [(2.0 * z * w, w * w) for w in omega for z in DAMPING_RATIOS]
    rows += [(w, 0.0) for w in omega]
    model = Model("grid", period, base={"mass": 1.0, "damping": 1.0, "stiffness": 1.0,
                                        "force_constant": 1.0, "delay": period})
    measured = source.axis.position[:SAMPLES] - np.mean(source.axis.position[:SAMPLES])
    simulator, best = Simulator(model), (-1.0, 0.0, rows[0])
    for first in range(0, len(rows), ROWS_AT_ONCE):
        part = rows[first:first + ROWS_AT_ONCE]
        outputs = simulator.run_many(source.axis.input[:SAMPLES], ("damping", "stiffness"),
                                     np.array(part), signal=source.axis.measures)
        outputs -= outputs.mean(axis=1, keepdims=True)
        power = np.maximum(np.einsum("ij,ij->i", outputs, outputs), 1e-300)
        product = outputs @ measured
        explained = np.where(np.isfinite(product), product**2 / power, -1.0)
        at = int(np.argmax(explained))
        best = max(best, (float(explained[at]), float(product[at] / power[at]), part[at]))
    _, gain, (damping, stiffness) = best
    return LinearPlant((Mode(gain, damping, stiffness),), 0.5 * period, period)
