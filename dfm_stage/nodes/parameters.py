"""ROS parameters from tables: type, unit, range and description in one place.

A node lists its parameters as `Setting`s. They are declared with a descriptor that carries unit
and range (so `ros2 param describe` shows them and rclpy refuses NaN and out-of-range numbers), a
change at run time is validated as a whole before any of it is applied, and every refusal says why.
"""

from __future__ import annotations

import array
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from dfm_stage.errors import DfmError
from dfm_stage.model.parameter import Option, Parameter

_WIDEST = 1e300
_TYPE_WORDS = {
    RosParameter.Type.DOUBLE: ("a real number", "write 1.0, not 1"),
    RosParameter.Type.INTEGER: ("a whole number", "write 1, not 1.0"),
    RosParameter.Type.BOOL: ("true or false", "write true or false"),
    RosParameter.Type.STRING: ("a text", "put it in quotes"),
    RosParameter.Type.DOUBLE_ARRAY: ("a list of real numbers", "write [1.0, 2.0]"),
}


class SettingError(DfmError):
    """A node parameter has a value it cannot take."""


@dataclass(frozen=True)
class Setting:
    """One ROS parameter of a node.

    `default` fixes the type. `live` says that it may change while the node runs. `choices` are
    the allowed texts, `low` and `high` the inclusive range of a number.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False

    @classmethod
    def of(cls, parameter: Parameter | Option, *, prefix: str = "", live: bool = False,
           default: float | None = None) -> Setting:
        """Return the setting that stands for a parameter of the pure packages."""
        if isinstance(parameter, Option):
            return cls(prefix + parameter.name, parameter.default, parameter.description,
                       parameter.unit, choices=parameter.choices, live=live)
        return cls(prefix + parameter.name,
                   float(parameter.default if default is None else default),
                   parameter.description, parameter.unit, parameter.low, parameter.high, live=live)

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows."""
        out = ParameterDescriptor(
            description=self.description + (f" [{self.unit}]" if self.unit else ""),
            read_only=not self.live)
        if isinstance(self.default, float):
            out.floating_point_range = [FloatingPointRange(
                from_value=max(self.low, -_WIDEST), to_value=min(self.high, _WIDEST), step=0.0)]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            out.integer_range = [IntegerRange(
                from_value=int(max(self.low, -2**62)), to_value=int(min(self.high, 2**62)),
                step=1)]
        if self.choices:
            out.additional_constraints = "one of: " + ", ".join(self.choices)
        return out

    def complaint(self, value: Any) -> str | None:
        """Return why `value` is refused, or None."""
        if self.choices and value not in self.choices:
            return f"{self.name} must be one of {', '.join(self.choices)}, not {value!r}"
        if isinstance(self.default, float) and not (
                math.isfinite(value) and self.low <= value <= self.high):
            unit = f" {self.unit}" if self.unit else ""
            return (f"{self.name} = {value:g}{unit} is outside "
                    f"[{self.low:g}, {self.high:g}]{unit}")
        return None


class Settings:
    """The declared parameters of one node, by name; `values` holds those in force.

    `given` are the names that somebody set, `asked` those of the change that is checked, `plan` is
    what the check of the values in force returned. Before `follow` nothing can change.
    """

    def __init__(self, node: Node, settings: Sequence[Setting]) -> None:
        self._node = node
        self._table = {setting.name: setting for setting in settings}
        self.values = {setting.name: self._declare(node, setting) for setting in settings}
        self.given = set(node._parameter_overrides)
        self.asked: set[str] = set()
        self.plan: Any = None

    def follow(self, check: Callable[[dict[str, Any]], object],
               applied: Callable[[set[str]], object]) -> None:
        """Check the values as a whole, and from now on every change of them.

        `check(values)` refuses a combination by raising DfmError and changes nothing; what it
        returns becomes `plan` with the values. `applied(names)` is called after that.
        """
        self.plan = self._next_plan = check(self.values)
        self._check, self._applied = check, applied
        self._node.add_on_set_parameters_callback(self._on_set)
        self._node.add_post_set_parameters_callback(self._post_set)

    def _declare(self, node: Node, setting: Setting) -> Any:
        default = setting.default
        if isinstance(default, array.array):
            # rclpy cannot tell the type of an empty list; declared by type it is "not set".
            default = RosParameter.Type.DOUBLE_ARRAY
        try:
            value = node.declare_parameter(setting.name, default, setting.descriptor()).value
            if value is None:
                return setting.default
        except InvalidParameterTypeException as error:
            kind = (default if isinstance(default, RosParameter.Type)
                    else RosParameter.Type.from_parameter_value(default))
            words, remedy = _TYPE_WORDS[kind]
            raise SettingError(f"{node.get_name()}: parameter {setting.name} must be {words} "
                               f"({remedy})") from error
        except InvalidParameterValueException as error:
            why = setting.complaint(node._parameter_overrides[setting.name].value) or str(error)
            raise SettingError(f"{node.get_name()}: parameter {why}") from error
        if reason := setting.complaint(value):
            raise SettingError(f"{node.get_name()}: parameter {reason}")
        return value

    def _on_set(self, changes: list[RosParameter]) -> SetParametersResult:
        proposed = dict(self.values)
        for change in changes:
            setting = self._table.get(change.name)
            if setting is None:
                continue
            if reason := setting.complaint(change.value):
                return SetParametersResult(successful=False, reason=reason)
            proposed[change.name] = change.value
        self.asked = {change.name for change in changes}
        try:
            self._next_plan = self._check(proposed)
        except DfmError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _post_set(self, changes: list[RosParameter]) -> None:
        changed = {each.name: each.value for each in changes if each.name in self._table}
        self.values |= changed
        self.given |= changed.keys()
        self.plan = self._next_plan
        if changed:
            self._applied(set(changed))

    def __getitem__(self, name: str) -> Any:
        return self.values[name]
