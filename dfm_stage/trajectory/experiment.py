"""An experiment as data: what is asked of each axis, for how long, by which controller."""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from dfm_stage.model.parameter import nearest
from dfm_stage.trajectory.errors import TrajectoryError, place
from dfm_stage.trajectory.kind import Kind, choose
from dfm_stage.trajectory.outcome import DEFAULT_BOUNDS, Bounds
from dfm_stage.trajectory.signals import (
    EXCITATION_KINDS,
    REFERENCE_KINDS,
    Excitation,
    Reference,
    make_excitation,
    make_reference,
)
from dfm_stage.yaml_text import YamlError, load_yaml, text_of

# The mode in which no control law is in force: the excitation is the whole command.
OPEN_LOOP = "open_loop"
_KEYS = ("name", "description", "mode", "duration_s", "axes", "model", "controller", "seed",
         "bounds")


@dataclass(frozen=True)
class AxisSpec:
    """What one axis is asked to do; None is: hold zero, add no voltage."""

    reference: Mapping[str, Any] | None = None
    excitation: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Experiment:
    """A checked experiment. `source` is the file it came from, empty for a mapping.

    `model` is a name or path of a model.yaml, `controller` a path of a parameter file or a mapping
    of controller parameters; both are left to whoever uses them, and empty where not given.
    `bounds` are what a run has to keep to count as done.
    """

    name: str
    mode: str
    duration_s: float
    axes: Mapping[str, AxisSpec]
    model: str = ""
    controller: str | Mapping[str, Any] = ""
    seed: int = 0
    description: str = ""
    source: str = field(default="", compare=False)
    bounds: Bounds = DEFAULT_BOUNDS

    def reference(self, axis: str, sample_period_s: float) -> Reference:
        """Return the movement of an axis, holding zero where none is asked for."""
        return make_reference(self._axis(axis).reference or {"kind": "hold"},
                              sample_period_s=sample_period_s, duration_s=self.duration_s,
                              seed=self.axis_seed(axis), where=f"axes.{axis}.reference")

    def excitation(self, axis: str, sample_period_s: float) -> Excitation:
        """Return the voltage of an axis, zero where none is asked for."""
        return make_excitation(self._axis(axis).excitation or {"kind": "hold"},
                               sample_period_s=sample_period_s, duration_s=self.duration_s,
                               seed=self.axis_seed(axis), where=f"axes.{axis}.excitation")

    def axis_seed(self, axis: str) -> int:
        """Return the seed of an axis: the same for the same name, another for each axis."""
        return zlib.crc32(f"{self.seed}/{axis}".encode())

    def _axis(self, axis: str) -> AxisSpec:
        if axis not in self.axes:
            raise TrajectoryError(f"experiment {self.name!r} has no axis {axis!r}, "
                                  f"{nearest(axis, self.axes)}", "axes")
        return self.axes[axis]


def load_experiment(source: str | os.PathLike[str] | Mapping[str, Any]) -> Experiment:
    """Return the experiment in a YAML file or a mapping of the same shape.

    Raises
    ------
    TrajectoryError
        If the file cannot be read or an entry is missing, unknown or out of range; the message
        names the file, the line and the entry.
    """
    if isinstance(source, Mapping):
        return _experiment(source, "")
    path = Path(source)
    try:
        text = text_of(path)
    except FileNotFoundError:
        raise TrajectoryError(f"{path}: there is no such experiment file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise TrajectoryError(f"{path}: cannot read the experiment: {reason}") from None
    try:
        content = load_yaml(text, layout=True)
    except YamlError as error:
        raise TrajectoryError(f"{error.at(path)}: not valid YAML: {error}") from None
    if not isinstance(content, CommentedMap):
        raise TrajectoryError(f"{path}:1: an experiment is a mapping with the keys "
                              f"{', '.join(_KEYS)}")
    try:
        return _experiment(content, str(path))
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}:{_line(content, error.key)}: {error}", error.key) from None


