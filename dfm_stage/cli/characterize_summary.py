"""What characterize prints and reports of each experiment: names and quantities."""

from __future__ import annotations

from typing import Any

RESPONSE = {
    "numerator": "numerator", "damping, 2 zeta w": "damping", "stiffness, w^2": "stiffness",
    "natural frequency": "natural_frequency", "damping ratio": "damping_ratio",
    "static gain": "static_gain", "amplifier lag": "lag", "delay": "delay"}
QUANTITIES: dict[str, dict[str, str]] = {
    "static": {"stiffness": "stiffness", "largest distance from a line": "linearity",
               "hysteresis loop": "hysteresis",
               "hysteresis loop over the travel": "hysteresis_percent"},
    "decay": {"logarithmic decrement": "decrement", "damping ratio": "damping",
              "damping ratio, Eq. 2 as printed": "damping_as_printed",
              "natural frequency": "natural_frequency",
              "decrement of the first half": "early", "decrement of the second half": "late"},
    "step": {"rise time, 10 to 90 %": "rise_time", "settling time, {band:g} %": "settling_time",
             "overshoot": "overshoot", "time of the peak": "peak_time",
             "damping ratio from the overshoot": "damping",
             "natural frequency from the peak": "natural_frequency"},
    "stepped_sine": RESPONSE, "multisine": RESPONSE,
}
"""What is told of each kind of experiment: words, and the attribute of its result."""


def summary(kind: str, result: Any) -> list[tuple[str, Any]]:
    """Return what a result says, as (what, Quantity) pairs."""
    found = getattr(result, "constrained", result)
    band = 100.0 * getattr(found, "band", 0.0)
    return [(words.format(band=band), getattr(found, name))
            for words, name in QUANTITIES[kind].items()]
