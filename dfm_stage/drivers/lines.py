"""Bytes as they arrive into lines, whatever their fragments."""

from __future__ import annotations

from typing import NamedTuple

LONGEST_LINE = 256


class Line(NamedTuple):
    """One line without its end; `after` bytes of the same `feed` came after that."""

    text: bytes
    after: int


class LineBuffer:
    """Splits a byte stream at any of `ends`; empty lines are dropped.

    A line longer than LONGEST_LINE is noise and is thrown away up to its end.
    """

    def __init__(self, ends: bytes = b"\r\n") -> None:
        self._ends = ends
        self._rest = bytearray()
        self._skipping = False

    def feed(self, data: bytes) -> list[Line]:
        """Return the lines that are complete now."""
        lines = []
        begin = 0
        for index, byte in enumerate(data):
            if byte in self._ends:
                self._rest += data[begin:index]
                begin = index + 1
                if len(self._rest) > LONGEST_LINE:
                    self._skipping = True
                if self._rest and not self._skipping:
                    lines.append(Line(bytes(self._rest), len(data) - begin))
                self._skipping = False
                self._rest.clear()
        self._rest += data[begin:]
        if len(self._rest) > LONGEST_LINE:
            self._skipping = True
            self._rest.clear()
        return lines

    def clear(self) -> None:
        """Forget an unfinished line."""
        self._rest.clear()
        self._skipping = False
