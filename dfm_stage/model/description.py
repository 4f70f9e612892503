"""The model of a stage as immutable data, and the addresses of its parameters.

A parameter is addressed as `mass` or `cubic_stiffness.k3`; in a model of several axes as
`x.mass` or `x.cubic_stiffness.k3`, and a coupling as `coupling.x.y.ratio`.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Integral, Real
from typing import Any, Literal, NoReturn, TypeVar

from dfm_stage.model.effect import Effect
from dfm_stage.model.formula import Formula, FormulaEffect
from dfm_stage.model.kernel.slots import ABSENT
from dfm_stage.model.parameter import BASE_BY_NAME, ModelError, Parameter
from dfm_stage.model.registry import ALL, EFFECTS, coupling_effect, library_of

SCHEMA_VERSION = 1
USUAL_AXIS = "x"
"""The axis of a record or a model whose only axis has no name."""
Drive = Literal["voltage", "current"]


class Frozen(dict[str, Any]):
    """A dictionary that refuses to be changed, and still can be pickled."""

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise ModelError("a model is immutable: use Model.with_parameters or Model.with_effect")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = _refuse
    __ior__ = _refuse

    def __reduce__(self) -> tuple[type[Frozen], tuple[dict[str, Any]]]:
        return Frozen, (dict(self),)


def _set(instance: object, **values: Any) -> None:
    """Give a frozen dataclass the checked form of its fields."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def _frozen(origin: Mapping[str, Any] | None) -> Frozen | None:
    return None if origin is None else Frozen(origin)


