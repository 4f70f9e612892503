"""What characterize prints and reports of each experiment: names and quantities."""

from __future__ import annotations

from typing import Any


def summary(kind: str, result: Any) -> list[tuple[str, Any]]:
    """Return what a result says, as (what, Quantity) pairs."""
    if kind == "static":
        return [("stiffness", result.stiffness),
                ("largest distance from a line", result.linearity),
                ("hysteresis loop", result.hysteresis),
                ("hysteresis loop over the travel", result.hysteresis_percent)]
    if kind == "decay":
        return [("logarithmic decrement", result.decrement), ("damping ratio", result.damping),
                ("damping ratio, Eq. 2 as printed", result.damping_as_printed),
                ("natural frequency", result.natural_frequency),
                ("decrement of the first half", result.early),
                ("decrement of the second half", result.late)]
    if kind == "step":
        return [("rise time, 10 to 90 %", result.rise_time),
                (f"settling time, {100 * result.band:g} %", result.settling_time),
                ("overshoot", result.overshoot), ("time of the peak", result.peak_time),
                ("damping ratio from the overshoot", result.damping),
                ("natural frequency from the peak", result.natural_frequency)]
    fit = result.constrained
    return [("numerator", fit.numerator), ("damping, 2 zeta w", fit.damping),
            ("stiffness, w^2", fit.stiffness), ("natural frequency", fit.natural_frequency),
            ("damping ratio", fit.damping_ratio), ("static gain", fit.static_gain),
            ("amplifier lag", fit.lag), ("delay", fit.delay)]
