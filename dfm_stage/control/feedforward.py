"""The input that moves a sampled stage along a known reference: stable inversion.

U = R / G on the unit circle. Sampling a stage with more poles than zeros gives zeros near or
outside the unit circle (Astrom, Hagander and Sternby, Automatica 20(1), 1984), so a causal inverse
does not exist or grows; the inverse on the circle is bounded and uses the reference ahead of time
instead, delay included (Devasia, Chen and Paden, IEEE Trans. Autom. Control 41(7), 1996).
Where the reference repeats this is exact. Else it is continued smoothly to rest and held there
until the answer has died out, so that the circle closes without a trace.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dfm_stage.control.errors import ControlError
from dfm_stage.control.stage import Sampled

Array = NDArray[np.float64]
_DIED_OUT = 1e-7        # share left of the answer: below one count of an encoder
_LONGEST = 2_000_000    # samples: bounds memory and time


def periodic_input(stage: Sampled, reference: ArrayLike) -> Array:
    """Return one period (N,) of the input, V, that makes y the periodic reference (N,), m.

    Raises
    ------
    ControlError
        If the reference is not finite, or the stage does not answer at one of its frequencies.
    """
    r = _checked(reference)
    spectrum = np.fft.rfft(r)
    f = np.asarray(np.fft.rfftfreq(r.size, stage.sample_period_s), dtype=np.float64)
    answer = stage.response(f)
    wanted = np.abs(spectrum) > 1e-12 * np.max(np.abs(spectrum), initial=1e-300)
    silent = wanted & (np.abs(answer) < 1e-9 * np.max(np.abs(answer)))
    silent[-1] = False                            # half the rate: nothing smooth has that
    if np.any(silent) or not np.all(np.isfinite(answer)):
        at = f[int(np.argmax(silent))] if np.any(silent) else 0.0
        raise ControlError(f"feedforward: the stage cannot follow the reference at {at:.3g} Hz; "
                           "give the model a spring, or damping to its modes")
    out = np.where(wanted, spectrum / np.where(wanted, answer, 1.0), 0.0)
    if r.size % 2 == 0:
        out[-1] = 0.0
    return np.asarray(np.fft.irfft(out, r.size))


def inverse_input(stage: Sampled, reference: ArrayLike) -> Array:
    """Return the input (N,), V, that makes y the reference (N,), m, from rest on its first value.

    The input knows the whole reference in advance. Before it the stage has been at rest on its
    first value, so that should start gently; what comes after it is a smooth stop.

    Raises
    ------
    ControlError
        As `periodic_input`, or if the stage's answer dies out too slowly.
    """
    r = _checked(reference)
    h = stage.sample_period_s
    # zeros decay as the inverse, poles as the stage does
    rates = -np.log(np.clip(np.abs(np.concatenate((_zeros(stage), [0.5]))), 1e-12, None))
    slowest = float(np.min(np.abs(rates)))
    length = math.log(1.0 / _DIED_OUT) / max(slowest, 1e-12)
    if length > _LONGEST:
        raise ControlError("feedforward: the inverse of this model never dies out; give damping "
                           "to its modes")
    stop = _stop(r, max(2, round(1.0 / h)))
    pause = math.ceil(length)
    back = _smooth(float(stop[-1]), float(r[0]), max(2, round(1.0 / h)))
    whole = np.concatenate((r, stop, np.full(pause, stop[-1]), back, np.full(pause, r[0])))
    return periodic_input(stage, whole)[:r.size]


def _checked(reference: ArrayLike) -> Array:
    r = np.asarray(reference, dtype=np.float64)
    if r.ndim != 1 or r.size < 4 or not np.all(np.isfinite(r)):
        raise ControlError("feedforward: the reference must be at least four finite numbers, "
                           f"not shape {r.shape}")
    return r


def _zeros(stage: Sampled) -> NDArray[np.complex128]:
    """Return the finite zeros of the sampled stage, shape (q,)."""
    from scipy.linalg import eigvals

    n = stage.b.size
    pencil = np.block([[stage.a, stage.b[:, None]], [stage.c[None], np.zeros((1, 1))]])
    found = eigvals(pencil, np.diag(np.append(np.ones(n), 0.0)))
    found = np.asarray(found[np.isfinite(found)], dtype=np.complex128)
    return np.asarray(found[(np.abs(found) < 1e6) & (np.abs(found) > 1e-6)])


def _stop(r: Array, samples: int) -> Array:
    """Return how a movement comes to rest: velocity and acceleration go to zero smoothly."""
    v = (11.0 * r[-1] - 18.0 * r[-2] + 9.0 * r[-3] - 2.0 * r[-4]) / 6.0
    a = 2.0 * r[-1] - 5.0 * r[-2] + 4.0 * r[-3] - r[-4]
    t = np.arange(1, samples + 1, dtype=np.float64)
    u = t / samples
    # r(0), v, a given; zero velocity and acceleration at the end, wherever that is
    fade = 1.0 - u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
    return np.asarray(r[-1] + np.cumsum((v + a * t * (1.0 - u)) * fade))


def _smooth(first: float, last: float, samples: int) -> Array:
    u = np.arange(1, samples + 1, dtype=np.float64) / samples
    return np.asarray(first + (last - first) * u**4 * (35.0 - 84.0 * u + 70.0 * u**2
                                                       - 20.0 * u**3))
