"""The ultimate gain of a loop, from a model or from a recorded oscillation, and the rules on it.

A proportional loop u = K (r - y) oscillates for ever at the ultimate gain K_u with the ultimate
period P_u. A second-order plant without delay has none; delay, amplifier lag and sampling give it
one. The rules are those of Ziegler and Nichols, Trans. ASME 64 (1942), 759-768.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array
from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains
from dfm_stage.control.sampled import frequency_grid
from dfm_stage.control.stage import Sampled

Rule = Literal["p", "pi", "pid"]
_RULES: dict[Rule, tuple[float, float, float]] = {
    # gain / K_u, integral time / P_u (0: none), derivative time / P_u
    "p": (0.5, 0.0, 0.0),
    "pi": (0.45, 1.0 / 1.2, 0.0),
    "pid": (0.6, 0.5, 0.125),
}
_FILTER_SHARE = 0.1


@dataclass(frozen=True)
class Ultimate:
    """Gain (V/m) and period (s) of a loop's oscillation at the limit of stability."""

    gain_v_m: float
    period_s: float


def ultimate(stage: Sampled) -> Ultimate:
    """Return the ultimate gain and period of a sampled stage, exactly.

    It is the smallest K above zero at which a pole of a - K b c crosses the unit circle: a
    frequency where the response is real and negative, found to the last digit.

    Raises
    ------
    ControlError
        If the stage alone is not stable, or no gain makes the loop oscillate.
    """
    if np.max(np.abs(np.linalg.eigvals(stage.a))) >= 1.0 - 1e-12:
        raise ControlError("ultimate gain: the stage alone must be stable; give it damping and "
                           "stiffness")
    from scipy.optimize import brentq

    def imaginary(frequency_hz: float) -> float:
        return float(stage.response(np.array([frequency_hz]))[0].imag)

    f = frequency_grid(stage)
    response = stage.response(f)
    turns = np.flatnonzero((np.signbit(response.imag[:-1]) != np.signbit(response.imag[1:]))
                           & (np.minimum(response.real[:-1], response.real[1:]) < 0.0))
    candidates = [float(brentq(imaginary, f[k], f[k + 1], xtol=1e-12)) for k in turns]
    candidates.append(0.5 / stage.sample_period_s)
    found = []
    for each in candidates:
        real = float(stage.response(np.array([each]))[0].real)
        if real < 0.0:
            found.append(Ultimate(-1.0 / real, 1.0 / each))
    for crossing in sorted(found, key=lambda one: one.gain_v_m):
        if _radius(stage, crossing.gain_v_m * (1.0 + 1e-6)) > 1.0:
            return crossing
    raise ControlError("ultimate gain: no gain makes this loop oscillate; a model with delay or "
                       "amplifier lag has one")


def _radius(stage: Sampled, gain: float) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(stage.a - gain * np.outer(stage.b, stage.c)))))


def ziegler_nichols(found: Ultimate, rule: Rule = "pid", *,
                    derivative_filter_s: float | None = None,
                    output_limit_v: float = 10.0) -> PidGains:
    """Return the gains that the classic table gives: K = 0.6 K_u, T_i = P_u / 2, T_d = P_u / 8.

    They act on the error, derivative included, as the rule has it. The rule has no filter of the
    derivative; by default its time constant is a tenth of the derivative time.

    Raises
    ------
    ControlError
        If the rule is not one of p, pi, pid, or gain or period are not above zero.
    """
    if rule not in _RULES:
        raise ControlError(f"ziegler_nichols: rule must be one of {', '.join(_RULES)}, "
                           f"not {rule!r}")
    for name, value in (("gain", found.gain_v_m), ("period", found.period_s)):
        if not (math.isfinite(value) and value > 0.0):
            raise ControlError(f"ziegler_nichols: the ultimate {name} must be above zero, "
                               f"not {value!r}")
    share, integral, derivative = _RULES[rule]
    kp, derivative_s = share * found.gain_v_m, derivative * found.period_s
    return PidGains(
        kp=kp, ki=kp / (integral * found.period_s) if integral else 0.0, kd=kp * derivative_s,
        derivative_filter_s=(_FILTER_SHARE * derivative_s if derivative_filter_s is None
                             else derivative_filter_s),
        output_limit_v=output_limit_v, setpoint_weight=1.0, derivative_weight=1.0)


