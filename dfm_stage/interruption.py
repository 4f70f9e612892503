"""SIGINT and SIGTERM while a process begins and ends: no word, and the code that shells expect.

While modules are imported nobody can answer a KeyboardInterrupt, and after the work is done nobody
needs one. Here the signals end the process on the spot in both. In between a node takes them
itself (`nodes.process.StopRequest`), and a tool gets its KeyboardInterrupt (`as_usual`).
"""

from __future__ import annotations

import os
import signal
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = 128 + signal.SIGINT
_asked: list[int] = []


def end_at_once() -> None:
    """From now on a signal ends the process with 128 + its number; what is ignored stays so.

    Whoever starts the process may have blocked the signals until it can answer them: now it can.
    """
    for number in SIGNALS:
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _end)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)


def as_usual() -> None:
    """After `end_at_once`, SIGINT raises KeyboardInterrupt, and SIGTERM ends the process."""
    if signal.getsignal(signal.SIGTERM) is _end:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, _raise)


def work_is_over() -> None:
    """After `as_usual`, signals end the process at once again."""
    if signal.getsignal(signal.SIGINT) is _raise:
        end_at_once()


def interrupted() -> bool:
    """Whether SIGINT came after `as_usual`: a library may have turned it into another error."""
    return bool(_asked)


def block() -> None:
    """Hold the signals back until the program that takes this process over can answer them."""
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)


def _end(number: int, _frame: FrameType | None) -> None:
    os._exit(128 + number)


def _raise(number: int, _frame: FrameType | None) -> None:
    _asked.append(number)
    raise KeyboardInterrupt
