"""Whether what a model leaves is noise, and what it looks like where it is not.

Coloured noise must pass and broadband errors of the scale must not, so no single test decides:
what repeats with the input, what is strong at low frequencies and foretold by input and motion,
smooth drifts, lines, patterns over position, and the shape of the distribution are looked at
together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from dfm_stage.arrays import Array
from dfm_stage.diagnosis.decisions import (
    DRIFT,
    DRIFT_LINES,
    EXCESS,
    FEW_SAMPLES,
    FEWEST_OF_OCTAVE,
    FLATNESS,
    FLATNESS_SIGMAS,
    FORETOLD_SHARE,
    HELD_OUT_FLOOR,
    LINE,
    MEMORYLESS,
    ONE_PARITY,
    PATTERN,
    PATTERN_TRAVEL,
    PERIODS,
    REPEATING_NOISE,
    REPEATING_SPREAD,
    SIZES_APART,
    SLOW_LINES,
    SMOOTH,
)
from dfm_stage.diagnosis.observation import Observation
from dfm_stage.diagnosis.predictable import foretold
from dfm_stage.diagnosis.spectra import is_resolution, lattice, position_peaks
from dfm_stage.identification.noise import fit_noise, whiten
from dfm_stage.identification.periods import local_mean
from dfm_stage.identification.weights import high_band_rms
from dfm_stage.model import Model
from dfm_stage.transforms import cosine_transform, inverse_cosine_transform


@dataclass(frozen=True)
class Finding:
    """One number about a residual, its limit for white noise, and what it means in words; noise
    may be `coloured`, and exceed it."""

    name: str
    value: float
    limit: float
    text: str
    coloured: bool = False

    @property
    def real(self) -> bool:
        """Whether noise does not explain it."""
        return self.value > self.limit and not self.coloured


def findings(run: Observation, residual: Array, known_noise: float | None,
             model: Model | None = None, ask_colour: bool = True) -> list[Finding]:
    """Look at what is left of one run's output (N - skip,) by a model with a linear part; without
    one, or where nobody asks for its colour, all noise is taken to be white. There is nothing to
    find in what rounding leaves."""
    spread = float(np.std(residual))
    if model is not None and spread <= HELD_OUT_FLOOR * rounding_rms(run, model):
        return []
    found = [Finding("excess", spread / high_band_rms(residual), EXCESS,
                     "RMS over that of high frequencies: slow or resonant motion is left")]
    if known_noise:
        found.append(Finding("known_noise", spread / known_noise, EXCESS,
                             "RMS over the noise that the model gives"))
    if ask_colour and model is not None and any(f.real for f in found) \
            and run.record_size >= FEW_SAMPLES and all(
                share < FORETOLD_SHARE for share in foretold(run, residual, model)):
        found = [replace(f, coloured=f.real) for f in found]
    white = _white(residual)
    found += [*_repeating(run, residual), _drift(residual), _line(residual),
              _pattern(run, residual, white), _shape(white)]
    return found


def rounding_rms(run: Observation, model: Model) -> float:
    """RMS of the error of a reading that counts in the resolution that the model gives, over
    motion of many counts: step / sqrt(12) (Widrow and Kollar, Quantization Noise, 2008); 0
    elsewhere. It follows the motion and looks like a gap, but the model says all there is."""
    resolution = model.base.get("encoder_resolution", 0.0)
    step = lattice(run.output) if resolution > 0.0 and run.order == 0 else None
    if step is None or not is_resolution(step, resolution):
        return 0.0
    return step / math.sqrt(12.0)


def _repeating(run: Observation, residual: Array) -> list[Finding]:
    period = run.periodicity.period if run.periodicity is not None else 0
    count = residual.size // period if period else 0
    if count < PERIODS:
        return []
    rows = residual[residual.size - count * period:].reshape(count, period)
    spectra = np.fft.rfft(rows, axis=1)[:, 1:]
    mean = spectra.mean(axis=0)
    noise = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (count - 1) / count
    ratio = np.abs(mean) ** 2 / np.maximum(local_mean(noise, 15), 1e-300)
    low = ratio[: max(40, ratio.size // 3)]
    limit = 1.0 + REPEATING_SPREAD / math.sqrt(low.size) + REPEATING_NOISE / math.sqrt(
        low.size * (count - 1))
    return [Finding("repeating", float(np.mean(low)), limit,
                    "power that repeats with the input over power that does not")]


def _drift(residual: Array) -> Finding:
    power = np.abs(np.fft.rfft(residual * np.hanning(residual.size))) ** 2
    near = power[6:60] if power.size > DRIFT_LINES else power[3:]
    slow = float(np.mean(power[:3]) / max(float(np.median(near)) / math.log(2.0), 1e-300))
    return Finding("drift", slow, DRIFT, "power at the lowest frequencies over that above them",
                   coloured=slow > DRIFT and not _smooth(residual))


def _smooth(residual: Array) -> bool:
    """Whether a curve of third degree takes all of a slow motion: noise that wanders has no such
    shape."""
    slow = cosine_transform(residual - residual.mean())
    slow[SLOW_LINES:] = 0.0
    wave = inverse_cosine_transform(slow)
    time = np.linspace(-1.0, 1.0, wave.size)
    left = wave - np.polynomial.legendre.legval(time, np.polynomial.legendre.legfit(time, wave, 3))
    return float(left @ left) < (1.0 - SMOOTH) * float(wave @ wave)


def _line(residual: Array) -> Finding:
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    width = power.size * 2 - 2
    power = power[3:]
    sloping = np.maximum(_sloping(power), 1e-300)
    around = sliding_window_view(np.pad(power, 50, mode="reflect"), 101)
    at, highest = 0, 0.0
    # a running median takes long; no line stands out more than it does from the sloping floor
    likely = np.argsort(-power / sloping)
    for some in np.array_split(likely, math.ceil(likely.size / 64)):
        if highest >= power[some[0]] / sloping[some[0]]:
            break
        ratio = power[some] / np.maximum(np.median(around[some], axis=1), sloping[some])
        if np.max(ratio) > highest:
            at, highest = int(some[np.argmax(ratio)]), float(np.max(ratio))
    return Finding("line", math.log(2.0) * highest, LINE,
                   "highest line over its neighbourhood, at "
                   f"{(at + 3) / width:.4g} of the sample rate")


def _sloping(power: Array) -> Array:
    """The floor (F,) of a spectrum without its first three lines, from the median of each octave:
    1/f noise rises within the width of a running median."""
    line = np.log(np.arange(3, power.size + 3))
    edges = [*(3 * 2**k - 3 for k in range(int(math.log2((power.size + 3) / 3)) + 1)), power.size]
    octaves = [slice(a, b) for a, b in pairwise(edges) if b - a >= FEWEST_OF_OCTAVE]
    middle = [float(np.mean(line[part])) for part in octaves]
    level = [math.log(max(float(np.median(power[part])), 1e-300)) for part in octaves]
    return np.asarray(np.exp(np.interp(line, middle, level)))


def _pattern(run: Observation, residual: Array, white: Array) -> Finding:
    position = run.simulated_position(residual)
    best = 0.0
    if run.order or float(np.ptp(position)) < PATTERN_TRAVEL * float(np.std(residual)):
        return Finding("pattern", best, PATTERN, "too little motion to see errors of a scale")
    for period in position_peaks([position[-white.size:]], [white], 3):
        turn = np.exp(2j * np.pi * position[-white.size:] / period)
        best = max(best, float(np.abs(np.sum(white * turn)) ** 2 / white.size))
    return Finding("pattern", best, PATTERN, "power tied to position, as errors of a scale are")


def _shape(white: Array) -> Finding:
    scaled = white / max(float(np.std(white)), 1e-300)
    kurtosis = 3.0 - float(np.mean(scaled**4))
    limit = max(FLATNESS, FLATNESS_SIGMAS * math.sqrt(24.0 / white.size))
    return Finding("flatness", kurtosis, limit,
                   "distribution flatter than normal, as rounding and periodic errors make it")


def _white(residual: Array) -> Array:
    model = fit_noise(residual, 20)
    return whiten(residual, model.polynomial) / max(model.sigma, 1e-300)


@dataclass(frozen=True)
class Description:
    """What an unexplained remainder looks like, in the words of diagnosis.json; None where that
    was not looked at."""

    parity: str | None
    memory: bool | None
    amplitude_exponent: float | None
    frequency_hz: float | None
    side: str

    def to_dict(self) -> dict[str, object]:
        """As JSON keeps it."""
        return {"parity": self.parity, "memory": self.memory,
                "amplitude_exponent": self.amplitude_exponent,
                "frequency_hz": self.frequency_hz, "side": self.side}


def describe(runs: Sequence[Observation], residuals: Sequence[Sequence[Array]]) -> Description:
    """Describe what is left of all runs."""
    first = max(range(len(runs)), key=lambda i: float(np.std(residuals[i][0])))
    run, left = runs[first], residuals[first][0]
    position = run.simulated_position(left)
    return Description(_parity(position, left), _memory(run, position, left),
                       _exponent(runs, residuals), _strongest_hz(left, run.sample_period),
                       _side(residuals[first]))


def _parity(position: Array, left: Array) -> str:
    """Odd and even parts of the residual as a function of motion and speed."""
    x = (position - position.mean()) / max(float(np.std(position)), 1e-300)
    v = np.gradient(position)
    v = v / max(float(np.std(v)), 1e-300)
    odd = np.array([x, v, x**3, v**3, x * x * v, x * v * v, np.sign(v), np.abs(v) * v])
    even = np.array([np.ones_like(x), x * x, v * v, x * v, np.abs(v), x**4])
    powers = [_taken(columns, left) for columns in (odd, even)]
    if max(powers) < ONE_PARITY * min(powers):
        return "both"
    return "odd" if powers[0] > powers[1] else "even"


def _taken(columns: Array, left: Array) -> float:
    solved = np.linalg.lstsq(columns.T, left, rcond=1e-9)[0]
    return float(np.sum((columns.T @ solved) ** 2)) + 1e-300


def _memory(run: Observation, position: Array, left: Array) -> bool:
    """Whether the residual depends on more than present motion, speed and input."""
    x, v = position - position.mean(), np.gradient(position)
    u = run.input[run.skip:]
    scaled = [c / float(np.std(c)) for c in (x, v, u) if np.ptp(c) > 0.0]
    present = [np.ones_like(x)]
    for c in scaled:
        present += [c, c * c, c**3, np.abs(c) * c, np.sign(c)]
    taken = _taken(np.array(present), left)
    return taken < MEMORYLESS * float(left @ left)


def _exponent(runs: Sequence[Observation], residuals: Sequence[Sequence[Array]]) -> float | None:
    """How the residual grows with amplitude, from two runs of different size."""
    sizes = [float(np.std(r.output)) for r in runs]
    lefts = [float(np.std(parts[0])) for parts in residuals]
    big, small = int(np.argmax(sizes)), int(np.argmin(sizes))
    if sizes[small] <= 0.0 or sizes[big] < SIZES_APART * sizes[small] or lefts[small] <= 0.0:
        return None
    return math.log(lefts[big] / lefts[small]) / math.log(sizes[big] / sizes[small])


def _strongest_hz(left: Array, sample_period: float) -> float | None:
    power = np.abs(np.fft.rfft((left - left.mean()) * np.hanning(left.size))) ** 2
    total = float(np.sum(power))
    if total <= 0.0:
        return None
    return float(np.fft.rfftfreq(left.size, sample_period)[int(np.argmax(power))])


def _side(parts: Sequence[Array]) -> str:
    """Actuator where the current disagrees too, mechanical where it does not."""
    if len(parts) < 2:
        return "unclear"
    current = parts[1]
    return "actuator" if float(np.std(current)) > EXCESS * high_band_rms(current) \
        else "mechanical"
