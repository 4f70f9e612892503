"""Parameter files of the controller: written with what they promise, read by node and axis."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any

from dfm_stage.control.errors import ControlError
from dfm_stage.files import write_whole
from dfm_stage.yaml_text import YamlError, load_yaml, text_of

# Parameters that a node takes at its start only.
FIXED = ("sample_period_s",)


def parameter_text(nodes: Mapping[str, Mapping[str, Any]], comments: Sequence[str] = ()) -> str:
    """Return a ROS parameter file: node's full name -> its parameters, after the comments."""
    lines = [f"# {line}".rstrip() for line in comments]
    for name, parameters in nodes.items():
        lines += [f"{name}:", "  ros__parameters:"]
        lines += [f"    {key}: {_scalar(value)}" for key, value in parameters.items()]
    return "\n".join(lines) + "\n"


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write a file whole or not at all.

    Raises
    ------
    ControlError
        If its folder is not there or cannot be written.
    """
    try:
        write_whole(path, text)
    except OSError as error:
        raise ControlError(f"{path}: cannot write ({error.strerror})") from error


def read_parameters(path: str | os.PathLike[str], axis: str, node: str = "controller"
                    ) -> dict[str, Any]:
    """Return the parameters that a file has for a node of an axis; empty if it has none for it.

    Names may be full (`/stage/x/controller`) or wild (`/**/controller`, `/**`, `controller`); a
    file without `ros__parameters` anywhere is taken as the controller's parameters themselves.

    Raises
    ------
    ControlError
        If the file cannot be read or is no parameter file.
    """
    try:
        content = load_yaml(text_of(path))
    except OSError as error:
        raise ControlError(f"{path}: cannot read the parameter file: {error.strerror}") from None
    except ValueError:
        raise ControlError(f"{path}: cannot read the parameter file: it is not UTF-8 text"
                           ) from None
    except YamlError as error:
        raise ControlError(f"{error.at(path)}: not valid YAML: {error}") from None
    if not isinstance(content, Mapping) or not all(isinstance(name, str) for name in content):
        raise ControlError(f"{path}: a parameter file is a mapping of nodes to ros__parameters")
    if not any(isinstance(each, Mapping) for each in content.values()):
        return dict(content) if node == "controller" else {}
    found: dict[str, Any] = {}
    for name in ("/**", node, f"/**/{node}", f"/stage/{axis}/{node}"):
        section = content.get(name)
        if isinstance(section, Mapping) and isinstance(section.get("ros__parameters"), Mapping):
            found |= section["ros__parameters"]
    return found


def _scalar(value: Any) -> str:
    if isinstance(value, float):
        text = repr(value)
        mantissa, e, exponent = text.partition("e")
        return text if "." in mantissa else f"{mantissa}.0{e}{exponent}"
    return json.dumps(value)