def _experiment(content: Mapping[str, Any], source: str) -> Experiment:
    _require_known(content, _KEYS)
    name = _text(content, "name")
    if not name:
        raise TrajectoryError("name is missing; give the experiment one")
    mode = content.get("mode")
    if not isinstance(mode, str) or not mode.isidentifier():
        raise TrajectoryError(f"mode must be {OPEN_LOOP} or the name of a control law such as "
                              f"pid, not {mode!r}", "mode")
    controller = content.get("controller") or ""
    if not isinstance(controller, (str, Mapping)):
        raise TrajectoryError("controller must be a file name or a mapping of its parameters, "
                              f"not {controller!r}", "controller")
    seed = content.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise TrajectoryError(f"seed must be a whole number from 0, not {seed!r}", "seed")
    return Experiment(name, mode, _duration(content), _axes(content, mode, source),
                      _beside(_text(content, "model"), source),
                      _beside(controller, source) if isinstance(controller, str)
                      else _plain(controller),
                      int(seed), _text(content, "description"), source,
                      Bounds.from_mapping(content.get("bounds") or {}))


def _beside(name: str, source: str) -> str:
    """Return a file that stands beside the experiment by its full path, any other as it is."""
    here = Path(source).absolute().parent / name
    beside = source and name and not Path(name).is_absolute() and here.is_file()
    return str(here) if beside else name


def _axes(content: Mapping[str, Any], mode: str, source: str) -> dict[str, AxisSpec]:
    axes = content.get("axes")
    if not isinstance(axes, Mapping) or not axes:
        raise TrajectoryError("axes is missing; give at least axes: {x: {reference: {...}}}",
                              "axes")
    return {axis: _axis(axis, {} if given is None else given, mode, source)
            for axis, given in axes.items()}


def _axis(axis: object, entry: object, mode: str, source: str) -> AxisSpec:
    """Return what one axis is asked to do, in the order of what is checked first."""
    where = f"axes.{axis}"
    if not isinstance(axis, str) or not axis.isidentifier():
        raise TrajectoryError(f"an axis needs a plain name such as x, not {axis!r}", "axes")
    if not isinstance(entry, Mapping):
        raise TrajectoryError(f"{where} must hold reference and/or excitation, not {entry!r}",
                              where)
    _require_known(entry, tuple(_PARTS), where)
    plain = {}
    for part, kinds in _PARTS.items():
        if part in entry:
            choose(entry[part], kinds, f"{where}.{part}")
            plain[part] = _plain(entry[part])
            if "file" in plain[part]:
                plain[part]["file"] = _beside(plain[part]["file"], source)
    if mode == OPEN_LOOP and "reference" in entry:
        raise TrajectoryError(f"{where}.reference has no effect with mode: open_loop; remove "
                              "it or choose another mode", f"{where}.reference")
    return AxisSpec(**plain)


_PARTS: dict[str, Mapping[str, Kind[Any]]] = {"reference": REFERENCE_KINDS,
                                              "excitation": EXCITATION_KINDS}


def _require_known(entry: Mapping[Any, Any], known: tuple[str, ...], where: str = "") -> None:
    for key in entry:
        if key not in known:
            raise TrajectoryError(f"{where or 'an experiment'} has no entry {key!r}, "
                                  f"{nearest(key, known)}", f"{where}.{key}".lstrip("."))


def _duration(content: Mapping[str, Any]) -> float:
    value = content.get("duration_s")
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1e6:
        raise TrajectoryError("duration_s must be a number of seconds above 0 and below 1e6, "
                              f"not {value!r}", "duration_s")
    return float(value)


def _text(content: Mapping[str, Any], key: str) -> str:
    value = content.get(key, "")
    if not isinstance(value, str):
        raise TrajectoryError(place(key, f"must be text, not {value!r}"), key)
    return str(value)


def _plain(value: Any) -> Any:
    """Turn what the YAML reader returns into plain dicts, lists and numbers."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return value


def _line(content: CommentedMap, key: str) -> int:
    """Return the 1-based line of a dotted key, or of the deepest part of it that exists."""
    line, here = 1, content
    for part in key.split("."):
        if not isinstance(here, CommentedMap) or part not in here:
            break
        line, here = here.lc.key(part)[0] + 1, here[part]
    return line
