"""What goes wrong when a trajectory or an experiment is described."""

from __future__ import annotations

from dfm_stage.errors import DfmError


class TrajectoryError(DfmError):
    """A specification cannot be turned into a signal; `key` is the dotted place in it."""

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


class LimitError(DfmError):
    """A trajectory leaves what the stage is allowed to do."""


def place(where: str, message: str) -> str:
    """Put `where` before a message, if there is one."""
    return f"{where}: {message}" if where else message
