"""Iterative learning for a movement that repeats: what was wrong this time is right the next.

Pass j adds the periodic voltage u_j to the loop; afterwards, per frequency of the period,

    U_j+1 = U_0 + Q (U_j - U_0 + L E_j),    L = gain / T,    T = G / (1 + G C)

with U_0 what is known before (the model's inverse, or nothing), E the error r - y, G the stage, C
the feedback law and Q a low-pass without phase. With another stage, T_i in place of T, the error
shrinks by |Q (1 - L T_i)| per pass: it converges if that is below one at every frequency (Norrlof
and Gunnarsson, Int. J. Control 75(14), 2002).
`design_learning` computes this for the model and all candidates it is given, takes the L, smaller
and turned in phase where they differ, that makes the worst of them converge fastest, does not
learn at the frequencies where it would not shrink, and refuses where these are the movement's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array, Complex
from dfm_stage.control.errors import ControlError
from dfm_stage.control.stage import Sampled, sample_model
from dfm_stage.model import Model

Law = Callable[[Array], Complex]
_WIDTH = 0.25       # of the cutoff, over which the low-pass falls: a smooth edge rings little
_WORSE = 3.0        # times the best error: noise alone does not reach that


@dataclass(frozen=True)
class LearningDesign:
    """Filters at the frequencies k / (N h), k = 0 ... N // 2, and what they promise.

    `contraction` is the largest |Q (1 - L T)| over frequencies and candidates: the factor by which
    the part of the error that can be learnt shrinks per pass, at worst.
    """

    samples: int
    learning: Complex
    robustness: Array
    contraction: float
    cutoff_hz: float


def design_learning(stage: Sampled, law: Law, samples: int, *, candidates: Sequence[Sampled] = (),
                    gain: float = 0.5, cutoff_hz: float | None = None,
                    slowest: float = 0.97) -> LearningDesign:
    """Return the learning filters for a period of `samples`.

    Parameters
    ----------
    stage : Sampled
        The model.
    law : callable
        Frequencies (F,) in Hz to the feedback's response from -y to u, V/m.
    samples : int
        Length N of the period.
    candidates : sequence of Sampled
        What the stage may be instead; the model itself is always among them. The feedback loop
        has to be stable with each of them.
    gain : float
        Share of an error taken off at once; below one averages the noise of passes.
    cutoff_hz : float, optional
        Learn up to here, by default to an eighth of the sample rate.
    slowest : float
        Where a candidate shrinks the error by less than this factor, nothing is learnt.

    Raises
    ------
    ControlError
        If that is so at one of the period's first three frequencies, where the movement is.
    """
    if not 0.0 < gain <= 1.0:
        raise ControlError(f"learning: gain must lie between 0 and 1, not {gain!r}")
    if samples < 8:
        raise ControlError(f"learning: a period of {samples} samples is too short")
    h = stage.sample_period_s
    f = np.asarray(np.fft.rfftfreq(samples, h), dtype=np.float64)
    feedback = law(np.maximum(f, f[1] * 1e-3))
    plants = [each.response(np.maximum(f, f[1] * 1e-3)) for each in (stage, *candidates)]
    through = [plant / (1.0 + plant * feedback) for plant in plants]
    model = through[0]
    usable = np.abs(model) > 1e-6 * float(np.max(np.abs(model)))
    learning, worst = _most_robust(np.where(usable, gain / np.where(usable, model, 1.0), 0.0),
                                   through)
    learning[0], worst[0] = 0.0, 1.0              # integral action leaves nothing to learn there
    cutoff_hz = cutoff_hz or 0.125 / h
    q = np.where(worst < slowest, _low_pass(f, cutoff_hz), 0.0)
    if np.min(q[1:4]) == 0.0:
        at = 1 + int(np.argmin(q[1:4]))
        raise ControlError(f"learning: at {f[at]:.3g} Hz the error would change by "
                           f"{worst[at]:.2f} per pass with a stage that is possible here; it is "
                           "not started")
    return LearningDesign(samples, learning, q, float(np.max(q * worst)), cutoff_hz)


def _most_robust(learning: Complex, through: Sequence[Complex]) -> tuple[Complex, Array]:
    """Return the filter, turned and shrunk per frequency so that the worst candidate converges
    fastest, and how fast that is."""
    best, least = learning, np.full(learning.size, np.inf)
    for factor in np.outer(np.geomspace(1.0, 0.03, 16),
                           np.exp(1j * np.linspace(-1.4, 1.4, 29))).ravel():
        tried = factor * learning
        worst = np.max([np.abs(1.0 - tried * each) for each in through], axis=0)
        better = worst < least - 1e-6
        best, least = np.where(better, tried, best), np.where(better, worst, least)
    return best, least


def neighbours(model: Model, share: float = 0.1) -> list[Sampled]:
    """Return what the stage may be instead of a one-axis model: each parameter up and down.

    Mass, stiffness, damping, force constant and delay, and those of effects that are part of the
    linear stage, such as a second mode, one at a time by `share` of their value.
    """
    names = [name for name in ("mass", "stiffness", "damping", "force_constant", "delay")
             if model.base.get(name)]
    names += [f"{use.name}.{name}" for use in model.effects if use.effect.stamp
              for name in use.parameters]
    values = model.parameters()
    return [sample_model(model.with_parameters({name: values[name] * factor}))
            for name in names for factor in (1.0 - share, 1.0 + share)]


def _low_pass(f: Array, cutoff_hz: float) -> Array:
    """One up to the cutoff, then a quarter of it to fall to zero."""
    u = np.clip((f - cutoff_hz) / (_WIDTH * cutoff_hz), 0.0, 1.0)
    return np.asarray(0.5 * (1.0 + np.cos(np.pi * u)))


class Learner:
    """The learnt signal of one axis, pass by pass.

    `signal` (N,) V is what the next pass adds, `best` that of the pass with the smallest error so
    far; `errors` the RMS of each pass's error, m. `stopped`
    is empty, or says why learning ended: then `signal` is that of the best pass.
    """

    def __init__(self, design: LearningDesign, start: ArrayLike | None = None) -> None:
        self.design = design
        self.signal: Array = (np.zeros(design.samples) if start is None
                              else np.array(start, dtype=np.float64))
        if self.signal.shape != (design.samples,):
            raise ControlError(f"learning: the signal to start from has shape "
                               f"{self.signal.shape}, the period {design.samples} samples")
        self._start = self.best = self.signal
        self.errors: list[float] = []
        self.stopped = ""

    def update(self, error: ArrayLike) -> Array:
        """Learn from the error r - y (N,), m, of the pass that used `signal`; return the next.

        A pass that is three times worse than the best one ends the learning.

        Raises
        ------
        ControlError
            If the error is not N finite numbers.
        """
        e = np.asarray(error, dtype=np.float64)
        if e.shape != self.signal.shape or not np.all(np.isfinite(e)):
            raise ControlError(f"learning: the error must be {self.signal.size} finite numbers")
        if self.stopped:
            return self.signal
        rms = float(np.sqrt(np.mean(e**2)))
        least = min(self.errors, default=math.inf)
        if rms > _WORSE * least:
            self.stopped = (f"pass {len(self.errors) + 1} has {rms / least:.1f} times "
                            "the error of the best one")
            self.signal = self.best
            return self.signal
        if rms <= least:
            self.best = self.signal
        self.errors.append(rms)
        d = self.design
        spectrum = d.robustness * (np.fft.rfft(self.signal - self._start)
                                   + d.learning * np.fft.rfft(e))
        self.signal = self._start + np.fft.irfft(spectrum, d.samples)
        return self.signal
