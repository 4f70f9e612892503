"""A progress line on a terminal, or a line now and then where there is none."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

_BAR = 24
_FIRST_AFTER_S = 2.0
_EVERY_S = (0.1, 10.0)


class Progress:
    """Say on stderr what is being done and how far it is.

    >>> with Progress("scan") as progress:
    ...     progress(0.5)

    On a terminal the line is rewritten in place; elsewhere nothing is written before two seconds
    have passed, and then a line every ten.
    """

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        self._what = what
        self._stream = stream or sys.stderr
        self._terminal = self._stream.isatty()
        self._start = self._last = time.monotonic()
        self._said = False

    def __call__(self, fraction: float) -> None:
        """Show that `fraction` (0 to 1) is done."""
        now = time.monotonic()
        if now - self._last < (_EVERY_S[0] if self._terminal else
                               _EVERY_S[1] if self._said else _FIRST_AFTER_S):
            return
        self._last, self._said = now, True
        elapsed = now - self._start
        left = f", {elapsed * (1.0 - fraction) / fraction:.0f} s left" if fraction > 0.02 else ""
        bar = "#" * round(_BAR * min(1.0, fraction))
        text = f"{self._what} [{bar:.<{_BAR}}] {100 * fraction:3.0f} %{left}"
        print(f"\r{text:<79}" if self._terminal else f"{text}\n", end="", file=self._stream,
              flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal and self._said:
            print("\r" + " " * 79, end="\r", file=self._stream, flush=True)


@contextmanager
def steps(what: str, quiet: bool = False, stream: TextIO | None = None
          ) -> Iterator[Callable[[str], None]]:
    """Yield a function that takes the name of the step begun, for work whose length is not known.

    On a terminal the line shows the step and the time, and keeps moving; elsewhere the steps that
    begin after the first two seconds are a line each.
    """
    out = stream or sys.stderr
    begun = time.monotonic()
    finished = threading.Event()
    live = out.isatty() and not quiet
    name, shown = "", 0

    def draw() -> None:
        nonlocal shown
        text = f"{what}: {name}, {time.monotonic() - begun:.0f} s"
        print(f"\r{text:<{shown}}", end="", file=out, flush=True)
        shown = len(text)

    def tick() -> None:
        while not finished.wait(0.5):
            draw()

    def step(begins: str) -> None:
        nonlocal name
        name = begins
        if live:
            draw()
        elif not quiet and time.monotonic() - begun > _FIRST_AFTER_S:
            print(f"{what}: {name}", file=out, flush=True)

    thread = threading.Thread(target=tick, daemon=True)
    if live:
        thread.start()
    try:
        yield step
    finally:
        finished.set()
        if live:
            thread.join()
            print(f"\r{'':<{shown}}", end="\r", file=out, flush=True)
