"""What can go wrong when runs are recorded and read; every message is one line."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path

from dfm_stage.errors import DfmError


class RecordingError(DfmError):
    """Base of the errors of this package."""


class BagWriteError(RecordingError):
    """A bag cannot be created, or can no longer be written to."""


class BagReadError(RecordingError):
    """A bag, or what was asked of it, cannot be read at all."""


class NotInBagError(BagReadError, KeyError):
    """A topic or field that was asked for is not in the bag."""


class DefinitionError(RecordingError):
    """The definition of a message type is missing or cannot be understood."""


class MissingPackageError(RecordingError, ImportError):
    """An optional package that was asked for is not installed."""


class RecordError(RecordingError):
    """A file does not hold a usable record; the message names the place in the file.

    `path` is the file, which the message then begins with; None as long as it is not known.
    """

    def __init__(self, text: str, path: str | os.PathLike[str] | None = None) -> None:
        super().__init__(text if path is None else f"{path}: {text}")
        self.path = path


@contextlib.contextmanager
def in_file(path: Path) -> Iterator[None]:
    """Name the file in each RecordError that does not yet, and in what a bag lacks."""
    try:
        yield
    except (RecordError, NotInBagError) as error:
        if getattr(error, "path", None) is not None:
            raise
        raise RecordError(str(error), path) from None


_REMEDIES = {
    errno.ENOSPC: "the disk is full; free some space or choose a folder on another disk",
    errno.EDQUOT: "the disk quota is used up; free some space or choose another disk",
    errno.EFBIG: "the file would grow beyond the allowed size; raise the limit (ulimit -f)",
    errno.EACCES: "no permission to write here; choose another folder",
    errno.EPERM: "no permission to write here; choose another folder",
    errno.EROFS: "the disk is read-only; choose another folder",
    errno.EEXIST: "exists already and nothing is overwritten; choose another name",
    errno.ENOTDIR: "a part of this path is a file, not a folder; choose another name",
}


@contextlib.contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Raise a BagWriteError that says what to do where the system refuses to write `path`."""
    try:
        yield
    except OSError as error:
        reason = _REMEDIES.get(error.errno or 0, error.strerror or str(error))
        raise BagWriteError(f"{path}: {reason}") from error
