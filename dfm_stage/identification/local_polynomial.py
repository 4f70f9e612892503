"""Frequency response of records that are not periodic: the local polynomial method.

Around each DFT line response and leakage are second-degree polynomials of the frequency, fitted to
the neighbouring lines by least squares (Pintelon, Schoukens, Vandersteen and Barbe, Mechanical
Systems and Signal Processing 24, 2010). Leakage and transients drop out, and the residual of each
small fit gives the variance. Where a reference drives a closed loop, responses from the reference
to output and to input are estimated together and divided, which feedback does not bias.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array, Complex, Lines
from dfm_stage.identification.errors import IdentificationError

DEGREE = 2
"""Of the polynomials: the curvature of a resonance over the few lines of one fit."""
EXCITED = 1e-3
"""Amplitude of a line over the largest, averaged over a fit, from which the input excites it."""
WINDOWS = 4
"""Fits side by side that the samples must suffice for."""


@dataclass(frozen=True)
class LocalEstimate:
    """`omega` (F,) rad/s, `response` (F,), `variance` (F,) with `dof` degrees of freedom."""

    omega: Array
    response: Complex
    variance: Array
    dof: float


def local_polynomial(input_: Array, output: Array, sample_period: float, *,
                     reference: Array | None = None, half_width: int = 7,
                     points: int = 300) -> LocalEstimate:
    """Estimate the response at up to `points` lines spread evenly in logarithm.

    `half_width` lines on either side take part in each fit. Lines at which the input carries less
    than a thousandth of its largest amplitude are left out.

    Raises
    ------
    IdentificationError
        If the record is too short for a single fit.
    """
    cause = input_ if reference is None or np.ptp(reference) == 0.0 else reference
    unknowns = 2 * (DEGREE + 1)
    samples = cause.size
    if samples < WINDOWS * (2 * half_width + 1):
        raise IdentificationError(f"{samples} samples are too few for a frequency response: "
                                  "record longer")
    x = np.fft.rfft(cause) / samples
    responses = np.stack([np.fft.rfft(output), np.fft.rfft(input_)]) / samples
    centres = _centres(np.abs(x), half_width, points)
    offsets = np.arange(-half_width, half_width + 1)
    powers = (offsets / half_width)[:, None] ** np.arange(DEGREE + 1)
    rows = centres[:, None] + offsets
    design = np.concatenate([x[rows][:, :, None] * powers, np.broadcast_to(
        powers, (centres.size, *powers.shape)).astype(complex)], axis=2)
    scale = np.linalg.norm(design, axis=1, keepdims=True)
    design = design / np.maximum(scale, 1e-300)
    inverse = np.linalg.pinv(design, rcond=1e-10)
    estimates, residuals = [], []
    for target in responses:
        values = target[rows]
        solved = np.einsum("fij,fj->fi", inverse, values)
        residuals.append(values - np.einsum("fij,fj->fi", design, solved))
        estimates.append(solved[:, 0] / scale[:, 0, 0])
    free = offsets.size - unknowns
    response = estimates[0] / estimates[1]
    error = residuals[0] - response[:, None] * residuals[1]
    noise = np.sum(np.abs(error) ** 2, axis=1) / free
    gain = np.sum(np.abs(inverse[:, 0, :]) ** 2, axis=1) / scale[:, 0, 0] ** 2
    variance = noise * gain / np.abs(estimates[1]) ** 2
    omega = 2.0 * math.pi * centres / (samples * sample_period)
    return LocalEstimate(np.asarray(omega), response, variance, 2.0 * free)


def _centres(amplitude: Array, half_width: int, points: int) -> Lines:
    last = amplitude.size - half_width - 1
    inner = np.arange(half_width + 1, last)
    spread = np.convolve(amplitude, np.ones(2 * half_width + 1) / (2 * half_width + 1), "same")
    strong = inner[spread[inner] > EXCITED * spread[inner].max()]
    wanted = np.unique(np.round(np.geomspace(strong[0], strong[-1], points)).astype(np.int64))
    return wanted[np.isin(wanted, strong)]