def unknown_name(kind: str, name: object, known: Iterable[str]) -> str:
    """The message for an unknown name, with the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}"
    return f"{kind} {name!s} is not known; {hint}"


@dataclass(frozen=True)
class EffectUse:
    """An effect that is on, with the values of all its parameters (SI).

    One that is a `formula` carries it, whatever is registered.
    """

    name: str
    parameters: Mapping[str, float]
    origin: Mapping[str, Any] | None = None
    formula: Formula | None = None
    _own: FormulaEffect | None = field(init=False, default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        effect = EFFECTS.get(self.name) if self.formula is None else self.formula.effect()
        if effect is None:
            raise ModelError(unknown_name("effect", self.name, library_of([ALL])))
        if isinstance(effect, FormulaEffect):
            EFFECTS.hold(effect)
            _set(self, formula=effect.formula, _own=effect)
        known = effect.defaults
        for name in self.parameters:
            if name not in known:
                raise ModelError(unknown_name(f"{self.name}: parameter", name, known))
        for parameter in effect.parameters:
            if parameter.name not in self.parameters and parameter.name not in effect.optional:
                raise ModelError(f"{self.name}: parameter {parameter.name} ({parameter.unit or 1})"
                                 " is missing; give it a number")
        _set(self, origin=_frozen(self.origin), parameters=Frozen({
            p.name: p.checked(self.parameters.get(p.name, p.default), self.name)
            for p in effect.parameters}))

    @property
    def effect(self) -> Effect:
        """The effect: that of the formula, or the one that is registered now."""
        return EFFECTS[self.name] if self._own is None else self._own

    def __reduce__(self) -> tuple[Any, ...]:
        return EffectUse, (self.name, self.parameters, self.origin, self.formula)

    def to_dict(self) -> dict[str, Any]:
        """The entry of model.yaml."""
        own = {"name": self.name, "parameters": dict(self.parameters)} if self.formula is None \
            else self.formula.to_dict(self.parameters)
        return own if self.origin is None else {**own, "origin": plain(self.origin)}


def _checked_base(base: Mapping[str, float]) -> Frozen:
    for name in base:
        if name not in BASE_BY_NAME:
            raise ModelError(unknown_name("base: parameter", name, BASE_BY_NAME))
    if "mass" not in base:
        raise ModelError("base: mass (kg) is missing; give it a number above zero")
    if "damping" not in base and "stiffness" not in base:
        raise ModelError("base: give damping (N s/m), stiffness (N/m) or both")
    return Frozen({name: BASE_BY_NAME[name].checked(value, "base")
                   for name, value in base.items()})


@dataclass(frozen=True)
class AxisModel:
    """Base parameters and effects of one axis of a model of several axes."""

    base: Mapping[str, float]
    effects: tuple[EffectUse, ...] = ()
    drive: Drive = "voltage"

    def __post_init__(self) -> None:
        _set(self, base=_checked_base(self.base), effects=tuple(self.effects))
        _check_axis(self)


def _coupled_by(axis: AxisModel) -> str | None:
    """The effect of an axis to which the neighbouring axis counts."""
    return next((use.name for use in axis.effects if use.effect.couples), None)


def _check_axis(axis: AxisModel | Model) -> None:
    if axis.drive not in ("voltage", "current"):
        raise ModelError(f"base: drive must be voltage or current, not {axis.drive!r}")
    names = [use.name for use in axis.effects]
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"effects: {name} stands there {names.count(name)} times; "
                             "merge them into one")
    for parameter in ("coil_inductance", "back_emf"):
        added = [name for name in names if EFFECTS[name].adds_to == parameter]
        present = added or ([parameter] if axis.base.get(parameter, 0.0) else [])
        if present and axis.drive == "current":
            raise ModelError(f"{present[0]} has no meaning with drive: current; "
                             "use drive: voltage or remove it")
        if (present and parameter == "coil_inductance"
                and axis.base.get("coil_resistance", 0.0) <= 0.0):
            raise ModelError(f"{present[0]} needs coil_resistance (ohm) above zero in base")


@dataclass(frozen=True)
class Model:
    """A stage: `base` and `effects` of one axis, or `axes` with `coupling` between them.

    `base` holds only what the file gives; an absent parameter is zero. `coupling[a][b]` are the
    parameters of the effect by which axis b acts on axis a. `document` is the text
    the model was read from; it does not take part in comparisons.

    Raises
    ------
    ModelError, ParameterError
        From the constructor, if a name is unknown, a value out of range or a part missing.
    """

    name: str
    sample_period: float
    base: Mapping[str, float] = field(default_factory=dict)
    effects: tuple[EffectUse, ...] = ()
    axes: Mapping[str, AxisModel] = field(default_factory=dict)
    coupling: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    origin: Mapping[str, Any] | None = None
    drive: Drive = "voltage"
    position_unit: str = "m"
    document: str | None = field(default=None, compare=False, repr=False)

    def __post_init__(self) -> None:
        period = Parameter("sample_period", 1e-3, "s", "time between samples", 1e-7, 1e3)
        if self.axes and (self.base or self.effects):
            raise ModelError("give either base and effects or axes, not both")
        _set(self, sample_period=period.checked(self.sample_period), effects=tuple(self.effects),
             base=Frozen() if self.axes else _checked_base(self.base), axes=Frozen(self.axes),
             coupling=Frozen(self._checked_coupling()), origin=_frozen(self.origin))
        _check_axis(self)

    def _checked_coupling(self) -> dict[str, Frozen]:
        checked: dict[str, Frozen] = {}
        for target, sources in self.coupling.items():
            for name in (target, *sources):
                if name not in self.axes:
                    raise ModelError(unknown_name("coupling: axis", name, self.axes))
            if target in sources:
                raise ModelError(f"coupling: axis {target} cannot act on itself")
            if len(sources) > 1:
                raise ModelError(f"coupling: axis {target} can be coupled to one other axis only")
            own = _coupled_by(self.axes[target])
            if own is not None:
                raise ModelError(f"coupling: axis {target} also has the effect {own}; "
                                 "keep one of the two")
            checked[target] = Frozen({
                source: EffectUse(coupling_effect().name, values).parameters
                for source, values in sources.items()})
        return checked

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes; empty for a model of one axis."""
        return tuple(self.axes)

    @property
    def input_unit(self) -> str:
        """Unit of the input: V, or A with a current drive."""
        return "A" if self.drive == "current" else "V"

    def usual_axis(self, axis: str | None = None) -> str | None:
        """`axis` if it is given; else `x` if the model has several axes and one of that name."""
        return axis if axis is not None or USUAL_AXIS not in self.axes else USUAL_AXIS

    def axis(self, name: str | None = None) -> Model:
        """The model of one axis; its coupling has become an effect.

        `name` may be None where there is one axis only; that of a model without names is `x`.

        Raises
        ------
        ModelError
            If there is no such axis, or `name` is None and there are several.
        """
        if not self.axes:
            if name not in (None, USUAL_AXIS):
                raise ModelError(f"model {self.name} has one axis without a name; "
                                 f"there is no axis {name}")
            return self
        if name is None and len(self.axes) == 1:
            name = next(iter(self.axes))
        if name is None:
            raise ModelError(f"model {self.name} has the axes {', '.join(self.axes)}; choose one")
        if name not in self.axes:
            raise ModelError(unknown_name("axis", name, self.axes))
        chosen = self.axes[name]
        coupled = tuple(EffectUse(coupling_effect().name, values)
                        for values in self.coupling.get(name, {}).values())
        return Model(f"{self.name}.{name}", self.sample_period, chosen.base,
                     chosen.effects + coupled, origin=self.origin, drive=chosen.drive,
                     position_unit=self.position_unit)

    def neighbour(self, name: str | None) -> str | None:
        """The axis that acts on axis `name`, or None."""
        if name is None or name not in self.axes:
            return None
        for source in self.coupling.get(name, {}):
            return source
        effect = _coupled_by(self.axes[name])
        if effect is not None:
            others = [axis for axis in self.axes if axis != name]
            if len(others) == 1:
                return others[0]
            raise ModelError(f"axis {name}: {effect} needs exactly one other axis; "
                             "use coupling to name it")
        return None

    def effect(self, name: str) -> EffectUse | None:
        """The effect called `name` of a one-axis model, or None where it is off."""
        return next((use for use in self.effects if use.name == name), None)

    def effective_base(self) -> dict[str, float]:
        """The base parameters of a one-axis model, with the effects that add to them.

        Beside them `constant_force` and `dry_friction` (N) and `command_limit` (V or A).
        """
        values = {**ABSENT, **self.base}
        for use in self.effects:
            effect = use.effect
            if effect.adds_to is not None:
                own, so_far = next(iter(use.parameters.values())), values.get(effect.adds_to, 0.0)
                values[effect.adds_to] = (min(so_far, own) if effect.adds_to == "command_limit"
                                          else so_far + own)
        return values

    def parameters(self) -> dict[str, float]:
        """The values of all parameters that the model gives, by address."""
        if not self.axes:
            return _values(self)
        values = {f"{name}.{k}": v for name, axis in self.axes.items()
                  for k, v in _values(axis).items()}
        for target, sources in self.coupling.items():
            for source, given in sources.items():
                values.update({f"coupling.{target}.{source}.{k}": v for k, v in given.items()})
        return values

    def parameter(self, address: str) -> Parameter:
        """Unit, limits and meaning of the parameter at `address`, in the model's units.

        Raises
        ------
        ModelError
            If there is no such parameter. A base parameter need not be given in the model.
        """
        head, _, rest = address.partition(".")
        if head in self.axes and rest:
            return self.axis(head).parameter(rest)
        if head == "coupling" and rest:
            found = coupling_effect().parameter(rest.rpartition(".")[2])
        elif address in BASE_BY_NAME:
            found = BASE_BY_NAME[address]
        elif (effect := self._named(head)) is not None and rest in effect.defaults:
            found = effect.parameter(rest)
        else:
            raise ModelError(unknown_name("parameter", address, self.parameters()))
        return replace(found, unit=self._unit(found.unit))

    def _named(self, name: str) -> Effect | None:
        """The effect of this name: the model's own, or a registered one."""
        use = self.effect(name)
        return use.effect if use is not None else EFFECTS.get(name)

    def _unit(self, unit: str) -> str:
        if self.drive == "current":
            unit = unit.replace("N/V", "N/A").replace("V or A", "A")
        unit = unit.replace("V or A", "V")
        if self.position_unit == "m":
            return unit
        return re.sub("(?<![A-Za-z])m(?![A-Za-z])", self.position_unit,
                      unit.replace("kg", "N s^2/m"))

    def with_parameters(self, values: Mapping[str, float]) -> Model:
        """A copy with other values; an absent base parameter is added.

        Raises
        ------
        ModelError, ParameterError
            If an address is unknown or a value is out of range.
        """
        new = self.parameters()
        for address, value in values.items():
            axis, _, own = address.rpartition(".")
            if address not in new and not (
                    own in BASE_BY_NAME and (axis in self.axes if self.axes else not axis)):
                raise ModelError(unknown_name("parameter", address, self.parameters()))
            new[address] = value
        if not self.axes:
            return _with_values(self, new)
        axes = {name: _with_values(axis, _below(name, new)) for name, axis in self.axes.items()}
        return replace(self, axes=axes, coupling={
            target: {source: _below(f"coupling.{target}.{source}", new) for source in sources}
            for target, sources in self.coupling.items()})

    def with_effect(self, name: str, parameters: Mapping[str, float],
                    origin: Mapping[str, Any] | None = None) -> Model:
        """A copy of a one-axis model with an effect added, or replaced if it has it."""
        uses = {use.name: use for use in self.effects}
        own = uses[name].formula if name in uses else None
        uses[name] = EffectUse(name, parameters, origin, own)
        return replace(self, effects=tuple(uses.values()))

    def without_effect(self, name: str) -> Model:
        """A copy of a one-axis model with the effect `name` off."""
        return replace(self, effects=tuple(u for u in self.effects if u.name != name))

    def to_dict(self) -> dict[str, Any]:
        """The model as plain dictionaries, lists and numbers, as model.yaml has it."""
        data: dict[str, Any] = {"dfm_model": SCHEMA_VERSION, "name": self.name,
                                "sample_period": self.sample_period}
        if self.position_unit != "m":
            data["position_unit"] = self.position_unit
        if self.axes:
            data["axes"] = {name: _axis_dict(axis) for name, axis in self.axes.items()}
            if self.coupling:
                data["coupling"] = {t: {s: dict(v) for s, v in sources.items()}
                                    for t, sources in self.coupling.items()}
        else:
            data.update(_axis_dict(self))
        if self.origin is not None:
            data["origin"] = plain(self.origin)
        return data