@dataclass(frozen=True)
class Oscillation:
    """A steady oscillation: ratio of the fundamentals u / y (V/m), period (s), and how far u leads
    the opposite of y (rad): zero at the limit of a proportional loop."""

    gain_v_m: float
    period_s: float
    lead_rad: float


def oscillation(position: ArrayLike, voltage: ArrayLike, sample_period_s: float, *,
                periods: int = 4) -> Oscillation:
    """Return the steady oscillation at the end of a record.

    The input's fundamental is taken from the record, not as 4 d / pi, which allows for hysteresis,
    limits and the lateness of sampled switching.

    Parameters
    ----------
    position, voltage : array_like
        (N,) m and V, at t_k and held from t_k.
    periods : int
        How many whole periods at the end are used.

    Raises
    ------
    ControlError
        If there are too few periods, they differ by more than 5 %, or input and position are far
        from opposite.
    """
    y, u = np.asarray(position, dtype=np.float64), np.asarray(voltage, dtype=np.float64)
    if y.ndim != 1 or y.shape != u.shape or not np.all(np.isfinite(y + u)):
        raise ControlError("oscillation: position and voltage must be finite and of one length, "
                           f"not {y.shape} and {u.shape}")
    rises = _rises(-y)
    if rises.size < periods + 1:
        raise ControlError(f"oscillation: the record has {max(0, rises.size - 1)} whole periods, "
                           f"{periods} are needed; let it run longer")
    ends = rises[-periods - 1:]
    period = float(ends[-1] - ends[0]) / periods
    if np.ptp(np.diff(ends)) > max(0.05 * period, 2.0):
        raise ControlError("oscillation: the last periods differ by more than 5 %; let it run "
                           "longer or take a larger amplitude")
    first, last = round(float(ends[0])), round(float(ends[-1]))
    turn = np.exp(-2j * math.pi / period * np.arange(last - first))
    y_1, u_1 = np.sum(y[first:last] * turn), np.sum(u[first:last] * turn)
    lead = float(np.angle(-u_1 / y_1)) if abs(y_1) > 0.0 else math.pi
    if abs(lead) > 0.6:
        raise ControlError("oscillation: input and position are not in opposite phase; is the "
                           "loop closed, and nothing else shaking the stage?")
    return Oscillation(float(abs(u_1 / y_1)), period * sample_period_s, lead)


def ultimate_from_relays(found: Sequence[Oscillation]) -> Ultimate:
    """Return the ultimate gain from oscillations under relays that switch early and late.

    A relay (Astrom and Hagglund, Automatica 20 (1984), 645-651) holds the loop at its ultimate
    period, but a sampled one switches up to a sample late; on a lightly damped stage, whose phase
    hardly depends on frequency, that alone is 20 % of K_u. So gain and frequency are interpolated
    over the lead to where it is zero, with as many runs as there are (one: taken as it is).

    Raises
    ------
    ControlError
        If there is no run, or several whose leads are all on one side by more than 0.02 rad.
    """
    if not found:
        raise ControlError("relay: no oscillation to evaluate")
    lead = np.array([each.lead_rad for each in found])
    gain = np.array([each.gain_v_m for each in found])
    rate = np.array([1.0 / each.period_s for each in found])
    if len(found) > 1 and (np.min(lead) > 0.02 or np.max(lead) < -0.02):
        raise ControlError("relay: no run comes near opposite phase of input and position; a "
                           "relay that switches earlier or later is needed")
    weight = np.array([np.prod([b / (b - a) for j, b in enumerate(lead) if j != i])
                       for i, a in enumerate(lead)])
    return Ultimate(float(weight @ gain), 1.0 / float(weight @ rate))


def _rises(signal: Array) -> Array:
    """Return where the signal crosses its middle upwards, in samples, interpolated."""
    tail = signal[signal.size // 2:]
    middle = 0.5 * (float(np.max(tail, initial=-math.inf)) + float(np.min(tail, initial=math.inf)))
    s = signal - middle
    up = np.flatnonzero((s[:-1] < 0.0) & (s[1:] >= 0.0))
    return np.asarray(up + s[up] / (s[up] - s[up + 1]), dtype=np.float64)
