"""Colours on a terminal, and nowhere else."""

from __future__ import annotations

import os
import sys
from typing import Literal, TextIO

Tone = Literal["good", "warn", "bad"]
TONES: dict[str, Tone] = {"none": "good", "retune": "good", "named": "good", "ambiguous": "warn",
                          "unknown": "bad", "not_excited": "warn"}
"""How good news each verdict of the diagnosis is."""
_CODES = {"good": "32", "warn": "33", "bad": "31"}


def paint(text: str, tone: Tone, stream: TextIO | None = None) -> str:
    """Return text in a colour where `stream` (default: stdout) is a terminal that shows colours.

    NO_COLOR, if it is set to anything, and TERM=dumb turn them off (https://no-color.org).
    """
    out = stream if stream is not None else sys.stdout
    plain = (not out.isatty() or bool(os.environ.get("NO_COLOR"))
             or os.environ.get("TERM") == "dumb")
    return text if plain else f"\x1b[{_CODES[tone]}m{text}\x1b[0m"