One = TypeVar("One", AxisModel, Model)


def _values(axis: AxisModel | Model) -> dict[str, float]:
    """Address -> value of what one axis gives."""
    return {**axis.base, **{f"{use.name}.{name}": value for use in axis.effects
                            for name, value in use.parameters.items()}}


def _with_values(axis: One, new: Mapping[str, float]) -> One:
    """A copy of one axis with the values of `new`, which has them all."""
    return replace(axis, base={k: v for k, v in new.items() if k in BASE_BY_NAME}, effects=tuple(
        replace(use, parameters={k: new[f"{use.name}.{k}"] for k in use.parameters})
        for use in axis.effects))


def _below(head: str, values: Mapping[str, float]) -> dict[str, float]:
    """The values whose address begins with `head` and a dot, by the rest of it."""
    return {address.removeprefix(f"{head}."): value for address, value in values.items()
            if address.startswith(f"{head}.")}


def _axis_dict(axis: AxisModel | Model) -> dict[str, Any]:
    data: dict[str, Any] = {"base": dict(axis.base)}
    if axis.drive != "voltage":
        data["base"]["drive"] = axis.drive
    if axis.effects:
        data["effects"] = [use.to_dict() for use in axis.effects]
    return data


def plain(value: Any) -> Any:
    """`value` as dictionaries, lists, numbers and texts of Python's own types."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, Real):
        return int(value) if isinstance(value, Integral) else float(value)
    return str(value)
