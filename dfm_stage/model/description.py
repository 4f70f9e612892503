"""The model of a stage as immutable data, and the addresses of its parameters.

A parameter is addressed as `mass` or `cubic_stiffness.k3`; in a model of several axes as
`x.mass` or `x.cubic_stiffness.k3`, and a coupling as `coupling.x.y.ratio`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NoReturn

from dfm_stage.model.base import BASE_BY_NAME
from dfm_stage.model.errors import ModelError
from dfm_stage.model.kernel.slots import ABSENT
from dfm_stage.model.parameter import Parameter
from dfm_stage.model.registry import EFFECTS, coupling_effect

SCHEMA_VERSION = 1
Drive = Literal["voltage", "current"]


class Frozen(dict[str, Any]):
    """A dictionary that refuses to be changed, and still can be pickled."""

    def _refuse(self, *_: object, **__: object) -> NoReturn:
        raise ModelError("a model is immutable: use Model.with_parameters or Model.with_effect")

    __setitem__ = __delitem__ = clear = pop = popitem = setdefault = update = _refuse
    __ior__ = _refuse

    def __reduce__(self) -> tuple[type[Frozen], tuple[dict[str, Any]]]:
        return Frozen, (dict(self),)


def unknown_name(kind: str, name: object, known: Iterable[str]) -> str:
    """The message for an unknown name, with the nearest known one."""
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}"
    return f"{kind} {name!s} is not known; {hint}"


@dataclass(frozen=True)
class EffectUse:
    """An effect that is on, with the values of all its parameters (SI)."""

    name: str
    parameters: Mapping[str, float]
    origin: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        effect = EFFECTS.get(self.name)
        if effect is None:
            raise ModelError(unknown_name("effect", self.name, EFFECTS))
        known = effect.defaults
        for name in self.parameters:
            if name not in known:
                raise ModelError(unknown_name(f"{self.name}: parameter", name, known))
        values = {}
        for parameter in effect.parameters:
            if parameter.name in self.parameters:
                values[parameter.name] = parameter.checked(self.parameters[parameter.name],
                                                           self.name)
            elif parameter.name in effect.optional:
                values[parameter.name] = parameter.default
            else:
                raise ModelError(f"{self.name}: parameter {parameter.name} ({parameter.unit or 1})"
                                 " is missing; give it a number")
        object.__setattr__(self, "parameters", Frozen(values))
        if self.origin is not None:
            object.__setattr__(self, "origin", Frozen(self.origin))


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
        object.__setattr__(self, "base", _checked_base(self.base))
        object.__setattr__(self, "effects", tuple(self.effects))
        _check_axis(self)


def _coupled_by(axis: AxisModel) -> str | None:
    """The effect of an axis to which the neighbouring axis counts."""
    return next((use.name for use in axis.effects if EFFECTS[use.name].couples), None)


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
        object.__setattr__(self, "sample_period", period.checked(self.sample_period))
        object.__setattr__(self, "effects", tuple(self.effects))
        if self.axes:
            if self.base or self.effects:
                raise ModelError("give either base and effects or axes, not both")
            object.__setattr__(self, "base", Frozen({}))
        else:
            object.__setattr__(self, "base", _checked_base(self.base))
        object.__setattr__(self, "axes", Frozen(self.axes))
        object.__setattr__(self, "coupling", Frozen(self._checked_coupling()))
        if self.origin is not None:
            object.__setattr__(self, "origin", Frozen(self.origin))
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

    def axis(self, name: str | None = None) -> Model:
        """The model of one axis; its coupling has become an effect.

        `name` may be None where there is one axis only.

        Raises
        ------
        ModelError
            If there is no such axis, or `name` is None and there are several.
        """
        if not self.axes:
            if name is not None:
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
        for use in self.effects:
            if use.name == name:
                return use
        return None

    def effective_base(self) -> dict[str, float]:
        """The base parameters of a one-axis model with all effects that add to one.

        Beside them `constant_force` and `dry_friction` (N) and `command_limit` (V or A).
        """
        values = {**ABSENT, **self.base}
        for use in self.effects:
            effect = EFFECTS[use.name]
            if effect.adds_to is not None:
                own, so_far = next(iter(use.parameters.values())), values.get(effect.adds_to, 0.0)
                values[effect.adds_to] = (min(so_far, own) if effect.adds_to == "command_limit"
                                          else so_far + own)
        return values

    def parameters(self) -> dict[str, float]:
        """Address -> value of every parameter the model gives."""
        if not self.axes:
            values = dict(self.base)
            for use in self.effects:
                values.update({f"{use.name}.{k}": v for k, v in use.parameters.items()})
            return values
        values = {}
        for name, axis in self.axes.items():
            own = Model(name, self.sample_period, axis.base, axis.effects, drive=axis.drive)
            values.update({f"{name}.{k}": v for k, v in own.parameters().items()})
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
        elif head in EFFECTS and rest in EFFECTS[head].defaults:
            found = EFFECTS[head].parameter(rest)
        else:
            raise ModelError(unknown_name("parameter", address, self.parameters()))
        return replace(found, unit=self._unit(found.unit))

    def _unit(self, unit: str) -> str:
        if self.drive == "current":
            unit = unit.replace("N/V", "N/A").replace("V or A", "A")
        unit = unit.replace("V or A", "V")
        if self.position_unit == "m":
            return unit
        unit = unit.replace("kg", "N s^2/m")
        return "".join(self.position_unit if part == "m" else part
                       for part in _split_symbols(unit))

    def with_parameters(self, values: Mapping[str, float]) -> Model:
        """A copy with other values; an absent base parameter is added.

        Raises
        ------
        ModelError, ParameterError
            If an address is unknown or a value is out of range.
        """
        if not self.axes:
            base, effects = dict(self.base), {use.name: dict(use.parameters)
                                              for use in self.effects}
            for address, value in values.items():
                head, _, rest = address.partition(".")
                if not rest and address in BASE_BY_NAME:
                    base[address] = value
                elif rest and head in effects and rest in effects[head]:
                    effects[head][rest] = value
                else:
                    raise ModelError(unknown_name("parameter", address, self.parameters()))
            return replace(self, base=base, effects=tuple(
                replace(use, parameters=effects[use.name]) for use in self.effects))
        axes = dict(self.axes)
        coupling = {t: {s: dict(v) for s, v in sources.items()}
                    for t, sources in self.coupling.items()}
        for address, value in values.items():
            head, _, rest = address.partition(".")
            parts = rest.split(".")
            if head in axes and rest:
                own = Model(head, self.sample_period, axes[head].base, axes[head].effects,
                            drive=axes[head].drive).with_parameters({rest: value})
                axes[head] = AxisModel(own.base, own.effects, own.drive)
            elif head == "coupling" and len(parts) == 3 \
                    and parts[2] in coupling.get(parts[0], {}).get(parts[1], {}):
                coupling[parts[0]][parts[1]][parts[2]] = value
            else:
                raise ModelError(unknown_name("parameter", address, self.parameters()))
        return replace(self, axes=axes, coupling=coupling)

    def with_effect(self, name: str, parameters: Mapping[str, float],
                    origin: Mapping[str, Any] | None = None) -> Model:
        """A copy of a one-axis model with an effect added, or replaced where it was on."""
        use = EffectUse(name, parameters, origin)
        kept = [u for u in self.effects if u.name != name]
        at = [u.name for u in self.effects].index(name) if len(kept) < len(self.effects) \
            else len(kept)
        return replace(self, effects=(*kept[:at], use, *kept[at:]))

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
            data["origin"] = _plain(self.origin)
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Model:
        """The inverse of `to_dict`.

        Raises
        ------
        ModelError, ParameterError
            With a message that names the place inside `data`.
        """
        from dfm_stage.model.document import model_from_mapping
        return model_from_mapping(data, "model")


def _split_symbols(unit: str) -> list[str]:
    parts = [""]
    for character in unit:
        if character.isalpha() == (parts[-1][-1:].isalpha()):
            parts[-1] += character
        else:
            parts.append(character)
    return parts


def _axis_dict(axis: AxisModel | Model) -> dict[str, Any]:
    data: dict[str, Any] = {"base": dict(axis.base)}
    if axis.drive != "voltage":
        data["base"]["drive"] = axis.drive
    if axis.effects:
        data["effects"] = []
        for use in axis.effects:
            item: dict[str, Any] = {"name": use.name, "parameters": dict(use.parameters)}
            if use.origin is not None:
                item["origin"] = _plain(use.origin)
            data["effects"].append(item)
    return data


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
