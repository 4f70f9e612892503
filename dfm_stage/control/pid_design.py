"""Gains of a PID for a model: by placing the closed-loop poles, or from the ultimate gain.

A proportional loop u = K (r - y) oscillates for ever at the ultimate gain K_u with the ultimate
period P_u; both come from a model or from a recorded oscillation. A second-order plant without
delay has none; delay, amplifier lag and sampling give it one. The rules are those of Ziegler and
Nichols, Trans. ASME 64 (1942), 759-768.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dfm_stage.arrays import Array
from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains
from dfm_stage.control.stage import (
    Margins,
    Sampled,
    frequency_grid,
    margins,
    radius,
    sample_model,
    sample_stage,
)
from dfm_stage.model import Model

Design = TypeVar("Design")
_FILTER_RATIO = 8.0     # of the derivative filter's corner to the bandwidth: costs 7 degrees there
Rule = Literal["p", "pi", "pid"]
_RULES: dict[Rule, tuple[float, float, float]] = {
    # gain / K_u, integral time / P_u (0: none), derivative time / P_u
    "p": (0.5, 0.0, 0.0),
    "pi": (0.45, 1.0 / 1.2, 0.0),
    "pid": (0.6, 0.5, 0.125),
}
_FILTER_SHARE = 0.1


@dataclass(frozen=True)
class PidDesign:
    """Gains, the margins they leave on the sampled model, and why they are what they are."""

    gains: PidGains
    margins: Margins
    reason: str


def pid_for(base: Mapping[str, float] | Model, bandwidth_hz: float, *,
            sample_period_s: float = 1e-3,
            damping_ratio: float = 0.8, integral_ratio: float = 0.3, output_limit_v: float = 10.0,
            feedforward: bool = True,
            notch: tuple[float, float] | None = None) -> PidDesign:
    """Return PID gains that put the poles of a mass on a spring where they are wanted.

    With m x'' + c x' + k x = K u and w = 2 pi bandwidth_hz, the gains

        kp = (m w^2 (1 + 2 zeta alpha) - k) / K,  ki = m alpha w^3 / K,
        kd = (m w (2 zeta + alpha) - c) / K

    give the characteristic polynomial (s + alpha w)(s^2 + 2 zeta w s + w^2) (Astrom and
    Hagglund, Advanced PID Control, sec. 6.4). Delay, amplifier lag, sampling and the derivative's
    filter, 1 / (8 w), are left out there and counted in `margins`.

    Parameters
    ----------
    base : mapping or Model
        As in a model.yaml: mass, force_constant; damping, stiffness, delay,
        amplifier_time_constant where there are such. The margins of a one-axis Model count its
        second mode too.
    bandwidth_hz, damping_ratio, integral_ratio : float
        Distance of the complex poles from the origin over 2 pi; zeta and alpha.
    feedforward : bool
        Add the inverse model's output, and let the reference's velocity act in the derivative
        part; steps of the reference still give no derivative kick.
    notch : tuple of float, optional
        Frequency (Hz) and damping ratio of a mode that a notch takes out of the feedback.

    Raises
    ------
    ControlError
        If the model lacks mass or force constant, a number is not positive, the bandwidth is so
        low that the spring alone is stiffer, or so high that the sampled loop is unstable.
    """
    for name, value in (("bandwidth_hz", bandwidth_hz), ("sample_period_s", sample_period_s),
                        ("damping_ratio", damping_ratio), ("integral_ratio", integral_ratio)):
        if not (math.isfinite(value) and value > 0.0):
            raise ControlError(f"{name} must be a positive number, not {value!r}")
    base, stage = _stage_of(base, sample_period_s)
    gains = _placed(base, bandwidth_hz, damping_ratio, integral_ratio).changed(
        {"output_limit_v": output_limit_v})
    if feedforward:
        gains = gains.changed(_inverse(base, gains, sample_period_s))
    if notch is not None:
        gains = gains.changed({"notch_hz": notch[0], "notch_depth_damping": notch[1]})
    found = margins(stage, gains)
    if not found.stable:
        raise ControlError(f"bandwidth_hz = {bandwidth_hz:g} Hz is unstable with the model's "
                           f"delay and lag at {1.0 / sample_period_s:g} Hz sampling; ask for less")
    law = "inverse model fed forward" if feedforward else (
        f"setpoint weight {gains.setpoint_weight:.2f} cancels the integral's pole")
    reason = (f"poles at {bandwidth_hz:g} Hz with damping ratio {damping_ratio:g} and at "
              f"{integral_ratio * bandwidth_hz:g} Hz for the integral; derivative filtered at "
              f"{_FILTER_RATIO * bandwidth_hz:g} Hz; {law}; "
              f"{f'notch at {notch[0]:.4g} Hz; ' if notch else ''}the sampled loop with delay and "
              f"lag keeps a modulus margin of {found.modulus:.2f}, {found.phase_deg:.0f} degrees "
              f"of phase and a gain margin of {found.gain:.1f}")
    return PidDesign(gains, found, reason)


def _placed(base: Mapping[str, float], bandwidth_hz: float, zeta: float,
            alpha: float) -> PidGains:
    """Return the gains of the equations above, without feedforward."""
    m, gain = base["mass"], base["force_constant"]
    c, k = base.get("damping", 0.0), base.get("stiffness", 0.0)
    w = 2.0 * math.pi * bandwidth_hz
    kp = (m * w**2 * (1.0 + 2.0 * zeta * alpha) - k) / gain
    kd = (m * w * (2.0 * zeta + alpha) - c) / gain
    ki = m * alpha * w**3 / gain
    if kp <= 0.0 or kd <= 0.0:
        least = math.sqrt(k / m / (1.0 + 2.0 * zeta * alpha)) / (2.0 * math.pi)
        raise ControlError(f"bandwidth_hz = {bandwidth_hz:g} Hz is below what spring and damper "
                           f"give without control; ask for more than {least:.3g} Hz")
    return PidGains(kp=kp, ki=ki, kd=kd, derivative_filter_s=1.0 / (_FILTER_RATIO * w),
                    setpoint_weight=min(1.0, ki / (kp * alpha * w)))


def _inverse(base: Mapping[str, float], gains: PidGains,
             sample_period_s: float) -> dict[str, float]:
    """Return the feedforward gains that invert the base model with this PID beside it."""
    gain, late = base["force_constant"], gains.derivative_filter_s + 0.5 * sample_period_s
    return {"feedforward_position": (base.get("stiffness", 0.0) / gain
                                     + gains.kp * (1.0 - gains.setpoint_weight)),
            "feedforward_velocity": base.get("damping", 0.0) / gain + gains.kd,
            "feedforward_acceleration": base["mass"] / gain - gains.kd * late}


def pid_with_margin(base: Mapping[str, float] | Model, modulus_margin: float = 0.5, *,
                    sample_period_s: float = 1e-3, damping_ratio: float = 0.8,
                    integral_ratio: float = 0.3, output_limit_v: float = 10.0,
                    feedforward: bool = True,
                    notch: tuple[float, float] | None = None) -> PidDesign:
    """Return the fastest `pid_for` that keeps the modulus margin; its bandwidth to 1 %.

    Raises
    ------
    ControlError
        As `pid_for`, or if no bandwidth keeps the margin.
    """
    if not 0.0 < modulus_margin < 1.0:
        raise ControlError(f"modulus_margin must lie between 0 and 1, not {modulus_margin!r}")

    design = partial(pid_for, base, sample_period_s=sample_period_s, damping_ratio=damping_ratio,
                     integral_ratio=integral_ratio, output_limit_v=output_limit_v,
                     feedforward=feedforward, notch=notch)
    values, _ = _stage_of(base, sample_period_s)
    damper = values.get("damping", 0.0) / values["mass"] / (2.0 * damping_ratio + integral_ratio)
    low = 1.02 * max(math.sqrt(values.get("stiffness", 0.0) / values["mass"]), damper,
                     1e-4 / sample_period_s) / (2.0 * math.pi)
    best = if_stable(design, low)
    if best is None or best.margins.modulus < modulus_margin:
        raise ControlError(f"no bandwidth above the stage's own {low:.3g} Hz keeps a modulus "
                           f"margin of {modulus_margin:g}; lower the margin or the delay")
    high = 0.25 / sample_period_s
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        found = if_stable(design, middle)
        if found is not None and found.margins.modulus >= modulus_margin:
            low, best = middle, found
        else:
            high = middle
    return best


def if_stable(design: Callable[..., Design], *arguments: Any) -> Design | None:
    """Return the design, None where there is none that is stable."""
    try:
        return design(*arguments)
    except ControlError:
        return None


def _stage_of(base: Mapping[str, float] | Model,
              sample_period_s: float) -> tuple[Mapping[str, float], Sampled]:
    if isinstance(base, Model):
        return base.base, sample_model(base, sample_period_s)
    return base, sample_stage(base, sample_period_s)


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
    if radius(stage.a) >= 1.0 - 1e-12:
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
    real = stage.response(np.array(candidates)).real.tolist()
    for gain, period in sorted((-1.0 / size, 1.0 / each) for size, each in zip(
            real, candidates, strict=True) if size < 0.0):
        if radius(stage.a - gain * (1.0 + 1e-6) * np.outer(stage.b, stage.c)) > 1.0:
            return Ultimate(gain, period)
    raise ControlError("ultimate gain: no gain makes this loop oscillate; a model with delay or "
                       "amplifier lag has one")


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
    period, but a sampled one switches up to a sample late. The phase of a lightly damped stage
    hardly depends on frequency, so that alone is 20 % of K_u. So gain and frequency are
    interpolated over the lead to where it is zero. A single run is taken as it is.

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
