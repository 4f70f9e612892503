"""YAML from outside, read in bounded time: its depth, its length and what aliases stand for."""

from __future__ import annotations

import os
import warnings
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer, ComposerError
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.events import AliasEvent, ScalarEvent

from dfm_stage.errors import DfmError

LONGEST = 1_000_000
"""Characters; a model has thousands."""
MOST_NODES = 50_000
"""Names, values, lists and mappings, those that aliases repeat included: some seconds."""
DEEPEST = 40
"""Levels; everything that walks a tree afterwards calls itself at each of them."""
MOST_DIGITS = 400
"""Of a whole number: the largest float has 309."""


class YamlError(DfmError):
    """A text that is no YAML, or more than is read; `line` counts from 1, None if unknown."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line

    def at(self, path: object) -> str:
        """The path with the line, if there is one."""
        return f"{path}:{self.line}" if self.line else str(path)


def text_of(path: str | os.PathLike[str]) -> str:
    """The text of a file, not much more of it than `load_yaml` takes.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, is not UTF-8, or if no file can have this name.
    """
    with open(path, encoding="utf-8") as file:
        return file.read(LONGEST + 1)


def load_yaml(text: str, layout: bool = False) -> Any:
    """What a text holds, as plain values; with `layout` as ruamel's, which know their lines.

    Raises
    ------
    YamlError
        If it is not YAML, or longer, deeper or larger than is read.
    """
    if len(text) > LONGEST:
        raise YamlError(f"more than {LONGEST} characters")
    yaml = YAML(typ="rt" if layout else "safe", pure=True)
    yaml.Composer = _Bounded
    yaml.preserve_quotes = layout
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return yaml.load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise YamlError(" ".join(str(error.problem or error.context or "malformed").split()),
                        None if mark is None else mark.line + 1) from None
    except Exception as error:  # noqa: BLE001 odd text makes ruamel raise errors of every kind
        raise YamlError(" ".join(str(error).split()) or type(error).__name__) from None


class _Bounded(Composer):
    """Counts nodes and levels while they are put together, before anything is built of them."""

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader=loader)
        self._nodes = self._levels = 0
        self._sizes: dict[str, int] = {}

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        before = self._nodes
        self._nodes += 1
        self._levels += 1
        if self._levels > DEEPEST:
            self._refuse(f"more than {DEEPEST} levels", event)
        if isinstance(event, AliasEvent) and event.anchor in self.anchors:
            if event.anchor not in self._sizes:
                self._refuse(f"{event.anchor} holds itself", event)
            self._nodes += self._sizes[event.anchor]
        elif event.anchor is not None:
            self._sizes.pop(event.anchor, None)
        if self._nodes > MOST_NODES:
            self._refuse(f"more than {MOST_NODES} values, counting those that aliases repeat",
                         event)
        node = super().compose_node(parent, index)
        if isinstance(event, ScalarEvent) and len(event.value) > MOST_DIGITS \
                and str(node.tag).endswith(":int"):
            self._refuse(f"a number of {len(event.value)} digits", event)
        if event.anchor is not None and not isinstance(event, AliasEvent):
            self._sizes[event.anchor] = self._nodes - before
        self._levels -= 1
        return node

    @staticmethod
    def _refuse(reason: str, event: Any) -> None:
        raise ComposerError(None, None, reason, event.start_mark)
