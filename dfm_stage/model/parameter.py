"""A named quantity with unit, range and meaning: the one way parameters are described."""

from __future__ import annotations

import math
from dataclasses import dataclass

from dfm_stage.errors import DfmError


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
        number = float(value)
        if not math.isfinite(number):
            raise ParameterError(f"{place}{self.name} must be finite, not {value!r}")
        if not self.low <= number <= self.high:
            raise ParameterError(f"{place}{self.name} = {number:g}{unit} is outside "
                                 f"[{self.low:g}, {self.high:g}]{unit}")
        return number
