"""The one base of every error this package raises on purpose."""

from __future__ import annotations


class DfmError(Exception):
    """An error whose message is one line: what is wrong, where, and what to do about it.

    Line ends in what was quoted, such as a key of a file, become spaces.
    """

    def __str__(self) -> str:
        return " ".join(super().__str__().split("\n"))


class CheckFailedError(DfmError):
    """The input is usable, but what was asked for cannot be answered for: exit code 1, not 2."""
