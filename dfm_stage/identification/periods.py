"""Finding the period, the excited lines and the transient of a periodic record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dfm_stage.arrays import Array, Complex, Lines

SHORTEST_PERIOD, FEWEST_PERIODS = 8, 2
"""In samples: of fewer, no multisine has lines; and in whole periods, to repeat at all."""
REPETITION = 0.05
"""Difference (1 = unrelated) up to which a signal repeats: a measured input has some noise."""
HUMP = 0.5
"""Difference (1 = unrelated) that a shift must pass before a repetition counts: a smooth signal
repeats itself at tiny shifts."""
AS_GOOD = 2.0
"""Times the smallest difference at which a shorter period is as good: that of its noise."""
SMALLEST_DIFFERENCE = 1e-9
"""Rounding of the correlation; an exact repetition differs by no more."""
RUN_NOISE, RUN_ROUNDING, RUN_WINDOW_TOLERANCE = 4.0, 1e-6, 20.0
"""How far a window of the repeating stretch may differ: times the smallest difference, plus
rounding, times what a short window scatters more than the mean."""
WINDOWS_A_PERIOD = 20
"""Windows in which the repeating stretch is looked for: fine enough to cut off rest and start."""
DECADES, SMALLEST_GAP = 3.0, 0.3
"""How far (log10) below the largest line others are looked for; how wide a gap is a border."""
STANDS_OUT = 4.0
"""Standard deviations of its amplitude by which an excited line exceeds zero."""
FEWEST_TO_COMPARE = 3
"""Periods: of two, no later half says what settled looks like."""
SMOOTHED_OVER = 5
"""Lines on either side over which the noise is averaged."""
SETTLED = 11.5
"""log(1 / false alarms): one record in a hundred thousand settled looks unsettled."""


@dataclass(frozen=True)
class Periodicity:
    """`period` in samples, first sample `start` and number `count` of whole periods."""

    period: int
    start: int
    count: int

    def fold(self, signal: Array) -> Array:
        """Return the periods of `signal` (N,) as rows (count, period)."""
        stop = self.start + self.count * self.period
        return np.asarray(signal[self.start:stop].reshape(self.count, self.period))


def find_period(signal: Array, *, minimum: int = SHORTEST_PERIOD,
                tolerance: float = REPETITION) -> Periodicity | None:
    """Find the shortest exact repetition in `signal` (N,), None where there is none.

    The difference function d(P) = mean (x(t) - x(t+P))^2 / (2 var) (de Cheveigne and Kawahara
    2002) is scanned over the middle of the record, so that rest before and after the excitation
    does not matter; the best P has the smallest d, the shortest P as good as it (within twice the
    noise) wins. `tolerance` is the largest d that counts as a repetition: zero for commands,
    noise over signal power for a measured input. At least two periods must fit.
    """
    x = np.asarray(signal, dtype=float)
    active = np.flatnonzero(x != x[0])
    if active.size < FEWEST_PERIODS * minimum:
        return None
    moving = np.flatnonzero(np.diff(x) != 0.0)
    first, last = int(moving[0]), int(moving[-1]) + 2
    inner = x[first:last] - np.mean(x[first:last])
    difference = _difference(inner)
    if difference.size <= minimum:
        return None
    candidates = difference[minimum:]
    hump = np.flatnonzero(candidates > HUMP)
    if not hump.size:
        return None
    later = candidates[hump[0]:]
    best = float(later.min())
    if best > tolerance:
        return None
    good = np.flatnonzero(later <= AS_GOOD * best + SMALLEST_DIFFERENCE)
    period = int(minimum + hump[0] + good[0])
    run_start, run_stop = _repeating_run(
        x, period, RUN_NOISE * max(best, SMALLEST_DIFFERENCE) + RUN_ROUNDING)
    count = (run_stop - run_start) // period
    if count < FEWEST_PERIODS:
        return None
    return Periodicity(period, run_stop - count * period, count)


def _difference(x: Array) -> Array:
    """Return d(P) for P = 0 .. N // 2 through the autocorrelation."""
    samples = x.size
    size = 1 << (2 * samples).bit_length()
    spectrum = np.fft.rfft(x, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: samples // 2 + 1]
    power = np.concatenate(([0.0], np.cumsum(x**2)))
    shifts = np.arange(samples // 2 + 1)
    head = power[samples - shifts]
    tail = power[samples] - power[shifts]
    total = np.maximum(head + tail, 1e-300)
    return np.asarray((total - 2.0 * correlation) / total)


def _repeating_run(x: Array, period: int, tolerance: float) -> tuple[int, int]:
    """Return start and stop of the stretch in which x repeats with `period`.

    Compared a window of a twentieth of the period at a time, so that noise does not end the run.
    """
    power = float(np.var(x[np.flatnonzero(np.diff(x))[0]:]))
    window = max(period // WINDOWS_A_PERIOD, 1)
    squared = (x[period:] - x[:-period]) ** 2 / (2.0 * power)
    sums = np.concatenate(([0.0], np.cumsum(squared)))
    blocks = squared.size // window
    if blocks == 0:
        return 0, 0
    stop = squared.size
    edges = np.unique(np.append(stop - window * np.arange(blocks, -1, -1), 0))
    means = (sums[edges[1:]] - sums[edges[:-1]]) / np.diff(edges)
    # Edges of the runs of good windows, as (first, last + 1); the longest of them, the first of
    # equals.
    good = np.concatenate(([False], means <= RUN_WINDOW_TOLERANCE * tolerance, [False]))
    runs = np.flatnonzero(np.diff(good)).reshape(-1, 2)
    if not runs.size:
        return 0, 0
    first, last = runs[np.argmax(np.diff(runs))]
    return int(edges[first]), int(edges[last]) + period


def excited_lines(input_spectrum: Array, noise: Array | None = None) -> Lines:
    """Return the DFT lines that carry the excitation, from mean amplitudes (period // 2 + 1,).

    The line amplitudes of a multisine fall into two groups with a gap between them; the widest
    gap in logarithm, looked for within three decades of the largest, is the border. `noise` is
    the standard deviation of the amplitudes over periods; a line must exceed it four times.
    """
    amplitude = np.asarray(input_spectrum, dtype=float).copy()
    amplitude[0] = 0.0
    largest = amplitude.max()
    if largest <= 0.0:
        return np.empty(0, dtype=np.int64)
    logs = np.sort(np.log10(np.maximum(amplitude[1:] / largest, 1e-12)))
    ladder = logs[max(int(np.count_nonzero(logs <= -DECADES)) - 1, 0):]
    gaps = np.diff(ladder, append=ladder[-1])
    widest = int(np.argmax(gaps))
    border = (float(ladder[widest] + 0.5 * gaps[widest]) if gaps[widest] > SMALLEST_GAP
              else -DECADES)
    limit = largest * 10.0**border
    chosen = amplitude > limit
    if noise is not None:
        chosen &= amplitude > STANDS_OUT * noise
    return np.flatnonzero(chosen).astype(np.int64)


def settled_from(lines: Complex) -> int:
    """Return how many leading periods (rows of (M, F) line spectra) still hold a transient.

    Each period is compared with the mean of the later half; the noise of a line comes from that
    half. A period counts as settled when its largest deviation over lines stays below what noise
    gives once in a hundred thousand records. With fewer than four periods only the first is
    looked at.
    """
    count, width = lines.shape
    if count < FEWEST_TO_COMPARE:
        return 0
    half = max(count // 2, 2)
    late = lines[-half:]
    centre = late.mean(axis=0)
    variance = np.sum(np.abs(late - centre) ** 2, axis=0) / (half - 1)
    smooth = local_mean(variance, SMOOTHED_OVER)
    smooth = np.maximum(smooth, 1e-6 * np.mean(smooth) + 1e-300)
    limit = (np.log(max(width, 1)) + SETTLED) * (1.0 + 1.0 / half)
    # Few periods leave the variance itself uncertain.
    limit *= 1.0 + 3.0 / np.sqrt((half - 1) * min(width, 2 * SMOOTHED_OVER + 1))
    deviation = np.max(np.abs(lines - centre) ** 2 / smooth, axis=1)
    bad = np.flatnonzero(deviation[: count - half] > limit)
    return int(bad[-1]) + 1 if bad.size else 0


def without_transient(signal: Array, found: Periodicity, poles: Sequence[complex],
                      sample_period: float) -> Array:
    """Return `signal` (N,) less the decaying free motion that `poles` (1/s) allow.

    What differs between periods is free motion and noise; amplitude and phase of each pole are
    fitted to it by least squares. Poles that do not decay take no part.
    """
    time = np.arange(found.count * found.period) * sample_period
    columns = []
    for pole in poles:
        if pole.real >= 0.0 or pole.imag < 0.0:
            continue
        motion = np.exp(pole * time)
        columns += [motion.real, motion.imag] if pole.imag > 0.0 else [motion.real]
    if not columns:
        return signal
    shape = (len(columns), found.count, found.period)
    folded = np.array(columns).reshape(shape)
    varying = (folded - folded.mean(axis=1, keepdims=True)).reshape(len(columns), -1)
    measured = found.fold(signal)
    target = (measured - measured.mean(axis=0)).ravel()
    gram = varying @ varying.T
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    amplitude = np.linalg.lstsq(gram / np.outer(norm, norm), (varying @ target) / norm,
                                rcond=1e-12)[0] / norm
    cleaned = np.array(signal, dtype=float)
    stop = found.start + found.count * found.period
    cleaned[found.start:stop] -= amplitude @ folded.reshape(len(columns), -1)
    return cleaned


def local_mean(values: Array, half_width: int) -> Array:
    """Return the running mean over 2 * half_width + 1 neighbours, fewer at the ends."""
    sums = np.concatenate(([0.0], np.cumsum(values)))
    index = np.arange(values.size)
    low = np.maximum(index - half_width, 0)
    high = np.minimum(index + half_width + 1, values.size)
    return np.asarray((sums[high] - sums[low]) / (high - low))

