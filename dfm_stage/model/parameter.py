"""Parameters: how each is described, those of the base of one axis, and the model's errors.

The base is mass, spring, damper, coil, amplifier and encoder. The plant they describe, with
`u` the held command, `e` the drive and `y` the reading:

    s(t) = clip(u(t - delay))                          dead time, then the limit
    amplifier_time_constant * a' = s - a               amplifier
    (coil_inductance / coil_resistance) * e' = a - back_emf * x' - e        coil
    mass * x'' + damping * x' + stiffness * x = force_constant * e
    y = x + encoder_zero + noise, rounded to encoder_resolution

An absent parameter is zero: no spring, no dead time, no lag, no noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from dfm_stage.errors import DfmError


class ModelError(DfmError):
    """A model is malformed: an unknown name, a value out of range, a part that is missing."""


class SimulationError(DfmError):
    """A simulation cannot be done as asked, or did not arrive at an answer."""


class ParameterError(DfmError):
    """A parameter is unknown, of the wrong type, not finite or out of range."""


@dataclass(frozen=True)
class Parameter:
    """One real-valued parameter.

    `low` and `high` are the inclusive limits of what is physically allowed; infinite where there
    is none. `unit` is empty for a pure number.
    """

    name: str
    default: float
    unit: str
    description: str
    low: float = -math.inf
    high: float = math.inf

    def checked(self, value: object, where: str = "") -> float:
        """Return `value` as a float.

        Raises
        ------
        ParameterError
            If it is not a finite number inside [low, high].
        """
        place = f"{where}: " if where else ""
        unit = f" {self.unit}" if self.unit else ""
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ParameterError(f"{place}{self.name} must be a number{unit and ' in'}{unit}, "
                                 f"not {value!r}")
        try:
            number = float(value)
        except OverflowError:       # a whole number of hundreds of digits
            number = math.inf
        if not math.isfinite(number):
            raise ParameterError(f"{place}{self.name} must be finite, not {value!r}")
        if not self.low <= number <= self.high:
            raise ParameterError(f"{place}{self.name} = {number:g}{unit} is outside "
                                 f"[{self.low:g}, {self.high:g}]{unit}")
        return number

    def inside(self, value: float) -> float:
        """`value`, or the limit that it is beyond."""
        return min(max(value, self.low), self.high)


BASE_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("mass", 1.0, "kg", "moving mass", 1e-6, 1e6),
    Parameter("damping", 0.0, "N s/m", "viscous damping", 0.0, 1e9),
    Parameter("stiffness", 0.0, "N/m", "linear stiffness", 0.0, 1e12),
    Parameter("force_constant", 1.0, "N/V", "static force per unit of command", -1e6, 1e6),
    Parameter("amplifier_time_constant", 0.0, "s", "first-order lag of the amplifier", 0.0, 10.0),
    Parameter("delay", 0.0, "s", "dead time between command and amplifier", 0.0, 1.0),
    Parameter("encoder_resolution", 0.0, "m", "one encoder count; 0 = no rounding", 0.0, 1.0),
    Parameter("noise", 0.0, "m", "RMS of the white noise of the reading", 0.0, 1.0),
    Parameter("encoder_zero", 0.0, "m", "reading at the spring's rest position", -1e3, 1e3),
    Parameter("coil_resistance", 0.0, "ohm", "resistance of the coil", 0.0, 1e6),
    Parameter("coil_inductance", 0.0, "H", "inductance of the coil", 0.0, 1e3),
    Parameter("back_emf", 0.0, "V s/m", "voltage induced per unit of speed", 0.0, 1e6),
)

BASE_BY_NAME: dict[str, Parameter] = {p.name: p for p in BASE_PARAMETERS}


@dataclass(frozen=True)
class Option:
    """A setting that is not one real number: a switch, a word or a list of numbers.

    The type of `default` decides: bool, str (one of `choices`, any text where there are none) or
    a tuple of floats in `unit`.
    """

    name: str
    default: bool | str | tuple[float, ...]
    description: str
    choices: tuple[str, ...] = ()
    unit: str = ""

    def checked(self, value: object, where: str = "") -> bool | str | tuple[float, ...]:
        """Return `value` in the type of the default.

        Raises
        ------
        ParameterError
            If it has another type, is not among the choices or is not finite.
        """
        if isinstance(self.default, bool):
            if isinstance(value, (bool, np.bool_)):
                return bool(value)
            wanted = "true or false"
        elif isinstance(self.default, str):
            if isinstance(value, str) and (value in self.choices or not self.choices):
                return str(value)
            wanted = f"one of {', '.join(self.choices)}" if self.choices else "text"
        else:
            if hasattr(value, "__iter__") and not isinstance(value, (str, bytes, Mapping)):
                element = Parameter(self.name, 0.0, self.unit, self.description)
                return tuple(element.checked(each, where) for each in value)
            wanted = f"a list of numbers in {self.unit}"
        place = f"{where}: " if where else ""
        raise ParameterError(f"{place}{self.name} must be {wanted}, not {value!r}")


def nearest(name: object, known: Iterable[str]) -> str:
    """Return "did you mean ...?" for a misspelt name, or the list of what there is."""
    names = sorted(known)
    close = get_close_matches(str(name), names, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(names)}"
