"""The one base of every error this package raises on purpose."""

from __future__ import annotations

LONGEST = 800
"""Characters of a message; paths are rarely longer than a third of it."""


class DfmError(Exception):
    """An error whose message is one line: what is wrong, where, and what to do about it.

    What was quoted, such as a key of a file, may be anything: its line ends become spaces, what
    a terminal would obey is escaped, and the middle of a very long message is left out.
    """

    def __str__(self) -> str:
        text = " ".join(Exception.__str__(self).splitlines())
        if len(text) > LONGEST:
            text = f"{text[:LONGEST * 2 // 3]} ... {text[-LONGEST // 4:]}"
        if text.isprintable():
            return text
        return "".join(each if each.isprintable() else ascii(each)[1:-1] for each in text)


class CheckFailedError(DfmError):
    """The input is usable, but what was asked for cannot be answered for: exit code 1, not 2."""
