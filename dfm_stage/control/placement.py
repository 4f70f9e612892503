"""PID gains for a second-order stage by placing the closed-loop poles."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from dfm_stage.control.errors import ControlError
from dfm_stage.control.gains import PidGains
from dfm_stage.control.sampled import Margins, margins
from dfm_stage.control.stage import Sampled, sample_model, sample_stage
from dfm_stage.model import Model

Design = TypeVar("Design")
_FILTER_RATIO = 8.0     # of the derivative filter's corner to the bandwidth: costs 7 degrees there


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
    spring = math.sqrt(values.get("stiffness", 0.0) / values["mass"])
    damper = values.get("damping", 0.0) / values["mass"] / (2.0 * damping_ratio + integral_ratio)
    low = 1.02 * max(spring, damper, 1e-4 / sample_period_s) / (2.0 * math.pi)
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
