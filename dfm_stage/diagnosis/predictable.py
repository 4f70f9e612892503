"""What of a residual the input and the motion foretell: a gap is caused by them, noise is not.

Colour alone says nothing: 1/f noise of a sensor is as slow as creep. So the residual is regressed
on the input and on functions of the simulated motion, and predicted on stretches left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from dfm_stage.arrays import Array, Complex
from dfm_stage.diagnosis.blocks import Blocks
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.model import Model
from dfm_stage.model.linear import linear_part
from dfm_stage.transforms import cosine_transform, inverse_cosine_transform, longer_length

FOLDS = 6
"""Stretches of a record, each predicted from the others: few, so that slow noise does not reach
from one into the next, where a short one would be interpolated between its neighbours."""
SLOWEST = 8 * FOLDS
"""Half cycles in a record from which an octave holds enough of them to be told from the others'
stretches: below, as many functions as there are meet any noise."""
BANDS = 30
"""Bands of frequency with a gain and a phase each: any linear error, its resonances smeared."""
WAVES, WAVE_NUMBER, SEED = 16, 1.2, 1
"""Random Fourier features of position and speed, the spread of their wave numbers, the draw."""
DIRECTED = 0.05
"""Share of the RMS speed at which a direction is half known."""
RIDGES = (1e-4, 1e-2, 1e-1)
"""Penalties tried, on columns of unit power."""
SEEN = 1e-3
"""Share of a column in an octave below which it is leakage there."""


def foretold(run: Observation, residual: Array, model: Model) -> Iterator[float]:
    """Yield, for each octave, the share of the power of one run's residual (N - skip,) that input
    and motion foretell on stretches left out; at most 1, below zero where nothing is.

    By octaves, because noise that grows towards low frequencies would hide a gap above them. The
    motion is simulated: a measured one would foretell its own noise.
    """
    whole = cosine_transform(np.vstack((_columns(run, residual, model), residual)))
    total = np.linalg.norm(whole, axis=1)
    low = SLOWEST
    while low < residual.size // 2:
        lines = whole[:, low:2 * low]
        used = np.linalg.norm(lines, axis=1) > SEEN * total
        used[-1] = True
        octave = np.zeros((int(used.sum()), min(4 * low, residual.size)))  # sampled as it needs
        octave[:, low:low + lines.shape[1]] = lines[used]
        signals = inverse_cosine_transform(octave).T
        edges = np.linspace(0, len(signals), FOLDS + 1).astype(np.int64)
        count = signals.shape[1] - 1
        blocks = Blocks(signals, edges, np.ones(FOLDS))
        left = blocks.ridge_fit((), range(count), count, RIDGES).errors
        power = max(float(signals[:, -1] @ signals[:, -1]), 1e-300)
        yield 1.0 - float(left @ blocks.sizes) / power
        low *= 2


def _columns(run: Observation, residual: Array, model: Model) -> Array:
    """Bands of the input, and functions of the motion as errors of the reading and as forces on
    the linear part (c, N - skip)."""
    size = residual.size
    length = longer_length(2 * size)
    turns: Array = np.fft.rfftfreq(length).astype(np.float64)

    def spectrum(signal: Array) -> Complex:
        back = np.linspace(signal[-1], signal[0], length - size + 2)[1:-1]
        return np.asarray(np.fft.rfft(np.concatenate((signal, back))))

    def signal_of(lines: Complex) -> Array:
        return np.asarray(np.fft.irfft(lines, length)[:size])

    drive = spectrum(run.input[run.skip:] - np.mean(run.input[run.skip:]))
    found: list[Array] = []
    for low, high in _bands(size):
        band: Complex = ((turns >= low) & (turns < high)).astype(np.complex128)
        found += [signal_of(drive * band), signal_of(drive * (1j * band))]
    response = _response(model, 2.0 * math.pi * turns / run.sample_period)
    for each in _functions(run.output[run.skip:] - residual):
        found += [each, signal_of(spectrum(each - each.mean()) * response)]
    return np.array(found)


def _bands(size: int) -> list[tuple[float, float]]:
    """Edges (cycles a sample) of bands, half of them alike in width and half in ratio."""
    low, top = 2.0 / size, 0.51
    edges = np.unique(np.concatenate(([0.0], np.geomspace(low, top, BANDS // 2),
                                      np.linspace(low, top, BANDS // 2)))).tolist()
    return list(pairwise(edges))


def _functions(position: Array) -> list[Array]:
    """Functions (N,) of position and speed, both over their spread."""
    x = (position - position.mean()) / max(float(np.std(position)), 1e-300)
    v = np.gradient(position)
    v = v / max(float(np.std(v)), 1e-300)
    sign = v / np.hypot(v, DIRECTED)
    found = [x * x, x**3, v * v, v**3, x * v, x * x * v, x * v * v, sign, np.abs(v), np.abs(x),
             sign * x, sign * x * x, x**4, x**5]
    draw = np.random.default_rng(SEED)
    for _ in range(WAVES):
        a, b = WAVE_NUMBER * draw.standard_normal(2)
        found.append(np.cos(a * x + b * v + 2.0 * math.pi * draw.random()))
    return found


def _response(model: Model, omega: Array) -> Complex:
    """Position per force (F,) of the linear part; at rest as at the lowest frequency."""
    part = linear_part(model)
    poles, vectors = np.linalg.eig(part.a)
    residues = (part.c @ vectors) * np.linalg.solve(vectors, part.b.astype(complex))
    s = 1j * np.maximum(omega, omega[1])[:, None]
    return np.asarray((residues / (s - poles)).sum(axis=1))
