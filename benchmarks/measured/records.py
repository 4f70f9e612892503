"""The table of measured records: their sources, and what a diagnosis of each should say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

TABLE = Path(__file__).with_name("records.yaml")


@dataclass(frozen=True)
class Expected:
    """What is right: see the head of records.yaml."""

    verdicts: tuple[str, ...]
    why: str
    first: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    required: tuple[tuple[str, ...], ...] = ()
    complete: bool | None = None

    @property
    def allowed(self) -> frozenset[str]:
        """Every name that is not wrong."""
        return frozenset((*self.first, *self.also))


@dataclass(frozen=True)
class MeasuredRecord:
    """One entry of the table. `fit` and `hold` are names of parts, each with its words.

    `development` says that it was used to set rules, `answers_used` that it was after a first run.
    """

    name: str
    what: str
    source: str
    licence: str
    files: tuple[str, ...]
    rate: str
    fit: Mapping[str, str]
    hold: Mapping[str, str]
    expected: Expected
    published: tuple[str, ...]
    development: bool = False
    answers_used: bool = False
    folder: str = ""
    model: Mapping[str, Any] = field(default_factory=dict)
    model_file: str | None = None
    options: tuple[str, ...] = ()
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    rmse: Mapping[str, Any] | None = None
    force: Mapping[str, Any] | None = None

    def where(self, folders: Sequence[Path]) -> Path | None:
        """The first of the folders' subfolders that holds all files of the record, or None."""
        for folder in folders:
            found = folder / (self.folder or self.name)
            if all((found / own_name(file)).is_file() for file in self.files):
                return found
        return None

    @property
    def set_rules(self) -> bool:
        """Whether answers on it are not blind."""
        return self.development or self.answers_used

    @property
    def how_to_get(self) -> str:
        """One line: what to put where."""
        names = ", ".join(file if AS in file else own_name(file) for file in self.files)
        return f"put {names} of {self.source} into DIR/{self.folder or self.name}"


AS = " as "
"""Between the path of a file at its source and another name for the reader's own copy."""


def own_name(file: str) -> str:
    """The name of the reader's own copy of a file."""
    return Path(file.rpartition(AS)[2]).name


def load_records(table: Path = TABLE) -> dict[str, MeasuredRecord]:
    """Return the table, in its order.

    Raises
    ------
    TypeError
        If an entry has a key that means nothing, or lacks one.
    """
    content = YAML(typ="safe").load(table.read_text("utf-8"))
    return {name: _record(name, entry) for name, entry in content.items()}


def _record(name: str, entry: Mapping[str, Any]) -> MeasuredRecord:
    expected = dict(entry["expected"])
    expected["why"] = " ".join(expected["why"].split())
    expected["required"] = tuple(tuple(group) for group in expected.get("required", ()))
    for key in ("verdicts", "first", "also"):
        expected[key] = tuple(expected.get(key, ()))
    lists = {key: tuple(entry.get(key, ())) for key in ("files", "published", "options")}
    return MeasuredRecord(name=name, **{**entry, **lists, "expected": Expected(**expected)})
