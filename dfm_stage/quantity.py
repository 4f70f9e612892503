"""Numbers with their units and 95 % intervals, and how people read them.

A prefix that fits, digits that mean something, and the interval where there is one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_SCALABLE = ("m", "s", "V", "A", "N", "Hz", "W", "H", "F", "m/s", "m/V", "m/N", "N/V", "N/A")
MOST_ZEROS = 2
"""Zeros after the point of an interval above which it stands in brackets: 0.012 does not."""
SMALLEST_PLAIN, LARGEST_PLAIN = 1e-3, 1e5
"""Between which a value with an interval is written without a power of ten."""
SKEWED = 0.1
"""Distance of an interval's middle from the value, over half its width, that is told."""
LEAST_SHOWN = 0.05
"""Share of half an interval's width below which a number has no digit left beside it."""
_SYMBOLS = {"ohm": "Ω", "deg": "°"}


@dataclass(frozen=True)
class Quantity:
    """`value` in an SI `unit` with the 95 % interval `ci95`; None means held, not estimated."""

    value: float
    unit: str = ""
    ci95: tuple[float, float] | None = None

    @property
    def half_width(self) -> float:
        """Half the width of the interval, zero for a held value."""
        return 0.0 if self.ci95 is None else 0.5 * (self.ci95[1] - self.ci95[0])

    @property
    def bounded(self) -> bool:
        """Whether there is an interval, with two finite limits."""
        return self.ci95 is not None and all(map(math.isfinite, self.ci95))

    def covers(self, truth: float) -> bool:
        """Whether the interval contains `truth`."""
        return self.ci95 is not None and self.ci95[0] <= truth <= self.ci95[1]

    def to_dict(self) -> dict[str, Any]:
        """As JSON keeps it; limits that are not finite become null."""
        return {"value": float(self.value), "unit": self.unit,
                "ci95": None if self.ci95 is None else [
                    float(x) if math.isfinite(x) else None for x in self.ci95]}

    def __str__(self) -> str:
        return format_quantity(self.value, self.unit, self.ci95)


def display_unit(values: Iterable[float], unit: str) -> tuple[float, str]:
    """Return (factor, unit): what to multiply `values` in `unit` by, and the unit they then have.

    The prefix brings the largest absolute value to between about 1 and 1000 (0.99 V stays in
    volts). Units that take no prefix come back with factor 1.
    """
    finite = [abs(float(v)) for v in values if math.isfinite(v) and v != 0.0]
    if unit not in _SCALABLE or not finite:
        return 1.0, _typeset(unit)
    largest = max(finite) * 1.02
    usable = [each for each in _PREFIXES
              if each[0] <= 1.0 or unit not in ("s", "m", "m/s", "m/V", "m/N")]
    scale, prefix = next((each for each in usable if largest >= each[0]), usable[-1])
    return 1.0 / scale, prefix + unit


def format_number(value: float, digits: int = 4) -> str:
    """Return a number with at most `digits` significant digits, and a real minus sign."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else ("∞" if value > 0 else "−∞")
    if value == 0.0:
        return "0"
    exponent = math.floor(math.log10(abs(value)))
    if -4 <= exponent < 6:
        text = _bare(f"{value:.{max(0, digits - 1 - exponent)}f}")
    else:
        mantissa, power = f"{value:.{digits - 1}e}".split("e")
        text = f"{_bare(mantissa)}·10{_superscript(int(power))}"
    return text.replace("-", "−")


def format_quantity(value: float, unit: str = "",
                    ci95: tuple[float, float] | None = None) -> str:
    """Return "24.510 ± 0.012 rad/s": the interval to two digits decides those of the value.

    An interval that is small beside a digit of the value stands in brackets, in units of the last
    digit: "3.9008867(55) Hz" is 3.9008867 ± 0.0000055 Hz. Values that no prefix brings near one
    get a power of ten. An interval that is not symmetric about the value (by more than a tenth) is
    written out; where it is so wide that the value or an end would be rounded to nothing, each
    number has its own digits.
    """
    factor, shown = display_unit((value,), unit)
    tail = f" {shown}" if shown and shown != "°" else shown
    if ci95 is None or not all(math.isfinite(bound) for bound in ci95):
        return format_number(value * factor) + tail
    low, high = (float(bound) * factor for bound in ci95)
    value *= factor
    half = 0.5 * (high - low)
    if not half > 0.0:
        return format_number(value) + tail
    skewed = abs(0.5 * (low + high) - value) > SKEWED * half
    if skewed and any(0.0 < abs(each) < LEAST_SHOWN * half for each in (value, low, high)):
        value_text, *ends = (format_number(each, 3) for each in (value, low, high))
        return f"{value_text} ({' to '.join(ends)}){tail}"
    largest = max(abs(value), half)
    exponent = 0 if SMALLEST_PLAIN <= largest < LARGEST_PLAIN else math.floor(math.log10(largest))
    scale = 10.0**-exponent
    value, low, high, half = (scale * each for each in (value, low, high, half))
    decimals = 1 - math.floor(math.log10(half))
    if round(half * 10.0**decimals) == 100:  # 0.0996 is 0.10
        decimals -= 1
    if skewed:
        text = f"{_to(value, decimals)} ({_to(low, decimals)} to {_to(high, decimals)})"
    elif decimals > MOST_ZEROS + 1:
        text = f"{_to(value, decimals)}({round(half * 10.0**decimals)})"
    else:
        text = f"{_to(value, decimals)} ± {_to(half, decimals)}"
        text = f"({text})" if exponent else text
    power = f"·10{_superscript(exponent)}" if exponent else ""
    return text.replace("-", "−") + power + tail


def _to(value: float, decimals: int) -> str:
    """A number to so many decimals, of which negative ones are zeros before the point."""
    return f"{round(value, decimals):.{max(0, decimals)}f}"


def superscript_power(value: float) -> str:
    """Return a power of ten as "10⁻³", small ones as plain numbers."""
    exponent = round(math.log10(value)) if value > 0.0 else 0
    if value > 0.0 and np.isclose(value, 10.0**exponent) and not -3 <= exponent <= 4:
        return f"10{_superscript(exponent)}"
    return f"{value:g}".replace("-", "−")


def _typeset(unit: str) -> str:
    """Return "m/(V s^2)" as "m/(V·s²)"."""
    raised = re.sub(r"\^(-?\d+)", lambda power: _superscript(int(power.group(1))), unit)
    return _SYMBOLS.get(unit, raised.replace(" ", "·"))


def _bare(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def _superscript(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
