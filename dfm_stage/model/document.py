"""model.yaml: read with messages that name the line, written back with its comments."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from dfm_stage.errors import DfmError
from dfm_stage.files import write_whole
from dfm_stage.model.description import (
    SCHEMA_VERSION,
    AxisModel,
    EffectUse,
    Model,
    plain,
    unknown_name,
)
from dfm_stage.model.effect import Effect
from dfm_stage.model.formula import KINDS, FormulaEffect, formula_of
from dfm_stage.model.parameter import BASE_BY_NAME, ModelError, Parameter
from dfm_stage.model.registry import ALL, EFFECTS, coupling_effect, library_of
from dfm_stage.share import config_folder
from dfm_stage.yaml_text import YamlError, load_yaml, text_of

T = TypeVar("T")
_AXIS_KEYS = ("base", "effects")
_TOP_KEYS = ("dfm_model", "name", "sample_period", "position_unit", "drive", *_AXIS_KEYS, "axes",
             "coupling", "origin")
_EFFECT_KEYS = ("name", "parameters", "origin")
_FORMULA_KEYS = (*KINDS, "state")


def load_model(path_or_name: str | os.PathLike[str]) -> Model:
    """The model in a file, or the one of that bare name among those that come with the package.

    Raises
    ------
    ModelError
        If there is no such model, or it is malformed; the message names file and line.
    """
    path = _find(path_or_name)
    try:
        text = text_of(path)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ModelError(f"{path}: cannot be read: {reason}") from error
    return parse_model(text, str(path))


def parse_model(text: str, where: str) -> Model:
    """The model in a YAML text; `where` begins every message.

    Raises
    ------
    ModelError
        As `load_model`.
    """
    try:
        data = load_yaml(text, layout=True)
    except YamlError as error:
        raise ModelError(f"{error.at(where)}: not valid YAML: {error}") from error
    return model_from_dict(data, where, text)


def save_model(model: Model, path: str | os.PathLike[str]) -> None:
    """Write `model` to `path`; comments of the text it was read from stay where they are.

    Raises
    ------
    ModelError
        If the file cannot be written. What stood there before is then still there.
    """
    target = Path(path)
    try:
        write_whole(target, model_text(model))
    except OSError as error:
        raise ModelError(f"{target}: cannot be written: {error.strerror}") from error


def model_text(model: Model) -> str:
    """The YAML text of a model."""
    data: Any = _styled(model.to_dict())
    if model.document is not None:
        old = load_yaml(model.document, layout=True)
        _merge(old, data)
        data = old
    stream = io.StringIO()
    _yaml().dump(data, stream)
    return stream.getvalue()


def model_from_dict(data: Any, where: str = "model", text: str | None = None) -> Model:
    """The model that `Model.to_dict` gave, or that ruamel.yaml found in a `text`.

    Raises
    ------
    ModelError
        If it is malformed; the message names the line where `data` knows it.
    """
    top = _Node(data, where, (), data)
    top.keys(_TOP_KEYS)
    version = top.data.get("dfm_model")
    if version is None:
        top.fail(f"the schema version is missing; begin with dfm_model: {SCHEMA_VERSION}")
    if isinstance(version, bool) or version != SCHEMA_VERSION:
        top.fail(f"dfm_model: {version!r} is not a schema version this program reads; "
                 f"it reads {SCHEMA_VERSION}", "dfm_model")
    name = top.data.get("name")
    if not isinstance(name, str) or not name:
        top.fail(f"name must be a text, not {name!r}", "name")
    period = top.number(Parameter("sample_period", 1e-3, "s", "", 1e-7, 1e3), "sample_period")
    unit = top.data.get("position_unit", "m")
    if not isinstance(unit, str):
        top.fail(f"position_unit must be a text, not {unit!r}", "position_unit")
    origin = _origin(top)
    common: dict[str, Any] = {"origin": origin, "position_unit": str(unit), "document": text}
    if "axes" not in top.data:
        if "coupling" in top.data:
            top.fail("coupling needs axes", "coupling")
        axis = _axis(top, top.data.get("drive"))
        return top.build(lambda: Model(str(name), period, axis.base, axis.effects,
                                       drive=axis.drive, **common))
    for key in _AXIS_KEYS:
        if key in top.data:
            top.fail(f"{key} belongs below each of the axes", key)
    axes = {key: _axis(child, top.data.get("drive")) for key, child in top.child("axes").items()}
    if not axes:
        top.fail("axes is empty; give at least one axis", "axes")
    coupled = top.child("coupling").items() if "coupling" in top.data else []
    coupling = {target: {source: _values(node, coupling_effect().name)
                         for source, node in sources.items()} for target, sources in coupled}
    return top.build(lambda: Model(str(name), period, axes=axes, coupling=coupling, **common),
                     "coupling" if "coupling" in top.data else "axes")


def _axis(node: _Node, default_drive: object) -> AxisModel:
    if node.path:
        node.keys(_AXIS_KEYS)
    base_node = node.child("base")
    base_node.keys((*BASE_BY_NAME, "drive"), "base: parameter")
    drive: Any = base_node.data.get("drive", default_drive or "voltage")
    if drive not in ("voltage", "current"):
        base_node.fail(f"drive must be voltage or current, not {drive!r}", "drive")
    base = {key: base_node.number(BASE_BY_NAME[key], key)
            for key in base_node.data if key != "drive"}
    effects: list[EffectUse] = []
    listed = node.data.get("effects")
    if listed is not None and not isinstance(listed, (list, tuple)):
        node.fail("effects must be a list of items with name and parameters", "effects")
    for index in range(len(listed or ())):
        item = node.child("effects", index)
        effect = _effect(item)
        if effect.name in [other.name for other in effects]:
            item.fail(f"effect {effect.name} is there already; merge the two", "name")
        effects.append(effect)
    return base_node.build(lambda: AxisModel(base, tuple(effects), drive))


def _effect(node: _Node) -> EffectUse:
    node.keys((*_EFFECT_KEYS, *_FORMULA_KEYS))
    name = node.data.get("name")
    if any(key in node.data for key in _FORMULA_KEYS):
        return _formula(node)
    if not isinstance(name, str) or name not in EFFECTS:
        node.fail(unknown_name("effect", name, library_of([ALL])), "name")
    values = _values(node.child("parameters"), name) if "parameters" in node.data else {}
    return node.build(lambda: EffectUse(name, values, _origin(node)))


def _formula(node: _Node) -> EffectUse:
    """An effect that brings its own formula."""
    formula = node.build(lambda: formula_of(plain(node.data)),
                         next(key for key in _FORMULA_KEYS if key in node.data))
    if isinstance(EFFECTS.get(formula.name, None), Effect) and not isinstance(
            EFFECTS[formula.name], FormulaEffect):
        node.fail(f"{formula.name} is an effect of the library; give the formula another name",
                  "name")
    return node.build(lambda: EffectUse(
        formula.name, {p.name: p.value for p in formula.parameters}, _origin(node), formula),
        formula.kind)


def _values(node: _Node, effect: str) -> dict[str, float]:
    known = EFFECTS[effect]
    node.keys(tuple(known.defaults), f"{effect}: parameter")
    return {key: node.number(known.parameter(key), key) for key in node.data}


def _origin(node: _Node) -> Mapping[str, Any] | None:
    if node.data.get("origin") is None:
        return None
    return dict(plain(node.child("origin").data))


class _Node:
    """A mapping inside the document that knows its path, so that messages can name the line."""

    def __init__(self, data: Any, where: str, path: tuple[Any, ...], root: Any) -> None:
        self.data, self.where, self.path, self.root = data, where, path, root
        if not isinstance(data, Mapping):
            name = next((p for p in reversed(path) if isinstance(p, str)), "the document")
            self.fail(f"{name} must be a mapping of names to values, not {_short(data)}")

    def items(self) -> list[tuple[str, _Node]]:
        return [(str(key), self.child(key)) for key in self.data]

    def child(self, key: str, index: int | None = None) -> _Node:
        if key not in self.data:
            self.fail(f"{key} is missing")
        if index is None:
            return _Node(self.data[key], self.where, (*self.path, key), self.root)
        return _Node(self.data[key][index], self.where, (*self.path, key, index), self.root)

    def keys(self, known: Sequence[str], kind: str | None = None) -> None:
        kind = kind or ".".join(str(p) for p in (*self.path, "key"))
        for key in self.data:
            if key not in known:
                self.fail(unknown_name(kind, key, known), key)

    def number(self, parameter: Parameter, key: str) -> float:
        value = self.data.get(key)
        if isinstance(value, str):
            with contextlib.suppress(ValueError):
                value = float(value)
        try:
            return parameter.checked(value, ".".join(str(p) for p in self.path))
        except DfmError as error:
            self.fail(str(error), key)

    def build(self, make: Callable[[], T], key: str | None = None) -> T:
        try:
            return make()
        except DfmError as error:
            self.fail(str(error), key)

    def fail(self, message: str, key: Any = None) -> NoReturn:
        line = _line(self.root, self.path if key is None else (*self.path, key))
        raise ModelError(f"{self.where}{f':{line}' if line else ''}: {message}")


def _line(root: Any, path: tuple[Any, ...]) -> int | None:
    """The 1-based line of the deepest part of `path` that exists, or None outside ruamel data."""
    line, node = None, root
    for key in path:
        position = getattr(node, "lc", None)
        if position is None or position.data is None or key not in position.data:
            break
        line = int(position.data[key][0]) + 1
        node = node[key]
    return line


def _merge(old: Any, new: Mapping[str, Any]) -> None:
    """Make `old` equal to `new`, touching only what differs."""
    for key in [k for k in old if k not in new]:
        del old[key]
    for key, value in new.items():
        current = old.get(key)
        if isinstance(value, Mapping) and isinstance(current, Mapping):
            _merge(current, value)
        elif key == "effects" and isinstance(current, list):
            _merge_effects(current, value)
        elif key not in old or plain(current) != plain(value):
            old[key] = value


def _merge_effects(old: Any, new: list[dict[str, Any]]) -> None:
    wanted = {item["name"]: item for item in new}
    for index in reversed(range(len(old))):
        if old[index].get("name") not in wanted:
            del old[index]
    present = {item["name"]: item for item in old}
    for item in new:
        if item["name"] not in present:
            old.append(item)
            continue
        if any(key in item for key in KINDS):
            _merge(present[item["name"]], item)
            continue
        known = EFFECTS[item["name"]]
        given = present[item["name"]].get("parameters") or {}
        _merge(present[item["name"]], {**item, "parameters": {
            k: v for k, v in item["parameters"].items()
            if k in given or k not in known.optional or v != known.defaults[k]}})


def _find(path_or_name: str | os.PathLike[str]) -> Path:
    path = Path(path_or_name)
    if path.suffix in (".yaml", ".yml") or len(path.parts) != 1 or path.is_file():
        return path
    folder = config_folder() / "models"
    if (folder / f"{path.name}.yaml").is_file():
        return folder / f"{path.name}.yaml"
    known = sorted(found.stem for found in folder.glob("*.yaml"))
    raise ModelError(unknown_name("model", path.name, known))


def _yaml() -> YAML:
    yaml = YAML(typ="rt")
    yaml.width = 99
    yaml.preserve_quotes = True
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml


def _styled(value: Any, inside: str = "") -> Any:
    """`value` as ruamel data, with parameters, origin and lists of numbers on one line each."""
    if isinstance(value, dict):
        mapped = CommentedMap({k: _styled(v, k) for k, v in value.items()})
        if inside in ("parameters", "origin", "state"):
            mapped.fa.set_flow_style()
        return mapped
    if isinstance(value, list):
        listed = CommentedSeq([_styled(v) for v in value])
        if not any(isinstance(v, dict) for v in value):
            listed.fa.set_flow_style()
        return listed
    return value


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
