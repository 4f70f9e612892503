"""What goes wrong when a trajectory or an experiment is described."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from dfm_stage.errors import DfmError


class TrajectoryError(DfmError):
    """A specification cannot be turned into a signal; `key` is the dotted place in it."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


class LimitError(DfmError):
    """A trajectory leaves what the stage is allowed to do."""


def nearest(name: object, known: Iterable[str]) -> str:
    """Return "did you mean ...?" for a misspelt name, or the list of what there is."""
    names = sorted(known)
    close = get_close_matches(str(name), names, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(names)}"


def place(where: str, message: str) -> str:
    """Put `where` before a message, if there is one."""
    return f"{where}: {message}" if where else message
