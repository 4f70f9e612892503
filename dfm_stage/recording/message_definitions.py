"""ROS 2 message definitions: found in installed packages, joined into schema texts, parsed.

A schema text ("ros2msg") is the definition of one message followed by those of every message it
uses, each after a line of 80 `=` and a line `MSG: package/Type`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dfm_stage.recording.errors import DefinitionError

PRIMITIVES = frozenset({
    "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64",
    "uint64", "float32", "float64", "string", "wstring"})
SEPARATOR = "=" * 80

_LINE = re.compile(r"(?P<type>\S+)\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)")
_TYPE = re.compile(r"(?P<base>[A-Za-z][\w/]*)(?:<=(?P<text_bound>\d+))?"
                   r"(?:\[(?P<bounded><=)?(?P<count>\d+)?\])?(?P<end>$)")
_TYPE_NAME = re.compile(r"(?P<package>[A-Za-z]\w*)/(?:msg/)?(?P<name>[A-Za-z]\w*)")


@dataclass(frozen=True)
class Field:
    """One field of a message: `base` is a primitive or the full name `package/msg/Type`.

    `count` is None for a single value, a positive number for a fixed array, and 0 for a sequence.
    """

    name: str
    base: str
    count: int | None = None


def full_name(type_name: str) -> str:
    """Return `package/msg/Type` for that name or its short form `package/Type`.

    Raises
    ------
    DefinitionError
        If it is neither.
    """
    match = _TYPE_NAME.fullmatch(type_name)
    if match is None:
        raise DefinitionError(f"{type_name!r} is not a message type: write package/msg/Type")
    return f"{match['package']}/msg/{match['name']}"


def parse_fields(text: str, type_name: str) -> list[Field]:
    """Return the fields of one definition, constants left out.

    Raises
    ------
    DefinitionError
        If a line is not a field, a constant, a comment or empty.
    """
    package = full_name(type_name).split("/")[0]
    fields = []
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        kind = _TYPE.fullmatch(match["type"]) if match else None
        if match is None or kind is None:
            raise DefinitionError(f"{type_name}, line {number}: {line[:60]!r} is not a field")
        if match["rest"].startswith("="):
            continue
        base = kind["base"]
        if base not in PRIMITIVES:
            base = full_name(base if "/" in base else f"{package}/{base}")
        fixed = kind["count"] is not None and not kind["bounded"]
        count = int(kind["count"]) if fixed else 0 if match["type"].endswith("]") else None
        if fixed and not count:
            raise DefinitionError(f"{type_name}, line {number}: an array of no elements")
        fields.append(Field(match["name"], base, count))
    return fields


def parse_schema(text: str, type_name: str) -> dict[str, list[Field]]:
    """Return the fields of every message in a schema text, by full name; `type_name` is first.

    Raises
    ------
    DefinitionError
        If a part cannot be parsed.
    """
    definitions = {}
    for index, part in enumerate(re.split(r"^={80}[ \t]*\r?\n", text, flags=re.MULTILINE)):
        name, body = full_name(type_name), part
        if index:
            head, _, body = part.partition("\n")
            if not head.startswith("MSG:"):
                raise DefinitionError(f"{type_name}: part {index + 1} of its schema has no "
                                      f"'MSG: package/Type' line")
            name = full_name(head[4:].strip())
        definitions[name] = parse_fields(body, name)
    return definitions


def ament_share_folders() -> list[Path]:
    """Return the share folder of every prefix in AMENT_PREFIX_PATH."""
    return [Path(prefix) / "share" for prefix in
            os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]


def definition_text(type_name: str, share_folders: Sequence[Path] | None = None) -> str:
    """Return the schema text of a message type from installed `.msg` files.

    Parameters
    ----------
    type_name : str
        `package/msg/Type`.
    share_folders : sequence of Path, optional
        Folders that hold `package/msg/Type.msg`; by default those of AMENT_PREFIX_PATH.

    Raises
    ------
    DefinitionError
        If a definition is not there or cannot be parsed.
    """
    folders = ament_share_folders() if share_folders is None else list(share_folders)
    wanted = [full_name(type_name)]
    texts: dict[str, str] = {}
    while wanted:
        name = wanted.pop(0)
        if name not in texts:
            texts[name] = _installed_text(name, folders)
            wanted += (field.base for field in parse_fields(texts[name], name)
                       if field.base not in PRIMITIVES)
    first, *others = texts.items()
    return "".join((first[1].rstrip("\n") + "\n", *(
        f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n" + text.rstrip("\n") + "\n"
        for name, text in others)))


def _installed_text(type_name: str, folders: Sequence[Path]) -> str:
    package, _, short = type_name.split("/")
    for folder in folders:
        path = folder / package / "msg" / f"{short}.msg"
        try:
            return path.read_text(encoding="utf-8")
        except FileNotFoundError:
            continue
        except (OSError, UnicodeDecodeError) as error:
            raise DefinitionError(f"{path}: cannot be read ({error})") from error
    searched = ", ".join(map(str, folders)) or "no folder (AMENT_PREFIX_PATH is empty)"
    raise DefinitionError(f"{type_name}: no {package}/msg/{short}.msg in {searched}; "
                          f"source the installation that has it")
